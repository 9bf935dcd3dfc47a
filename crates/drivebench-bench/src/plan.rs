//! The plan: the response of the motor to a sequence, predicted from the nameplate before anything is energised.

use serde::Serialize;
use thiserror::Error;

use super::bench_file::BenchFile;
use super::currents::CurrentsPilot;
use super::guard::Guard;
use super::limits::{Limits, Nameplate};
use super::pilot::Pilot;
use drivebench_model::excitation::ExcitationError;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::effect::TermKind;
use drivebench_model::plant::{
    ActiveEffect, Input, Model, ModelError, MotorKey, Plant, Scenario, State, Trajectory,
};
use drivebench_model::sample::{Channel, Demand, DriveState, Sample};

#[derive(Clone, Debug, Error, PartialEq, Serialize)]
#[error("segment {segment:?}: predicted {quantity} {predicted:.4} {unit}, limit {limit:.4} {unit}")]
pub struct Refusal {
    pub segment: String,
    /// As `peak current`.
    pub quantity: &'static str,
    pub predicted: f64,
    pub limit: f64,
    pub unit: &'static str,
}

impl Refusal {
    pub fn help(&self) -> &'static str {
        match self.quantity {
            "peak current" => "lower slew_v_per_s, or the amplitudes of this segment",
            "peak speed" | "peak voltage" => {
                "lower the voltages of this segment; of [currents], turn_rad_s and levels_a"
            }
            FALL => {
                "leave coast-down parts out: nothing holds a vertical load while the output is off"
            }
            UNHELD => "give load.hold_current_a, load.brake_release_s and load.brake_apply_s",
            REVERSE_V | REVERSE_A => {
                "the converter goes one way only ([converter] quadrants of the drive's profile): use positive levels"
            }
            "travel" => "shorten this segment, or use smaller and symmetric voltages",
            _ => "shorten the sequence, or raise limits.time_s",
        }
    }
}

/// Extremes of one segment, magnitudes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SegmentPlan {
    pub name: String,
    pub start_s: f64,
    pub end_s: f64,
    pub peak_voltage_v: f64,
    pub peak_current_a: f64,
    pub peak_speed_rad_s: f64,
    /// Farthest from the angle at the start of the run, rad.
    pub travel_rad: f64,
    /// Largest braking power into the supply, W.
    pub peak_returned_w: f64,
    /// Points of the prediction with the output off.
    #[serde(skip)]
    coasting_points: usize,
    #[serde(skip)]
    peak_reverse_v: f64,
    #[serde(skip)]
    peak_reverse_a: f64,
}

