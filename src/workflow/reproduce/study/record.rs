//! Records of a case: two runs of the software drive in virtual time, through its registers.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use thiserror::Error;

use super::sizes;
use super::truth::{Truth, truths};
use super::{Case, Group};
use crate::drive::{DriveLink, LinkError};
use crate::emulator::truth::MotorTruth;
use crate::emulator::truth::effect::HiddenEffect;
use crate::emulator::{
    EmulatorConfig, EmulatorConfigError, Latency, MemoryLink, SoftDrive, VirtualClock,
};
use crate::excitation::{
    ExcitationError, Output, Prbs, Program, Ramp, Segment, Standstill, Steps, rich,
};
use crate::plant::{Scenario, ScenarioError};
use crate::sample::{Channel, Command, Demand, Origin, Run, RunError, Sample};

/// Spread of the specimens' R, L, Ke, J and Mc about the nameplate.
const TOLERANCE: f64 = 0.15;
/// Sensors of a common servo drive: 1 r/min and 10 mA steps, noise of about the same size.
const SPEED_NOISE_RAD_S: f64 = 0.15;
const SPEED_STEP_RAD_S: f64 = 0.104_72;
const CURRENT_NOISE_A: f64 = 0.03;
const CURRENT_STEP_A: f64 = 0.01;
/// So much noisier are the sensors where they are bad, and so much smaller the hidden effect on a harsh background.
const BAD_SENSORS_RATIO: f64 = 3.0;
const HARSH_SIZE_RATIO: f64 = 0.5;
/// Share of the rows that a bad line loses at random, and how long it is away altogether.
const LOST_SHARE: f64 = 0.1;
const AWAY_S: f64 = 0.4;
/// Stream of the generator that draws them: the run itself is that of a line that loses nothing.
const LOSS_STREAM: u64 = 1;
const FULL_V: f64 = 105.0;
const SLEW_V_PER_S: f64 = 350.0;
const PRBS_SLEW_V_PER_S: f64 = 500.0;
/// At rest first: the noise floor and the offsets come from here.
const STANDSTILL_S: f64 = 0.5;
/// A slow link samples for longer, and its polls lie up to this much late: the stamps say when.
const LATE_S: f64 = 0.003;

/// How the machine is moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Excitation {
    Rich,
    Steps,
    Unipolar,
    Prbs,
    Ramp,
    /// The rich sequence over a serial link.
    Rich100Hz,
}

