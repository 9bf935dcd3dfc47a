//! `replay` through the real binary: the live run again, to the bit and in constant memory.

use crate::kit::motor_log::push;
use crate::kit::prelude::*;
use std::process::Command;
use std::sync::LazyLock;

/// A live run of the emulated motor; the tests work on copies.
fn live() -> &'static Path {
    static RUN: LazyLock<Recorded> =
        LazyLock::new(|| recorded("--emulator zk-22fc-plain --seed 3", &[]));
    &RUN
}

fn copy() -> (Desk, PathBuf) {
    let desk = Desk::new();
    let to = desk.path("run");
    fs::create_dir(&to).expect("a new folder");
    for entry in fs::read_dir(live()).expect("the run is there") {
        let path = entry.expect("an entry can be read").path();
        let name = path.file_name().expect("a file has a name");
        fs::copy(&path, to.join(name)).expect("a file can be copied");
    }
    (desk, to)
}

fn replay(run: &Path) -> Done {
    call("replay {} --json", &[run])
}

/// The samples with one line changed.
fn change(run: &Path, row: usize, with: impl Fn(&str) -> String) {
    let path = run.join("samples.csv");
    let text = fs::read_to_string(&path).expect("samples are text");
    let changed: String = text
        .lines()
        .enumerate()
        .map(|(n, line)| if n == row { with(line) } else { line.to_owned() } + "\n")
        .collect();
    assert_ne!(text, changed);
    fs::write(path, changed).expect("the copy can be written");
}

#[test]
fn a_live_run_comes_out_again_to_the_bit() {
    let result = replay(live()).expect(0).json();
    assert_eq!(result["identical"], true);
    assert_eq!(result["first_difference"], Value::Null);
    assert_eq!(result["configuration_from"], "manifest");
    let inertia = &result["parameters"]["inertia_kg_m2"];
    assert_eq!(inertia["verdict"], "settled");
    let kept = read_json(live().join("result.json"));
    assert_eq!(&kept["parameters"]["inertia_kg_m2"], inertia);
    assert!(kept["online"]["rows"].as_u64() > Some(1000));
    let text = call("replay {}", &[live()]).expect(0).stdout;
    has(&text, &["identical to the live estimates"]);
}

#[test]
fn one_changed_digit_is_found() {
    let (_out, run) = copy();
    let text = fs::read_to_string(run.join("samples.csv")).expect("samples");
    let rows: Vec<Vec<&str>> = text.lines().map(|row| row.split(',').collect()).collect();
    let column = rows[0].iter().position(|name| *name == "current_a");
    let column = column.expect("a current is recorded");
    // The last digit of one current in the middle of the run.
    let row = (rows.len() / 2..rows.len()).find(|row| rows[*row][column].len() > 3);
    change(&run, row.expect("a row with a current"), |line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        let last = cells[column].pop();
        cells[column].push(if last == Some('1') { '2' } else { '1' });
        cells.join(",")
    });
    let done = replay(&run).expect(1);
    let result = done.json();
    assert_eq!(result["identical"], false);
    let key = result["first_difference"]["key"].as_str().expect("a key");
    has(&done.error(), &[key]);
    assert!(key.starts_with("parameters."), "{key}");
}

#[test]
fn the_configuration_of_the_live_estimators_is_used() {
    let (_out, run) = copy();
    let path = run.join("manifest.json");
    let mut manifest = read_json(&path);
    let online = manifest["configs"]["online"].as_str().expect("a text");
    let other = online.replace("electrical_forgetting = 0.995", "electrical_forgetting = 0.97");
    assert_ne!(online, other);
    manifest["configs"]["online"] = Value::String(other);
    fs::write(&path, manifest.to_string()).expect("the copy can be written");
    let result = replay(&run).expect(1).json();
    assert_eq!(result["configuration"]["electrical_forgetting"], 0.97);
    assert_eq!(result["identical"], false);

    manifest["configs"]["online"] = Value::String("electrical = 1".into());
    fs::write(&path, manifest.to_string()).expect("the copy can be written");
    replay(&run).fails(2, &["configs.online"]);
}

