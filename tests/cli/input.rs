//! What the command line makes of foreign, torn and empty files, wrong keys, wrong words and plans that are too much.

use crate::kit::motor_log::coulomb_step;
use crate::kit::prelude::*;
use std::f64::consts::TAU;
use std::sync::LazyLock;

/// A run of the plain motor, as rows of text: time, voltage, current, speed.
fn rows() -> Vec<[String; 4]> {
    static CSV: LazyLock<String> = LazyLock::new(|| {
        let run = recorded("--emulator zk-22fc-plain --seed 7", &[]);
        fs::read_to_string(run.join("samples.csv")).expect("samples")
    });
    let mut lines = CSV.lines().map(|row| row.split(',').collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    let places = ["time_s", "voltage_cmd_v", "current_a", "speed_rad_s"].map(|name| {
        header.iter().position(|cell| *cell == name).expect("a column that every run has")
    });
    lines.map(|row| places.map(|place| row[place].to_owned())).collect()
}

const HEADER: &str = "time_s,voltage_cmd_v,current_a,speed_rad_s\n";

fn csv(header: &str, rows: &[[String; 4]]) -> String {
    let mut text = header.to_owned();
    for row in rows {
        let _ = writeln!(text, "{}", row.join(","));
    }
    text
}

impl Desk {
    /// `identify --json` on a file of this text.
    fn identify(&self, text: &str, more: &str) -> Done {
        self.on(&format!("identify {{}} --json {more}"), text)
    }
}

/// As a logger on a PC exports it: text and units in the head, date and clock over midnight, a text for missing values, and
/// the rows of the rotated file before it once more.
#[test]
fn a_log_with_dates_units_and_repeats_gives_the_same_motor() {
    let (desk, rows) = (Desk::new(), rows());
    let own = desk.identify(&csv(HEADER, &rows), "").expect(0).json();
    let milli = |cell: &str| (cell.parse::<f64>().unwrap() * 1e3).to_string();
    let lines: Vec<String> = rows
        .iter()
        .enumerate()
        .map(|(row, [time, volts, amps, speed])| {
            let amps = if row == 30 { "ERR".to_owned() } else { milli(amps) };
            let time_s = format!("{:.9}", 86_397.0 + time.parse::<f64>().unwrap());
            let (s, fraction) = time_s.split_once('.').unwrap();
            let s: u32 = s.parse().unwrap();
            let (day, hour, minute) = (5 + s / 86_400, s / 3600 % 24, s / 60 % 60);
            let clock = format!("{hour:02}:{minute:02}:{:02}.{fraction}", s % 60);
            format!("0{day}/05/2024;{clock};{};{amps};{speed}\n", milli(volts))
        })
        .collect();
    let again = lines[60..].concat();
    let text = format!(
        "Logger;V2.1\nRun of the morning\n\nDate;Time;u;i;w\n;;mV;mA;rad/s\n{}{again}",
        lines[..100].concat()
    );
    let map = "time_s=Date+Time,voltage_cmd_v=u,current_a=i,speed_rad_s=w";
    let done = desk.identify(&text, &format!("--map {map} --missing ERR --skip 3")).expect(0);
    has(
        &done.stderr,
        &[
            "2 lines with text stand before the header row, a row of units stands under the headers",
            "names mA for column \"i\": current_a is the column times 0.001",
            "time_s counts the seconds since midnight of 2024-05-05",
            "40 rows repeat earlier rows exactly (from line 106 on) and were left out",
            "voltage_cmd_v is used as the voltage",
        ],
    );
    let found = done.json();
    assert_eq!(found["rows"].as_u64(), Some(rows.len() as u64));
    has(&found["notes"].to_string(), &["midnight of 2024-05-05", "40 rows repeat"]);
    for key in ["resistance_ohm", "back_emf_v_s_per_rad"] {
        expect_near(key, parameter(&found, key), parameter(&own, key).unwrap(), 0.05);
    }
    // The text is named with the option that reads it, and the next command keeps the options.
    let error = desk.identify(&text, &format!("--map {map}")).expect(2).error();
    has(&error, &["row ", "column \"", "\"ERR\" is not a number", "--missing 'ERR'"]);
    let text = desk.on(&format!("identify {{}} --map {map} --missing ERR"), &text).expect(0).stdout;
    has(&text, &["--missing ERR"]);
}

#[test]
fn a_column_of_missing_values_is_not_measured_and_never_zero() {
    let (desk, rows) = (Desk::new(), rows());
    let without = |place: usize| {
        let mut rows = rows.clone();
        for row in &mut rows {
            row[place] = "NaN".to_owned();
        }
        csv(HEADER, &rows)
    };
    // Without the current the back-EMF is still there, and near what all columns give.
    let all = desk.identify(&csv(HEADER, &rows), "").expect(0).json();
    let found = desk.identify(&without(2), "").expect(0).json();
    let key = "back_emf_v_s_per_rad";
    let (ours, theirs) = (parameter(&all, key).unwrap(), parameter(&found, key).unwrap());
    assert!((theirs / ours - 1.0).abs() < 0.02, "{ours} {theirs}");
    // Without the voltage nothing electrical can come out.
    let done = desk.identify(&without(1), "--require resistance_ohm").expect(5);
    assert!(parameter(&done.json(), "resistance_ohm").is_none());
    done.error();
}

/// Force and position of a linear axis: 95 kg, 20 N of dry friction, 200 N.s/m, 6 N of its own weight on the slope.
fn axis() -> String {
    let (mass, dry, viscous, offset) = (95.0, 20.0, 200.0, 6.0);
    let force = |t: f64| {
        150.0 * (TAU * 0.37 * t).sin()
            + 70.0 * (TAU * 1.3 * t + 1.0).sin()
            + 40.0 * (TAU * 3.1 * t).sin()
    };
    let (mut text, mut speed, mut position) = ("t,force_n,x_m\n".to_owned(), 0.0_f64, 0.0);
    let (step_s, every) = (1e-5, 200);
    for step in 0..1_500_000_u32 {
        let time_s = f64::from(step) * step_s;
        if step % every == 0 {
            // As an encoder of 0.1 um reads it.
            let count = (position * 1e7_f64).round() / 1e7;
            let _ = writeln!(text, "{time_s:.5},{:.3},{count}", force(time_s));
        }
        let next = coulomb_step(speed, force(time_s) - offset, [dry, viscous, mass], step_s);
        position += 0.5 * (speed + next) * step_s;
        speed = next;
    }
    text
}

#[test]
fn an_axis_is_identified_from_force_and_position() {
    let desk = Desk::new();
    let file = desk.put("axis.csv", &axis());
    let model = desk.put(
        "axis.toml",
        "[motor]\nname = \"axis\"\n[[effect]]\nid = \"viscous_friction\"\n[[effect]]\nid = \"constant_load\"\n",
    );
    let text = "identify {} --model {} --json --map time_s=t,torque_n_m=force_n,angle_rad=x_m";
    let done = call(text, &[&file, &model]).expect(0);
    has(&done.stderr, &["derived"]);
    let found = done.json();
    assert_eq!(found["scheme"], "weak-form");
    for (key, truth, tolerance) in [
        ("inertia_kg_m2", 95.0, 0.015),
        ("load_torque_n_m", 20.0, 0.08),
        ("viscous_friction.viscous_n_m_s_per_rad", 200.0, 0.05),
        ("constant_load.constant_n_m", 6.0, 0.15),
    ] {
        expect_near(key, parameter(&found, key), truth, tolerance);
    }
}

#[test]
fn figures_of_an_axis_without_electrics_stand_under_their_names() {
    let desk = Desk::new();
    // A second at rest, in which the last digit of the encoder flickers, gives the floor.
    let moving = axis();
    let (header, moving) = moving.split_once('\n').unwrap();
    let mut text = format!("{header}\n");
    for k in 0..500_u32 {
        let digit = k.wrapping_mul(2_654_435_761) >> 31;
        let _ = writeln!(text, "{:.5},0.000,{}", f64::from(k) * 2e-3, f64::from(digit) * 1e-7);
    }
    for row in moving.lines() {
        let (time_s, rest) = row.split_once(',').unwrap();
        let _ = writeln!(text, "{:.5},{rest}", time_s.parse::<f64>().unwrap() + 1.0);
    }
    let file = desk.put("axis.csv", &text);
    let model = desk.put(
        "axis.toml",
        "[motor]\nname = \"axis\"\ninertia_kg_m2 = 80.0\nload_torque_n_m = 20.0\n\
         [[effect]]\nid = \"viscous_friction\"\nviscous_n_m_s_per_rad = 200.0\n",
    );
    let page = desk.path("page.html");
    let map = "--map time_s=t,torque_n_m=force_n,angle_rad=x_m";
    let compared = format!("compare {{}} --model {{}} --html {{}} {map}");
    let shown = call(&compared, &[&file, &model, &page]).expect(0).stdout;
    let row = |name: &str| {
        let mut lines = shown.lines().map(str::trim_start);
        let found = lines.find(|line| line.starts_with(name) && line.contains(" %"));
        found.unwrap_or_else(|| panic!("{name}: {shown}")).to_owned()
    };
    let found = json_of(&format!("compare {{}} --model {{}} --json {map}"), &[&file, &model]);
    let torque = &found["signals"]["torque_n_m"];
    let [floor, rmse] = ["/noise_floor", "/holdout/rmse"]
        .map(|key| torque.pointer(key).and_then(Value::as_f64).unwrap());
    let times = format!(" {:.2} ", rmse / floor);
    has(&row("torque "), &[&times]);
    // What is not known has no multiple.
    has(&row("speed (0.75 s windows) "), &[" - ", "not known"]);
    has(&shown, &["torque error is correlated with its own past ("]);
    assert!(found["residual"]["torque_n_m"]["rho_ee"].is_object());
    assert!(found["residual"].get("speed_rad_s").is_none());
    let page = fs::read_to_string(page).unwrap();
    has(&page, &["speed (0.75 s windows)"]);
    let lights = &page[page.find("Residual tests").unwrap()..];
    let lights = &lights[..lights.find("</table>").unwrap()];
    assert!(lights.contains("torque") && !lights.contains("speed"), "{lights}");
}

#[test]
fn a_wrong_key_is_named_with_its_line_and_the_nearest() {
    let desk = Desk::new();
    let model = "[motor]\nname = \"m\"\nresistance_ohm = 1.1\ninertia_kg_m2 = 0.0045\n";
    let profile = include_str!("../../bench-configs/drives/vacon10.toml");
    let run = desk.put("run.csv", &csv(HEADER, &rows()[..60]));
    for (command, text, right, wrong) in [
        ("identify RUN --model {}", model, "inertia_kg_m2", "inertia_kgm2"),
        ("plan {}", BENCH, "slew_v_per_s", "slew_v_pers"),
        ("plan {}", BENCH, "resistance_ohm", "resistence_ohm"),
        ("emulate {}", PLAIN, "current_limit_a", "curent_limit_a"),
        ("emulate --profile {}", profile, "quantity", "quantty"),
    ] {
        let place = format!("\n{right}");
        assert!(text.contains(&place), "{right}");
        let text = text.replacen(&place, &format!("\n{wrong}"), 1);
        let number = 1 + text.lines().position(|l| l.starts_with(wrong)).unwrap();
        let file = desk.put("wrong.toml", &text);
        let mut arguments = line(command, &[&file]);
        for argument in &mut arguments {
            if argument.as_os_str() == "RUN" {
                argument.clone_from(&run);
            }
        }
        drivebench(arguments).fails(2, &[&format!("wrong.toml:{number}:"), wrong, right]);
    }
}

#[test]
fn a_plan_that_is_too_much_is_refused_with_figure_and_limit() {
    let desk = Desk::new();
    call("plan {} --json", &[&desk.put("good.toml", BENCH)]).expect(0);
    let (right, wrong) = ("\nspeed_rad_s = 340.0", "\nspeed_rad_s = 100.0");
    assert!(BENCH.contains(right));
    let file = desk.put("fast.toml", &BENCH.replacen(right, wrong, 1));
    let done = call("plan {} --json", &[&file]).expect(2);
    let error = done.error();
    has(&error, &["speed", "100"]);
    assert!(done.json()["refusals"].as_array().map_or(0, Vec::len) > 0);
    assert!(done.json()["peak_speed_rad_s"].as_f64().unwrap() > 100.0);
    // And `run` refuses it before anything is energised.
    let out = desk.path("runs");
    let error = refusal("run {} --port sim: --headless --out {}", &[&file, &out]);
    has(&error, &["plan refused"]);
    assert!(!out.exists());
}

#[test]
fn effects_has_a_card_for_each() {
    let all = drivebench(["effects", "--json"]).expect(0).json();
    let all = all.as_array().unwrap();
    assert!(all.len() >= 27);
    let changelog = include_str!("../../CHANGELOG.md").split_whitespace();
    let changelog = changelog.collect::<Vec<_>>().join(" ");
    for card in all {
        let id = card["id"].as_str().unwrap();
        let name = card["name"].as_str().unwrap();
        let is_listed = changelog.contains(name) || changelog.contains(&format!("`add {id}`"));
        assert!(is_listed, "{id} is not in the CHANGELOG");
        for key in "name equation causes looks_like excite remedy".split(' ') {
            assert!(card[key].as_str().is_some_and(|text| !text.is_empty()), "{id}: {key}");
        }
        // What the user or the data define has its parameters in its settings.
        let is_defined = ["custom", "table"].contains(&id);
        assert!(!card["parameters"].as_array().unwrap().is_empty() || is_defined, "{id}");
    }
}

#[test]
fn every_command_has_help_with_an_example() {
    let page = drivebench(["--help"]).expect(0).stdout;
    assert!(page.contains("130"), "the exit statuses are missing");
    let commands: Vec<&str> = page
        .lines()
        .skip_while(|line| !line.starts_with("Commands:"))
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|command| *command != "help")
        .collect();
    assert!(commands.len() >= 11, "{commands:?}");
    for command in commands {
        let help = drivebench([command, "--help"]).expect(0).stdout;
        assert!(help.contains("Example"), "{command}: no example");
        assert!(help.contains(&format!("drivebench {command} ")), "{command}: {help}");
    }
}

#[test]
fn usage_errors_are_two_lines_and_status_2() {
    refusals(
        "nonsense
         identify
         identify a.csv --model
         run --sed 3
         compare a.csv --min-fit much
         compare a.csv --screen
         view a.csv
         run --headless --port=
         run --headless --port sim: --emulator zk-22fc-plane
         emulate --link telepathy
         emulate --link modbus-tcp --pty no.pty
         emulate --listen 127.0.0.1:0
         emulate --pty README.md
         emulate --pty no-such-folder/drive.pty
         compare runs/a --fit
         replay runs/a runs/b",
        &[],
    );
}
