//! Tests of the diagnosis that a simulation cannot cheat, for runs with voltage, current and speed: doses, placebos,
//! split halves, the floor a fifth up and down; on simulated messy records.
//!
//! ```text
//! truth + dose --(record.rs)--> messy record --diagnose--> named? right? --add--> size, interval
//! ../placebo.rs: regressors that mean nothing --add--> must be refused
//! ```
//!
//! None of the real records at hand has voltage, current and speed of a motor; machines of other simulators are in
//! `tests/foreign`. `DRIVEBENCH_EVERYTHING=1 cargo test --release --test bench rule6 -- --nocapture` does every
//! case and prints the tables; else a few cases are done.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "times of a record are converted to its rows"
)]

mod record;

use drivebench::diagnosis::{Diagnosis, Evidence, add, diagnose};
use drivebench::emulator::truth::effect::HiddenEffect;
use drivebench::plant::{Model, effect};
use drivebench::report::wording::change::change;
use drivebench::report::wording::diagnosis::diagnosis as sentence;
use rayon::prelude::*;
use record::{DURATION_S, nameplate, record};

use crate::placebo::{OF_MOTION_AND_CURRENT, placebos};
use crate::{everything, swapped};

/// A known effect, its usual size (in the middle of what the study hides), and the key of its size in the emulator.
struct Dose(&'static str, f64, &'static str);

/// None of them is in the background.
const DOSES: [Dose; 6] = [
    Dose("quadratic_load", 2e-6, "quadratic_n_m_s2_per_rad2"),
    Dose("voltage_drop", 1.4, "drop_v"),
    Dose("constant_load", 0.08, "constant_n_m"),
    Dose("stribeck_friction", 0.12, "stribeck_n_m"),
    Dose("speed_delay", 2.7e-3, "delay_s"),
    Dose("current_offset", 0.2, "offset_a"),
];

impl Dose {
    /// As it is put into the truth.
    fn hidden(&self, size: f64) -> HiddenEffect {
        let mut values = vec![(self.2, size)];
        if self.0 == "stribeck_friction" {
            values.push(("stribeck_speed_rad_s", 10.0));
        }
        HiddenEffect::new(self.0, &values).expect("an effect of the emulator")
    }
}

/// What the background holds besides the coloured torque: these names are right too.
const BACKGROUND: [&str; 4] = ["viscous_friction", "cogging", "command_delay", "supply_sag"];
const STUDY_LEVEL: f64 = 1.0;
/// Doses in units of the size that the program states as detectable in the record without a dose; and from where on it must
/// do so.
const MULTIPLES: [f64; 6] = [0.25, 0.5, 1.0, 1.5, 2.0, 4.0];
const FEW_MULTIPLES: [f64; 2] = [1.5, 4.0];
const KEPT: f64 = 1.5;
/// Standard deviations that an estimate may lie off, and relative deviation from a straight line.
const INTERVAL: f64 = 3.0;
const LINEAR: f64 = 0.1;

fn doses_done() -> &'static [Dose] {
    &DOSES[..if everything() { DOSES.len() } else { 1 }]
}

fn evidence(hidden: &[HiddenEffect], machine: u64) -> Evidence {
    let run = |run| record(hidden, STUDY_LEVEL, machine, run, DURATION_S);
    Evidence::new(run(0), Some(run(1)), None)
}

/// Size and standard deviation of the effect, fitted with the model.
fn size_of(id: &str, model: &Model, data: &Evidence) -> (f64, f64) {
    let added = add(effect::find(id).unwrap(), model, data.clone()).unwrap();
    let first = &added.parameters[0];
    (first.value.unwrap(), first.std.unwrap_or(f64::NAN))
}

/// In the answer, or left open with a name of the answer.
fn is_named(found: &Diagnosis, id: &str) -> bool {
    let mut rivals = found.confusable.iter().flatten();
    found.effects.contains(&id) || rivals.any(|rival| *rival == id)
}

/// Names that are neither the dose nor in the background, and were not left open with one that is.
fn wrong(found: &Diagnosis, id: &str) -> Vec<&'static str> {
    let is_right = |name: &str| name == id || BACKGROUND.contains(&name);
    let is_open = |name: &str| {
        let mut pairs = found.confusable.iter();
        pairs.any(|pair| pair[0] == name && is_right(pair[1]))
    };
    found.effects.iter().copied().filter(|name| !is_right(name) && !is_open(name)).collect()
}

struct Row {
    multiple: f64,
    size: f64,
    value: f64,
    std: f64,
    found: Diagnosis,
}

