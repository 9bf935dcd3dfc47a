//! Several effects at once on an axis that a torque or a current drives, beside a disturbance with a memory: what is there
//! is named, and nothing else.

use super::*;
use crate::identification::speed_from_angle;
use crate::plant::{ActiveEffect, Input, Motor, MotorKey};
use crate::sample::{Channel, Origin, Run};
use rand_distr::StandardNormal;

const PERIOD_S: f64 = 1e-3;
const SAMPLES: usize = 10_000;
const TORQUE_N_M_PER_A: f64 = 0.35;

/// How a record comes about.
#[derive(Clone, Copy)]
struct Bench {
    input: Input,
    /// Standard deviation of the disturbance torque, N.m, which remembers itself for half a second.
    disturbance_n_m: f64,
    /// Of the noise of each sample of the torque, N.m.
    input_n_m: f64,
    /// Counts of the encoder in a turn, where there is no speed.
    counts: Option<f64>,
}

const BY_TORQUE: Bench = Bench {
    input: Input::Torque,
    disturbance_n_m: 0.01,
    input_n_m: 0.0,
    counts: None,
};
const BY_CURRENT: Bench = Bench {
    input: Input::Current,
    input_n_m: 0.02,
    ..BY_TORQUE
};

fn axis() -> Model {
    let motor = Motor::new("axis")
        .with(MotorKey::Inertia, 0.0045)
        .with(MotorKey::LoadTorque, 0.35)
        .with(MotorKey::TorqueConstant, TORQUE_N_M_PER_A);
    Model::baseline(motor)
}

fn machine(effects: &[(&str, &[f64])]) -> Model {
    let mut model = axis();
    for (id, values) in effects {
        model.effects.push(ActiveEffect {
            effect: effect::find(id).unwrap(),
            values: values.iter().copied().map(Some).collect(),
        });
    }
    model
}

/// Speed and angle of the machine, by small steps of its own.
#[derive(Default)]
struct Shaft {
    time_s: f64,
    speed_rad_s: f64,
    angle_rad: f64,
}

impl Shaft {
    fn step(&mut self, machine: &Model, drive_n_m: f64, disturbance_n_m: f64) {
        const STEPS: u32 = 10;
        let h = PERIOD_S / f64::from(STEPS);
        let effects: Vec<_> = machine
            .effects
            .iter()
            .map(|active| active.effect.terms(&active.values_or_guess()))
            .collect();
        for _ in 0..STEPS {
            let at = Instant {
                time_s: self.time_s,
                current_a: drive_n_m / TORQUE_N_M_PER_A,
                speed_rad_s: self.speed_rad_s,
                angle: crate::plant::ShaftAngle::at(self.angle_rad),
                torque_n_m_per_a: TORQUE_N_M_PER_A,
                ..Instant::default()
            };
            let (mut net, mut level) = (drive_n_m - disturbance_n_m, 0.35);
            for terms in &effects {
                net -= terms.torque_n_m(&at, &[]);
                level += terms.friction_n_m(&at);
            }
            let stopping = h * level / 0.0045;
            let free = self.speed_rad_s + h * net / 0.0045;
            // Friction takes what it can, and no more than the speed.
            self.speed_rad_s = free.signum() * (free.abs() - stopping).max(0.0);
            self.angle_rad += h * self.speed_rad_s;
            self.time_s += h;
        }
    }
}

