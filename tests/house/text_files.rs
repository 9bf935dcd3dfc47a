//! Whatever stands in a file of the user: it is read or refused with words, and never more than that.

use drivebench::bench::BenchFile;
use drivebench::drive::DriveProfile;
use drivebench::emulator::EmulatorConfig;
use drivebench::plant::ModelFile;
use drivebench::recording::{ReadOptions, read_csv};
use drivebench::workflow::suite::Suite;
use proptest::prelude::*;

const BENCH: &str = include_str!("../../bench-configs/benches/zk-22fc-emulated.toml");
const EMULATOR: &str = include_str!("../../bench-configs/emulators/example.toml");
const SUITE: &str = include_str!("../../bench-configs/suites/acceptance.toml");
const OWN: &str = include_str!("../../bench-configs/drives/own.toml");
const FOREIGN: &str = include_str!("../../bench-configs/drives/epulse50-dc.toml");
const MODEL: &str = "[motor]\nname = \"m\"\nresistance_ohm = 1.1\ninductance_h = 0.0099\nback_emf_v_s_per_rad = 0.35\n\
                     inertia_kg_m2 = 0.0045\nload_torque_n_m = 0.4\n\n[effects.stribeck_friction]\n";
const SAMPLES: &str = "time_s,voltage_v,current_a,speed_rad_s\n0.0,0,0,0\n0.01,1.5,0.2,0\n0.02,1.5,,0.1\n0.03,3,0.5,0.4\n";

/// What a typo, a broken download or malice puts in the place of something.
const PIECES: [&str; 22] = [
    "", "\n", "\r\n", "\"", "[", "]]", "{", "}", "=", ",", "#", "nan", "inf", "-inf", "1e999",
    "-0", "0", "true", "\u{0}", "\u{feff}", "\u{fffd}", ";",
];
const LONG_PIECES: [&str; 3] = ["18446744073709551616", "a.b.c = 1\n", "[sequence]\n"];

/// A file that was right, with some places cut out or replaced.
fn spoilt(text: &'static str) -> impl Strategy<Value = String> {
    let piece = prop_oneof![
        4 => prop::sample::select([&PIECES[..], &LONG_PIECES].concat()).prop_map(str::to_owned),
        1 => "\\PC{0,12}",
    ];
    let cuts = prop::collection::vec((any::<prop::sample::Index>(), 0..12_usize, piece), 1..6);
    cuts.prop_map(move |cuts| {
        let mut chars: Vec<char> = text.chars().collect();
        for (place, length, piece) in cuts {
            let begin = place.index(chars.len() + 1);
            let end = (begin + length).min(chars.len());
            chars.splice(begin..end, piece.chars());
        }
        chars.into_iter().collect()
    })
}

/// Reads a file of this name; why it was refused.
type Read = fn(&str, &str) -> Result<(), String>;

fn outcome<T, E: std::fmt::Display>(read: Result<T, E>) -> Result<(), String> {
    read.map(drop).map_err(|error| error.to_string())
}

/// A file of each kind that users write, and its reader.
const FILES: [(&str, &str, Read); 7] = [
    ("bench.toml", BENCH, |name, text| outcome(BenchFile::parse(name, text))),
    ("emulator.toml", EMULATOR, |name, text| outcome(EmulatorConfig::parse(name, text))),
    ("own.toml", OWN, |name, text| outcome(DriveProfile::parse(name, text))),
    ("foreign.toml", FOREIGN, |name, text| outcome(DriveProfile::parse(name, text))),
    ("model.toml", MODEL, |name, text| outcome(ModelFile::parse(name, text))),
    ("suite.toml", SUITE, |name, text| outcome(Suite::parse(name, text, |_| options()))),
    ("samples.csv", SAMPLES, |name, text| {
        outcome(read_csv(text.as_bytes(), name, ReadOptions::default()))
    }),
];

/// Options of commands that the suite gives to its steps.
fn options() -> Vec<String> {
    ["run-seed", "holdout", "controller"].map(str::to_owned).into()
}

#[test]
fn every_key_of_a_suite_stands_in_its_example() {
    let words: Vec<&str> = SUITE.split(|c: char| c != '_' && !c.is_alphanumeric()).collect();
    // A key that is like none: else the one that was meant is named alone.
    let step = "name = \"a\"\n[[case]]\nname = \"b\"\n[[case.step]]\nexcite = {}\n";
    for (wrong, known) in [
        ("qqqqqqqq = 1".to_owned(), "defaults"),
        ("name = \"a\"\n[defaults]\nqqqqqqqq = 1".to_owned(), "timeout_s"),
        ("name = \"a\"\n[[case]]\nqqqqqqqq = 1".to_owned(), "repeat"),
        ("name = \"a\"\n[[case]]\nneeds = [\"qqqqqqqq\"]".to_owned(), "baseline"),
        (format!("{step}qqqqqqqq = 1"), "commission"),
        (format!("{step}signal = [{{ qqqqqqqq = 1 }}]"), "channel"),
    ] {
        let error = Suite::parse("suite.toml", &wrong, |_| options()).expect_err(&wrong);
        let keys = error.help.strip_prefix("allowed: ").expect(&error.message);
        assert!(keys.split(", ").any(|key| key == known), "{keys}");
        for key in keys.split(", ") {
            assert!(words.contains(&key), "{key} of {wrong:?}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// A refusal has a message, which does not repeat the whole file.
    #[test]
    fn a_spoilt_file_is_read_or_refused(
        ((name, _, read), text) in prop::sample::select(&FILES[..])
            .prop_flat_map(|file| (Just(file), prop_oneof![9 => spoilt(file.1), 1 => "\\PC{0,200}"])),
    ) {
        if let Err(error) = read(name, &text) {
            prop_assert!(!error.is_empty() && error.len() < 4000, "{}: {}", name, error);
        }
    }
}
