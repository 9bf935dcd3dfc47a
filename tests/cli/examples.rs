//! The examples of the library do what they promise.

#[path = "../../examples/diagnose_two_runs.rs"]
#[allow(dead_code, unreachable_pub, reason = "an example is a program of its own")]
mod diagnose_two_runs;
#[path = "../../examples/drive_link.rs"]
#[allow(dead_code, unreachable_pub, reason = "an example is a program of its own")]
mod drive_link;
#[path = "../../examples/gallery.rs"]
#[allow(dead_code, unreachable_pub, reason = "an example is a program of its own")]
mod gallery;
#[path = "../../examples/identify_csv.rs"]
#[allow(dead_code, unreachable_pub, reason = "an example is a program of its own")]
mod identify_csv;
#[path = "../../examples/own_effect.rs"]
#[allow(dead_code, unreachable_pub, reason = "an example is a program of its own")]
mod own_effect;

use drivebench::drive::DriveLink;
use drivebench::plant::testing;
use drivebench::sample::{Channel, Command, Demand};

#[test]
fn a_foreign_csv_gives_the_resistance() {
    let run = testing::with_a_fan(0);
    let rows = (0..run.samples()).map(|row| {
        let time_s = run.sample_time_s[row];
        format!(
            "{time_s},{},{},{}\n",
            run.input_at(time_s),
            run.current_a[row],
            run.speed_rad_s[row]
        )
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("record.csv");
    std::fs::write(&path, "t,u,i,w\n".to_owned() + &rows.collect::<String>()).unwrap();
    let map = "time_s=t,voltage_v=u,current_a=i,speed_rad_s=w".parse().unwrap();
    let found = identify_csv::identify(&path, &map).unwrap();
    let resistance = found.lines().find_map(|line| line.strip_prefix("resistance_ohm = "));
    let value: f64 = resistance.unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((value / 1.1 - 1.0).abs() < 0.5, "{found}");
}

#[test]
fn the_fan_is_named() {
    let found = diagnose_two_runs::missing(testing::with_a_fan(0), testing::with_a_fan(3)).unwrap();
    assert_eq!(found.effects, ["quadratic_load"], "{:?}", found.answer());
}

#[test]
fn an_effect_of_ones_own_is_judged_like_any_other() {
    let result = own_effect::judged().unwrap();
    assert_eq!(result.parameters[0].key, "cubic_load.cubic_n_m_s3_per_rad3");
    assert!(result.parameters[0].value.unwrap() > 0.0, "{:?}", result.finding);
}

#[test]
fn a_drive_turns_for_a_second_and_is_off_afterwards() {
    let (mut link, clock) = drive_link::emulated().unwrap();
    link.identify().unwrap();
    let samples = drive_link::one_second(&mut link, &clock, 24.0).unwrap();
    let last = samples.last().unwrap();
    assert!(last.get(Channel::Speed).unwrap() > 20.0, "{last:?}");
    clock.set_time_s(5.0);
    let after = link.exchange(Command { seq: 200, demand: Demand::Disable }).unwrap();
    assert!(after.get(Channel::Speed).unwrap().abs() < 1.0, "{after:?}");
}

#[test]
fn the_gallery_in_the_documentation_is_that_of_this_program() {
    let docs = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let files = gallery::gallery().unwrap();
    assert!(files.len() > 30, "{}", files.len());
    for (name, text) in files {
        let there = std::fs::read_to_string(docs.join(&name)).unwrap_or_default();
        assert!(there == text, "docs/{name} is not current: cargo run --release --example gallery");
    }
}
