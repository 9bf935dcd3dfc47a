use std::fs::{self, Permissions};
use std::os::unix::fs::{FileExt as _, MetadataExt as _, PermissionsExt as _};

use super::*;
use crate::recording::csv_cells::whole_rows;
use crate::recording::{MemoryRecorder, ReadOptions, open_run, run_from_memory};
use drivebench_model::sample::{Applied, Channel, Origin};

fn layout() -> Layout {
    Layout::of_drive(&[Channel::VoltageCmd, Channel::Current, Channel::Speed])
}

/// A session: a command and its sample in each cycle, and 20 events.
fn drive(recorder: &mut dyn Record, cycles: u32) {
    for cycle in 0..cycles {
        let seq = u64::from(cycle) + 1;
        let time_s = f64::from(cycle) * 0.01;
        recorder.command(&CommandRow::volts(seq, time_s, f64::from(cycle % 7)));
        let mut sample = Sample::at(time_s + 0.004)
            .with(Channel::Current, f64::from(cycle) * 0.1)
            .with(Channel::Speed, -f64::from(cycle));
        sample.seq = Some(seq);
        sample.applied = Some(Applied { seq, time_s: time_s + 0.001 });
        recorder.row(&sample);
        if cycle % 50 == 0 && cycle < 1000 {
            recorder.event(Event::new(time_s, Some(seq), "mark").with("cycle", cycle));
        }
    }
}

fn read(path: std::path::PathBuf) -> String {
    fs::read_to_string(path).unwrap()
}

fn manifest() -> Manifest {
    let mut manifest = Manifest { name: "test".into(), ..Manifest::default() };
    manifest.set_origin(Channel::Current, Origin::Measured);
    manifest
}

fn recorder(root: &std::path::Path) -> Recorder {
    let folder = RunFolder::create(root, "20260131T000000Z", "test").unwrap();
    Recorder::create(folder, layout(), &manifest(), 50).unwrap()
}

#[test]
fn disk_and_memory_hold_the_same_bytes() {
    let root = tempfile::tempdir().unwrap();
    let mut disk = recorder(root.path());
    drive(&mut disk, 200);
    let folder = disk.folder().clone();
    let kept = disk.finish(&manifest());
    assert_eq!((kept.status.rows, kept.error), (400, None));
    let again = Recorder::create(folder.clone(), layout(), &manifest(), 50);
    assert!(again.is_err(), "a folder with a run is not recorded into again");
    let mut memory = MemoryRecorder::new(layout());
    drive(&mut memory, 200);
    memory.flush();
    let [samples, events] = [folder.samples(), folder.events()].map(read);
    assert_eq!(samples, memory.samples);
    assert_eq!(events, memory.events);
    assert_eq!(memory.events.lines().count(), 4);

    let loaded = open_run(folder.path(), ReadOptions::default()).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    assert_eq!(loaded.manifest.unwrap().rows, Some(400));
    assert_eq!(loaded.run.rows(), 400);
    assert_eq!(loaded.run.points(Channel::VoltageCmd).count(), 200);
    assert_eq!(loaded.run.origin(Channel::Current), Origin::Measured);
    assert_eq!(loaded.run.time_s(), memory.run("m").unwrap().time_s());
}

#[test]
fn a_run_that_is_dropped_keeps_its_rows_and_stays_unfinished() {
    let root = tempfile::tempdir().unwrap();
    let mut disk = recorder(root.path());
    let path = disk.folder().path().to_owned();
    assert!(read(path.join("manifest.json")).contains("\"finished\": false"));
    drive(&mut disk, 10);
    drop(disk);
    let loaded = open_run(&path, ReadOptions::default()).unwrap();
    assert_eq!((loaded.run.rows(), loaded.run.rows_dropped), (20, 0));
    assert!(loaded.warnings[0].contains("not finished"));
}

/// A kill leaves whole lines only.
#[test]
fn the_file_grows_by_whole_lines() {
    let root = tempfile::tempdir().unwrap();
    let folder = RunFolder::create(root.path(), "s", "lines").unwrap();
    let (samples, events) = folder.create_logs().unwrap();
    let lines = |file| Lines::new(Log(Ok(file)), Capacity::SAMPLES);
    let mut journal = Journal::new(layout(), lines(samples), lines(events), 50);
    for row in 0..50_usize {
        let mut line = Row::at(row as f64);
        line.set(Channel::Current, Some(row as f64 / 3.0));
        journal.rows(&[line]);
        let text = read(folder.samples());
        assert!(text.ends_with('\n'));
        assert_eq!(text.lines().count(), row + 2);
    }
}

/// The files of a whole run of so many cycles.
fn expected(cycles: u32) -> (String, String) {
    let mut memory = MemoryRecorder::new(layout());
    drive(&mut memory, cycles);
    memory.flush();
    (memory.samples, memory.events)
}

