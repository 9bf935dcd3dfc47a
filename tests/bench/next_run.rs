//! The recommended run is made, in virtual time: what was promised of it shows, and nothing is promised twice.

use drivebench::bench::BenchFile;
use drivebench::diagnosis::{Diagnosis, Evidence, Status, diagnose, recommend};
use drivebench::emulator::EmulatorConfig;
use drivebench::plant::Model;
use drivebench::report::wording::next_run::{hidden_reason, next_run};
use drivebench::workflow::{experiment_limits, next_bench};

use crate::diagnosis_on_emulator::Specimen;

const PLAIN: &str = include_str!("../../bench-configs/emulators/zk-22fc-plain.toml");
/// One direction and few levels: much is not shown by it.
const WEAK: &str = "[[sequence]]
standstill = { seconds = 0.6 }
[[sequence]]
steps = { levels_v = [20.0, 60.0, 35.0, 80.0, 50.0], hold_s = 0.5 }
";
/// Runs after which nothing more is recommended.
const MOST_RUNS: u64 = 3;

fn unseen(diagnosis: &Diagnosis) -> Vec<&'static str> {
    let unseen = diagnosis.candidates.iter().filter(|own| own.status == Status::NotExcited);
    unseen.map(|own| own.effect).collect()
}

/// What was promised of the runs of one machine, and what of it showed.
#[derive(Default)]
struct Kept {
    promised: usize,
    shown: usize,
    runs: u64,
}

/// Makes every run that is recommended; where it `adds`, with what was found in the model.
fn followed(file: &BenchFile, hidden: &str, adds: bool, seed: u64) -> Kept {
    let hidden =
        if hidden.is_empty() { String::new() } else { format!("\n[[hidden]]\n{hidden}\n") };
    let config = EmulatorConfig::parse("machine", &format!("{PLAIN}{hidden}")).unwrap();
    let mut specimen = Specimen::new(&config, seed);
    let [fit, holdout] = [1, 2].map(|run_seed| specimen.run(file, run_seed));
    let mut evidence = Evidence::new(fit, Some(holdout), None);
    let limits = experiment_limits(file);
    let mut model = Model::baseline(file.motor.motor());
    let mut diagnosis = diagnose(&model, evidence.clone()).unwrap();
    if adds {
        model = diagnosis.model.model.clone();
        diagnosis = diagnose(&model, evidence.clone()).unwrap();
    }
    let mut kept = Kept::default();
    let (mut made, mut showed): (Vec<&str>, Vec<&str>) = (Vec::new(), Vec::new());
    loop {
        let next = recommend(&diagnosis, &evidence, &limits).unwrap();
        let Some(next) = next else { return kept };
        let Some(recipe) = next.recipe.as_ref() else {
            assert!(next.pair.is_some() || !next.hidden.is_empty());
            assert!(next.hidden.iter().all(|own| !hidden_reason(own).is_empty()));
            return kept;
        };
        let words = next_run(&next);
        assert!(!made.contains(&recipe.id), "{hidden}: {made:?} {words}");
        assert!(next.reveals.iter().all(|id| !showed.contains(id)), "{hidden}: {showed:?} {words}");
        assert!(kept.runs < MOST_RUNS, "{hidden}: {words}");
        made.push(recipe.id);
        let text = next_bench(file, recipe, &diagnosis.model.model, &words);
        let bench = BenchFile::parse("next", &text).unwrap();
        kept.runs += 1;
        evidence = evidence.with_run(specimen.run(&bench, 9 + kept.runs));
        diagnosis = diagnose(&model, evidence.clone()).unwrap();
        let left = unseen(&diagnosis);
        let shown = next.reveals.iter().copied();
        let shown: Vec<&str> = shown.filter(|id| !left.contains(id)).collect();
        kept.promised += next.reveals.len();
        kept.shown += shown.len();
        showed.extend(shown);
    }
}

#[test]
fn a_recommended_run_shows_what_it_promises_once() {
    let default = BenchFile::embedded_default();
    let text = default.to_toml();
    let (head, _) = text.split_once("[[sequence]]").unwrap();
    let weak = BenchFile::parse("weak", &format!("{head}{WEAK}")).unwrap();
    let mut all = Kept::default();
    for (seed, (file, hidden, adds)) in [
        (&default, "", false),
        (&weak, "", false),
        (&weak, "", false),
        (
            &weak,
            "id = \"stribeck_friction\"\nstribeck_n_m = 0.16\nstribeck_speed_rad_s = 10.0",
            true,
        ),
        (&weak, "id = \"quadratic_load\"\nquadratic_n_m_s2_per_rad2 = 1.8e-6", true),
        (&weak, "id = \"current_offset\"\noffset_a = 0.3", false),
        (&weak, "id = \"voltage_offset\"\noffset_v = 1.5", true),
        (&weak, "id = \"viscous_friction\"\nviscous_n_m_s_per_rad = 4e-4", false),
        (&weak, "id = \"supply_sag\"\nsag_ohm = 0.3", false),
        (
            &default,
            "id = \"stribeck_friction\"\nstribeck_n_m = 0.16\nstribeck_speed_rad_s = 10.0",
            false,
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let kept = followed(file, hidden, adds, 1 + seed as u64);
        all.promised += kept.promised;
        all.shown += kept.shown;
        all.runs += kept.runs;
    }
    let (promised, shown) = (all.promised, all.shown);
    println!("{shown} of {promised} shown in {} runs", all.runs);
    assert!(promised >= 6 && 10 * shown >= 9 * promised, "{shown} of {promised}");
}
