//! A diagnosis as it might come: Stribeck friction is missing.

use std::sync::LazyLock;

use ratatui::Terminal;
use ratatui::backend::TestBackend;

use crate::diagnosis::{
    AddResult, Candidate, Comparison, Diagnosis, DiagnosisVerdict, ErrorMap, ErrorOf,
    Event as Found, Evidence, FailureLocation, Fitted, HoldoutFrom, Peak, Reached, ResidualLights,
    Rung, Status, compare,
};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::plant::{Model, Motor, testing};
use crate::sample::{ParameterEstimate, Verdict};
use crate::tui::application::Effect;
use crate::tui::diagnosis::state::{Event, State};
use crate::tui::diagnosis::view::view;
use crate::tui::keys::Press;
use crate::workflow::News;

pub(super) fn fitted(effects: &[&str]) -> Fitted {
    let mut model = Model::baseline(Motor::zk_22fc());
    for effect in effects {
        model = model.with_effect(effect).unwrap();
    }
    Fitted {
        model,
        parameters: Vec::new(),
        nrms: 4.9,
        noise: NoiseFloor {
            current_a: 0.03,
            speed_rad_s: 0.15,
            source: FloorSource::Standstill,
            samples: 300,
        },
        interval_factor: 1.0,
        start: crate::plant::State::default(),
    }
}

pub(super) fn candidate(effect: &'static str, status: Status, after: f64) -> Candidate {
    let spec = &crate::plant::effect::find(effect).unwrap().parameters()[0];
    let size = ParameterEstimate {
        key: format!("{effect}.{}", spec.key),
        value: Some(0.2),
        std: Some(0.01),
        unit: spec.unit,
        verdict: Verdict::Settled,
        reason: None,
    };
    Candidate {
        effect,
        rank: 1,
        status,
        probability: match status {
            Status::Supported => 0.97,
            Status::Possible => 0.43,
            _ => 0.01,
        },
        parameters: Some(size)
            .into_iter()
            .filter(|_| status == Status::Supported)
            .collect(),
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
        upper_bound: Some(0.002),
        detectable: Some(0.002),
        evidence: format!("{effect} takes the held-out error from 5.10 to {after:.2}"),
    }
}

pub(super) fn diagnosis() -> Diagnosis {
    Diagnosis {
        rivals: Vec::new(),
        sensor_floor: Some(1.0),
        repeat_floor: None,
        repeats: None,
        repeat_follows: Vec::new(),
        verdict: DiagnosisVerdict::Effect,
        effect: Some("stribeck_friction"),
        effects: vec!["stribeck_friction"],
        sufficient: true,
        noise_floor_from: FloorSource::Standstill,
        holdout_from: HoldoutFrom::Run,
        explained_percent: 99.8,
        holdout_before: 5.1,
        holdout_after: 1.03,
        candidates: vec![
            candidate("stribeck_friction", Status::Supported, 1.03),
            candidate("cogging", Status::Possible, 3.9),
            candidate("viscous_friction", Status::RuledOut, 5.08),
            candidate("inductance_saturation", Status::NotExcited, 5.1),
        ],
        confusable: Vec::new(),
        ladder: Vec::new(),
        axis_map: Vec::new(),
        confirm: None,
        limits: vec![
            "whether this machine repeats is not known: too many rows were lost".to_owned(),
        ],
        equivalences: Vec::new(),
        next_experiment: None,
        unknown: vec![],
        sentence: "missing: stribeck_friction; held-out error 5.10 -> 1.03 times the noise floor, 100 % explained"
            .to_owned(),
        baseline: fitted(&[]),
        model: fitted(&["stribeck_friction"]),
    }
}

/// What is left once the effect is in the model.
pub(super) fn nothing_more() -> Diagnosis {
    Diagnosis {
        verdict: DiagnosisVerdict::None,
        effect: None,
        effects: Vec::new(),
        holdout_before: 1.03,
        holdout_after: 1.03,
        explained_percent: 0.0,
        candidates: vec![
            candidate("cogging", Status::RuledOut, 1.03),
            candidate("inductance_saturation", Status::NotExcited, 1.03),
        ],
        sentence: "nothing is missing: held-out error 1.03 times the noise floor".to_owned(),
        baseline: fitted(&["stribeck_friction"]),
        ..diagnosis()
    }
}

/// The figures of a short run, all of them replaced below by fixed ones.
static COMPARED: LazyLock<Comparison> = LazyLock::new(|| {
    let model = Model::baseline(Motor::zk_22fc());
    let events = vec![(0.0, 0.0), (0.3, 40.0), (0.9, -40.0)];
    let run = |seed| testing::record(&model, events.clone(), 0.01, 1.5, seed);
    let evidence = Evidence::new(run(1), Some(run(2)), None);
    compare(&model, &evidence, ErrorOf::Structure).unwrap()
});

