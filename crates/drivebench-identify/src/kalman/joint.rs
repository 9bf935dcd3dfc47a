//! Joint estimation of state and parameters by an extended Kalman filter, on line: the alternative to scheme 3.
//!
//! Start: from the model's R, L, Ke, J, Mc where all are given (each may be off by half), and from scheme 3 as soon as
//! that is certain, if there was no start or the two differ by a fifth. A filter that starts far from the truth may diverge
//! (Ljung, *IEEE Trans. Automatic Control* AC-24 (1979) 36); the linear regression of scheme 3 cannot.

use super::filter::{Filter, I, J, KE, L, MC, Mode, N, R, Tally};
use super::physics::KnownEffects;
use crate::online::AppliedVoltage;
use crate::recursive::{IGNORANT, Memory, Scheme3};
use crate::verdict;
use drivebench_model::plant::{Model, MotorKey, Slot};
use drivebench_model::sample::{Channel, ParameterEstimate, Reason, Run, Sample, Verdict};

/// The five parameters and their states.
const PARAMETERS: [(MotorKey, usize); 5] = [
    (MotorKey::Resistance, R),
    (MotorKey::Inductance, L),
    (MotorKey::BackEmf, KE),
    (MotorKey::Inertia, J),
    (MotorKey::LoadTorque, MC),
];
/// Largest relative standard deviation of a start.
const START_SPREAD: f64 = 0.3;
/// Standard deviation of a start over that of its estimate.
const WIDER: f64 = 10.0;
/// Largest relative standard deviation of scheme 3 for a start.
const CERTAIN: f64 = 0.2;

/// The joint filter: the parameters are constant, and there is no load torque beside the Coulomb torque.
#[derive(Clone, Debug)]
pub struct Kalman {
    filter: Filter,
    fixed: [Option<f64>; 5],
    starter: Option<Box<Scheme3>>,
    begun: bool,
    samples: u32,
    applied: AppliedVoltage,
}

impl Kalman {
    /// `model`: start, fixed parameters, torque constant, effects that are known.
    pub fn new(model: &Model) -> Self {
        let motor = &model.motor;
        let torque = motor.get(MotorKey::TorqueConstant);
        let given = |key: MotorKey| model.fixed.iter().any(|fixed| fixed == key.key());
        let fixed = PARAMETERS.map(|(key, _)| motor.get(key).filter(|_| given(key)));
        let positive = |value: &f64| *value > 0.0 && value.is_finite();
        let mut filter = Filter::new([0.0; N], [0.0; N], torque);
        filter.asleep = true;
        filter.effects = KnownEffects::of(model).0;
        let mut kalman = Self {
            filter,
            fixed,
            starter: Some(Box::new(Scheme3::new(Memory::default(), torque, None))),
            begun: false,
            samples: 0,
            applied: AppliedVoltage::default(),
        };
        let [r, l, ke, j] = [0, 1, 2, 3].map(|k| motor.get(PARAMETERS[k].0).filter(positive));
        if let (Some(r), Some(l), Some(ke), Some(j)) = (r, l, ke, j) {
            let load = motor.get(MotorKey::LoadTorque).unwrap_or(0.0);
            kalman.start([r, l, ke, j, load], [0.5; 5]);
        }
        kalman
    }

    /// Starts from the estimates of another pass over the same data, without scheme 3.
    fn next_pass(model: &Model, found: &Self) -> Self {
        let mut kalman = Self::new(model);
        let sensors = &found.filter.sensors;
        if sensors.iter().any(|sensor| sensor.at_rest().is_none()) {
            kalman.filter.sensors = *sensors;
        }
        kalman.filter.sensors[I].largest = sensors[I].largest;
        kalman.starter = None;
        let values = found.values();
        let spread = std::array::from_fn(|k| {
            let state = PARAMETERS[k].1;
            let size = if state == MC { values[k].abs() } else { 1.0 };
            let std = (found.filter.belief.p[state][state] * found.widening()).sqrt();
            (WIDER * std / size.max(f64::MIN_POSITIVE)).clamp(0.01, START_SPREAD)
        });
        kalman.start(values, spread);
        // The start is a good one.
        kalman.filter.early = 0.0;
        kalman.filter.reference = Some(kalman.filter.belief.x);
        kalman
    }

    fn start(&mut self, values: [f64; 5], spread: [f64; 5]) {
        let (mut x, mut variance) = ([0.0; N], [0.0; N]);
        for (k, (_, state)) in PARAMETERS.into_iter().enumerate() {
            let value = self.fixed[k].unwrap_or(values[k]);
            x[state] = if state == MC { value } else { value.ln() };
            variance[state] = self.fixed[k].map_or(spread[k].powi(2), |_| 0.0);
        }
        let torque = self.filter.torque_n_m_per_a.unwrap_or(x[KE].exp());
        let most = torque * self.filter.sensors[I].largest.max(1e-3);
        if variance[MC] > 0.0 {
            // A start without any friction leaves its size open: 5 % of the largest electrical torque.
            let known = spread[4] < START_SPREAD;
            let unknown = if known { 0.0 } else { 0.05 * most };
            variance[MC] = (spread[4] * x[MC]).powi(2).max(unknown.powi(2));
        }
        self.filter.restart(x, variance);
        self.begun = true;
    }