impl SegmentPlan {
    fn refuses(
        &self,
        quantity: &'static str,
        predicted: f64,
        limit: f64,
        unit: &'static str,
    ) -> Refusal {
        Refusal { segment: self.name.clone(), quantity, predicted, limit, unit }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Plan {
    pub duration_s: f64,
    pub rows: u64,
    pub peak_voltage_v: f64,
    pub peak_current_a: f64,
    /// In rated currents.
    pub peak_current_ratio: f64,
    pub peak_speed_rad_s: f64,
    pub travel_rad: f64,
    /// Root mean square over the run: what heats the winding.
    pub rms_current_a: f64,
    /// Integral of the squared current, A2.s.
    pub i2t_a2_s: f64,
    /// Heat in the winding at its nameplate resistance, J.
    pub copper_loss_j: f64,
    /// Electrical energy drawn, J; the returned energy is not subtracted.
    pub energy_j: f64,
    /// Braking energy into the supply, J, and its largest power, W.
    pub returned_j: f64,
    pub peak_returned_w: f64,
    pub segments: Vec<SegmentPlan>,
    /// Empty: the plan may be run.
    pub refusals: Vec<Refusal>,
    pub warnings: Vec<String>,
    pub parameters: Vec<Observability>,
}

impl Plan {
    pub fn is_refused(&self) -> bool {
        !self.refusals.is_empty()
    }
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum PlanError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Sequence(#[from] ExcitationError),
}

/// Predicts one run of the bench, of voltages or of currents, with this motor.
///
/// # Errors
/// The motor cannot be simulated, or the sequence cannot be made.
pub fn plan_run(
    bench: &BenchFile,
    run_seed: u64,
    motor: &Nameplate,
    rate_hz: f64,
    drive_current_limit_a: Option<f64>,
) -> Result<Plan, PlanError> {
    let limits = bench.limits();
    let pilot: &mut dyn Pilot = match &bench.currents {
        Some(section) => &mut CurrentsPilot::new(section, Some(run_seed), f64::INFINITY),
        None => &mut bench.program(run_seed)?,
    };
    Ok(plan(pilot, motor, &limits, rate_hz, drive_current_limit_a)?)
}

/// Predicts the demands of a pilot at `rate_hz` under the slew and voltage limits, without the winding limit: a plan that needs it draws too
/// much.
pub(super) fn plan(
    pilot: &mut dyn Pilot,
    motor: &Nameplate,
    limits: &Limits,
    rate_hz: f64,
    drive_current_limit_a: Option<f64>,
) -> Result<Plan, ModelError> {
    let mut predicted = Prediction::of(pilot, motor, limits, rate_hz)?;
    let mut plan = std::mem::take(&mut predicted.plan);
    plan.duration_s = pilot.duration_s();
    plan.rows = whole((plan.duration_s * rate_hz).ceil()) as u64;
    plan.peak_current_ratio = plan.peak_current_a / motor.rated_current_a;
    plan.rms_current_a = (plan.i2t_a2_s / plan.duration_s.max(predicted.step_s)).sqrt();
    plan.copper_loss_j = motor.resistance_ohm * plan.i2t_a2_s;
    plan.parameters = parameters(&predicted, &plan, motor, rate_hz);
    let ramp_s = predicted.last.voltage_v.abs() / limits.slew_v_per_s;
    plan.refusals = beyond_limits(&plan, limits, drive_current_limit_a, ramp_s);
    plan.refusals.extend(by_load_and_converter(&plan, limits, predicted.step_s));
    plan.warnings = warnings(&predicted, &plan, limits, rate_hz);
    if plan.rms_current_a > motor.rated_current_a {
        plan.warnings.push(format!(
            "the effective current is {:.2} A, rated are {:.2} A: let the motor cool between runs",
            plan.rms_current_a, motor.rated_current_a
        ));
    }
    Ok(plan)
}

/// `ramp_s`: of the output to zero after the last segment.
fn beyond_limits(
    plan: &Plan,
    limits: &Limits,
    drive_current_limit_a: Option<f64>,
    ramp_s: f64,
) -> Vec<Refusal> {
    // At its own limit the drive would clip the voltage, and the run would not be the planned one.
    let current_a =
        drive_current_limit_a.map_or(limits.current_a, |amps| amps.min(limits.current_a));
    let (volts, amps) = (Some(limits.voltage_v), Some(current_a));
    let (speed, time) = (Some(limits.speed_rad_s), Some(limits.time_s));
    let last = plan.segments.len().saturating_sub(1);
    let of = |(index, segment): (usize, &SegmentPlan)| {
        let on_s = segment.end_s + if index == last { ramp_s } else { 0.0 };
        let rows = [
            ("peak voltage", segment.peak_voltage_v, volts, "V"),
            ("peak current", segment.peak_current_a, amps, "A"),
            ("peak speed", segment.peak_speed_rad_s, speed, "rad/s"),
            ("travel", segment.travel_rad, limits.travel_rad, "rad"),
            ("time with the output on", on_s, time, "s"),
        ];
        let beyond = |(quantity, predicted, limit, unit): (_, f64, Option<f64>, _)| {
            let limit = limit.filter(|limit| predicted > *limit)?;
            Some(segment.refuses(quantity, predicted, limit, unit))
        };
        rows.into_iter().filter_map(beyond).collect::<Vec<_>>()
    };
    plan.segments.iter().enumerate().flat_map(of).collect()
}

fn raise(peak: &mut f64, value: f64) {
    *peak = peak.max(value.abs());
}

/// The response at these instants, from the start on, to voltages that the caller sets: zero first.
pub(super) fn under_voltage(name: &str, sample_time_s: Vec<f64>) -> Scenario {
    let count = sample_time_s.len();
    let (input, channel, events) = (Input::Voltage, Channel::VoltageCmd, vec![(0.0, 0.0)]);
    Scenario {
        current_a: vec![f64::NAN; count],
        speed_rad_s: vec![f64::NAN; count],
        ..Scenario::planned(name, input, channel, events, sample_time_s)
    }
}

/// Points of the prediction per control period: peaks lie between the host's samples.
const POINTS_PER_PERIOD: usize = 10;

#[derive(Clone, Copy, Debug, Default)]
struct Point {
    time_s: f64,
    segment: usize,
    /// At the terminals: the demand before the voltage limit; the back-EMF where the output is off.
    voltage_v: f64,
    current_a: f64,
    speed_rad_s: f64,
    angle_rad: f64,
    coasts: bool,
    /// Of the sequence, with the hold of a load.
    wanted_v: f64,
    /// The voltage is limited because the supply takes no braking energy.
    supply: bool,
}

/// The predicted run, in memory that does not grow with its length.
#[derive(Default)]
struct Prediction {
    /// Sums and extremes so far.
    plan: Plan,
    step_s: f64,
    /// Bound of the ripple: 5 % of the rated current.
    reverse_a: f64,
    points: usize,
    last: Point,
    /// While the output is on.
    peak_acceleration_rad_s2: f64,
    fastest_rad_s: f64,
    slowest_rad_s: f64,
    least_current_a: f64,
    supply_points: usize,
}

impl Prediction {
    fn push(&mut self, point: Point, name: &str) {
        let plan = &mut self.plan;
        if plan.segments.len() <= point.segment {
            let (name, start_s) = (name.to_owned(), point.time_s);
            plan.segments.push(SegmentPlan { name, start_s, ..SegmentPlan::default() });
        }
        let returned_w = (-point.voltage_v * point.current_a).max(0.0);
        if let Some(segment) = plan.segments.last_mut() {
            segment.end_s = point.time_s;
            for (peak, own, value) in [
                (&mut plan.peak_voltage_v, &mut segment.peak_voltage_v, point.voltage_v),
                (&mut plan.peak_current_a, &mut segment.peak_current_a, point.current_a),
                (&mut plan.peak_speed_rad_s, &mut segment.peak_speed_rad_s, point.speed_rad_s),
                (&mut plan.travel_rad, &mut segment.travel_rad, point.angle_rad),
                (&mut plan.peak_returned_w, &mut segment.peak_returned_w, returned_w),
            ] {
                raise(peak, value);
                raise(own, value);
            }
            segment.coasting_points += usize::from(point.coasts);
            segment.peak_reverse_v = segment.peak_reverse_v.max(-point.wanted_v);
            if point.wanted_v < 0.0 && point.current_a < -self.reverse_a {
                segment.peak_reverse_a = segment.peak_reverse_a.max(-point.current_a);
            }
        }
        plan.i2t_a2_s += point.current_a * point.current_a * self.step_s;
        plan.returned_j += returned_w * self.step_s;
        plan.energy_j += (point.voltage_v * point.current_a).max(0.0) * self.step_s;
        if self.points > 0 && !point.coasts {
            let rise_rad_s = point.speed_rad_s - self.last.speed_rad_s;
            raise(&mut self.peak_acceleration_rad_s2, rise_rad_s / self.step_s);
        }
        self.fastest_rad_s = self.fastest_rad_s.max(point.speed_rad_s);
        self.slowest_rad_s = self.slowest_rad_s.min(point.speed_rad_s);
        self.least_current_a = self.least_current_a.min(point.current_a);
        self.supply_points += usize::from(point.supply);
        self.points += 1;
        self.last = point;
    }

    /// Control period by control period, so that slew and coasting act as they will in the session.
    fn of(
        pilot: &mut dyn Pilot,
        motor: &Nameplate,
        limits: &Limits,
        rate_hz: f64,
    ) -> Result<Self, ModelError> {
        let period_s = 1.0 / rate_hz;
        let step_s = period_s / POINTS_PER_PERIOD as f64;
        let hold_a = limits.load.hold_a();
        let hold_v = motor.resistance_ohm * hold_a;
        let mut model = Model::baseline(motor.motor());
        if limits.load.vertical {
            let weight_n_m = motor.back_emf_v_s_per_rad * hold_a;
            model.effects.push(ActiveEffect::with(TermKind::TorqueOffset.effect(), &[weight_n_m]));
        }
        let mut driven = Plant::new(&model, Input::Voltage)?;
        // Of a coasting motor, and of one whose current the drive controls.
        let mut mechanical = Plant::new(&Model::baseline(motor.motor()), Input::Current)?;
        // A drive current limit of zero means that the drive limits itself: it switches the winding limit off.
        let mut guard = Guard::new(limits.clone(), motor, Some(0.0));
        let points_s = (1..=POINTS_PER_PERIOD).map(|point| point as f64 * step_s);
        let mut one_period = under_voltage("plan", points_s.collect());
        let periods = whole((pilot.duration_s() * rate_hz).ceil()).max(1);
        let mut predicted =
            Self { step_s, reverse_a: 0.05 * motor.rated_current_a, ..Self::default() };
        let (mut current_a, mut speed_rad_s, mut angle_rad) = (hold_a, 0.0, 0.0);
        let mut out = Trajectory::default();
        for period in 0..periods {
            let begin_s = period as f64 * period_s;
            let wanted = match pilot.demand(begin_s, begin_s) {
                Ok(Demand::Voltage(volts)) => Demand::Voltage(volts + hold_v),
                wanted => wanted.unwrap_or(Demand::Stop),
            };
            let shaped = guard.shape(begin_s, wanted);
            let coasts = !wanted.energises();
            let wanted_v = wanted.voltage_v().unwrap_or(0.0);
            let excess_v = (wanted_v.abs() - limits.voltage_v).max(0.0);
            let given = match shaped.demand {
                Demand::Voltage(volts) => Some(volts),
                _ => None,
            };
            let amps = match wanted {
                Demand::Current(amps) => amps,
                _ => 0.0,
            };
            one_period.events[0].1 = given.unwrap_or(amps);
            let start = State::at(if given.is_none() { amps } else { current_a }, speed_rad_s);
            let plant = if given.is_none() { &mut mechanical } else { &mut driven };
            plant.simulate_into(&one_period, start, &mut out);
            for (at, &w) in out.speed_rad_s.iter().enumerate() {
                angle_rad += 0.5 * (speed_rad_s + w) * step_s;
                speed_rad_s = w;
                current_a = if given.is_none() { amps } else { out.current_a[at] };
                let terminal_v =
                    given.unwrap_or(motor.resistance_ohm * amps + motor.back_emf_v_s_per_rad * w);
                let segment = pilot.segment_at(begin_s);
                let point = Point {
                    time_s: begin_s + (predicted.points % POINTS_PER_PERIOD + 1) as f64 * step_s,
                    segment,
                    voltage_v: terminal_v + excess_v.copysign(terminal_v),
                    current_a,
                    speed_rad_s,
                    angle_rad,
                    coasts,
                    wanted_v,
                    supply: shaped.causes.supply,
                };
                predicted.push(point, pilot.segment_name(segment));
            }
            let mut sample = Sample::at(begin_s + period_s).with(Channel::Speed, speed_rad_s);
            sample.state = Some(DriveState::Running);
            // The shaper needs the speed; limits are checked afterwards.
            guard.watch(begin_s + period_s, &sample, false);
            pilot.sample(begin_s + period_s, begin_s + period_s, &sample, true);
        }
        Ok(predicted)
    }
}

const FALL: &str = "free fall of a vertical load";
const UNHELD: &str = "vertical load without a described brake";
const REVERSE_V: &str = "reverse voltage";
const REVERSE_A: &str = "reverse current";

/// Refusals by load and converter, one of a kind for each segment.
fn by_load_and_converter(plan: &Plan, limits: &Limits, step_s: f64) -> Vec<Refusal> {
    let mut refusals = Vec::new();
    if let (Some(first), Some(last)) = (plan.segments.first(), plan.segments.last())
        && limits.load.missing().is_some()
    {
        refusals.push(first.refuses(UNHELD, last.end_s, 0.0, "s"));
    }
    for segment in &plan.segments {
        let coasts_s = step_s * segment.coasting_points as f64;
        let found = [
            (limits.load.vertical, FALL, coasts_s, "s"),
            (limits.quadrants < 2, REVERSE_V, segment.peak_reverse_v, "V"),
            (limits.quadrants == 2, REVERSE_A, segment.peak_reverse_a, "A"),
        ];
        for (applies, quantity, most, unit) in found {
            if applies && most > 0.0 {
                refusals.push(segment.refuses(quantity, most, 0.0, unit));
            }
        }
    }
    refusals
}

fn warnings(predicted: &Prediction, plan: &Plan, limits: &Limits, rate_hz: f64) -> Vec<String> {
    let mut warnings = Vec::new();
    if let Some(watts) = limits.braking_w {
        let share = 100.0 * predicted.supply_points as f64 / predicted.points.max(1) as f64;
        warnings.push(format!(
            "the supply takes nothing back and {watts} W are dissipated outside of the winding: deceleration is limited in \
             {share:.0} % of the run, where the voltage is not that of the sequence; braking returns at most {:.1} W, {:.2} J",
            plan.peak_returned_w, plan.returned_j
        ));
        if limits.bus_max_v.is_none() {
            warnings.push(
                "limits.bus_max_v is not given: a bus that rises under braking does not end the run".to_owned(),
            );
        }
    }
    if limits.dead_time_s > 0.0 {
        let (dead_ms, most_hz) = (1e3 * limits.dead_time_s, 1.0 / limits.dead_time_s);
        let rate = if rate_hz > most_hz {
            format!(": of {rate_hz} Hz it follows {most_hz:.0} Hz")
        } else {
            String::new()
        };
        warnings
            .push(format!("the thyristor bridge takes a command up to {dead_ms} ms late{rate}"));
    }
    if limits.quadrants < 4 && predicted.least_current_a < 0.0 {
        warnings.push(
            "the converter gives no negative current: where one is predicted the shaft coasts instead".to_owned(),
        );
    }
    warnings
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Prospect {
    Good,
    /// Only by methods that integrate the circuit exactly between samples.
    Weak,
    NotObservable,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Observability {
    pub key: &'static str,
    pub prospect: Prospect,
    pub reason: String,
}

fn parameters(
    predicted: &Prediction,
    plan: &Plan,
    motor: &Nameplate,
    rate_hz: f64,
) -> Vec<Observability> {
    let current_share = plan.peak_current_a / motor.rated_current_a;
    let speed_share = plan.peak_speed_rad_s / motor.rated_speed_rad_s;
    let inertial_share = predicted.peak_acceleration_rad_s2 * motor.inertia_kg_m2
        / (motor.back_emf_v_s_per_rad * motor.rated_current_a);
    let turns_rad_s = 0.05 * motor.rated_speed_rad_s;
    let forward = predicted.fastest_rad_s > turns_rad_s;
    let backward = predicted.slowest_rad_s < -turns_rad_s;

    let of = |key: MotorKey, prospect: Prospect, reason: String| Observability {
        key: key.key(),
        prospect,
        reason,
    };
    // Below 20 % of the rated value nothing is excited.
    let where_enough = |share: f64, prospect: Prospect| {
        if share >= 0.2 { prospect } else { Prospect::NotObservable }
    };
    let by_share = |key: MotorKey, share: f64, what: &str| {
        let reason = format!("{what} reaches {:.0} % of rated", 100.0 * share);
        of(key, where_enough(share, Prospect::Good), reason)
    };
    let electrical_s = motor.inductance_h / motor.resistance_ohm;
    let periods = 1.0 / (rate_hz * electrical_s);
    // With a period above half of L/R the difference quotient of the current is biased (paper A); beyond 3 L/R exp(-3) is left
    // of a transient at the next sample.
    let (prospect, verdict) = if periods <= 0.5 {
        (Prospect::Good, "the transient is sampled")
    } else if periods <= 3.0 {
        (Prospect::Weak, "only exact discretisation or output error identifies it")
    } else {
        (Prospect::NotObservable, "the transient is over between two samples: use burst capture")
    };
    let load = match (forward, backward) {
        (true, true) => (Prospect::Good, "both directions separate it from an offset"),
        (false, false) => (Prospect::NotObservable, "the shaft does not move"),
        _ => (Prospect::Weak, "one direction only: it is not separable from a constant load"),
    };
    vec![
        by_share(MotorKey::Resistance, current_share, "the current"),
        of(
            MotorKey::Inductance,
            where_enough(current_share, prospect),
            format!("L/R {:.2} ms, period {:.2} ms: {verdict}", 1e3 * electrical_s, 1e3 / rate_hz),
        ),
        by_share(MotorKey::BackEmf, speed_share, "the speed"),
        by_share(MotorKey::Inertia, inertial_share, "the accelerating torque"),
        of(MotorKey::LoadTorque, load.0, load.1.to_owned()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Wave, has, near, within};
    use drivebench_model::sample::Demand;

    fn planned(duration_s: f64, limits: &Limits, demand: impl Fn(f64) -> Demand + Send) -> Plan {
        plan(&mut Wave { duration_s, demand }, &Nameplate::zk_22fc(), limits, 100.0, None).unwrap()
    }

    fn step(volts: f64, limits: &Limits) -> Plan {
        planned(1.0, limits, |time_s| Demand::Voltage(if time_s < 0.1 { 0.0 } else { volts }))
    }

    #[test]
    fn a_full_voltage_step_is_refused() {
        // Voltage over resistance, less the drop of the inductance: 75 A, 13 times rated; 30 V still 21 A.
        let limits = Limits { slew_v_per_s: 1e6, ..Limits::zk_22fc() };
        let plan = step(110.0, &limits);
        within(plan.peak_current_a, 70.0..80.0);
        near(plan.peak_current_ratio, 13.0, 0.5);
        for words in [" half\"", "peak current", "22.8"] {
            has(&plan.refusals[0], words);
        }
        within(step(30.0, &limits).peak_current_a, 20.0..22.0);
    }

    #[test]
    fn the_slew_limit_is_part_of_the_prediction() {
        let slow = |time_s| Limits { slew_v_per_s: 300.0, time_s, ..Limits::zk_22fc() };
        let plan = step(100.0, &slow(60.0));
        assert!(!plan.is_refused(), "{:?}", plan.refusals);
        // s R J/Ke^2 / R + Mc/Ke = 10.8 + 1.3 A
        near(plan.peak_current_a, 12.1, 0.6);
        // The ramp down counts as time with the output on: 1 s and a third.
        for (time_s, refused) in [(1.3, true), (1.4, false)] {
            assert_eq!(step(100.0, &slow(time_s)).is_refused(), refused, "{time_s}");
        }
    }

    #[test]
    fn the_embedded_bench_keeps_every_limit_with_margin() {
        let bench = BenchFile::embedded_default();
        for seed in [1, 2, 3] {
            let mut program = bench.program(seed).unwrap();
            let mut worst: f64 = 0.0;
            for (inertia, resistance, back_emf) in
                [(1.0, 1.0, 1.0), (1.1, 0.9, 0.9), (0.9, 0.9, 0.9)]
            {
                let mut motor = bench.nameplate().unwrap();
                motor.inertia_kg_m2 *= inertia;
                motor.resistance_ohm *= resistance;
                motor.back_emf_v_s_per_rad *= back_emf;
                let plan = plan(&mut program, &motor, &bench.limits(), 100.0, Some(11.4)).unwrap();
                assert!(!plan.is_refused(), "seed {seed}: {:?}", plan.refusals);
                worst = worst.max(plan.peak_current_a);
            }
            assert!(worst > 5.7, "{worst} A excites nothing");
        }
    }

    #[test]
    fn travel_time_and_the_drive_s_own_limit_are_checked_too() {
        let bench = BenchFile::embedded_default();
        let mut program = bench.program(1).unwrap();
        let tight = Limits { travel_rad: Some(10.0), time_s: 5.0, ..bench.limits() };
        let nameplate = bench.nameplate().unwrap();
        let plan = plan(&mut program, &nameplate, &tight, 100.0, Some(3.0)).unwrap();
        for quantity in ["travel", "time with the output on", "peak current"] {
            assert!(plan.refusals.iter().any(|r| r.quantity == quantity), "{quantity}");
        }
    }

    #[test]
    fn a_coasting_motor_draws_no_current() {
        let plan = planned(2.0, &Limits::zk_22fc(), |time_s| {
            if time_s < 1.0 { Demand::Voltage(50.0) } else { Demand::Disable }
        });
        assert!(plan.segments[1].peak_current_a < 1e-9);
        assert!(plan.segments[1].peak_speed_rad_s > 100.0);
    }

    #[test]
    fn prospects_follow_from_rate_and_excitation() {
        use Prospect::{Good, NotObservable, Weak};
        let bench = BenchFile::embedded_default();
        let mut rich = bench.program(1).unwrap();
        // Below breakaway.
        let mut small = Wave { duration_s: 1.0, demand: |_| Demand::Voltage(1.0) };
        let cases: [(bool, _, _); 4] = [
            (true, 1000.0, [Good, Good, Good, Good, Good]),
            (true, 100.0, [Good, Weak, Good, Good, Good]),
            (true, 20.0, [Good, NotObservable, Good, Good, Good]),
            (false, 100.0, [NotObservable; 5]),
        ];
        for (is_rich, rate_hz, expected) in cases {
            let nameplate = bench.nameplate().unwrap();
            let pilot: &mut dyn Pilot = if is_rich { &mut rich } else { &mut small };
            let plan = plan(pilot, &nameplate, &bench.limits(), rate_hz, None).unwrap();
            let found: Vec<_> = plan.parameters.iter().map(|found| found.prospect).collect();
            assert_eq!(found, expected, "{rate_hz} Hz");
        }
    }
}
