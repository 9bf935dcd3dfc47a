use super::*;
use drivebench_model::excitation::{Chirp, Output, Prbs, Program, Segment};
use drivebench_model::plant::testing::record;
use drivebench_model::plant::{ActiveEffect, Model, Motor, effect};
use nalgebra::DMatrix;

/// 22 Hz, half of the inertia behind the coupling.
const COUPLING: [f64; 4] = [22.0, 0.5, 0.02, 0.5];

fn model(coupling: Option<[f64; 4]>) -> Model {
    let mut model = Model::baseline(Motor::zk_22fc());
    if let Some(values) = coupling {
        let coupling = effect::find("elastic_coupling").unwrap();
        model.effects.push(ActiveEffect::with(coupling, &values));
    }
    model
}

/// About 20 V, so that the shaft keeps turning; held for a period of the host.
fn scenario(model: &Model, segment: Segment, rate_hz: f64, seed: u64) -> Scenario {
    let seconds = segment.excitation().duration_s();
    let program = Program::new(&[segment], 4e3).unwrap();
    let count = whole(seconds * rate_hz);
    let at = |n: usize| n as f64 / rate_hz;
    let events = (0..count).map(|n| match program.value_at(at(n)) {
        Output::Voltage(volts) => (at(n), volts),
        Output::Coast => (at(n), 0.0),
    });
    record(model, events.collect(), 1.0 / rate_hz, seconds, seed)
}

fn prbs(seconds: f64) -> Segment {
    Segment::Prbs(Prbs {
        amplitude_v: 8.0,
        clock_s: 0.004,
        seconds,
        seed: 3,
        offset_v: 20.0,
        levels: 5,
    })
}

fn chirp(seconds: f64) -> Segment {
    Segment::Chirp(Chirp {
        amplitude_v: 8.0,
        from_hz: 0.5,
        to_hz: 120.0,
        seconds,
        offset_v: 20.0,
    })
}

/// Current, motor speed, load speed, twist: as the textbook has it, by itself.
fn matrix(coupling: [f64; 4]) -> DMatrix<f64> {
    let (r, l, ke, j) = (1.1, 0.0099, 0.3538, 0.0045);
    let [hertz, ratio, damping, _] = coupling;
    let (j1, j2) = (j * (1.0 - ratio), j * ratio);
    let reduced = j1 * j2 / j;
    let k = (std::f64::consts::TAU * hertz).powi(2) * reduced;
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
    let jw = Complex::new(0.0, std::f64::consts::TAU * hertz);
    let system = DMatrix::from_fn(size, size, |row, column| {
        let own = if row == column {
            jw
        } else {
            Complex::default()
        };
        own - Complex::new(a[(row, column)], 0.0)
    });
    let mut b = nalgebra::DVector::from_element(size, Complex::default());
    b[0] = Complex::new(1.0 / 0.0099, 0.0);
    let x = system.lu().solve(&b).unwrap();
    [x[0], x[1]]
}

fn found(mode: ModeKind, pathway: Pathway, all: &[Mode]) -> Vec<Mode> {
    let own = all
        .iter()
        .filter(|own| own.kind == mode && own.pathway == pathway);
    own.copied().collect()
}

fn assert_mode(mode: &Mode, hertz: f64, damping: f64) {
    let (off, off_damping) = (
        mode.frequency_hz / hertz - 1.0,
        mode.damping_ratio / damping - 1.0,
    );
    println!("{mode:?}: {off:+.4} {off_damping:+.3}");
    assert!(off.abs() < 0.02, "{mode:?}, true {hertz} Hz");
    assert!(off_damping.abs() < 0.2, "{mode:?}, true {damping}");
    let sigmas = (mode.frequency_hz - hertz).abs() / mode.frequency_std_hz;
    let damping_sigmas = (mode.damping_ratio - damping).abs() / mode.damping_std;
    println!("{sigmas:.2} {damping_sigmas:.2}");
    assert!(
        sigmas < 4.0,
        "{mode:?}, true {hertz} Hz: {sigmas} deviations"
    );
}

#[test]
fn resonance_and_anti_resonance_are_found_with_their_damping_in_thirty_seconds() {
    for (segment, coupling) in [
        (prbs(30.0), COUPLING),
        (chirp(30.0), COUPLING),
        (prbs(30.0), [35.0, 0.3, 0.01, 0.5]),
        (prbs(30.0), [12.0, 0.7, 0.05, 0.2]),
    ] {
        let model = model(Some(coupling));
        let all = frequency_response(&[scenario(&model, segment, 500.0, 1)]).unwrap();
        let [hertz, ratio, damping, _] = coupling;
        println!("{:#?}", all.modes);
        // The mechanics by themselves: the coupling's own frequency; the load against a held motor.
        let mechanics = found(ModeKind::Resonance, Pathway::CurrentToSpeed, &all.modes);
        assert_mode(&mechanics[0], hertz, damping);
        let anti = found(ModeKind::AntiResonance, Pathway::VoltageToSpeed, &all.modes);
        let held = (1.0 - ratio).sqrt();
        assert_mode(&anti[0], hertz * held, damping * held);
        // Behind the winding: the poles of the whole.
        let eigenvalues = matrix(coupling).complex_eigenvalues();
        let pole = eigenvalues
            .iter()
            .filter(|p| p.im > 1.0 && -p.re < 0.5 * p.norm());
        let pole = pole.max_by(|a, b| a.im.total_cmp(&b.im)).unwrap();
        let poles = found(ModeKind::Resonance, Pathway::VoltageToSpeed, &all.modes);
        let nearest = poles.last().unwrap();
        assert_mode(
            nearest,
            pole.norm() / std::f64::consts::TAU,
            -pole.re / pole.norm(),
        );
    }
}