    /// Takes a sample. A voltage command in it holds from its stamp on; where no command ever came, the measured voltage
    /// is held in its place. Stale or missing: the other quantity is used alone. While a limit of the drive holds its
    /// output the motor has another voltage than was commanded, and neither side of such a row is learnt from.
    pub fn push(&mut self, sample: &Sample) {
        let time_s = sample.time_s;
        self.filter.voltage.torn |= sample.limited;
        if let Some(volts) = self.applied.of(sample) {
            self.filter.voltage.apply(time_s, volts, self.filter.now_s);
            if let Some(starter) = &mut self.starter {
                starter.voltage_applied(time_s, volts);
            }
        }
        let measured = [Channel::Current, Channel::Speed].map(|channel| sample.good(channel));
        if measured == [None, None] {
            return;
        }
        self.samples = self.samples.saturating_add(1);
        self.filter.asleep = !self.begun || self.samples < 12;
        self.filter.push(time_s, measured);
        self.filter.voltage.torn |= sample.limited;
        if let (Some(starter), [Some(current), Some(speed)]) = (&mut self.starter, measured) {
            starter.set_limited(sample.limited);
            starter.push(time_s, current, speed);
            if self.samples.is_multiple_of(8) {
                self.start_from_scheme_3();
            }
        }
    }

    /// Scheme 3 gives the start once it is certain of R, Ke and J, and is not needed after that.
    fn start_from_scheme_3(&mut self) {
        let Some(starter) = &self.starter else { return };
        let found = starter.estimates();
        let value = |k: usize| {
            let estimate = found.get(k)?;
            let (value, std) = (estimate.value?, estimate.std?);
            (value > 0.0 && std < CERTAIN * value).then_some(value)
        };
        let (Some(r), Some(ke), Some(j)) = (value(0), value(2), value(3)) else { return };
        let mut spread: [f64; 5] = std::array::from_fn(|k| {
            let relative = found.get(k).and_then(|e| Some(e.std? / e.value?.abs()));
            relative.map_or(START_SPREAD, |std| (WIDER * std).clamp(0.05, START_SPREAD))
        });
        let l = value(1).unwrap_or_else(|| {
            spread[1] = 1.0;
            r * self.filter.period_s / 3.0
        });
        let load = found.get(4).and_then(|e| e.value).unwrap_or(0.0);
        self.starter = None;
        let now = self.values();
        let apart = |(k, value): (usize, f64)| {
            self.fixed[k].is_none() && (now[k] / value - 1.0).abs() > 0.2
        };
        if !self.begun || [(0, r), (2, ke), (3, j)].into_iter().any(apart) {
            self.start([r, l, ke, j, load], spread);
        }
    }

    /// R, L, Ke, J, Mc as they stand.
    fn values(&self) -> [f64; 5] {
        PARAMETERS.map(|(_, state)| {
            let x = self.filter.belief.x[state];
            if state == MC { x } else { x.exp() }
        })
    }

    /// R, L, Ke, J, Mc with verdicts.
    pub fn estimates(&self) -> Vec<ParameterEstimate> {
        if !self.begun {
            return self.before_the_start();
        }
        let widening = self.widening();
        let parameters = PARAMETERS.into_iter().zip(self.values());
        let estimate = |((key, state), value): ((MotorKey, usize), f64)| {
            let (prior, left) = (self.filter.prior[state], self.filter.belief.p[state][state]);
            if prior <= 0.0 {
                let fixed = ParameterEstimate::fixed(key.key(), key.unit(), value);
                return ParameterEstimate { std: None, ..fixed };
            }
            if left > IGNORANT * prior {
                let reason = self.reason(key, (left / prior).sqrt());
                return verdict::unknown(key, Reason::NotExcited, reason);
            }
            let size = if state == MC { 1.0 } else { value };
            let std = Some(size * (left * widening).sqrt());
            let (slot, period_s) = (Slot::Motor(key), self.filter.period_s);
            self.doubt(verdict::judge(&slot, value, std, period_s))
        };
        parameters.map(estimate).collect()
    }

    /// Factor on the variances for correlated innovations.
    fn widening(&self) -> f64 {
        let [current, speed] = self.filter.sensors.map(|sensor| sensor.colour());
        current.max(speed)
    }

