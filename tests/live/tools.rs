//! The everyday tools through the real binary, against the software drive in a process of its own over a
//! pseudo-terminal and TCP.

use crate::kit::prelude::*;

/// A software drive that never outlives its test.
struct Drive {
    emulator: Emulator,
    desk: Desk,
}

impl Drive {
    fn start(link: &str) -> Self {
        let desk = Desk::new();
        let emulator = Emulator::on(link, &desk.path("drive"), "", &[]);
        Self { emulator, desk }
    }

    /// Runs a command against this drive; `{}` in the text are the paths.
    fn ask(&self, text: &str, paths: &[&Path]) -> Done {
        let mut arguments = line(text, paths);
        let option = if self.emulator.address.contains(':') { "--host" } else { "--port" };
        arguments
            .extend([option, &self.emulator.address, "--timeout-ms", "20000"].map(PathBuf::from));
        drivebench(arguments)
    }
}

#[track_caller]
fn balances(counters: &Value) {
    let of = |name: &str| counters[name].as_u64().expect("a count");
    let sum: u64 = "ok timeout crc stale mismatch exception aborted".split(' ').map(of).sum();
    assert_eq!(of("sent"), sum, "{counters}");
}

#[test]
fn registers_are_read_as_in_the_contract() {
    for link in ["modbus-rtu", "modbus-tcp"] {
        let drive = Drive::start(link);
        let result = drive.ask("registers read 64:2 0x40 --repeat 5 --json", &[]).expect(0).json();
        let reads = result["reads"].as_array().expect("a list");
        assert_eq!(reads.len(), 2);
        assert_eq!(reads[0]["address"], 64);
        assert_eq!(reads[0]["values"], json!([0x4442, 1]));
        assert_eq!(reads[1]["values"], json!([0x4442]));
        assert!(reads[0].get("error").is_none());
        for key in ["rate_hz", "p50_us", "p99_us"] {
            assert!(result[key].as_f64().is_some_and(|value| value > 0.0), "{key}");
        }
        assert_eq!((&result["asked"], &result["answered"]), (&10.into(), &10.into()));
        balances(&result["counters"]);
        let text = drive.ask("registers read 64:2", &[]).expect(0).stdout;
        has(&text, &["17474", "4442"]);
    }
}

#[test]
fn a_silence_below_the_standard_is_allowed_with_a_warning() {
    let drive = Drive::start("modbus-rtu");
    let done = drive.ask("registers read 64:2 --gap 0", &[]).expect(0);
    has(&done.stdout, &["17474"]);
    let warning = "0 ms of silence before a request is below the standard's 1.75 ms at 115200 8N1";
    has(&done.stderr, &[warning]);
    let done = drive.ask("registers read 64:2 --gap 2", &[]).expect(0);
    lacks(&done.stderr, &["silence"]);
}

#[test]
fn a_read_that_is_refused_is_named_with_those_that_are_not() {
    let drive = Drive::start("modbus-rtu");
    let done = drive.ask("registers read 64 60000:2 --json", &[]).expect(3);
    let result = done.json();
    assert_eq!(result["reads"][0]["values"], json!([0x4442]));
    assert_eq!(result["reads"][1]["address"], 60_000);
    let error = result["reads"][1]["error"].as_str().expect("a text");
    has(error, &["0x02 illegal data address"]);
    has(&done.error(), &["60000"]);
    balances(&result["counters"]);
}

#[test]
fn nobody_at_the_other_end_is_exit_status_3_with_the_json() {
    let drive = Drive::start("modbus-rtu");
    let mut arguments = line("registers read 1 2 --unit 9 --timeout-ms 50 --json --port", &[]);
    arguments.push(PathBuf::from(&drive.emulator.address));
    let done = drivebench(arguments).expect(3);
    let result = done.json();
    assert!(result["rate_hz"].is_null() && result["p50_us"].is_null());
    assert_eq!(result["counters"]["timeout"], 2);
    has(&done.error(), &["no reply within 50 ms"]);
    call("registers read 1 --port /dev/drivebench-none", &[]).fails(3, &["it does not exist"]);
}

#[test]
fn wrong_arguments_are_usage_errors() {
    refusals(
        "registers read 1
         registers read --port x
         registers read 1:126 --port x
         registers read 70000 --port x
         registers read 1 --port x --host y:1
         registers read 1 --port x --framing 7E1
         registers read 1 --port x --unit 0
         registers read 1 --port x --gap -1
         registers read 1 --port x --gap 1 --gap-us 1000
         registers write 1 70000 --port x
         registers write 1 --port x
         doctor
         doctor --port x --units 9-3
         run --headless --port sim: --tap x.pcap
         run --headless --reopen-s=-1   => --reopen-s
         run --headless --reopen-s=soon => --reopen-s
         run --headless --reopen-s=1e9  => --reopen-s",
        &[],
    );
}

