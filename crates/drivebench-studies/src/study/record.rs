//! Records of a case: two runs of the software drive in virtual time, through its registers; and the truth of the machine: each
//! effect with its right names, its waves in a turn and its size.
//!
//! The emulator's effects have other forms than the catalogue's, so that a size needs a condition at which both are held
//! against each other. It is the key's own meaning where that names one (a saturation at rated current, a delay, an
//! offset, the first harmonic of a wave); for drags the torque at half the rated speed, settled behind a lag, for friction that falls with
//! speed that at half its own speed, for a drifting field its change six seconds after the start, each divided by that
//! of the catalogue's form with size one.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use thiserror::Error;

use super::cases::{drawn, right_names};
use super::{Case, Class, Excitation, Group};
use drivebench::drive::{DriveLink, LinkError};
use drivebench::emulator::truth::MotorTruth;
use drivebench::emulator::truth::effect::{HiddenEffect, Moment, Site};
use drivebench::emulator::{
    EmulatorConfig, EmulatorConfigError, Latency, MemoryLink, SoftDrive, VirtualClock,
};
use drivebench::excitation::{
    ExcitationError, Output, Prbs, Program, Ramp, Segment, Standstill, Steps, rich,
};
use drivebench::plant::{Instant, Scenario, ScenarioError, effect};
use drivebench::sample::{Channel, Command, Demand, Origin, Run, RunError, Sample};

/// The specimens, their sensors, their lines and how they are moved.
struct Settings {
    /// Spread of R, L, Ke, J and Mc about the nameplate.
    tolerance: f64,
    /// Sensors of a common servo drive: 1 r/min and 10 mA steps, noise of about the same size.
    speed_noise_rad_s: f64,
    speed_step_rad_s: f64,
    current_noise_a: f64,
    current_step_a: f64,
    /// So much noisier are the sensors where they are bad, and so much smaller the hidden effect on a harsh background.
    bad_sensors_ratio: f64,
    harsh_size_ratio: f64,
    /// Share of the rows that a bad line loses at random, and how long it is away altogether.
    lost_share: f64,
    away_s: f64,
    /// A slow link samples for longer, and its polls lie up to this much late: the stamps have the true times.
    late_s: f64,
    full_v: f64,
    slew_v_per_s: f64,
    prbs_slew_v_per_s: f64,
    /// At rest first: the noise floor and the offsets come from here.
    standstill_s: f64,
}

const SETTINGS: Settings = Settings {
    tolerance: 0.15,
    speed_noise_rad_s: 0.15,
    speed_step_rad_s: 0.104_72,
    current_noise_a: 0.03,
    current_step_a: 0.01,
    bad_sensors_ratio: 3.0,
    harsh_size_ratio: 0.5,
    lost_share: 0.1,
    away_s: 0.4,
    late_s: 0.003,
    full_v: 105.0,
    slew_v_per_s: 350.0,
    prbs_slew_v_per_s: 500.0,
    standstill_s: 0.5,
};

impl Excitation {
    pub(super) const fn period_s(self) -> f64 {
        match self {
            Self::Rich100Hz => 0.01,
            _ => 0.001,
        }
    }