#[test]
fn a_killed_run_has_nothing_to_compare_with_and_a_torn_row() {
    let (_out, run) = copy();
    let path = run.join("samples.csv");
    let text = fs::read_to_string(&path).expect("samples");
    fs::write(&path, &text[..text.len() * 2 / 3]).expect("the copy can be written");
    let manifest = fs::read_to_string(run.join("manifest.json")).expect("a manifest");
    let unfinished = manifest.replace("\"finished\": true", "\"finished\": false");
    assert_ne!(manifest, unfinished);
    fs::write(run.join("manifest.json"), unfinished).expect("the copy can be written");
    fs::remove_file(run.join("result.json")).expect("it was there");
    let done = replay(&run).expect(0);
    let result = done.json();
    assert_eq!(result["identical"], Value::Null);
    assert_eq!(result["rows_dropped"], 1);
    has(result["not_compared_because"].as_str().expect("a reason"), &["not finished"]);
    has(&done.stderr, &["last whole row"]);
    assert!(result["parameters"]["resistance_ohm"]["value"].is_number());
}

#[test]
fn a_foreign_file_is_replayed_by_its_map() {
    let (_out, run) = copy();
    let text = fs::read_to_string(run.join("samples.csv")).expect("samples");
    let foreign = run.join("log.csv");
    fs::write(&foreign, text.replace("time_s,", "t,")).expect("the copy can be written");
    let map = "time_s=t,voltage_cmd_v=voltage_cmd_v,current_a=current_a,speed_rad_s=speed_rad_s";
    let text = format!("replay {{}} --json --map {map}");
    let result = json_of(&text, &[&foreign]);
    assert_eq!(result["identical"], Value::Null);
    has(result["not_compared_because"].as_str().expect("a reason"), &["foreign"]);
    assert_eq!(result["configuration_from"], "default");
    let own = replay(live()).expect(0).json();
    // The live run started from the nameplate, the foreign one from nothing: the same motor, not the same bits.
    for key in ["resistance_ohm", "back_emf_v_s_per_rad", "inertia_kg_m2"] {
        let value = |of: &Value| parameter(of, key).expect("a value");
        let ratio = value(&result) / value(&own);
        assert!((ratio - 1.0).abs() < 0.01, "{key} {ratio}");
    }
    // Without speed no parameter is determined, and the reason is given.
    let done = call("replay {} --json --map time_s=t,current_a=current_a", &[&foreign]).expect(0);
    has(&done.stderr, &["no speed_rad_s"]);
    assert_eq!(done.json()["parameters"]["inertia_kg_m2"]["value"], Value::Null);
}

/// Under a limit on the memory that reading the whole run into columns goes far beyond.
#[test]
#[cfg(target_os = "linux")]
fn three_hundred_thousand_rows_stream_in_little_memory() {
    const ROWS: u32 = 300_000;
    let out = Desk::new();
    let path = out.path("long.csv");
    let mut text =
        "time_s,voltage_cmd_v,current_a,speed_rad_s,angle_rad,bus_v,torque_n_m\n".to_owned();
    for row in 0..ROWS {
        let time_s = f64::from(row) * 1e-3;
        let (wave, level) = ((time_s * 7.0).sin(), f64::from(row / 300 % 5));
        let cells = [time_s, level * 4.0, level + 0.1 * wave, level * 10.0 + wave, 1.0, 2.0, 3.0];
        push(&mut text, &cells);
    }
    fs::write(&path, &text).expect("a temporary file can be written");
    let limited = |arguments: &str| {
        let script = format!("ulimit -d 24576; exec \"$0\" {arguments}");
        let mut command = Command::new("sh");
        command.arg("-c").arg(script).arg(BINARY).arg(&path);
        Done::of(&command.output().expect("a shell can be started"))
    };
    assert_eq!(limited("replay \"$1\" --json").expect(0).json()["rows"], ROWS);
    // The same limit is too small for a command that holds the run: it is a limit.
    assert_ne!(limited("identify \"$1\" --json").status, 0);
}