#[test]
fn doses_are_found_and_named_from_some_size_on() {
    let machine = 0;
    let plain = evidence(&[], machine);
    let without = diagnose(&nameplate(), plain.clone()).unwrap();
    println!("no dose: {} {:?}", sentence(&without), without.confusable);
    let multiples: &[f64] = if everything() { &MULTIPLES } else { &FEW_MULTIPLES };
    let mut failures = Vec::new();
    for dose in doses_done() {
        let mut candidates = without.candidates.iter();
        let stated = candidates.find(|candidate| candidate.effect == dose.0);
        let stated = stated.unwrap().detectable.unwrap();
        let (natural, natural_std) = size_of(dose.0, &nameplate(), &plain);
        println!(
            "{}: stated detectable {stated:.2e}; without a dose {natural:.2e} +- {natural_std:.1e}",
            dose.0
        );
        let rows: Vec<Row> = multiples
            .par_iter()
            .map(|multiple| {
                let size = multiple * stated;
                let data = evidence(&[dose.hidden(size)], machine);
                let (value, std) = size_of(dose.0, &nameplate(), &data);
                Row {
                    multiple: *multiple,
                    size,
                    value,
                    std,
                    found: diagnose(&nameplate(), data).unwrap(),
                }
            })
            .collect();
        let mut named_from = None;
        let mut before = natural;
        for row in &rows {
            let found = &row.found;
            let (off, unit) = (row.value - natural - row.size, (row.value - natural) / row.size);
            println!(
                "  x {:4}: {:.2e}, found {:.3e} +- {:.1e} ({unit:.3} per unit, {:.2} std off): {:?} {:?}, open {:?}, {:.2} -> {:.2}",
                row.multiple,
                row.size,
                row.value,
                row.std,
                off / row.std,
                found.verdict,
                found.effects,
                found.confusable,
                found.holdout_before,
                found.holdout_after
            );
            let mut fails = |is_wrong: bool, what: &str| {
                if is_wrong {
                    failures.push(format!("{} x {}: {what}", dose.0, row.multiple));
                }
            };
            fails(!wrong(found, dose.0).is_empty(), "another name");
            fails(off.abs() > INTERVAL * row.std, "outside its interval");
            fails(off.abs() > LINEAR * row.size + row.std, "not linear");
            fails(row.value <= before, "not in the order of the doses");
            let is_named = is_named(found, dose.0);
            fails(named_from.is_some() && !is_named, "named below, not here");
            fails(row.multiple >= KEPT && !is_named, "stated as detectable");
            // A name that is only left open with one of the background is none yet.
            if found.effects.contains(&dose.0) {
                named_from = named_from.or(Some(row.multiple));
            }
            before = row.value;
        }
        match named_from {
            Some(multiple) => println!(
                "  named from {multiple} x {stated:.2e} = {:.2e}, {:.2} of the study's size",
                multiple * stated,
                multiple * stated / dose.1
            ),
            None => failures.push(format!("{}: named at no dose", dose.0)),
        }
    }
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn halves_and_a_fifth_of_the_floor_do_not_change_the_name() {
    let turned: &[f64] = if everything() { &[0.8, 1.2] } else { &[1.2] };
    let failures: Vec<String> = doses_done()
        .par_iter()
        .enumerate()
        .flat_map_iter(|(index, dose)| {
            let data = evidence(&[dose.hidden(dose.1)], 10 + index as u64);
            let mut failures = Vec::new();
            let mut judge = |what: &str, found: &Diagnosis| {
                println!(
                    "{}, {what}: {:?} {:?}, open {:?}, {:.2} -> {:.2}",
                    dose.0,
                    found.verdict,
                    found.effects,
                    found.confusable,
                    found.holdout_before,
                    found.holdout_after
                );
                if !is_named(found, dose.0) || !wrong(found, dose.0).is_empty() {
                    failures.push(format!("{}, {what}: {}", dose.0, sentence(found)));
                }
            };
            let halves = diagnose(&nameplate(), swapped(&data)).unwrap();
            judge("other half", &halves);
            for floor in turned {
                let mut data = data.clone();
                data.noise.current_a *= floor;
                data.noise.speed_rad_s *= floor;
                let what = format!("noise floor x {floor}");
                judge(&what, &diagnose(&nameplate(), data).unwrap());
            }
            let (one, one_std) = size_of(dose.0, &nameplate(), &data);
            let (two, two_std) = size_of(dose.0, &nameplate(), &swapped(&data));
            let apart = (one - two).abs() / one_std.hypot(two_std);
            println!(
                "{}: {one:.3e} +- {one_std:.1e} and {two:.3e} +- {two_std:.1e}, of {:.3e}: {apart:.1} std apart",
                dose.0, dose.1
            );
            if apart > INTERVAL {
                failures.push(format!("{}: the halves are {apart:.1} std apart", dose.0));
            }
            failures
        })
        .collect();
    assert!(failures.is_empty(), "{failures:#?}");
}

#[test]
fn placebos_are_refused() {
    let (records, each) = if everything() { (6, 40) } else { (1, 7) };
    let cases: Vec<(usize, u64)> = (0..records).zip(20..).collect();
    let counts: Vec<(usize, usize)> = cases
        .par_iter()
        .map(|&(record_of, machine)| {
            // Half of the records miss an effect: a model that is wrong must not make placebos right.
            let dose = &DOSES[record_of % DOSES.len()];
            let hidden = [dose.hidden(dose.1)];
            let hidden = if record_of % 2 == 0 { &hidden[..] } else { &[] };
            let run = record(hidden, STUDY_LEVEL, machine, 0, 1.6 * DURATION_S);
            let data = Evidence::new(run.clone(), None, None);
            let (data, baseline) = data.with_baseline(&nameplate()).unwrap();
            let placebos = placebos(&run, OF_MOTION_AND_CURRENT, each, machine);
            let passed = placebos.par_iter().filter(|placebo| {
                let added = add(**placebo, &baseline.model, data.clone()).unwrap();
                if added.accepted {
                    println!("machine {machine}: {}: {}", added.effect, change(&added));
                }
                added.accepted
            });
            (passed.count(), each)
        })
        .collect();
    let passed: usize = counts.iter().map(|count| count.0).sum();
    let judged: usize = counts.iter().map(|count| count.1).sum();
    // What is consistent with so many, at 95 %: three more than none.
    println!(
        "placebos supported: {passed} of {judged}; at most {:.1} % (95 %, where none passed)",
        300.0 / judged as f64
    );
    assert!(passed * 100 < judged, "{passed} of {judged}");
}
