//! The model beside the measurement: a free run that follows the applied voltage, sample by sample.

use crate::bench::limits::Nameplate;
use crate::plant::{Input, Model, Motor, MotorKey, Plant, Scenario, State, Trajectory};
use crate::sample::{Channel, Demand, ParameterEstimate, Sample, Verdict};

/// Gaps longer than this begin a new free run from the measurement, s.
const LONGEST_GAP_S: f64 = 0.5;

/// Free run of the nameplate's model, then of the identified one as soon as all of its values are settled.
pub(super) struct ModelTrace {
    plant: Option<Plant>,
    motor: Motor,
    state: State,
    last_s: Option<f64>,
    voltage_v: f64,
    is_identified: bool,
    scenario: Scenario,
    out: Trajectory,
}

impl ModelTrace {
    /// Without a nameplate there is no model until one is identified.
    pub(super) fn new(nameplate: Option<&Nameplate>) -> Self {
        let motor = nameplate.map(Nameplate::motor).unwrap_or_default();
        Self {
            plant: Plant::new(&Model::baseline(motor.clone()), Input::Voltage).ok(),
            motor,
            state: State::default(),
            last_s: None,
            voltage_v: 0.0,
            is_identified: false,
            scenario: Scenario {
                name: "live".to_owned(),
                input: Input::Voltage,
                input_channel: Channel::VoltageCmd,
                events: Vec::with_capacity(2),
                sample_time_s: vec![0.0],
                current_a: vec![f64::NAN],
                speed_rad_s: vec![f64::NAN],
                angle: Vec::new(),
                time_half_width_s: Vec::new(),
                unknown_input: vec![],
                scored: 0..1,
            },
            out: Trajectory::default(),
        }
    }

    pub(super) const fn is_identified(&self) -> bool {
        self.is_identified
    }

    /// Takes over estimates once every one of the five is settled.
    pub(super) fn learn(&mut self, estimates: &[ParameterEstimate]) {
        let mut motor = self.motor.clone();
        for key in MotorKey::ALL {
            if key == MotorKey::TorqueConstant {
                continue;
            }
            let settled = estimates
                .iter()
                .find(|estimate| estimate.key == key.key() && estimate.verdict == Verdict::Settled);
            match settled.and_then(|estimate| estimate.value) {
                Some(value) => motor.set(key, value),
                None => return,
            }
        }
        let model = Model::baseline(motor);
        if model.validate().is_ok()
            && let Ok(plant) = Plant::new(&model, Input::Voltage)
        {
            self.plant = Some(plant);
            self.is_identified = true;
        }
    }

    /// The model's speed at the sample, rad/s; NaN where there is none. `demand` is the command in force.
    pub(super) fn follow(&mut self, sample: &Sample, demand: Demand) -> f64 {
        let now_s = sample.time_s;
        let before_v = std::mem::replace(
            &mut self.voltage_v,
            match demand {
                // Off: the terminals are where the drive leaves them, which only a measurement tells.
                Demand::Voltage(volts) => volts,
                _ => sample.get(Channel::Voltage).unwrap_or(0.0),
            },
        );
        let last_s = self.last_s.replace(now_s);
        let fresh = last_s.is_none_or(|last_s| !(0.0..LONGEST_GAP_S).contains(&(now_s - last_s)));
        let Some(plant) = self.plant.as_mut() else {
            return f64::NAN;
        };
        let Some(begin_s) = last_s.filter(|_| !fresh) else {
            self.state = State::at(
                sample.get(Channel::Current).unwrap_or(0.0),
                sample.get(Channel::Speed).unwrap_or(0.0),
            );
            return self.state.speed_rad_s;
        };
        let applied_s = sample
            .applied
            .map_or(begin_s, |applied| applied.time_s.clamp(begin_s, now_s));
        self.scenario.events.clear();
        if applied_s > begin_s {
            self.scenario.events.push((begin_s, before_v));
        }
        self.scenario.events.push((applied_s, self.voltage_v));
        self.scenario.sample_time_s[0] = now_s;
        plant.simulate_into(&self.scenario, self.state, &mut self.out);
        self.state = State::at(self.out.current_a[0], self.out.speed_rad_s[0]);
        self.state.speed_rad_s
    }
}
