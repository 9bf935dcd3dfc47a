//! Runs to judge by that cannot be judged by, and files with holes: said plainly, and what can be answered is answered.

mod desk;
#[expect(dead_code, reason = "the other tests of the command line use the rest")]
mod program;

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use desk::Desk;
use program::{drivebench, line};

/// Resistance in ohm and back-EMF constant in V.s/rad of the motor of paper A.
const MOTOR: [f64; 2] = [1.1, 0.3538];
const L_H: f64 = 0.0099;
const J: f64 = 0.0045;
const MC: f64 = 0.455;
const COLUMNS: &str = "time_s,voltage_v,current_a,speed_rad_s";

/// Time, voltage, current, speed.
type Row = [f64; 4];

/// Uniform noise of this standard deviation; a linear congruential generator is noise enough here.
struct Noise(u64);

impl Noise {
    fn next(&mut self, deviation: f64) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let unit = f64::from(u32::try_from(self.0 >> 33).unwrap_or(0)) / f64::from(1_u32 << 31);
        (unit - 0.5) * 12f64.sqrt() * deviation
    }
}

fn steps(time_s: f64) -> f64 {
    let levels = [20.0, -25.0, 60.0, -10.0, 35.0, -50.0, 15.0, -40.0];
    if time_s < 0.5 {
        return 0.0;
    }
    let whole = time_s.floor();
    let place = levels
        .iter()
        .zip(0_u32..)
        .find(|(_, n)| f64::from(*n) >= whole);
    place.map_or(0.0, |(volts, _)| *volts)
}

/// 8 s at 5 ms under `share` of the steps, from a shaft that turns with `turning` rad/s.
fn record([resistance_ohm, ke]: [f64; 2], share: f64, turning: f64, seed: u64) -> Vec<Row> {
    let (step_s, every) = (1e-4, 50);
    let mut noise = Noise(seed);
    let (mut i, mut w) = (0.0_f64, turning);
    let mut rows = Vec::new();
    for step in 0..80_000_u32 {
        let time_s = f64::from(step) * step_s;
        let u = share * steps(time_s);
        if step % every == 0 {
            rows.push([time_s, u, i + noise.next(0.03), w + noise.next(0.15)]);
        }
        let torque = ke * i;
        i += step_s * (u - resistance_ohm * i - ke * w) / L_H;
        if w == 0.0 && torque.abs() <= MC {
            continue;
        }
        let direction = if w == 0.0 {
            torque.signum()
        } else {
            w.signum()
        };
        let next = w + step_s * (torque - MC * direction) / J;
        w = if w * next < 0.0 { 0.0 } else { next };
    }
    rows
}

fn good() -> &'static [Row] {
    static ROWS: OnceLock<Vec<Row>> = OnceLock::new();
    ROWS.get_or_init(|| record(MOTOR, 1.0, 0.0, 7))
}

fn push(text: &mut String, cells: &[f64]) {
    let cells: Vec<String> = cells.iter().map(f64::to_string).collect();
    let _ = writeln!(text, "{}", cells.join(","));
}

fn text_of(rows: &[Row], change: impl Fn(&mut Row)) -> String {
    let mut text = format!("{COLUMNS}\n");
    for row in rows {
        let mut row = *row;
        change(&mut row);
        push(&mut text, &row);
    }
    text
}

impl Desk {
    fn nameplate(&self) -> PathBuf {
        let [resistance_ohm, ke] = MOTOR;
        let text = format!(
            "[motor]\nname = \"n\"\nresistance_ohm = {resistance_ohm}\ninductance_h = {L_H}\n\
             back_emf_v_s_per_rad = {ke}\ninertia_kg_m2 = {J}\nload_torque_n_m = {MC}\n"
        );
        self.put("nameplate.toml", &text)
    }
}

