use std::f64::consts::TAU;

use super::*;
use drivebench_model::excitation::{Chirp, Prbs, Program, Segment};
use drivebench_model::plant::testing::{record, with};
use drivebench_model::plant::{Model, Motor};
use drivebench_model::sample::Demand;
use nalgebra::DMatrix;

/// 22 Hz, half of the inertia behind the coupling.
const COUPLING: [f64; 4] = [22.0, 0.5, 0.02, 0.5];

fn model(coupling: Option<[f64; 4]>) -> Model {
    let rigid = Model::baseline(Motor::zk_22fc());
    coupling.map_or(rigid.clone(), |values| with(&rigid, "elastic_coupling", &values))
}

/// About 20 V, so that the shaft keeps turning; held for a period of the host.
fn scenario(model: &Model, segment: Segment, rate_hz: f64, seed: u64) -> Scenario {
    let seconds = segment.excitation().duration_s();
    let program = Program::new(&[segment], 4e3).unwrap();
    let count = whole(seconds * rate_hz);
    let at = |n: usize| n as f64 / rate_hz;
    let volts = |time_s: f64| Demand::from(program.value_at(time_s)).voltage_v().unwrap();
    let events = (0..count).map(|n| (at(n), volts(at(n))));
    record(model, events.collect(), 1.0 / rate_hz, seconds, seed)
}

fn prbs(seconds: f64) -> Segment {
    let (amplitude_v, clock_s, offset_v) = (8.0, 0.004, 20.0);
    Segment::Prbs(Prbs { amplitude_v, clock_s, seconds, seed: 3, offset_v, levels: 5 })
}

fn chirp(seconds: f64) -> Segment {
    sweep(8.0, [0.5, 120.0], seconds)
}

fn sweep(amplitude_v: f64, [from_hz, to_hz]: [f64; 2], seconds: f64) -> Segment {
    Segment::Chirp(Chirp { amplitude_v, from_hz, to_hz, seconds, offset_v: 20.0 })
}

/// Current, motor speed, load speed, twist: as the textbook has it, by itself.
fn matrix(coupling: [f64; 4]) -> DMatrix<f64> {
    let (r, l, ke, j) = (1.1, 0.0099, 0.3538, 0.0045);
    let [hertz, ratio, damping, _] = coupling;
    let (j1, j2) = (j * (1.0 - ratio), j * ratio);
    let reduced = j1 * j2 / j;
    let k = (TAU * hertz).powi(2) * reduced;
    let d = 2.0 * damping * (k * reduced).sqrt();
    DMatrix::from_row_slice(
        4,
        4,
        &[
            [-r / l, -ke / l, 0.0, 0.0],
            [ke / j1, -d / j1, d / j1, -k / j1],
            [0.0, d / j2, -d / j2, k / j2],
            [0.0, 1.0, -1.0, 0.0],
        ]
        .concat(),
    )
}

/// Current and speed over voltage.
fn truth(a: &DMatrix<f64>, hertz: f64) -> [Complex<f64>; 2] {
    let size = a.nrows();
    let jw = Complex::new(0.0, TAU * hertz);
    let a = a.map(|value| Complex::new(value, 0.0));
    let system = DMatrix::from_diagonal_element(size, size, jw) - a;
    let mut b = nalgebra::DVector::from_element(size, Complex::default());
    b[0] = Complex::new(1.0 / 0.0099, 0.0);
    let x = system.lu().solve(&b).unwrap();
    [x[0], x[1]]
}

/// The first mode of this kind on a pathway, or the last.
fn mode(all: &[Mode], kind: ModeKind, pathway: Pathway, is_last: bool) -> Mode {
    let own = |mode: &&Mode| mode.kind == kind && mode.pathway == pathway;
    let found = if is_last { all.iter().rfind(own) } else { all.iter().find(own) };
    *found.unwrap()
}

#[track_caller]
fn assert_mode(mode: &Mode, hertz: f64, damping: f64) {
    let off = (mode.frequency_hz / hertz - 1.0).abs();
    let off_damping = (mode.damping_ratio / damping - 1.0).abs();
    let sigmas = (mode.frequency_hz - hertz).abs() / mode.frequency_std_hz;
    let is_near = off < 0.02 && off_damping < 0.2 && sigmas < 4.0;
    assert!(is_near, "{mode:?}, true {hertz} Hz, {damping}: {sigmas} deviations");
}

#[test]
fn resonance_and_anti_resonance_are_found_with_their_damping() {
    for (segment, coupling) in [
        (prbs(30.0), COUPLING),
        (chirp(30.0), COUPLING),
        (prbs(30.0), [35.0, 0.3, 0.01, 0.5]),
        (prbs(30.0), [12.0, 0.7, 0.05, 0.2]),
    ] {
        let model = model(Some(coupling));
        let all = frequency_response(&[scenario(&model, segment, 500.0, 1)]).unwrap();
        let [hertz, ratio, damping, _] = coupling;
        let mode = |kind, pathway, is_last| mode(&all.modes, kind, pathway, is_last);
        let (resonance, voltage) = (ModeKind::Resonance, Pathway::VoltageToSpeed);
        // The mechanics by themselves: the coupling's own frequency; the load against a held motor.
        assert_mode(&mode(resonance, Pathway::CurrentToSpeed, false), hertz, damping);
        let held = (1.0 - ratio).sqrt();
        assert_mode(&mode(ModeKind::AntiResonance, voltage, false), hertz * held, damping * held);
        // Behind the winding: the poles of the whole.
        let eigenvalues = matrix(coupling).complex_eigenvalues();
        let poles = eigenvalues.iter().filter(|p| p.im > 1.0 && -p.re < 0.5 * p.norm());
        let pole = poles.max_by(|a, b| a.im.total_cmp(&b.im)).unwrap();
        let (hertz, damping) = (pole.norm() / TAU, -pole.re / pole.norm());
        assert_mode(&mode(resonance, voltage, true), hertz, damping);
    }
}

