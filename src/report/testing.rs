//! A comparison and a diagnosis of fixed figures, for the tests of page and screen.

use std::sync::LazyLock;

use super::{Bars, Document, Table, Tone};
use drivebench_diagnose::next_experiment::{MenuEntry, PairEntry, Peaks};
use drivebench_diagnose::{
    Candidate, CandidateFinding, Comparison, Diagnosis, DiagnosisVerdict, EquationBalance,
    ErrorForm, ErrorMap, ErrorOf, Evidence, FailureLocation, Fitted, HoldoutFrom, Limit,
    NextExperiment, Peak, Reached, Recipe, Recommendation, RepeatUnknown, ResidualLights, Rung,
    Signals, Status, compare,
};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::plant::{Model, Motor, State, effect, testing};
use drivebench_model::sample::ParameterEstimate;

/// The motor with these effects, and no more of its fit than a report needs.
pub(crate) fn fitted(effects: &[&str]) -> Fitted {
    let baseline = Model::baseline(Motor::zk_22fc());
    let with = |model: Model, effect: &&str| model.with_effect(effect).unwrap();
    Fitted {
        model: effects.iter().fold(baseline, with),
        parameters: Vec::new(),
        nrms: 4.9,
        noise: NoiseFloor {
            current_a: testing::CURRENT_NOISE_A,
            speed_rad_s: testing::SPEED_NOISE_RAD_S,
            source: FloorSource::Standstill,
            samples: 300,
            memory: [0.0; 2],
        },
        interval_factor: 1.0,
        start: State::default(),
    }
}

pub(crate) fn rung(effects: Vec<&'static str>, holdout_rmse: f64) -> Rung {
    Rung { effects, holdout_rmse }
}

/// An effect that takes the held-out error from 5.1 to `after`; its first parameter is estimated where it is supported.
pub(crate) fn candidate(
    rank: usize,
    effect: &'static str,
    status: Status,
    after: f64,
) -> Candidate {
    let spec = &effect::find(effect).unwrap().parameters()[0];
    let key = format!("{effect}.{}", spec.key);
    let size = ParameterEstimate::found(key, spec.unit, 0.2, 0.01, None);
    let is_supported = status == Status::Supported;
    let bound = (status != Status::NotExcited).then_some(0.002);
    Candidate {
        effect,
        rank,
        status,
        probability: match status {
            Status::Supported => 0.97,
            Status::Possible => 0.43,
            _ => 0.01,
        },
        parameters: is_supported.then_some(size).into_iter().collect(),
        onsets: vec![],
        interval_factor: 2.0,
        reached: Some(Reached {
            torque_n_m: Some(Peak {
                value: 0.2,
                std: Some(0.01),
                interval_95: Some([0.18, 0.22]),
                unit: "N.m",
                percent_of_largest: Some(7.2),
            }),
            ..Reached::default()
        }),
        error_before: 4.8,
        error_after: Some(1.01),
        holdout_before: 5.1,
        holdout_after: Some(after),
        explained_percent: Some(100.0 * (5.1 * 5.1 - after * after) / (5.1 * 5.1 - 1.0)),
        as_good_as: None,
        upper_bound: bound,
        searched: vec![],
        detectable: bound,
        finding: match status {
            Status::NotExcited => CandidateFinding::NotShown,
            Status::RuledOut => CandidateFinding::RuledOut,
            Status::Possible | Status::Supported => CandidateFinding::Named {
                floor: FloorSource::Standstill,
                holdout_from: HoldoutFrom::Run,
            },
        },
        not_named: None,
        is_open: false,
        run_s: 12.0,
    }
}