fn record(machine: &Model, bench: Bench, seed: u64) -> Scenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = || rng.sample::<f64, _>(StandardNormal);
    let times: Vec<f64> = (0..SAMPLES).map(|k| k as f64 * PERIOD_S).collect();
    let kept = (-PERIOD_S / 0.5_f64).exp();
    let (mut level, mut disturbance, mut wanted) = (0.0, 0.0, 0.0);
    let (mut given, mut speeds, mut angles) = (Vec::new(), Vec::new(), Vec::new());
    let mut shaft = Shaft::default();
    for k in 0..SAMPLES {
        if k >= 200 && (k - 200) % 400 == 0 {
            wanted = 60.0 * normal().clamp(-1.6, 1.6);
        }
        // A speed loop gives the torque: smooth, and never at rest for long. The standstill before it tells the noise.
        let torque = 0.06 * (wanted - shaft.speed_rad_s) + 0.4 * f64::signum(wanted);
        let torque = if k < 200 {
            0.0
        } else {
            torque.clamp(-2.0, 2.0)
        };
        level += 0.2 * (torque - level);
        disturbance =
            kept * disturbance + bench.disturbance_n_m * (1.0 - kept * kept).sqrt() * normal();
        given.push(level + bench.input_n_m * normal());
        speeds.push(shaft.speed_rad_s + 0.15 * normal());
        angles.push(shaft.angle_rad);
        shaft.step(machine, level, disturbance);
    }
    let mut run = Run::new(format!("axis {seed}"), times).unwrap();
    let (channel, per) = if bench.input == Input::Torque {
        (Channel::Torque, 1.0)
    } else {
        (Channel::Current, TORQUE_N_M_PER_A)
    };
    let given = given.iter().map(|torque| torque / per).collect();
    run.set_column(channel, given, Origin::Measured).unwrap();
    if let Some(counts) = bench.counts {
        let resolution = std::f64::consts::TAU / counts;
        let counted = |angle: &f64| (angle / resolution).round() * resolution;
        let cells = angles.iter().map(counted).collect();
        run.set_column(Channel::Angle, cells, Origin::Measured)
            .unwrap();
    } else {
        run.set_column(Channel::Speed, speeds, Origin::Measured)
            .unwrap();
    }
    Scenario::from_run(&speed_from_angle::complete(&run).unwrap()).unwrap()
}

fn named(machine: &Model, bench: Bench, seed: u64) -> Diagnosis {
    let runs = [0, 1].map(|more| record(machine, bench, 2 * seed + more));
    let [training, holdout] = runs;
    let evidence = Evidence::new(training, Some(holdout), None);
    let diagnosis = diagnose(&axis(), &evidence).unwrap();
    eprintln!(
        "{seed}: {}; unknown {:?}",
        diagnosis.sentence, diagnosis.unknown
    );
    diagnosis
}

const PAIRS: [[(&str, &[f64]); 2]; 3] = [
    [
        ("viscous_friction", &[1e-3]),
        ("cogging", &[0.02, 0.01, 7.0]),
    ],
    [
        ("constant_load", &[0.06]),
        ("eccentric_load", &[0.03, 0.02]),
    ],
    [
        ("stribeck_friction", &[0.2, 12.0]),
        ("quadratic_load", &[2e-5]),
    ],
];

fn finds_both(bench: Bench, seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let pair = PAIRS[usize::try_from(seed).unwrap() % PAIRS.len()];
        let found = named(&machine(&pair), bench, seed);
        let mut names = found.effects.clone();
        names.sort_unstable();
        let mut there = pair.map(|(id, _)| id);
        there.sort_unstable();
        assert_eq!(names, there, "{seed}: {}", found.sentence);
        assert!(found.holdout_after < found.holdout_before);
        for (id, _) in pair {
            assert_eq!(status(&found, id), Status::Supported, "{seed} {id}");
        }
    }
}

fn names_nothing(bench: Bench, seeds: std::ops::Range<u64>) {
    for seed in seeds {
        let found = named(&machine(&[]), bench, seed);
        assert!(found.effects.is_empty(), "{seed}: {}", found.sentence);
        assert!(found.unknown.is_empty(), "{seed}: {:?}", found.unknown);
    }
}

#[test]
fn two_effects_at_once_are_named_where_a_torque_drives() {
    finds_both(BY_TORQUE, 0..3);
}

#[test]
fn two_effects_at_once_are_named_where_a_noisy_current_drives() {
    finds_both(BY_CURRENT, 3..6);
}

#[test]
fn two_effects_at_once_are_named_where_only_the_angle_is_measured() {
    let coarse = Bench {
        counts: Some(4096.0),
        ..BY_TORQUE
    };
    finds_both(coarse, 6..9);
}

#[test]
fn nothing_is_named_where_nothing_is_there() {
    for counts in [None, Some(4096.0)] {
        for bench in [BY_TORQUE, BY_CURRENT] {
            names_nothing(Bench { counts, ..bench }, 10..12);
        }
    }
}

#[test]
fn what_acts_in_the_armature_is_not_asked_of_a_run_without_a_voltage() {
    let found = named(&machine(&PAIRS[0]), BY_TORQUE, 0);
    for id in [
        "voltage_drop",
        "command_delay",
        "winding_heating",
        "flux_saturation",
    ] {
        let candidate = found
            .candidates
            .iter()
            .find(|one| one.effect == id)
            .unwrap();
        assert_eq!(candidate.status, Status::NotExcited, "{id}");
        assert!(
            candidate.evidence.contains("cannot be judged"),
            "{}",
            candidate.evidence
        );
        assert_eq!(candidate.upper_bound, None);
    }
}