impl Excitation {
    pub const ALL: [Self; 6] = [
        Self::Rich,
        Self::Steps,
        Self::Unipolar,
        Self::Prbs,
        Self::Ramp,
        Self::Rich100Hz,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Rich => "rich",
            Self::Steps => "steps",
            Self::Unipolar => "unipolar",
            Self::Prbs => "prbs",
            Self::Ramp => "ramp",
            Self::Rich100Hz => "rich 100 Hz",
        }
    }

    pub const fn description(self) -> &'static str {
        match self {
            Self::Rich => {
                "the default sequence: steps with dither, ramp, five levels at random, slow sine; 1 kHz"
            }
            Self::Steps => "random levels of both signs up to 105 V, held for 0.45 s; 1 kHz",
            Self::Unipolar => "the same with positive levels only, the shaft never reverses; 1 kHz",
            Self::Prbs => "nine levels up to 85 V at random, changing every 80 ms; 1 kHz",
            Self::Ramp => "slow ramps through the full range, nothing quick; 1 kHz",
            Self::Rich100Hz => {
                "the default sequence at 100 Hz, every poll up to 3 ms late and stamped"
            }
        }
    }

    const fn period_s(self) -> f64 {
        match self {
            Self::Rich100Hz => 0.01,
            _ => 0.001,
        }
    }

    fn program(self, rng: &mut ChaCha8Rng, seconds: f64) -> Result<Program, ExcitationError> {
        let still = Segment::Standstill(Standstill {
            seconds: STANDSTILL_S,
        });
        let hold_s = 0.45;
        let mut levels = |low: f64, high: f64| {
            let mut levels_v = Vec::new();
            while (levels_v.len() as f64) * hold_s < seconds - STANDSTILL_S {
                levels_v.push(rng.random_range(low..high));
            }
            Segment::Steps(Steps {
                levels_v,
                hold_s,
                dither: None,
            })
        };
        match self {
            Self::Rich | Self::Rich100Hz => {
                Program::new(&rich(FULL_V, SLEW_V_PER_S, rng.random()), SLEW_V_PER_S)
            }
            Self::Steps => Program::new(&[still, levels(-FULL_V, FULL_V)], SLEW_V_PER_S),
            Self::Unipolar => Program::new(&[still, levels(12.0, FULL_V)], SLEW_V_PER_S),
            Self::Prbs => {
                let prbs = Prbs {
                    amplitude_v: 85.0,
                    clock_s: 0.08,
                    seconds: seconds - STANDSTILL_S,
                    seed: rng.random(),
                    offset_v: 0.0,
                    levels: 9,
                };
                Program::new(&[still, Segment::Prbs(prbs)], PRBS_SLEW_V_PER_S)
            }
            Self::Ramp => {
                let sign = if rng.random() { 1.0 } else { -1.0 };
                let mut level = |sign: f64| sign * rng.random_range(0.8 * FULL_V..FULL_V);
                let (first_v, second_v) = (level(sign), level(-sign));
                let quarter_s = 0.25 * (seconds - STANDSTILL_S);
                let ramp = |from_v, to_v, seconds| {
                    Segment::Ramp(Ramp {
                        from_v,
                        to_v,
                        seconds,
                        dither: None,
                    })
                };
                let parts = [
                    still,
                    ramp(0.0, first_v, quarter_s),
                    ramp(first_v, second_v, 2.0 * quarter_s),
                    ramp(second_v, 0.0, quarter_s),
                ];
                Program::new(&parts, SLEW_V_PER_S)
            }
        }
    }
}

