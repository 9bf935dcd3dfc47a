//! The software drive on a line in memory, byte by byte: the same run for each seed, and every fault of line and drive answered
//! as it has to be.

use crate::kit::prelude::*;

#[test]
fn one_seed_is_one_run_to_the_bit_over_every_byte_of_a_line_too() {
    let samples = |seed: u64| {
        let desk = Desk::new();
        let options = format!("run --headless --port sim:rtu --json --seed {seed} --out {{}}");
        let result = call(&options, &[desk.folder()]).expect(0).json();
        assert_eq!(result["link"]["ok"], result["link"]["sent"]);
        assert!(result["wire"]["bytes_accepted"].as_u64().unwrap() > 40_000);
        fs::read_to_string(Path::new(word(&result, "/folder")).join("samples.csv")).unwrap()
    };
    let first = samples(1);
    assert!(first.len() > 10_000);
    assert!(first == samples(1), "the same seed gave other samples");
    assert!(first != samples(2), "another seed gave the same samples");
}

#[test]
fn what_was_sent_is_what_came_and_what_was_lost() {
    let desk = Desk::new();
    let faults = ["silence", "byte_dropped", "wrong_request", "held_reply"]
        .map(|kind| format!("\n[[fault]]\nkind = {kind:?}\nshare = 0.01\n"));
    let emulator = desk.put("e.toml", &format!("{PLAIN}{}", faults.concat()));
    let options = "run --headless --port sim:rtu --json --emulator {} --out {}";
    let result = call(options, &[&emulator, desk.folder()]).expect(0).json();
    let count = |class: &str| result["link"][class].as_u64().unwrap();
    let classes = ["timeout", "crc", "stale", "mismatch", "exception", "aborted"];
    let lost: u64 = classes.map(count).iter().sum();
    assert!(count("timeout") > 5 && lost > 20, "{}", result["link"]);
    assert_eq!(count("sent"), count("ok") + lost, "{}", result["link"]);
}

#[test]
fn every_fault_of_line_and_drive_is_answered_as_it_has_to_be() {
    for (suite, least) in [("faults-line", 40), ("faults-languages", 60)] {
        let desk = Desk::new();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bench-configs/suites");
        let done = call(
            "test {} --json --out {}",
            &[&folder.join(format!("{suite}.toml")), desk.folder()],
        );
        let found: Value = serde_json::from_str(&done.stdout).unwrap();
        let cases = found["cases"].as_array().unwrap().iter();
        let wrong = cases.filter(|case| case["verdict"] != "passed");
        let wrong: Vec<String> =
            wrong.map(|case| format!("{}: {}", case["name"], case["reason"])).collect();
        assert!(wrong.is_empty(), "{suite}: {}", wrong.join("\n"));
        assert!(found["passed"].as_u64() > Some(least));
        done.expect(0);
    }
}

#[test]
fn what_happens_on_a_line_is_refused_where_there_is_none() {
    let desk = Desk::new();
    let emulator = desk.put("e.toml", &format!("{PLAIN}\n[[fault]]\nkind = \"babble\"\n"));
    let refused =
        refusal("run --headless --port sim: --emulator {} --out {}", &[&emulator, desk.folder()]);
    has(&refused, &["sim: has no line", "sim:rtu"]);
    let emulator = desk.put("k.toml", &format!("{PLAIN}\n[[fault]]\nkind = \"local_control\"\n"));
    for port in ["sim:", "sim:rtu"] {
        let options = format!("run --headless --port {port} --emulator {{}} --out {{}}");
        let refused = refusal(&options, &[&emulator, desk.folder()]);
        has(&refused, &["local_control", "no keypad", "another profile"]);
    }
    let emulator = desk.put("f.toml", &format!("{PLAIN}\n[[fault]]\nkind = \"babbles\"\n"));
    let refused = refusal(
        "run --headless --port sim:rtu --emulator {} --out {}",
        &[&emulator, desk.folder()],
    );
    has(&refused, &["babbles", "did you mean `babble`?"]);
}