    fn program(self, rng: &mut ChaCha8Rng, seconds: f64) -> Result<Program, ExcitationError> {
        let Settings { full_v, slew_v_per_s, standstill_s, .. } = SETTINGS;
        let still = Segment::Standstill(Standstill { seconds: standstill_s });
        let hold_s = 0.45;
        let mut levels = |low: f64, high: f64| {
            let mut levels_v = Vec::new();
            while (levels_v.len() as f64) * hold_s < seconds - standstill_s {
                levels_v.push(rng.random_range(low..high));
            }
            Segment::Steps(Steps { levels_v, hold_s, dither: None })
        };
        match self {
            Self::Rich | Self::Rich100Hz => {
                Program::new(&rich(full_v, slew_v_per_s, rng.random()), slew_v_per_s)
            }
            Self::Steps => Program::new(&[still, levels(-full_v, full_v)], slew_v_per_s),
            Self::Unipolar => Program::new(&[still, levels(12.0, full_v)], slew_v_per_s),
            Self::Prbs => {
                let prbs = Prbs {
                    amplitude_v: 85.0,
                    clock_s: 0.08,
                    seconds: seconds - standstill_s,
                    seed: rng.random(),
                    offset_v: 0.0,
                    levels: 9,
                };
                Program::new(&[still, Segment::Prbs(prbs)], SETTINGS.prbs_slew_v_per_s)
            }
            Self::Ramp => {
                let sign = if rng.random() { 1.0 } else { -1.0 };
                let mut level = |sign: f64| sign * rng.random_range(0.8 * full_v..full_v);
                let (first_v, second_v) = (level(sign), level(-sign));
                let quarter_s = 0.25 * (seconds - standstill_s);
                let ramp = |from_v, to_v, seconds| {
                    Segment::Ramp(Ramp { from_v, to_v, seconds, dither: None })
                };
                let parts = [
                    still,
                    ramp(0.0, first_v, quarter_s),
                    ramp(first_v, second_v, 2.0 * quarter_s),
                    ramp(second_v, 0.0, quarter_s),
                ];
                Program::new(&parts, slew_v_per_s)
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
    // The run itself is that of a line that loses nothing.
    losses.set_stream(1);
    let config = config(case, &mut rng)?;
    let mut run = |name: &str| {
        let program = case.excitation.program(&mut rng, case.seconds)?;
        let mut rows = exchanged(&config, case, &program, &mut rng)?;
        if case.group == Group::Lossy {
            lose(&mut rows, &mut losses);
        }
        recorded(name, &rows, case.motor_class(), &mut rng)
    };
    let late = case.motor_class().and_then(Class::late);
    Ok(Runs {
        fit: run("fit")?,
        holdout: run("hold-out")?,
        truths: truths(&config.hidden, &config.motor).into_iter().chain(late).collect(),
        motor: config.motor.clone(),
    })
}

/// The specimen: drawn here and not by the drive, whose seed is left for noise and for what is random in an effect.
fn config(case: &Case, rng: &mut ChaCha8Rng) -> Result<EmulatorConfig, StudyError> {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain")?;
    if let Some(class) = case.motor_class() {
        config.motor = class.of(&config.motor);
    }
    config.motor = config.motor.specimen(SETTINGS.tolerance, rng.random());
    config.tolerance = 0.0;
    // The study tests the diagnosis: neither the drive's limiter nor its switches are to take part.
    config.limits.current_limit_a = 100.0;
    config.limits.bus_v = 120.0;
    config.limits.speed_limit_rad_s = 1000.0;
    config.limits.winding_limit_c = 1000.0;
    let noise = match case.group {
        Group::Harsh | Group::Noisy => SETTINGS.bad_sensors_ratio,
        _ => 1.0,
    };
    config.noise.current_a = noise * SETTINGS.current_noise_a;
    config.noise.speed_rad_s = noise * SETTINGS.speed_noise_rad_s;
    config.quantisation.current_a = SETTINGS.current_step_a;
    config.quantisation.speed_rad_s = SETTINGS.speed_step_rad_s;
    if let Some(Class { sensors, .. }) = case.motor_class() {
        // A small inductance lets a reversal draw twice the stall current, and a large inertia keeps it for seconds.
        config.limits.current_limit_a = 1000.0;
        config.limits.winding_limit_c = 1e5;
        let white = if sensors.memory_s > 0.0 { 0.0 } else { 1.0 };
        [config.noise.current_a, config.noise.speed_rad_s] = sensors.noise.map(|sd| white * sd);
        [config.quantisation.current_a, config.quantisation.speed_rad_s] = sensors.step;
    }
    config.hidden.clear();
    let is_harsh = case.group == Group::Harsh;
    let share = if is_harsh { SETTINGS.harsh_size_ratio } else { 1.0 };
    let known = |id: &str, hidden: Option<HiddenEffect>| {
        hidden.ok_or_else(|| StudyError::Effect(id.to_owned()))
    };
    for id in &case.hidden {
        let hidden = known(id, drawn(id, share, rng))?;
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
    case: &Case,
    program: &Program,
    rng: &mut ChaCha8Rng,
) -> Result<Vec<Row>, StudyError> {
    let period_s = case.period_s();
    let clock = VirtualClock::new();
    let no_wire = Latency { request_s: 0.0, reply_s: 0.0 };
    let drive = SoftDrive::new(config, rng.random());
    let mut link = MemoryLink::new(drive, clock.clone(), no_wire);
    let mut rows: Vec<Row> = Vec::new();
    let late_s = if case.excitation == Excitation::Rich100Hz { SETTINGS.late_s } else { 0.0 };
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
    let away_s = rng.random_range(SETTINGS.standstill_s..end_s - SETTINGS.away_s);
    let away_s = away_s..away_s + SETTINGS.away_s;
    rows.retain(|(_, sample)| {
        let is_lost = rng.random::<f64>() < SETTINGS.lost_share;
        !is_lost && !away_s.contains(&sample.time_s)
    });
}

/// The rows as a recorder would have written them: the command at the drive time at which it was applied, and the sample. A log of
/// another class has its sensors and columns, and no angle.
fn recorded(
    name: &str,
    rows: &[Row],
    class: Option<&Class>,
    rng: &mut ChaCha8Rng,
) -> Result<Scenario, StudyError> {
    let mut run = Run::new(name, rows.iter().map(|(_, sample)| sample.time_s).collect())?;
    // Without latency a command is applied at the instant of its own sample.
    let commands: Vec<f64> = rows.iter().map(|(volts, _)| *volts).collect();
    let signals = [Channel::Current, Channel::Speed, Channel::Angle].map(|channel| {
        let cells = rows.iter().map(|(_, sample)| sample.get(channel));
        (channel, cells.map(|cell| cell.unwrap_or(f64::NAN)).collect::<Vec<f64>>())
    });
    let mut columns = vec![(Channel::VoltageCmd, commands, Origin::Commanded)];
    columns.extend(signals.map(|(channel, cells)| (channel, cells, Origin::Measured)));
    if let Some(class) = class {
        class.make_log(&mut columns, rng);
    }
    for (channel, cells, origin) in columns {
        run.set_column(channel, cells, origin)?;
    }
    Ok(Scenario::from_run(&run)?)
}

/// Names of a speed that is late.
pub(super) const LATE_SPEED: [&str; 2] = ["speed_delay", "speed_filter"];

/// One effect that is there, and that the catalogue has a name for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Truth {
    /// The names that are right for it, each with its size in the unit of the first parameter, the amplitude where that is
    /// one of sine and cosine; none where the parameter is no size.
    pub(super) names: Vec<(&'static str, Option<f64>)>,
    /// Waves in a turn.
    pub(super) order: Option<f64>,
}

/// Everything in a machine that the catalogue has a name for: what is hidden first, as it is listed, with a background
/// taken apart.
pub(super) fn truths(hidden: &[HiddenEffect], motor: &MotorTruth) -> Vec<Truth> {
    let site = Site::of(motor);
    let single = hidden.iter().flat_map(|effect| effect.single(&site));
    single.map(|effect| Truth::of(&effect, &site)).filter(|truth| !truth.names.is_empty()).collect()
}

impl Truth {
    /// A speed that is late by this time.
    pub(super) fn late_speed(by_s: f64) -> Self {
        Self { names: LATE_SPEED.map(|id| (id, Some(by_s))).to_vec(), order: None }
    }

    fn of(hidden: &HiddenEffect, site: &Site) -> Self {
        let names = right_names(hidden.id()).into_iter();
        Self {
            names: names.map(|id| (id, size(hidden, id, site))).collect(),
            order: hidden.value("order"),
        }
    }
}

fn at_speed(speed_rad_s: f64) -> Instant {
    Instant { speed_rad_s, ..Instant::default() }
}

/// How large `hidden` is as the effect `id` of the catalogue.
fn size(hidden: &HiddenEffect, id: &str, site: &Site) -> Option<f64> {
    let of_catalogue = effect::find(id)?;
    let main = of_catalogue.parameters()[0].key;
    match id {
        // A frequency is no size.
        "elastic_coupling" => None,
        "viscous_friction" | "quadratic_load" | "asymmetric_viscous" => {
            // Half of what the excitations reach.
            let speed_rad_s = 0.5 * site.motor.rated_speed_rad_s;
            let torque_n_m = hidden.mechanism(site)?.drag_torque_n_m(speed_rad_s);
            let of_size_one = of_catalogue.terms(&[1.0]).torque_n_m(&at_speed(speed_rad_s), &[]);
            Some(torque_n_m / of_size_one)
        }
        "lagged_load" | "lagged_drag" => {
            let speed_rad_s = 0.5 * site.motor.rated_speed_rad_s;
            let lag_s = hidden.value("time_constant_s")?;
            let mut column = hidden.mechanism(site)?;
            let at = Moment { speed_rad_s, ..Moment::default() };
            // Until it has settled.
            (0..1000).for_each(|_| column.advance(0.02 * lag_s, &at, 0.0));
            let terms = of_catalogue.terms(&[1.0, lag_s]);
            let mut own = [0.0];
            terms.advance(&at_speed(speed_rad_s), &mut own, 20.0 * lag_s);
            Some(column.load_torque_n_m(&at) / terms.torque_n_m(&at_speed(speed_rad_s), &own))
        }
        "stribeck_friction" => {
            let own_rad_s = hidden.value("stribeck_speed_rad_s")?;
            // Half of where it has fallen.
            let speed_rad_s = 0.5 * own_rad_s;
            let at = Moment { speed_rad_s, ..Moment::default() };
            let terms = of_catalogue.terms(&[1.0, own_rad_s]);
            let of_size_one = terms.friction_n_m(&at_speed(speed_rad_s));
            let friction_n_m = hidden.mechanism(site)?.friction_n_m(&at);
            if friction_n_m > 0.0 {
                Some(friction_n_m / of_size_one)
            } else {
                // A bristle is no function of the speed; at a constant one it settles on the catalogue's curve.
                hidden.value(main)
            }
        }
        "field_change" => {
            // Half of a run.
            let time_s = 6.0;
            let at = Moment { time_s, ..Moment::default() };
            Some((hidden.mechanism(site)?.flux_factor(&at) - 1.0) / time_s)
        }
        _ => match main.strip_prefix("sin_") {
            Some(unit) => {
                let cosine = hidden.value(&format!("cos_{unit}"))?;
                Some(hidden.value(main)?.hypot(cosine))
            }
            None => hidden.value(main),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::cases::{drawn, known, wrong_form};
    use drivebench::emulator::EmulatorConfig;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn motor() -> MotorTruth {
        EmulatorConfig::embedded("zk-22fc-plain").unwrap().motor
    }

    fn hidden(text: &str) -> HiddenEffect {
        toml::from_str(text).unwrap()
    }

    fn size_of(text: &str) -> f64 {
        let truth = truths(&[hidden(text)], &motor()).remove(0);
        truth.names[0].1.unwrap()
    }

    #[test]
    fn everything_that_has_a_name_has_a_size_but_a_frequency() {
        for id in [known(), wrong_form()].concat() {
            let effect = drawn(id, 1.0, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
            let [truth] = &truths(&[effect], &motor())[..] else {
                panic!("{id} is one thing");
            };
            for (name, size) in &truth.names {
                let is_size = size.is_some_and(|size| size.is_finite() && size.abs() > 0.0);
                assert_eq!(is_size, *name != "elastic_coupling", "{id} as {name}");
            }
        }
    }

    #[test]
    fn a_size_is_that_of_the_catalogue_at_the_reference() {
        // Eyring's fluid: asinh(x)/x at a quarter of its speed.
        let drag = 4e-4 * 0.25_f64.asinh() / 0.25;
        let fan = 2e-6 * 0.5_f64.powf(-0.05);
        // Magnets that warm up slowly: (1 - e^-0.1)/0.1 of the drift at first.
        let drift = 4e-3 * (-0.1_f64).exp_m1() / 0.1;
        // e^-0.5 against e^-0.25.
        let film = 0.1 * (-0.25_f64).exp();
        for (id, settings, expected) in [
            ("viscous_friction", "viscous_n_m_s_per_rad = 4e-4", drag),
            ("quadratic_load", "quadratic_n_m_s2_per_rad2 = 2e-6", fan),
            ("field_change", "drift_per_s = -4e-3", drift),
            ("exponential_stribeck", "stribeck_n_m = 0.1\nstribeck_speed_rad_s = 8.0", film),
            ("lagged_load", "lagged_n_m_s2_per_rad2 = 2e-6\ntime_constant_s = 0.3", fan),
            ("cogging", "order = 6\nsin_n_m = 0.03\ncos_n_m = -0.04", 0.05),
        ] {
            let size = size_of(&format!("id = {id:?}\n{settings}"));
            assert!((size - expected).abs() < 1e-12, "{id}: {size}");
        }
    }

    #[test]
    fn a_shape_between_two_names_has_a_size_under_each() {
        let fan = hidden("id = \"fan_three_halves\"\nthree_halves_n_m_s15_per_rad15 = 3e-5");
        let motor = motor();
        let truth = truths(&[fan], &motor).remove(0);
        let speed = 0.5 * motor.rated_speed_rad_s;
        let of = |name: &str| {
            let mut names = truth.names.iter();
            names.find(|(id, _)| *id == name).unwrap().1.unwrap()
        };
        assert!((of("quadratic_load") * speed.sqrt() - 3e-5).abs() < 1e-12);
        assert!((of("viscous_friction") / speed.sqrt() - 3e-5).abs() < 1e-12);
    }

    #[test]
    fn a_background_is_taken_apart() {
        let motor = motor();
        let both = [
            hidden("id = \"messy\"\nscale = 2.0"),
            hidden("id = \"shaker\"\namplitude_n_m = 0.1\nfrequency_hz = 5.0"),
        ];
        let found = truths(&both, &motor);
        let names: Vec<&str> = found.iter().map(|truth| truth.names[0].0).collect();
        let background = crate::study::cases::BACKGROUND;
        assert_eq!(names, background);
        assert_eq!(found[1].order, Some(7.0));
        assert!((found[2].names[0].1.unwrap() - 0.8e-3).abs() < 1e-12);
    }
}