/// Stribeck friction is found, and every other status is there as well.
pub(crate) fn diagnosis() -> Diagnosis {
    Diagnosis {
        information_basis: None,
        rivals: Vec::new(),
        search_was_cut: false,
        sensor_floor: Some(1.0),
        repeat_floor: None,
        repeats: None,
        repeat_follows: Vec::new(),
        verdict: DiagnosisVerdict::Effect,
        reason: None,
        parameters: Vec::new(),
        effect: Some("stribeck_friction"),
        effects: vec!["stribeck_friction"],
        sufficient: true,
        noise_floor_from: FloorSource::Standstill,
        holdout_from: HoldoutFrom::Run,
        explained_percent: 99.8,
        holdout_before: 5.1,
        holdout_after: 1.03,
        candidates: vec![
            candidate(1, "stribeck_friction", Status::Supported, 1.03),
            candidate(2, "cogging", Status::Possible, 3.9),
            candidate(3, "viscous_friction", Status::RuledOut, 5.08),
            candidate(4, "inductance_saturation", Status::NotExcited, 5.1),
        ],
        confusable: Vec::new(),
        ladder: Vec::new(),
        axis_map: Vec::new(),
        confirm: None,
        limits: vec![Limit::RepeatUnknown(RepeatUnknown::RowsLost)],
        equivalences: Vec::new(),
        next_experiment: None,
        winding_drop: None,
        unknown: Vec::new(),
        superfluous: Vec::new(),
        added_rivals: Vec::new(),
        baseline: fitted(&[]),
        model: fitted(&["stribeck_friction"]),
    }
}

/// Two runs for a pair that is not distinguished: the separation of the dither is below that which the pair needs.
pub(crate) fn next_experiment() -> NextExperiment {
    let entry =
        |program, expected_separation| MenuEntry { program, expected_separation, needed: 612.0 };
    NextExperiment {
        finding: Recommendation::Distinguishes,
        bench: None,
        pair: Some(["viscous_friction", "quadratic_load"]),
        pairs: vec![PairEntry {
            pair: ["viscous_friction", "quadratic_load"],
            expected_separation: 8463.0,
            needed: 612.0,
            best_program: "slow_ramp",
            best_separation: 8463.0,
            best_needed: 612.0,
        }],
        reveals: Vec::new(),
        hidden: Vec::new(),
        expected_separation: 8463.0,
        menu: vec![entry("slow_ramp", 8463.0), entry("dither", 400.0)],
        peaks: Some(Peaks {
            voltage_v: 100.0,
            current_a: 6.0,
            speed_rad_s: 290.0,
            rms_current_a: 2.0,
            travel_rad: 1000.0,
            duration_s: 10.0,
        }),
        recipe: Some(Recipe { id: "slow_ramp", segments: Vec::new(), slew_v_per_s: 150.0 }),
    }
}

/// The signals of a short run, whose figures are all replaced below by fixed ones.
static SIGNALS: LazyLock<Signals> = LazyLock::new(|| {
    let model = Model::baseline(Motor::zk_22fc());
    let events = vec![(0.0, 0.0), (0.3, 40.0), (0.9, -40.0)];
    let run = |seed| testing::record(&model, events.clone(), 0.01, 1.5, seed);
    let evidence = Evidence::new(run(1), Some(run(2)), None);
    compare(&model, &evidence, ErrorOf::Structure).unwrap().signals
});