#[test]
fn a_rigid_shaft_has_no_resonance_and_is_within_intervals() {
    let (mut inside, mut count) = (0.0, 0.0);
    for seed in 0..4 {
        let segment = [prbs, chirp][usize::from(seed % 2 == 1)](20.0);
        let all = frequency_response(&[scenario(&model(None), segment, 500.0, seed)]).unwrap();
        assert!(all.modes.is_empty(), "{:?}", all.modes);
        let mut rigid = matrix(COUPLING).view((0, 0), (2, 2)).into_owned();
        (rigid[(1, 0)], rigid[(1, 1)]) = (0.3538 / 0.0045, 0.0);
        for own in &all.pathways {
            for point in own.points.iter().filter(|point| point.is_carried) {
                let [current, speed] = truth(&rigid, point.frequency_hz);
                let value = match own.pathway {
                    Pathway::VoltageToSpeed => speed,
                    Pathway::VoltageToCurrent => current,
                    Pathway::CurrentToSpeed => speed / current,
                };
                count += 1.0;
                let holds = (point.magnitude_low..=point.magnitude_high).contains(&value.norm());
                inside += f64::from(u8::from(holds));
            }
        }
    }
    let share: f64 = inside / count;
    let is_level = count > 1000.0 && (0.9..0.985).contains(&share);
    assert!(is_level, "{share} of {count}");
}

#[test]
fn only_points_that_the_excitation_carries_count_as_carried() {
    let slow = sweep(6.0, [1.0, 10.0], 20.0);
    let all = frequency_response(&[scenario(&model(None), slow, 500.0, 1)]).unwrap();
    let carried = |from: f64, to: f64| {
        let mut own = all.pathways[0].points.clone();
        own.retain(|point| (from..to).contains(&point.frequency_hz));
        own.iter().filter(|point| point.is_carried).count() as f64 / own.len() as f64
    };
    assert!(carried(1.5, 9.0) > 0.95);
    assert!(carried(30.0, 200.0) < 0.2, "{}", carried(30.0, 200.0));
}

#[test]
fn unfit_records_are_refused_and_a_reversing_shaft_is_cautioned() {
    use FrequencyResponseError::{NoVoltage, Short, Steady};
    let mut steady = scenario(&model(None), prbs(10.0), 100.0, 1);
    steady.events = vec![(0.0, 20.0)];
    let mut short = steady.clone();
    short.sample_time_s.truncate(50);
    let mut current = steady.clone();
    current.input = Input::Current;
    let refused = |scenario| frequency_response(&[scenario]).unwrap_err();
    assert!(matches!(refused(steady), Steady { .. }));
    assert!(matches!(refused(short), Short { rows: 50, .. }));
    assert!(matches!(refused(current), NoVoltage { .. }));
    let Segment::Prbs(binary) = prbs(10.0) else { panic!("it is one") };
    let slow = Prbs { amplitude_v: 20.0, clock_s: 0.1, offset_v: 0.0, levels: 2, ..binary };
    let about_zero = Segment::Prbs(slow);
    let all = frequency_response(&[scenario(&model(None), about_zero, 200.0, 1)]).unwrap();
    let caution = &all.cautions[0];
    assert!(caution.contains("never turns in one direction"), "{caution}");
    assert_eq!(all.stretches, 1);
}

fn beside(truth: &Model, model: &Model, segment: Segment, seed: u64) -> Compared {
    let measured = [scenario(truth, segment, 500.0, seed)];
    compared(&measured, Some(&of_model(model, &measured).unwrap())).unwrap()
}

#[test]
fn a_model_departs_where_it_lacks_the_coupling() {
    for seed in 0..4 {
        let segment = [prbs, chirp][usize::from(seed % 2 == 1)](20.0);
        let coupled = model(Some(COUPLING));
        for own in [&model(None), &coupled] {
            let found = beside(own, own, segment.clone(), seed);
            assert_eq!(found.departures, [], "seed {seed}");
            assert_eq!(found.missing_resonances(), []);
        }
        let found = beside(&coupled, &model(None), segment, seed);
        let missing = found.missing_resonances();
        assert_eq!(missing.len(), 1, "{missing:?}");
        assert!((missing[0].frequency_hz / 22.0 - 1.0).abs() < 0.02);
        let holds = |band: &&Departure| (band.from_hz..band.to_hz).contains(&22.0);
        let band = found.departures.iter().find(holds).unwrap();
        assert!(band.magnitude_db.abs() > 6.0, "{band:?}");
    }
}

#[test]
fn runs_of_one_machine_agree_and_those_of_two_are_cautioned() {
    let (coupled, rigid) = (model(Some(COUPLING)), model(None));
    for (segment, seed) in [(prbs(20.0), 1), (chirp(20.0), 2)] {
        let run = |model: &Model, seed| scenario(model, segment.clone(), 500.0, seed);
        let cautions = |other: Scenario| {
            compared(&[run(&coupled, seed), other], None).unwrap().measured.cautions
        };
        assert_eq!(cautions(run(&coupled, seed + 10)), Vec::<String>::new());
        let found = cautions(run(&rigid, seed + 10));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].contains("of one machine"), "{found:?}");
    }
}