fn wait_for_message(disk: &Recorder) -> String {
    for _ in 0..1000 {
        if let Some(messages) = disk.status().messages.last() {
            return messages.clone();
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    String::new()
}

#[test]
fn a_folder_that_is_deleted_or_renamed_is_made_again_whole() {
    let cycles = 50_000;
    for renamed in [false, true] {
        let root = tempfile::tempdir().unwrap();
        let folder = RunFolder::create(root.path(), "20260131T000000Z", "test").unwrap();
        let mut disk = Recorder::create(folder, layout(), &manifest(), 10_000).unwrap();
        // More than the rows that are kept in memory after they are written.
        drive(&mut disk, cycles);
        let path = disk.folder().path().to_owned();
        if renamed {
            fs::rename(&path, root.path().join("elsewhere")).unwrap();
        } else {
            fs::remove_dir_all(&path).unwrap();
        }
        // It is checked while no row arrives.
        let messages = wait_for_message(&disk);
        assert!(messages.contains("was deleted or renamed"), "{messages:?}");
        assert!(messages.contains("made again in"), "{messages:?}");
        let kept = disk.finish(&manifest());
        assert_eq!(kept.error, None);
        assert!(kept.status.error.is_some());
        let loaded = open_run(kept.folder.path(), ReadOptions::default()).unwrap();
        assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
        let (samples, events) = expected(cycles);
        assert!(samples.len() > 2 * Capacity::SAMPLES.written);
        assert_eq!(read(kept.folder.samples()), samples);
        assert_eq!(read(kept.folder.events()), events);
        assert_eq!(kept.logs.samples(), Some(samples.into_bytes()));
    }
}

#[test]
fn a_folder_that_is_gone_when_the_run_ends_is_made_again_too() {
    let root = tempfile::tempdir().unwrap();
    let mut disk = recorder(root.path());
    drive(&mut disk, 3);
    fs::remove_dir_all(disk.folder().path()).unwrap();
    drive(&mut disk, 3);
    let kept = disk.finish(&manifest());
    assert_eq!(kept.error, None);
    let loaded = open_run(kept.folder.path(), ReadOptions::default()).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
}

#[test]
fn a_run_whose_folder_cannot_be_made_again_is_kept_in_memory() {
    let root = tempfile::tempdir().unwrap();
    let runs = root.path().join("runs");
    let mut disk = recorder(&runs);
    drive(&mut disk, 30);
    fs::rename(&runs, root.path().join("elsewhere")).unwrap();
    fs::write(&runs, "a file stands in the way").unwrap();
    let messages = wait_for_message(&disk);
    assert!(messages.contains("cannot be made again"), "{messages:?}");
    let kept = disk.finish(&manifest());
    assert!(matches!(kept.error, Some(RecordingError::Io { .. })), "{:?}", kept.error);
    let samples = kept.logs.samples().unwrap();
    assert_eq!(String::from_utf8_lossy(&samples), expected(30).0);
    // Another folder takes all of it.
    let rescue = |place: &str| {
        let place = root.path().join(place);
        kept.logs.rescue(&kept.folder, &place, &manifest()).unwrap().unwrap()
    };
    let rescued = rescue("other");
    let rights = |folder: &RunFolder| fs::metadata(folder.path()).unwrap().mode() & 0o777;
    assert_eq!(rights(&rescued), 0o700);
    let (samples_csv, events_jsonl) = expected(30);
    assert_eq!(read(rescued.samples()), samples_csv);
    assert_eq!(read(rescued.events()), events_jsonl);
    // It has the permissions of the folder that it replaces.
    fs::remove_file(&runs).unwrap();
    fs::create_dir_all(kept.folder.path()).unwrap();
    fs::set_permissions(kept.folder.path(), Permissions::from_mode(0o750)).unwrap();
    assert_eq!(rights(&rescue("third")), 0o750);
    let run = run_from_memory(kept.folder.path(), &samples, &manifest()).unwrap();
    assert_eq!(run.run.rows(), 60);
    assert_eq!(run.run.origin(Channel::Current), Origin::Measured);
}

/// After a power cut all whole rows of a log are read to the bit, the torn one is reported, and nothing else is read. Reading
/// takes exactly the bytes of `whole_rows`, which is checked at every byte; the rows are compared once for each of these
/// lengths, and with a part of the next row behind them.
#[test]
fn a_log_cut_at_any_byte_gives_all_its_whole_rows() {
    let (samples, _) = expected(500);
    let bytes = samples.as_bytes();
    let ends: Vec<usize> = samples.match_indices('\n').map(|(at, _)| at + 1).collect();
    assert_eq!(ends.len(), 1001);
    let mut before = 0;
    for cut in 0..=bytes.len() {
        if ends.contains(&cut) {
            before = cut;
        }
        let (length, is_torn) = whole_rows(&mut std::io::Cursor::new(&bytes[..cut])).unwrap();
        assert_eq!((length, is_torn), (before as u64, before != cut), "cut at byte {cut}");
    }
    let folder = std::path::Path::new("r");
    let read = |cut: usize| run_from_memory(folder, &bytes[..cut], &manifest());
    let all = read(bytes.len()).unwrap().run;
    let channels = [Channel::VoltageCmd, Channel::Current, Channel::Speed];
    for (rows, pair) in ends.windows(2).enumerate() {
        for cut in [pair[0], pair[0] + 1, pair[1] - 1] {
            let torn = usize::from(cut != pair[0]);
            let loaded = match read(cut) {
                // The header alone is no run.
                Err(RecordingError::NoRows { .. }) if rows == 0 => continue,
                loaded => loaded.unwrap(),
            };
            let run = loaded.run;
            assert_eq!((run.rows(), run.rows_dropped), (rows, torn), "cut at byte {cut}");
            assert_eq!(loaded.warnings.len(), torn, "{:?}", loaded.warnings);
            assert_eq!(run.time_s(), &all.time_s()[..rows]);
            for channel in channels {
                let bits = |run: &drivebench_model::sample::Run| -> Option<Vec<u64>> {
                    let cells = run.column(channel)?.get(..rows)?;
                    Some(cells.iter().map(|cell| cell.to_bits()).collect())
                };
                let missing = vec![f64::NAN.to_bits(); rows];
                assert_eq!(bits(&run).unwrap_or(missing), bits(&all).unwrap());
            }
        }
    }
    assert!(read(ends[0] - 1).is_err(), "a header that is torn names no columns");
}

/// The manifest is replaced atomically; without that the samples are still read.
#[test]
fn a_manifest_cut_at_any_byte_loses_no_rows() {
    let root = tempfile::tempdir().unwrap();
    let mut disk = recorder(root.path());
    drive(&mut disk, 3);
    let kept = disk.finish(&manifest());
    let path = kept.folder.path().join("manifest.json");
    let text = read(path.clone());
    for cut in 0..text.len() {
        fs::write(&path, &text[..cut]).unwrap();
        let loaded = open_run(kept.folder.path(), ReadOptions::default()).unwrap();
        assert_eq!(loaded.run.rows(), 6);
        // Only its line feed may be missing.
        let is_whole = cut == text.len() - 1;
        assert_eq!(loaded.warnings.is_empty(), is_whole, "{:?}", loaded.warnings);
        assert_eq!(loaded.manifest.is_some(), is_whole);
    }
}

#[test]
fn a_folder_that_cannot_be_written_refuses_the_run() {
    let root = tempfile::tempdir().unwrap();
    let file = root.path().join("file");
    fs::write(&file, "no folder").unwrap();
    for place in [&file, std::path::Path::new("/proc"), std::path::Path::new("/dev/null")] {
        let error = RunFolder::create(place, "20260131T000000Z", "test").unwrap_err();
        assert!(matches!(error, RecordingError::Io { .. }), "{error}");
        assert!(error.help().contains("permissions"), "{}", error.help());
    }
    assert_eq!(read(file), "no folder");
}

const KILLED_ROOT: &str = "DRIVEBENCH_TEST_KILLED_ROOT";

/// File with the number of rows that the killed program has recorded.
const HANDED: &str = "handed";

/// Writes until it is killed, at the pace of its disk.
fn write_until_killed(root: &std::path::Path) {
    let mut recorder = recorder(root);
    let count = fs::File::create(root.join(HANDED)).unwrap();
    let mut handed = 0;
    for seq in 1..1_000_000_u32 {
        let (time_s, seq) = (f64::from(seq), u64::from(seq));
        recorder.command(&CommandRow::volts(seq, time_s, time_s));
        let mut sample = Sample::at(time_s + 0.5).with(Channel::Current, (time_s + 0.5) / 3.0);
        sample.seq = Some(seq);
        sample.applied = Some(Applied { seq, time_s: time_s + 0.25 });
        handed += recorder.row(&sample).len();
        count.write_all_at(&(handed as u64).to_le_bytes(), 0).unwrap();
        while recorder.status().rows < handed {
            std::thread::yield_now();
        }
    }
}

/// Starts this test as the program that is killed.
#[test]
fn a_killed_program_loses_no_whole_row() {
    if let Some(root) = std::env::var_os(KILLED_ROOT) {
        write_until_killed(std::path::Path::new(&root));
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let this = "recording::recorder::tests::a_killed_program_loses_no_whole_row";
    let mut child = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", this])
        .env(KILLED_ROOT, root.path())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let folder = RunFolder::existing(root.path().join("20260131T000000Z-test"));
    let size = || fs::metadata(folder.samples()).map_or(0, |data| data.len());
    while size() < 20_000 {
        let ended = child.try_wait().unwrap();
        assert_eq!(ended, None, "the program ended by itself");
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();

    let loaded = open_run(folder.path(), ReadOptions::default()).unwrap();
    assert!(loaded.run.rows() > 300);
    assert!(loaded.run.rows_dropped <= 1);
    let handed = fs::read(root.path().join(HANDED)).unwrap();
    let handed = u64::from_le_bytes(handed.try_into().unwrap());
    // Of the last cycle: a command and its sample.
    let lost = handed.saturating_sub(loaded.run.rows() as u64);
    assert!(lost <= 2, "{lost} of {handed} rows are lost");
    assert!(loaded.warnings.last().unwrap().contains("not finished"));
    for (time_s, current_a) in loaded.run.points(Channel::Current) {
        assert_eq!(current_a.to_bits(), (time_s / 3.0).to_bits());
    }
}
