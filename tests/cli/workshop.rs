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
fn several_effects_and_late_replies_still_reach_the_floor() {
    let desk = Desk::new();
    let machine = desk.put("machine.toml", &format!("{PLAIN}{MACHINE}"));
    let bench = BENCH
        .replace("config = \"zk-22fc-hidden\"", &format!("config = \"{}\"", machine.display()));
    let bench = desk.put("bench.toml", &bench);
    let out = desk.out();
    let found = json_of("commission {} --headless --json --port sim:rtu --out {}", &[&bench, &out]);
    // To its floor on the run that confirms, or the page gives the reason.
    let [before, after] =
        [0, 1].map(|row| number(&found, &format!("/confirmed/{row}/holdout_rmse")));
    let says_why =
        found["diagnosis"]["unknown"].as_array().is_some_and(|unknown| !unknown.is_empty());
    assert!(
        after < 0.5 * before && (after < 1.3 || says_why),
        "{before} -> {after}: {}",
        found["sentence"]
    );

    let fit = PathBuf::from(word(&found, "/runs/0/folder"));
    let [select, confirm] =
        [1, 2].map(|run| PathBuf::from(word(&found, &format!("/runs/{run}/folder"))));
    let diagnosed = json_of(
        "diagnose {} --model baseline --holdout {} --confirm {} --json",
        &[&fit, &select, &confirm],
    );
    assert_eq!(diagnosed["effects"], found["diagnosis"]["effects"]);
    let first = word(&diagnosed, "/effect").to_owned();
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

/// What the plain motor rubs and cogs with beyond Coulomb friction, unknown to the model.
const COGS: &str = "
[line]
baud = 115200

[[hidden]]
id = \"stribeck_friction\"
stribeck_n_m = 0.16
stribeck_speed_rad_s = 10.0

[[hidden]]
id = \"cogging\"
order = 7
sin_n_m = 0.1
cos_n_m = 0.0
";

#[test]
fn measured_maps_fed_forward_take_a_third_of_the_error() {
    let desk = Desk::new();
    let machine = desk.put("machine.toml", &format!("{PLAIN}{COGS}"));
    let (head, _) = BENCH.split_once("[[sequence]]").unwrap();
    let head = head.replace("zk-22fc-hidden", &machine.display().to_string());
    let square =
        "square = { low_rad_s = 90.0, high_rad_s = 110.0, half_period_s = 2.0, periods = 3 }";
    let reversals = "polyline = { points = [[0.0, 20.0], [1.0, -20.0], [2.0, 20.0], [3.0, -20.0], [4.0, 20.0]] }";
    assert!(head.contains(square));
    let head = head.replace(square, reversals).replace("time_s = 30.0", "time_s = 40.0");
    let bench = |name: &str, sequence: &str| {
        let standstill = "[[sequence]]\nstandstill = { seconds = 0.25 }\n\n[[sequence]]\n";
        desk.put(name, &format!("{head}{standstill}{sequence}\n"))
    };
    let held = "steps = { levels_v = [3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 14.0, 0.0, -3.0, -4.0, -5.0, -6.0, -8.0, -10.0, -14.0, 0.0], hold_s = 1.2 }";
    let slow = "steps = { levels_v = [3.4, -3.4], hold_s = 10.0 }";
    let [held, slow] = [("held", held), ("slow", slow)].map(|(name, sequence)| {
        let (bench, out) = (bench(&format!("{name}.toml"), sequence), desk.path(name));
        let found = json_of("run {} --headless --json --port sim:rtu --out {}", &[&bench, &out]);
        PathBuf::from(word(&found, "/folder"))
    });
    let model = desk.path("model.toml");
    call("identify {} --output {}", &[&held, &model]).expect(0);
    let maps = [("friction", &held), ("cogging", &slow)].map(|(torque, run)| {
        let map = desk.path(format!("{torque}.csv"));
        let text =
            format!("export --torque-map {torque} --run {{}} --model {{}} --to csv --output {{}}");
        call(&text, &[run, &model, &map]).expect(0);
        map
    });
    let speed = "speed {} --headless --port sim:rtu --model {} --out {}";
    let bench = bench("reversals.toml", "standstill = { seconds = 0.5 }");
    let out = desk.out();
    let own: [&Path; 3] = [&bench, &model, &out];
    let alone = json_of(&format!("{speed} --json --feed-forward compare"), &own);
    let given =
        format!("{speed} --feed-forward compare --feed-forward-map {{}} --feed-forward-map {{}}");
    let with_maps = [own.as_slice(), &[&maps[0], &maps[1]]].concat();
    let mapped = json_of(&format!("{given} --json"), &with_maps);
    let rms = |found: &Value| number(found, "/loop/tracking/1/rms_rad_s");
    assert!(rms(&mapped) < 0.67 * rms(&alone), "{} -> {}", rms(&alone), rms(&mapped));
    let folder = Path::new(word(&mapped, "/folder"));
    let page = fs::read_to_string(folder.join("report.html")).unwrap();
    has(&page, &["Speed loop", "feed-forward"]);
    let named = read_json(folder.join("manifest.json")).to_string();
    has(&named, &["friction.csv", "the measured cogging in 72 of 72 bins"]);

    let volts = desk.put("volts.csv", "time_s,voltage_v\n0,1\n");
    let heavy = fs::read_to_string(&maps[0]).unwrap();
    let row = heavy.lines().skip(1).find(|row| !row.contains(",,,")).unwrap();
    let middle = row.split(',').next().unwrap();
    let heavy =
        desk.put("heavy.csv", &heavy.replace(row, &format!("{middle},-40.0,-41.0,-39.0,9")));
    let one = format!("{speed} --feed-forward on --feed-forward-map {{}}");
    for (text, files, words) in [
        (format!("{speed} --feed-forward-map {{}}"), vec![&maps[0]], "feed-forward is off"),
        (one.clone(), vec![&volts], "header of a friction"),
        (one, vec![&heavy], "needs 40.000 N.m"),
        (given, vec![&maps[0], &maps[0]], "a second friction map"),
    ] {
        let files: Vec<&Path> =
            own.into_iter().chain(files.into_iter().map(PathBuf::as_path)).collect();
        call(&text, &files).fails(2, &[words]);
    }
}