/// What cannot serve as a hold-out is set aside with its reason, and the run is judged by its own last part.
#[test]
fn a_holdout_that_tests_nothing_is_not_used_and_why_is_told() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let run = desk.put("run.csv", &text_of(good(), |_| {}));
    let again = record(MOTOR, 0.9, 0.0, 23);
    for (name, text, reason) in [
        (
            "the run itself",
            text_of(good(), |_| {}),
            "are those of the run",
        ),
        (
            "another motor",
            text_of(&record([3.3, 0.17], 0.9, 0.0, 29), |_| {}),
            "not of the same motor",
        ),
        (
            "half a second",
            text_of(&again[..100], |_| {}),
            "at least 1 s",
        ),
        (
            "standstill",
            text_of(&again, |row| row[1..].fill(0.0)),
            "nothing changes",
        ),
        (
            "milliamperes",
            text_of(&again, |row| row[2] *= 1e3),
            "seems to be in mA",
        ),
        (
            "milliseconds",
            text_of(&again, |row| row[0] *= 1e3),
            "seems to be in ms",
        ),
    ] {
        let holdout = desk.put("holdout.csv", &text);
        let done = drivebench(line(
            "diagnose {} --json --model {} --holdout {}",
            &[&run, &nameplate, &holdout],
        ))
        .expect(0);
        let found = done.json();
        assert_eq!(found["holdout_from"], "split", "{name}: {}", done.stderr);
        assert_eq!(found["verdict"], "none", "{name}: {found:#}");
        assert!(done.stderr.contains(reason), "{name}: {}", done.stderr);
        assert!(done.stderr.contains("not used"), "{name}: {}", done.stderr);
        let notes = found["notes"].to_string();
        assert!(notes.contains(reason), "{name}: {notes}");
    }
    let good = desk.put("holdout.csv", &text_of(&again, |_| {}));
    let done = drivebench(line(
        "diagnose {} --json --model {} --holdout {}",
        &[&run, &nameplate, &good],
    ))
    .expect(0);
    assert_eq!(done.json()["holdout_from"], "run");
    assert!(!done.stderr.contains("warning"), "{}", done.stderr);
}

/// Without a standstill errors are counted in the residual of the refitted baseline, and no word may call that a floor.
#[test]
fn without_a_noise_floor_nothing_is_said_in_multiples_of_it() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    // The bridge takes 2 V of what was asked.
    let dropped = |rows: &[Row]| text_of(rows, |row| row[1] += 2.0 * row[1].signum());
    let run = desk.put("run.csv", &dropped(&good()[120..]));
    let other = record(MOTOR, 0.9, 0.0, 37);
    let holdout = desk.put("holdout.csv", &dropped(&other[120..]));
    let third = record(MOTOR, 0.8, 0.0, 41);
    let confirm = desk.put("confirm.csv", &dropped(&third[120..]));
    let model = desk.0.path().join("model2.toml");
    let page = desk.0.path().join("page.html");
    let paths: [&Path; 5] = [&nameplate, &run, &holdout, &confirm, &model];
    let files: [&Path; 4] = [&run, &nameplate, &holdout, &page];
    let diagnosed = "diagnose {} --model {} --holdout {} --html {}";
    let added = "add voltage_drop --model {} --run {} --holdout {} --confirm {} --output {}";
    let refused = "add quadratic_load --model {} --run {} --holdout {} --confirm {}";
    let diagnosis = drivebench(line(diagnosed, &files)).expect(0).stdout;
    let accepted = drivebench(line(added, &paths)).expect(0).stdout;
    let refusal = drivebench(line(refused, &paths[..4]));
    for (name, text) in [
        ("diagnose", diagnosis),
        ("page", fs::read_to_string(page).expect("written")),
        ("add", accepted),
        ("refused", refusal.stdout.clone() + &refusal.stderr),
        ("model", fs::read_to_string(model).expect("written")),
    ] {
        let text = text.replace("&#39;", "'");
        assert!(!text.contains("times the noise"), "{name}: {text}");
        assert!(!text.contains("at the noise floor"), "{name}: {text}");
        assert!(text.contains("the baseline's residual"), "{name}: {text}");
    }
}

/// The page of a command on the run, a hold-out and the nameplate.
fn page_of(desk: &Desk, command: &str, run: &Path, holdout: &Path) -> String {
    let page = desk.0.path().join(format!("{command}.html"));
    let nameplate = desk.nameplate();
    let text = format!("{command} {{}} --holdout {{}} --model {{}} --html {{}}");
    drivebench(line(&text, &[run, holdout, &nameplate, &page])).expect(0);
    fs::read_to_string(page).expect("the page is written")
}