/// Why a set has no runs: a fault of the study, never a verdict on the diagnosis.
#[derive(Debug, Error)]
pub(super) enum StudyError {
    #[error("the study draws no size of the hidden effect {0}")]
    Effect(String),
    #[error(transparent)]
    Config(#[from] EmulatorConfigError),
    #[error(transparent)]
    Excitation(#[from] ExcitationError),
    #[error(transparent)]
    Link(#[from] LinkError),
    #[error(transparent)]
    Run(#[from] RunError),
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    #[error("the drive tripped at {time_s} s")]
    Tripped { time_s: f64 },
}

/// Two runs of one specimen, each from rest and cold, and what it is made of.
#[derive(Debug)]
pub(super) struct Runs {
    pub(super) fit: Scenario,
    pub(super) holdout: Scenario,
    pub(super) truths: Vec<Truth>,
    pub(super) motor: MotorTruth,
}

pub(super) fn runs(case: &Case) -> Result<Runs, StudyError> {
    let mut rng = ChaCha8Rng::seed_from_u64(case.seed);
    let mut losses = ChaCha8Rng::seed_from_u64(case.seed);
    losses.set_stream(LOSS_STREAM);
    let config = config(case, &mut rng)?;
    let mut run = |name: &str| {
        let program = case.excitation.program(&mut rng, case.seconds)?;
        let mut rows = exchanged(&config, case.excitation.period_s(), &program, &mut rng)?;
        if case.group == Group::Lossy {
            lose(&mut rows, &mut losses);
        }
        recorded(name, &rows)
    };
    Ok(Runs {
        fit: run("fit")?,
        holdout: run("hold-out")?,
        truths: truths(&config.hidden, &config.motor),
        motor: config.motor.clone(),
    })
}

/// The specimen: drawn here and not by the drive, whose seed is left for noise and for what is random in an effect.
fn config(case: &Case, rng: &mut ChaCha8Rng) -> Result<EmulatorConfig, StudyError> {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain")?;
    config.motor = config.motor.specimen(TOLERANCE, rng.random());
    config.tolerance = 0.0;
    // The study asks about the diagnosis: neither the drive's limiter nor its switches are to take part.
    config.limits.current_limit_a = 100.0;
    config.limits.bus_v = 120.0;
    config.limits.speed_limit_rad_s = 1000.0;
    config.limits.winding_limit_c = 1000.0;
    let noise = match case.group {
        Group::Harsh | Group::Noisy => BAD_SENSORS_RATIO,
        _ => 1.0,
    };
    config.noise.current_a = noise * CURRENT_NOISE_A;
    config.noise.speed_rad_s = noise * SPEED_NOISE_RAD_S;
    config.quantisation.current_a = CURRENT_STEP_A;
    config.quantisation.speed_rad_s = SPEED_STEP_RAD_S;
    config.hidden.clear();
    let is_harsh = case.group == Group::Harsh;
    let share = if is_harsh { HARSH_SIZE_RATIO } else { 1.0 };
    let known = |id: &str, hidden: Option<HiddenEffect>| {
        hidden.ok_or_else(|| StudyError::Effect(id.to_owned()))
    };
    for id in &case.hidden {
        let hidden = known(id, sizes::drawn(id, share, rng))?;
        config.hidden.push(hidden);
    }
    if let Some(level) = case.group.background() {
        let hidden = known("messy", HiddenEffect::new("messy", &[("scale", level)]))?;
        config.hidden.push(hidden);
    }
    Ok(config)
}

/// What was commanded, and the telemetry that came back.
type Row = (f64, Sample);

/// Writes the program's voltage and reads the telemetry, period by period.
fn exchanged(
    config: &EmulatorConfig,
    period_s: f64,
    program: &Program,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Row>, StudyError> {
    let clock = VirtualClock::new();
    let no_wire = Latency {
        request_s: 0.0,
        reply_s: 0.0,
    };
    let drive = SoftDrive::new(config, rng.random());
    let mut link = MemoryLink::new(drive, clock.clone(), no_wire);
    let mut rows: Vec<Row> = Vec::new();
    let late_s = if period_s > 0.005 { LATE_S } else { 0.0 };
    let mut seq = 0;
    loop {
        let due_s = seq as f64 * period_s;
        if due_s > program.duration_s() {
            return Ok(rows);
        }
        let time_s = due_s + late_s * rng.random::<f64>();
        clock.set_time_s(time_s);
        let volts = match program.value_at(time_s) {
            Output::Voltage(volts) => volts,
            Output::Coast => 0.0,
        };
        seq += 1;
        let demand = Demand::Voltage(volts);
        let sample = link.exchange(Command { seq, demand })?;
        if sample.fault.is_some() {
            return Err(StudyError::Tripped { time_s });
        }
        rows.push((volts, sample));
    }
}

/// Takes out what a bad line did not bring: single rows, and all rows of one stretch after the standstill. The drive had
/// its commands all the same.
fn lose(rows: &mut Vec<Row>, rng: &mut ChaCha8Rng) {
    let end_s = rows.last().map_or(0.0, |(_, sample)| sample.time_s);
    let away_s = rng.random_range(STANDSTILL_S..end_s - AWAY_S);
    let away_s = away_s..away_s + AWAY_S;
    rows.retain(|(_, sample)| {
        let is_lost = rng.random::<f64>() < LOST_SHARE;
        !is_lost && !away_s.contains(&sample.time_s)
    });
}

/// The rows as a recorder would have written them: the command at the drive time at which it was applied, and the sample.
fn recorded(name: &str, rows: &[Row]) -> Result<Scenario, StudyError> {
    let mut run = Run::new(name, rows.iter().map(|(_, sample)| sample.time_s).collect())?;
    // Without latency a command is applied at the instant of its own sample.
    let commands = rows.iter().map(|(volts, _)| *volts).collect();
    run.set_column(Channel::VoltageCmd, commands, Origin::Commanded)?;
    for channel in [Channel::Current, Channel::Speed, Channel::Angle] {
        let cells = rows.iter().map(|(_, sample)| sample.get(channel));
        let cells = cells.map(|cell| cell.unwrap_or(f64::NAN)).collect();
        run.set_column(channel, cells, Origin::Measured)?;
    }
    Ok(Scenario::from_run(&run)?)
}