/// A model that fails below 12 rad/s, with this held-out error of the speed in rad/s.
pub(crate) fn comparison(rmse: f64) -> Comparison {
    let mut signals = SIGNALS.clone();
    for (signal, rmse, floor) in [
        (&mut signals.speed_rad_s, rmse, testing::SPEED_NOISE_RAD_S),
        (&mut signals.current_a, 0.2 * rmse, testing::CURRENT_NOISE_A),
    ] {
        let signal = signal.as_mut().unwrap();
        (signal.holdout.fit_percent, signal.holdout.rmse) = (97.9, rmse);
        (signal.fit_percent, signal.rmse) = (98.0, 0.99 * rmse);
        (signal.one_step_rmse, signal.noise_floor) = (1.07 * floor, Some(floor));
    }
    let balance = |equation, unit, rms, nres, refitted| EquationBalance {
        equation,
        unit,
        rms,
        nres: Some(nres),
        nres_refitted: Some(refitted),
        ..EquationBalance::default()
    };
    let cell = |row, column| (row + column > 3).then(|| 0.01 * f64::from(row * column));
    let row = |row| (0..12).map(|column| cell(row, column)).collect();
    let cells: Vec<Vec<Option<f64>>> = (0..12).map(row).collect();
    // Odd in the speed, and of both signs where the current is small.
    let side = |row: usize| if row < 6 { -1.0 } else { 1.0 };
    let part = |column: usize| if column < 3 { 0.1 } else { 1.0 };
    let mean = |(row, cells): (usize, &Vec<Option<f64>>)| {
        let cells = cells.iter().enumerate();
        let mean =
            |(column, cell): (usize, &Option<f64>)| cell.map(|rms| rms * side(row) * part(column));
        cells.map(mean).collect()
    };
    let means: Vec<Vec<Option<f64>>> = cells.iter().enumerate().map(mean).collect();
    Comparison {
        signals,
        locations: vec![FailureLocation {
            equation: "torque",
            variable: "speed_rad_s",
            from: -12.0,
            to: 12.0,
            share_of_error: 0.85,
            share_of_time: 0.11,
            follows: 0.9,
            strength: 300.0,
            form: ErrorForm::Between { either_way: false, begin_s: 0.0 },
        }],
        map: Some(ErrorMap {
            speed_edges_rad_s: (0..13).map(|k| -300.0 + 50.0 * f64::from(k)).collect(),
            current_edges_a: (0..13).map(|k| -6.0 + f64::from(k)).collect(),
            count: vec![vec![3; 12]; 12],
            torque_mean_n_m: means.clone(),
            voltage_mean_v: means,
            torque_rms_n_m: cells.clone(),
            voltage_rms_v: cells,
        }),
        residual: ResidualLights {
            enough_samples: true,
            autocorrelation_outside_99_percent: 0.8,
            independent_of_input: Some(true),
            ..ResidualLights::default()
        },
        noise_floor_from: FloorSource::Standstill,
        noise: fitted(&[]).noise,
        holdout_from: HoldoutFrom::Run,
        holdout_rmse: 5.1,
        balances: vec![
            balance("torque", "N.m", 0.024, 0.919, 0.913),
            balance("voltage", "V", 0.0261, 0.914, 0.901),
        ],
        not_fitted: None,
        limits: Vec::new(),
    }
}

/// The document of a commissioning that has found a fan.
pub(crate) fn document() -> Document {
    let mut document = Document::of(
        Tone::Good,
        "Effect found",
        "quadratic_load; held-out error 5.10 -> 1.03 times the noise floor",
    );
    let bar = |name: &str, error: f64| (name.to_owned(), error, format!("{error:.2}"));
    document.bars(
        "ladder",
        Bars::new(
            vec![bar("baseline", 5.1), bar("+ quadratic_load", 1.03)],
            "times the noise floor",
        ),
    );
    let parameters = [
        ("resistance_ohm", "1.1", "1.1432 ± 0.0041", "1.1003 ± 0.0007"),
        ("back_emf_v_s_per_rad", "0.3538", "0.35407 ± 0.00040", "0.35381 ± 0.00003"),
        ("quadratic_n_m_s2_per_rad2", "-", "-", "(2.012 ± 0.031)e-6"),
    ];
    let table = Table::of(parameters)
        .column("parameter", |row| row.0)
        .column("nameplate", |row| row.1)
        .column("before", |row| row.2)
        .column("after ± std", |row| row.3)
        .column("verdict", |_| "settled");
    document.table_on_card("motor", table, &["nameplate", "before"], 5);
    document
        .go_on("drivebench speed --model runs/20260102T030405Z-zk-22fc-emulated-fit/model.toml");
    document.ends_with("runs/20260102T030405Z-zk-22fc-emulated-fit/report.html");
    document
}
