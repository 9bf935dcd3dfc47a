//! The predicted run, instant by instant.

use crate::bench::guard::Guard;
use crate::bench::limits::{Limits, Nameplate};
use crate::bench::program::Program;
use crate::bench::timing::whole;
use crate::plant::{Input, Model, ModelError, Plant, Scenario, State, Trajectory};
use crate::sample::{Channel, Demand, DriveState, Sample};

/// Points per control period at which the prediction is looked at: peaks lie between the host's samples.
const POINTS_PER_PERIOD: usize = 10;

/// One predicted instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) time_s: f64,
    pub(super) segment: usize,
    /// At the terminals: what was asked for, before the voltage limit; the back-EMF where the output is off.
    pub(super) voltage_v: f64,
    pub(super) current_a: f64,
    pub(super) speed_rad_s: f64,
    pub(super) angle_rad: f64,
    pub(super) coasts: bool,
    /// What the sequence asks for, what holds a load included.
    pub(super) wanted_v: f64,
    /// The voltage is another one because the supply takes nothing back.
    pub(super) supply: bool,
}

/// The predicted run.
pub(super) struct Trace {
    pub(super) points: Vec<Point>,
    pub(super) step_s: f64,
}

impl Trace {
    /// Control period by control period, so that slew and coasting act as they will in the session.
    pub(super) fn simulate(
        program: &dyn Program,
        motor: &Nameplate,
        limits: &Limits,
        rate_hz: f64,
    ) -> Result<Self, ModelError> {
        let period_s = 1.0 / rate_hz;
        let step_s = period_s / POINTS_PER_PERIOD as f64;
        let hold_a = limits
            .load
            .brake()
            .map_or(0.0, |brake| brake.hold_current_a);
        let hold_v = motor.resistance_ohm * hold_a;
        let mut model = Model::baseline(motor.motor());
        if limits.load.vertical {
            model = model.with_effect("constant_load")?;
            let slots = model.slots();
            if let Some(weight) = slots
                .iter()
                .find(|slot| slot.key().contains("constant_n_m"))
            {
                model.set(weight, motor.back_emf_v_s_per_rad * hold_a);
            }
        }
        let mut driven = Plant::new(&model, Input::Voltage)?;
        let mut coasting = Plant::new(&Model::baseline(motor.motor()), Input::Current)?;
        // A drive current limit of zero stands for "limits itself": it switches the winding limit off.
        let mut guard = Guard::new(limits.clone(), motor, Some(0.0));
        let mut one_period = Scenario {
            name: "plan".to_owned(),
            input: Input::Voltage,
            input_channel: Channel::VoltageCmd,
            events: vec![(0.0, 0.0)],
            sample_time_s: (1..=POINTS_PER_PERIOD)
                .map(|point| point as f64 * step_s)
                .collect(),
            current_a: vec![f64::NAN; POINTS_PER_PERIOD],
            speed_rad_s: vec![f64::NAN; POINTS_PER_PERIOD],
            angle: Vec::new(),
            time_half_width_s: Vec::new(),
            unknown_input: vec![],
            scored: 0..POINTS_PER_PERIOD,
        };
        let periods = whole((program.duration_s() * rate_hz).ceil()).max(1);
        let mut points = Vec::with_capacity(periods * POINTS_PER_PERIOD);
        let (mut current_a, mut speed_rad_s, mut angle_rad) = (hold_a, 0.0, 0.0);
        let mut out = Trajectory::default();
        for period in 0..periods {
            let begin_s = period as f64 * period_s;
            let wanted = match program.demand_at(begin_s) {
                Demand::Voltage(volts) => Demand::Voltage(volts + hold_v),
                other => other,
            };
            let shaped = guard.shape(begin_s, wanted);
            let coasts = !wanted.energises();
            let volts = if coasts {
                0.0
            } else {
                shaped.demand.voltage_v().unwrap_or(0.0)
            };
            let excess_v = wanted
                .voltage_v()
                .map_or(0.0, |wanted_v| (wanted_v.abs() - limits.voltage_v).max(0.0));
            one_period.events[0].1 = volts;
            let start = State::at(if coasts { 0.0 } else { current_a }, speed_rad_s);
            let plant = if coasts { &mut coasting } else { &mut driven };
            plant.simulate_into(&one_period, start, &mut out);
            for (&i, &w) in out.current_a.iter().zip(&out.speed_rad_s) {
                angle_rad += 0.5 * (speed_rad_s + w) * step_s;
                (current_a, speed_rad_s) = (i, w);
                let terminal_v = if coasts {
                    motor.back_emf_v_s_per_rad * w
                } else {
                    volts
                };
                points.push(Point {
                    time_s: begin_s + (points.len() % POINTS_PER_PERIOD + 1) as f64 * step_s,
                    segment: program.segment_at(begin_s),
                    voltage_v: terminal_v + excess_v.copysign(terminal_v),
                    current_a,
                    speed_rad_s,
                    angle_rad,
                    coasts,
                    wanted_v: wanted.voltage_v().unwrap_or(0.0),
                    supply: shaped.causes.supply,
                });
            }
            let mut sample = Sample::at(begin_s + period_s).with(Channel::Speed, speed_rad_s);
            sample.state = Some(DriveState::Running);
            // Only to tell the shaper the speed: the prediction itself is judged afterwards.
            guard.watch(begin_s + period_s, &sample, false);
        }
        Ok(Self { points, step_s })
    }
}