    /// Verdict with the test of consistency: innovations that are larger than the noise.
    fn doubt(&self, mut judged: ParameterEstimate) -> ParameterEstimate {
        if judged.verdict == Verdict::NotObservable {
            return judged;
        }
        if let Some((name, ratio, allowed)) = self.inconsistency() {
            let figure = format!(
                "innovation of the {name} {ratio:.2} times its noise at rest (chance allows {allowed:.2})"
            );
            if ratio > 10.0 {
                let reason = format!("{figure}: the model does not describe these data");
                judged.set(Verdict::Invalid, Reason::ModelMisses, reason);
            } else {
                judged.unsettle(
                    Reason::ModelMisses,
                    format!("{figure}: an effect is missing, or the filter has not converged"),
                );
            }
        } else {
            let rows = self.filter.tally.used.max(1) as f64;
            let share = self.filter.tally.outliers as f64 / rows;
            if share > 0.02 {
                let reason = format!("{:.1} % of the rows are outliers", 100.0 * share);
                judged.unsettle(Reason::FaultyData, reason);
            }
        }
        judged
    }

    /// The sensor whose innovations are larger than chance allows, by how much, and what would be allowed.
    fn inconsistency(&self) -> Option<(&'static str, f64, f64)> {
        let [current, speed] = self.filter.sensors.map(|sensor| sensor.consistency());
        [("current", current), ("speed", speed)]
            .into_iter()
            .filter_map(|(name, found)| found.map(|(ratio, allowed)| (name, ratio, allowed)))
            .filter(|(_, ratio, allowed)| ratio > allowed)
            .max_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Counts of rows and consistency of the innovations, in a sentence.
    pub fn summary(&self) -> String {
        let Tally { used, breaks, outliers, reopened } = self.filter.tally;
        let [current, speed] = self.filter.consistency().map(|ratio| {
            let unknown = || "not known (no rest to compare with)".to_owned();
            ratio.map_or_else(unknown, |r| format!("{r:.2}"))
        });
        format!(
            "Kalman filter: {used} rows used, {breaks} breaks at reversals and stops, {outliers} outliers, opened again {reopened} times; innovation over noise: current {current}, speed {speed}; standard deviations widened {:.2} times",
            self.widening().sqrt()
        )
    }

    fn before_the_start(&self) -> Vec<ParameterEstimate> {
        let starter = self.starter.as_ref();
        let mut found = starter.map_or_else(Vec::new, |starter| starter.estimates());
        for estimate in &mut found {
            if estimate.value.is_some() && estimate.verdict != Verdict::Invalid {
                estimate.set(
                    Verdict::Searching,
                    Reason::NotConverged,
                    format!(
                        "from scheme 3; the filter starts when that is certain within {:.0} %",
                        100.0 * CERTAIN
                    ),
                );
            }
        }
        found.extend(PARAMETERS.iter().skip(found.len()).map(|(key, _)| {
            let reason = format!("{} samples with current and speed so far", self.samples);
            verdict::unknown(*key, Reason::TooFewRows, reason)
        }));
        found
    }

    fn reason(&self, key: MotorKey, deviation_ratio: f64) -> String {
        let [current, speed] = self.filter.sensors.map(|sensor| sensor.largest);
        let rests = self.filter.mode == Mode::AtRest;
        let state = if rests { ", now at rest" } else { "" };
        let period_ms = 1e3 * self.filter.period_s;
        let (left, rows) = (100.0 * deviation_ratio, self.filter.tally.used);
        let learnt = format!("{left:.0} % of its initial uncertainty remains after {rows} rows");
        match key {
            MotorKey::Inductance => {
                let physics = self.filter.physics();
                format!(
                    "{learnt}: period {period_ms:.1} ms, L/R about {:.1} ms, largest current {current:.2} A",
                    1e3 * physics.l / physics.r
                )
            }
            MotorKey::Resistance => format!("{learnt}: largest current {current:.2} A"),
            _ => format!(
                "{learnt}: largest speed {speed:.2} rad/s, motion begins at {:.2} rad/s{state}",
                self.filter.zone_rad_s()
            ),
        }
    }
}

/// Iterated filter over a recorded run: passes over the data, each from the estimates of the one before, until they do not
/// change, so that no row is linearised about a poor start. The prior of each further pass is ten standard deviations wide, so
/// that the data count once (and by a hundredth again) and the first updates stay within the linear range: with a prior of 30 %
/// the Coulomb torque is biased by 1.5 standard deviations.
pub fn identify(model: &Model, run: &Run) -> Kalman {
    let mut found = Kalman::new(model);
    run.samples().for_each(|sample| found.push(&sample));
    for _ in 0..3 {
        let values = found.values();
        let usable = found.begun
            && values.iter().all(|value| value.is_finite())
            && values[..4].iter().all(|value| *value > 0.0);
        if !usable {
            break;
        }
        let mut next = Kalman::next_pass(model, &found);
        run.samples().for_each(|sample| next.push(&sample));
        let still = PARAMETERS.iter().all(|(_, state)| {
            let step = next.filter.belief.x[*state] - found.filter.belief.x[*state];
            step.abs() <= 0.3 * next.filter.belief.p[*state][*state].sqrt()
        });
        found = next;
        if still {
            break;
        }
    }
    found
}

#[cfg(test)]
#[path = "joint_tests.rs"]
mod tests;
