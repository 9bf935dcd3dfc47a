//! The loop over a serial line as a workshop has it, in virtual time with every byte of its line: a machine with several
//! effects behind a drive that answers one request in a hundred late. Commission, diagnose, add, and a speed loop that is
//! better for it.

use crate::kit::prelude::*;

/// Beside Coulomb friction a bearing that drags, friction that falls with the speed, and brushes that drop volts.
const MACHINE: &str = "
[line]
baud = 115200

[[fault]]
kind = \"late_reply\"
share = 0.01
late_ms = 4.0

[[hidden]]
id = \"viscous_friction\"
viscous_n_m_s_per_rad = 4e-4

[[hidden]]
id = \"stribeck_friction\"
stribeck_n_m = 0.16
stribeck_speed_rad_s = 10.0

[[hidden]]
id = \"voltage_drop\"
drop_v = 1.2
";

fn tracking(found: &Value) -> f64 {
    number(found, "/loop/tracking/0/mean_abs_rad_s")
}

#[test]
fn a_machine_with_several_effects_and_late_replies_comes_to_its_floor_and_its_loop_is_better_for_it()
 {
    let desk = Desk::new();
    let machine = desk.put("machine.toml", &format!("{PLAIN}{MACHINE}"));
    let bench = BENCH.replace(
        "config = \"zk-22fc-hidden\"",
        &format!("config = \"{}\"", machine.display()),
    );
    let bench = desk.put("bench.toml", &bench);
    let out = desk.out();
    let found = json_of(
        "commission {} --headless --json --port sim:rtu --out {}",
        &[&bench, &out],
    );
    // To its floor on the run that confirms, or the page says why.
    let [before, after] =
        [0, 1].map(|row| number(&found, &format!("/confirmed/{row}/holdout_rmse")));
    let says_why = found["diagnosis"]["unknown"]
        .as_array()
        .is_some_and(|unknown| !unknown.is_empty());
    assert!(
        after < 0.5 * before && (after < 1.3 || says_why),
        "{before} -> {after}: {}",
        found["sentence"]
    );

    let fit = PathBuf::from(word(&found, "/runs/0/folder"));
    let [select, confirm] =
        [1, 2].map(|run| PathBuf::from(word(&found, &format!("/runs/{run}/folder"))));
    let told = json_of(
        "diagnose {} --model baseline --holdout {} --confirm {} --json",
        &[&fit, &select, &confirm],
    );
    assert_eq!(told["effects"], found["diagnosis"]["effects"]);
    let first = word(&told, "/effect").to_owned();
    let with_it = desk.path("with-it.toml");
    let added = json_of(
        &format!(
            "add {first} --run {{}} --model baseline --holdout {{}} --confirm {{}} --output {{}} --json"
        ),
        &[&fit, &select, &confirm, &with_it],
    );
    assert_eq!(added["accepted"], true, "{}", added["reason"]);

    // The same reference with the model that was found and with the plate alone.
    let speed = "speed {} --headless --json --feed-forward on --port sim:rtu --out {}";
    let plate = json_of(speed, &[&bench, &out]);
    let model = fit.join("model.toml");
    let found = json_of(&format!("{speed} --model {{}}"), &[&bench, &out, &model]);
    let [with, without] = [&found, &plate].map(tracking);
    assert!(with < without, "{without} -> {with}");
}