#[test]
fn a_rigid_shaft_has_no_resonance_and_intervals_hold_its_response() {
    let (mut inside, mut count) = (0.0, 0.0);
    for seed in 0..4 {
        let segment = if seed % 2 == 0 {
            prbs(20.0)
        } else {
            chirp(20.0)
        };
        let all = frequency_response(&[scenario(&model(None), segment, 500.0, seed)]).unwrap();
        assert!(all.modes.is_empty(), "{:?}", all.modes);
        let rigid = matrix(COUPLING).view((0, 0), (2, 2)).into_owned();
        let mut rigid = rigid;
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
                if !holds && seed < 2 {
                    println!(
                        "{:?} {:.2} Hz {:.4} {:.4}..{:.4} true {:.4}",
                        own.pathway,
                        point.frequency_hz,
                        point.magnitude,
                        point.magnitude_low,
                        point.magnitude_high,
                        value.norm()
                    );
                }
            }
        }
    }
    let share: f64 = inside / count;
    assert!(
        count > 1000.0 && (0.9..0.985).contains(&share),
        "{share} of {count}"
    );
}

#[test]
fn what_the_excitation_does_not_carry_is_not_said_to_be() {
    let slow = Segment::Chirp(Chirp {
        amplitude_v: 6.0,
        from_hz: 1.0,
        to_hz: 10.0,
        seconds: 20.0,
        offset_v: 20.0,
    });
    let all = frequency_response(&[scenario(&model(None), slow, 500.0, 1)]).unwrap();
    let speed = &all.pathways[0];
    let carried = |from: f64, to: f64| {
        let own = speed
            .points
            .iter()
            .filter(|p| (from..to).contains(&p.frequency_hz));
        let own: Vec<_> = own.collect();
        own.iter().filter(|point| point.is_carried).count() as f64 / own.len() as f64
    };
    assert!(carried(1.5, 9.0) > 0.95);
    assert!(carried(30.0, 200.0) < 0.2, "{}", carried(30.0, 200.0));
}

#[test]
fn a_record_that_tells_nothing_is_refused_with_its_reason() {
    let steady = Segment::Prbs(Prbs {
        amplitude_v: 1.0,
        clock_s: 10.0,
        seconds: 10.0,
        seed: 1,
        offset_v: 20.0,
        levels: 2,
    });
    let mut steady = scenario(&model(None), steady, 100.0, 1);
    steady.events = vec![(0.0, 20.0)];
    let refused = frequency_response(&[steady.clone()]).unwrap_err();
    assert!(matches!(refused, FrequencyResponseError::Steady { .. }));
    let mut short = steady.clone();
    short.sample_time_s.truncate(50);
    let refused = frequency_response(&[short]).unwrap_err();
    assert!(matches!(
        refused,
        FrequencyResponseError::Short { rows: 50, .. }
    ));
    let mut current = steady;
    current.input = Input::Current;
    assert!(frequency_response(&[current]).is_err());
}

#[test]
fn a_shaft_that_turns_round_all_the_time_is_used_whole_and_said() {
    let about_zero = Segment::Prbs(Prbs {
        amplitude_v: 20.0,
        clock_s: 0.1,
        seconds: 10.0,
        seed: 1,
        offset_v: 0.0,
        levels: 2,
    });
    let all = frequency_response(&[scenario(&model(None), about_zero, 200.0, 1)]).unwrap();
    assert!(
        all.cautions[0].contains("never keeps turning"),
        "{:?}",
        all.cautions
    );
    assert_eq!(all.stretches, 1);
}

fn beside(truth: &Model, model: &Model, segment: Segment, seed: u64) -> Compared {
    let measured = [scenario(truth, segment, 500.0, seed)];
    let simulated = of_model(model, &measured).unwrap();
    compared(&measured, Some(&simulated)).unwrap()
}

#[test]
fn a_true_model_departs_nowhere_and_one_without_the_coupling_where_it_swings() {
    for seed in 0..4 {
        let segment = if seed % 2 == 0 {
            prbs(20.0)
        } else {
            chirp(20.0)
        };
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
        let mut bands = found.departures.iter();
        let holds = |band: &&Departure| (band.from_hz..band.to_hz).contains(&22.0);
        let band = bands.find(holds).unwrap();
        assert!(band.magnitude_db.abs() > 6.0, "{band:?}");
    }
}

#[test]
fn runs_of_one_machine_agree_and_those_of_two_are_told() {
    let (coupled, rigid) = (model(Some(COUPLING)), model(None));
    for (segment, seed) in [(prbs(20.0), 1), (chirp(20.0), 2)] {
        let run = |model: &Model, seed| scenario(model, segment.clone(), 500.0, seed);
        let cautions = |other: Scenario| {
            let runs = [run(&coupled, seed), other];
            compared(&runs, None).unwrap().measured.cautions
        };
        assert_eq!(cautions(run(&coupled, seed + 10)), Vec::<String>::new());
        let said = cautions(run(&rigid, seed + 10));
        assert_eq!(said.len(), 1, "{said:?}");
        assert!(said[0].contains("of one machine"), "{said:?}");
    }
}
