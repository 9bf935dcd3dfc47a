//! The loop over a serial line as a workshop has it: a machine with several effects behind a drive that answers one request
//! in a hundred late. Commission, diagnose, add, and a speed loop that is better for it.

use crate::kit::prelude::*;

/// Beside Coulomb friction a bearing that drags, brushes that drop volts and a fan.
const MACHINE: &str = "
[line]
baud = 115200
late_share = 0.01
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
    // To its floor on the run that confirms, or the page says why.
    let is_at_its_floor = |found: &Value| {
        let [before, after] =
            [0, 1].map(|row| number(found, &format!("/confirmed/{row}/holdout_rmse")));
        let says_why = found["diagnosis"]["unknown"]
            .as_array()
            .is_some_and(|unknown| !unknown.is_empty());
        if after < 0.5 * before && (after < 1.3 || says_why) {
            Ok(())
        } else {
            Err(format!("{before} -> {after}: {}", found["sentence"]))
        }
    };
    // A run is recorded to its end also where the machine stood still for a moment, which is disturbed by that.
    let found = unless_it_stood_still(
        || {
            let text = "commission {} --headless --json --port emulator --out {}";
            let (done, ()) = in_real_time(|| (call(text, &[&bench, &out]), ()));
            done.expect(0).json()
        },
        is_at_its_floor,
    );
    eprintln!("{}", found["sentence"]);
    is_at_its_floor(&found).unwrap();

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
    let speed = |model: Option<&Path>| {
        let text = "speed {} --headless --json --feed-forward on --port emulator --out {}";
        match model {
            None => json_of(text, &[&bench, &out]),
            Some(model) => json_of(&format!("{text} --model {{}}"), &[&bench, &out, model]),
        }
    };
    let model = fit.join("model.toml");
    let (plate, found) = std::thread::scope(|scope| {
        let plate = scope.spawn(|| speed(None));
        let found = speed(Some(&model));
        (plate.join().unwrap(), found)
    });
    eprintln!("tracking {} -> {}", tracking(&plate), tracking(&found));
    assert!(tracking(&found) < tracking(&plate));
}