#[test]
fn a_page_names_no_holdout_that_was_set_aside_and_says_why_it_was() {
    let desk = Desk::new();
    let run = desk.put("run.csv", &text_of(good(), |_| {}));
    let other = record([3.3, 0.17], 0.9, 0.0, 29);
    let other = desk.put("other.csv", &text_of(&other, |_| {}));
    let page = page_of(&desk, "diagnose", &run, &other);
    assert!(page.contains("run.csv, last 40 % held out"), "{page}");
    assert!(!page.contains("held out other.csv"), "{page}");
    assert!(!page.contains("run 2"), "two runs: {page}");
    assert!(page.contains("not of the same motor"), "{page}");
}

#[test]
fn a_page_does_not_call_unseen_what_is_objected_to() {
    let desk = Desk::new();
    let run = desk.put("run.csv", &text_of(good(), |_| {}));
    let page = page_of(&desk, "compare", &run, &run);
    assert!(!page.contains("has not seen"), "{page}");
    assert!(page.contains("its samples are those of the run"), "{page}");
    let desk = Desk::new();
    let again = record(MOTOR, 0.9, 0.0, 23);
    let holdout = desk.put("again.csv", &text_of(&again, |_| {}));
    let page = page_of(&desk, "compare", &run, &holdout);
    assert!(page.contains("held out again.csv"), "{page}");
    assert!(page.contains("has not seen"), "{page}");
    assert!(!page.contains("About the data"), "{page}");
}

#[test]
fn both_pages_tell_of_holes_and_of_rows_that_were_dropped() {
    let desk = Desk::new();
    let with_hole = |rows: &[Row]| [&rows[..700], &rows[760..]].concat();
    let torn = text_of(&with_hole(good()), |_| {}) + "7.99,1";
    let run = desk.put("run.csv", &torn);
    let again = with_hole(&record(MOTOR, 0.9, 0.0, 23));
    let holdout = desk.put("again.csv", &text_of(&again, |_| {}));
    for command in ["diagnose", "compare"] {
        let page = page_of(&desk, command, &run, &holdout);
        for part in ["run.csv: no rows between", "again.csv: no rows between"] {
            assert!(page.contains(part), "{command}, {part}: {page}");
        }
        let dropped = "Rows of the file that were dropped: 1";
        assert!(page.contains(dropped), "{command}: {page}");
    }
}

#[test]
fn a_record_that_begins_while_the_motor_runs_out_has_the_floor_of_the_rest_after_it() {
    let desk = Desk::new();
    let rows = record(MOTOR, 1.0, 80.0, 31);
    let run = desk.put("coasts.csv", &text_of(&rows, |_| {}));
    let nameplate = desk.nameplate();
    let done = drivebench(line("compare {} --json --model {}", &[&run, &nameplate])).expect(0);
    let floor = done.json()["signals"]["speed_rad_s"]["noise_floor"].as_f64();
    assert!(floor > Some(0.1) && floor < Some(0.2), "{floor:?}");
}

#[test]
fn what_is_missing_in_a_file_is_told_before_it_passes_for_an_effect() {
    let desk = Desk::new();
    let nameplate = desk.nameplate();
    let mut text = format!("{COLUMNS}\n");
    for row in good() {
        if !(3.2..4.1).contains(&row[0]) {
            push(&mut text, &row[..4]);
        }
    }
    let gap = desk.put("gap.csv", &text);
    let done = drivebench(line("compare {} --json --model {}", &[&gap, &nameplate])).expect(0);
    assert!(
        done.stderr.contains("no rows between 3.195 s and 4.100 s"),
        "{}",
        done.stderr
    );
    let mut holes = format!("{COLUMNS}\n");
    for (k, row) in good().iter().enumerate() {
        let volts = if k % 10 == 9 {
            String::new()
        } else {
            row[1].to_string()
        };
        let _ = writeln!(holes, "{},{volts},{},{}", row[0], row[2], row[3]);
    }
    let holes = desk.put("holes.csv", &holes);
    let done = drivebench(line("compare {} --json --model {}", &[&holes, &nameplate])).expect(0);
    assert!(
        done.stderr
            .contains("voltage_v is empty in 160 of 1599 rows")
            || done
                .stderr
                .contains("voltage_v is empty in 160 of 1600 rows"),
        "{}",
        done.stderr
    );
}