#[test]
fn a_write_is_shown_guarded_and_read_back() {
    let drive = Drive::start("modbus-rtu");
    let refused = drive.ask("registers write 73 640", &[]).expect(2);
    has(&refused.stderr, &["-> 640 (0x0280)"]);
    has(&refused.error(), &["--yes"]);
    let before = drive.ask("registers read 73 --json", &[]).expect(0).json();
    assert_ne!(before["reads"][0]["values"][0], 640);
    // Our emulator has an identity, so --hardware is not needed.
    let result = drive.ask("registers write 73 640 --yes --json", &[]).expect(0).json();
    assert_eq!(result["before"], before["reads"][0]["values"]);
    assert_eq!(result["after"], json!([640]));
    assert_eq!((&result["confirmed"], &result["is_emulator"]), (&true.into(), &true.into()));
    balances(&result["counters"]);
    // Below the least that the register allows: refused, and nothing is changed.
    let done = drive.ask("registers write 73 1 --yes --json", &[]).expect(3);
    assert_eq!(done.json()["confirmed"], false);
    assert_eq!(done.json()["after"], json!([640]));
    has(&done.error(), &["0x03"]);
}

#[test]
fn a_tap_holds_every_frame_and_is_never_overwritten() {
    let drive = Drive::start("modbus-rtu");
    let file = drive.desk.path("read.pcap");
    let read = "registers read 64:2 64:3 --json --tap {}";
    let result = drive.ask(read, &[&file]).expect(0).json();
    let (link_type, frames) = capture(&file);
    assert_eq!(link_type, 147);
    let sent = result["counters"]["sent"].as_u64().expect("a count");
    assert_eq!(frames.len() as u64, 2 * sent);
    assert_eq!(frames[0][..6], [1, 3, 0, 64, 0, 2]);
    assert_eq!(frames[1][..7], [1, 3, 4, 0x44, 0x42, 0, 1]);
    drive.ask(read, &[&file]).fails(2, &["exists already"]);
    let nowhere = drive.desk.path("no/such/folder.pcap");
    drive.ask(read, &[&nowhere]).fails(2, &["cannot write"]);
}

#[test]
fn taps_of_tcp_are_ip_packets_and_of_the_stream_its_frames() {
    let drive = Drive::start("modbus-tcp");
    let file = drive.desk.path("tcp.pcap");
    drive.ask("registers read 64 --tap {}", &[&file]).expect(0);
    let (link_type, packets) = capture(&file);
    assert_eq!((link_type, packets.len()), (101, 2));
    assert_eq!(packets[0][0], 0x45);
    assert_eq!(packets[0][packets[0].len() - 5..], [3, 0, 64, 0, 1]);
    let drive = Drive::start("stream");
    let file = drive.desk.path("stream.pcap");
    // It ends at the watchdog check or before; the frames until then are in the capture.
    let text = BENCH.replace("protocol = \"modbus-rtu\"", "protocol = \"stream\"");
    let (head, _) = text.split_once("[[sequence]]").expect("it has a sequence");
    let text = format!("{head}[[sequence]]\nstandstill = {{ seconds = 0.3 }}\n");
    let bench = drive.desk.put("bench.toml", &text);
    let arguments = "run {} --headless --out {} --tap {} --port {}";
    let address = PathBuf::from(&drive.emulator.address);
    let out = drive.desk.path("runs");
    call(arguments, &[&bench, &out, &file, &address]);
    let (link_type, frames) = capture(&file);
    assert_eq!(link_type, 148);
    assert!(frames.len() > 10, "{}", frames.len());
    assert!(frames.iter().all(|frame| frame.ends_with(&[0])));
}

#[test]
fn the_doctor_measures_and_leaves_a_line_to_paste() {
    let drive = Drive::start("modbus-rtu");
    let done = drive.ask("doctor --scan --units 1-2 --json", &[]);
    // The scan waits for each unit for 120 ms at least; a machine that stands still that long finds nobody there.
    let found = done.expect(0).json();
    assert_eq!(found["exclusive"], true);
    assert_eq!(found["round_trip"]["answered"], 50);
    assert!(found["round_trip"]["reachable"]["read_write_hz"].as_f64().is_some_and(|r| r > 1.0));
    assert_eq!(found["answers_function_8"], true);
    assert_eq!(found["names"][0], "drivebench");
    balances(&found["counters"]);
    let text = drive.ask("doctor", &[]).expect(0).stdout;
    has(&text, &["round trip", "loop rate", "bug report", "115200 8N1 unit 1", "fc08 yes"]);
    let mut arguments = line("doctor --unit 9 --timeout-ms 50 --port", &[]);
    arguments.push(PathBuf::from(&drive.emulator.address));
    let done = drivebench(arguments).expect(3);
    has(&done.stdout, &["nothing answered"]);
    has(&done.error(), &["no reply"]);
}

#[test]
fn ports_are_a_list_even_where_there_is_none() {
    assert!(json_of("ports --json", &[])["ports"].is_array());
    assert!(!call("ports", &[]).expect(0).stdout.is_empty());
}