pub(super) fn comparison(rmse: f64) -> Comparison {
    let mut signals = COMPARED.signals.clone();
    for (signal, rmse, floor) in [
        (&mut signals.speed_rad_s, rmse, 0.15),
        (&mut signals.current_a, 0.2 * rmse, 0.03),
    ] {
        let signal = signal.as_mut().unwrap();
        (signal.holdout.fit_percent, signal.holdout.rmse) = (97.9, rmse);
        signal.noise_floor = Some(floor);
    }
    let cell = |row, column| (row + column > 3).then(|| 0.01 * f64::from(row * column));
    let row = |row| (0..12).map(|column| cell(row, column)).collect();
    let cells: Vec<Vec<Option<f64>>> = (0..12).map(row).collect();
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
            sentence: "85 % of the torque error lies between -12 and 12 rad/s, in 11 % of the time"
                .to_owned(),
        }],
        balances: Vec::new(),
        map: Some(ErrorMap {
            speed_edges_rad_s: (0..13).map(|k| -300.0 + 50.0 * f64::from(k)).collect(),
            current_edges_a: (0..13).map(|k| -6.0 + f64::from(k)).collect(),
            count: vec![vec![3; 12]; 12],
            torque_rms_n_m: cells.clone(),
            voltage_rms_v: cells,
        }),
        residual: ResidualLights {
            white: false,
            enough_samples: true,
            autocorrelation_outside_99_percent: 0.8,
            independent_of_input: true,
            ..ResidualLights::default()
        },
        noise_floor_from: FloorSource::Standstill,
        noise: NoiseFloor {
            current_a: 0.03,
            speed_rad_s: 0.15,
            source: FloorSource::Standstill,
            samples: 300,
        },
        holdout_from: HoldoutFrom::Run,
        holdout_rmse: 5.1,
        limits: Vec::new(),
    }
}

pub(super) fn added(effect: &'static str, accepted: bool) -> News {
    let rung = |effects: Vec<&'static str>, holdout_rmse| Rung {
        effects,
        holdout_rmse,
    };
    News::Added(Box::new(AddResult {
        effect,
        accepted,
        reason: format!("{effect} helps only in training (4.80 -> 4.20)"),
        before: comparison(0.76),
        after: comparison(0.155),
        parameters: Vec::new(),
        ladder: vec![rung(Vec::new(), 5.1), rung(vec![effect], 1.03)],
        confirm: None,
        fit: fitted(&["stribeck_friction"][..usize::from(accepted)]),
    }))
}

pub(super) fn hear(state: &mut State, news: News) {
    assert_eq!(state.update(Event::News(news)), None);
}

pub(super) fn press(state: &mut State, press: Press) -> Option<Effect> {
    state.update(Event::Press(press))
}

pub(super) fn begun(guess_first: bool) -> State {
    let mut state = State::new("run-a, held out run-b".to_owned(), guess_first);
    hear(&mut state, News::Compared(Box::new(comparison(0.76))));
    state
}

/// While the effects are being judged.
pub(super) fn searching(guess_first: bool) -> State {
    let mut state = begun(guess_first);
    for (effect, share) in [
        ("viscous_friction", 0.11),
        ("stribeck_friction", 0.97),
        ("cogging", 0.4),
        ("voltage_drop", 0.02),
    ] {
        let screened = Found::Screened { effect, share };
        hear(&mut state, News::Progress(screened));
    }
    let refitted = Found::Refitted {
        effect: "stribeck_friction",
        error: 1.01,
    };
    hear(&mut state, News::Progress(refitted));
    state
}

pub(super) fn answered() -> State {
    let mut state = searching(false);
    hear(&mut state, News::Diagnosed(Box::new(diagnosis())));
    state
}

/// After the effect was added.
pub(super) fn at_the_floor() -> State {
    let mut state = answered();
    press(&mut state, Press::Add);
    hear(&mut state, added("stribeck_friction", true));
    hear(&mut state, News::Diagnosed(Box::new(nothing_more())));
    state
}

pub(super) fn terminal(state: &State, width: u16, height: u16) -> Terminal<TestBackend> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| view(state, frame)).unwrap();
    terminal
}

pub(super) fn text(state: &State, width: u16, height: u16) -> String {
    terminal(state, width, height).backend().to_string()
}

pub(super) fn shows(state: &State, parts: &[&str]) {
    let shown = text(state, 80, 24);
    for part in parts {
        assert!(shown.contains(part), "{part}: {shown}");
    }
}
