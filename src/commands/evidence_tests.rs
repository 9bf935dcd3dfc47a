//! Tests of the runs that a command judges: later ones that are refused, and models that were fitted on what judges them.

use super::*;
use drivebench_model::plant::{MotorKey, testing};
use drivebench_model::sample::Origin;

#[test]
fn a_later_run_that_cannot_be_judged_is_refused() {
    let model = Model::baseline(Motor::zk_22fc());
    let events = || vec![(0.0, 0.0), (0.5, 60.0), (2.0, -60.0), (4.0, 30.0)];
    let record = |model: &Model, seed| testing::record(model, events(), 0.01, 6.0, seed);
    let fitted = record(&model, 1);
    let loaded = |run: Run| LoadedRun {
        run,
        manifest: None,
        folder: None,
        warnings: Vec::new(),
        dialect: None,
    };
    let later = |scenario: &Scenario, lost: &dyn Fn(usize) -> bool| {
        let run = loaded(testing::with_rows_lost(scenario, lost));
        admit_later(&run, &model, &fitted, &Terminal::default())
    };
    let whole = |_: usize| false;
    let (kept, notes) = later(&record(&model, 2), &whole).unwrap();
    assert!(kept.samples() == fitted.samples() && notes.is_empty(), "{notes:?}");
    let refused = |admitted: Result<(Scenario, Vec<String>), Failure>| {
        admitted.err().unwrap().headline().to_owned()
    };
    // The samples of the fitted run itself; and the beginning of a run that ended early.
    let headline = refused(later(&fitted, &whole));
    assert!(headline.contains("tests nothing"), "{headline}");
    let headline = refused(later(&record(&model, 3), &|row| row > 40));
    assert!(headline.contains("at least"), "{headline}");
    // A torque where the other has a voltage: newton metres are no volts.
    let driven = record(&model, 7);
    let torques = driven.current_a.iter().map(|amperes| 0.35 * amperes);
    let columns = [
        (Channel::Torque, torques.collect(), Origin::Measured),
        (Channel::Speed, driven.speed_rad_s.clone(), Origin::Measured),
    ];
    let torque = loaded(testing::run_of("torque", driven.sample_time_s, columns));
    let headline = refused(admit_later(&torque, &model, &fitted, &Terminal::default()));
    assert!(headline.contains("driven by a torque"), "{headline}");
    // A sensor that was turned round meanwhile.
    let mut reversed = record(&model, 4);
    for speed in &mut reversed.speed_rad_s {
        *speed = -*speed;
    }
    let headline = refused(later(&reversed, &whole));
    assert!(headline.starts_with("the new run cannot be used"), "{headline}");
    // Another motor on the same drive, and rows that were lost: used, with a note.
    let motor = |key, times| model.motor.get(key).unwrap() * times;
    let mut other = model.clone();
    other.motor.set(MotorKey::BackEmf, motor(MotorKey::BackEmf, 0.8));
    let (_, notes) = later(&record(&other, 5), &whole).unwrap();
    assert!(notes.iter().any(|note| note.contains("not of the same motor")), "{notes:?}");
    let (_, notes) = later(&record(&model, 6), &|row| (300..330).contains(&row)).unwrap();
    assert!(!notes.is_empty());
}

#[test]
fn a_model_fitted_on_its_hold_out_gives_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str| {
        let path = folder.path().join(name);
        std::fs::create_dir(&path).unwrap();
        path
    };
    let (fit, select) = (run("20260101T000000Z-fit"), run("20260101T000000Z-select"));
    let history = [fit.display().to_string()];
    // The record moved since.
    let moved = ["/gone/20260101T000000Z-fit".to_owned()];
    let samples = fit.join("samples.csv");
    let of_a_fit = Some("held-out figures are those of a fit");
    for (case, history, run, holdout, expected) in [
        ("hold-out", &history, &select, Some(&fit), of_a_fit),
        ("its samples", &history, &select, Some(&samples), of_a_fit),
        ("moved", &moved, &select, Some(&fit), of_a_fit),
        ("same run", &history, &fit, None, Some("its last part")),
        // A hold-out on which the model was not fitted is right.
        ("independent hold-out", &history, &fit, Some(&select), None),
        ("another", &history, &select, None, None),
    ] {
        let warning = was_fitted_on(history, run, holdout.map(PathBuf::as_path));
        let is_expected = match (&warning, expected) {
            (Some(warning), Some(part)) => warning.contains(part),
            (warning, expected) => warning.is_none() && expected.is_none(),
        };
        assert!(is_expected, "{case}: {warning:?}");
    }
}
