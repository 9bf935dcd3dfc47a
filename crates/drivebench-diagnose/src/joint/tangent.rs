//! Forward sensitivity analysis of a linearised run (Cacuci, J. Math. Phys. 22, 1981): response of the innovations to small forcings
//! along its trajectory, eight at a time; and the forcings that are the derivatives by parameters of the model.

use std::array::from_fn;

use super::grid::Grid;
use super::kalman::{Dynamics, Transition, Update, needs_refinement};
use super::process_noise::{combined, terms_of};
use super::run::LinearisedRun;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::effect::{Axis, Harmonic};
use drivebench_model::plant::{
    Effect, Instant, Model, MotorKey, Path, Reading, Scenario, SensorPath, Sums, Terms,
};

/// Deviations that are propagated at once, so that the coefficients of a step are read once and vector registers are full.
pub(super) const LANES: usize = 8;
/// Intervals that are processed at once, so that their forcings and innovations stay in the cache.
pub(super) const CHUNK: usize = 128;

/// A number for each lane.
pub(super) type Lane = [f64; LANES];

/// One transition: coefficients of the new current and speed on current, speed, disturbance, error of the voltage, forcing of the
/// current, forcing of the speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    current: [f64; 6],
    speed: [f64; 6],
    decay: f64,
    keeps: f64,
}

impl Step {
    pub(super) fn of(transition: &Transition, decay: f64, dynamics: &Dynamics) -> Self {
        let moves = f64::from(u8::from(transition.direction != 0.0));
        let apply = |x, g| transition.propagator.apply(x, g);
        let on = [
            apply([1.0, 0.0], [0.0; 2]),
            apply([0.0, transition.speed_factor], [0.0; 2]),
            apply([0.0; 2], [0.0, -dynamics.inverse_inertia * moves]),
            apply([0.0; 2], dynamics.per_input),
            apply([0.0; 2], [1.0, 0.0]),
            apply([0.0; 2], [0.0, moves]),
        ];
        Self {
            current: on.map(|to| to[0]),
            speed: on.map(|to| to[1] * moves),
            decay,
            keeps: transition.input_keeps,
        }
    }

    /// No interval: the first sample is at the begin of the run.
    pub(super) const fn identity() -> Self {
        Self {
            current: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            speed: [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            decay: 1.0,
            keeps: 1.0,
        }
    }
}

/// Deviations of current, speed, disturbance torque and voltage, each in every lane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Deviations([Lane; 4]);

impl Deviations {
    /// To the next sample, under forcings of the current (A/s) and the speed (rad/s2).
    #[inline]
    pub(super) fn advance(&mut self, step: &Step, forcing: &[Lane; 2]) {
        self.advance_unforced(step);
        for (state, on) in self.0.iter_mut().zip([&step.current, &step.speed]) {
            for k in 0..LANES {
                state[k] += on[4] * forcing[0][k] + on[5] * forcing[1][k];
            }
        }
    }

    /// The same without a forcing.
    #[inline]
    pub(super) fn advance_unforced(&mut self, step: &Step) {
        let [i, w, d, v] = self.0;
        for (state, on) in self.0.iter_mut().zip([&step.current, &step.speed]) {
            for k in 0..LANES {
                state[k] = (on[0] * i[k] + on[1] * w[k]) + (on[2] * d[k] + on[3] * v[k]);
            }
        }
        self.0[2] = d.map(|d| d * step.decay);
        self.0[3] = v.map(|v| v * step.keeps);
    }

    /// Measurement update with zero as the measured values: the whitened innovations, `sensor_error` added to the predicted readings.
    #[inline]
    pub(super) fn whiten(&mut self, update: &Update, sensor_error: &[Lane; 2]) -> [Lane; 2] {
        let mut white = [[0.0; LANES]; 2];
        for (signal, gains) in [&update.current, &update.speed].into_iter().enumerate() {
            let mut error = self.0[signal];
            for k in 0..LANES {
                error[k] += sensor_error[signal][k];
            }
            self.correct_states(gains, &error, -1.0);
            for k in 0..LANES {
                white[signal][k] = error[k] * gains[4];
            }
        }
        white
    }

    /// Reset after a gap of the record: the predicted readings, sensor errors included, equal the measured ones.
    fn reset_to_measurement(&mut self, sensor_error: &[Lane; 2]) {
        for (motion, sensor_error) in self.0.iter_mut().zip(sensor_error) {
            *motion = sensor_error.map(|sensor_error| -sensor_error);
        }
    }

    /// The inverse of [`Self::whiten`]: change of the readings of a free run from its whitened innovations.
    #[inline]
    pub(super) fn colour(&mut self, update: &Update, white: &[Lane; 2]) -> [Lane; 2] {
        let mut readings = [[0.0; LANES]; 2];
        for (signal, gains) in [&update.current, &update.speed].into_iter().enumerate() {
            if gains[4] <= 0.0 {
                continue;
            }
            let over = 1.0 / gains[4];
            let error = white[signal].map(|white| white * over);
            for k in 0..LANES {
                readings[signal][k] = error[k] + self.0[signal][k];
            }
            self.correct_states(gains, &error, 1.0);
        }
        readings
    }

    /// Scalar measurement update with `gains`: the whitened innovation.
    #[inline]
    pub(super) fn innovation(&mut self, signal: usize, value: &[f64], gains: &[f64; 5]) -> Lane {
        let mut error = [0.0; LANES];
        for k in 0..LANES {
            error[k] = value[k] - self.0[signal][k];
        }
        self.correct_states(gains, &error, 1.0);
        error.map(|error| error * gains[4])
    }

    #[inline]
    fn correct_states(&mut self, gains: &[f64; 5], error: &Lane, sign: f64) {
        for (state, gain) in self.0.iter_mut().zip(gains) {
            for k in 0..LANES {
                state[k] += sign * gain * error[k];
            }
        }
    }
}

/// A forcing along a trajectory, or an error of the readings.
pub(super) enum Tangent {
    Terms(Box<dyn Terms>),
    /// A weighted sum of terms without states that are zero before `begins_s`, s after the run's first command.
    Event {
        parts: Vec<(f64, Box<dyn Terms>)>,
        begins_s: f64,
    },
    /// Error of form: terms times a power of their own relative size.
    Power {
        terms: Box<dyn Terms>,
        power: f64,
        share: f64,
    },
    /// Error of form: terms stretched by this factor along current and speed, minus the terms.
    Stretched {
        terms: Box<dyn Terms>,
        factor: f64,
        share: f64,
    },
    /// Error of form: terms behind a first-order lag of this time constant, minus the terms.
    Lagging {
        terms: Box<dyn Terms>,
        time_constant_s: f64,
    },
    Wave(Wave),
    /// Hat function: a torque over the speed, or a voltage over the current.
    Hat {
        axis: Axis,
        centre: f64,
        width: f64,
        size: f64,
    },
    /// Torque over the speed by its values at equidistant speeds between plus and minus the largest.
    Curve {
        most: f64,
        values: Vec<f64>,
    },
    /// Offsets of the sensors: A and rad/s.
    Offset([f64; 2]),
    /// Difference quotient of two terms.
    Change {
        from: Box<dyn Terms>,
        to: Box<dyn Terms>,
        over: f64,
    },
    /// Change of a parameter of the motor.
    Motor(MotorKey, f64),
    /// Delay of the commands, s.
    CommandDelay(f64),
    /// Delays of current and speed in the readings, s.
    ReadingDelay([f64; 2]),
}

/// Sine or cosine over the shaft angle: a torque, N.m, or a share of the torque of the current.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wave {
    pub order: f64,
    pub sine: bool,
    pub size: f64,
    pub of_current: bool,
}

/// Forcing of the current, or of a balance of torques, constant over each interval, that is equal to a delay of the commands by `late_s`.
fn delay_forcing(run: &LinearisedRun<'_>, late_s: f64) -> Vec<f64> {
    let Grid { instants, motions, .. } = &run.grid;
    let mut forcing = vec![0.0; motions.len()];
    if run.dynamics.balanced_kg_m2.is_some() {
        // From the torque that the model transmits: the difference of a measured one has its noise.
        for (k, three) in instants.windows(3).enumerate() {
            let used = motions[k..k + 3].iter().all(|motion| motion.direction != 0.0);
            let torque = |at: &Instant| at.torque_n_m_per_a * at.current_a;
            let rate =
                (torque(&three[2]) - torque(&three[0])) / (three[2].time_s - three[0].time_s);
            forcing[k + 1] = if used { -late_s * rate } else { 0.0 };
        }
        return forcing;
    }
    let known_s = run.gains.command_delay_s;
    for pair in run.scenario.events.windows(2) {
        let acts_s = pair[1].0 + known_s;
        let number = run.grid.interval_at(run.scenario, acts_s);
        let (Some(motion), Some(cell)) = (motions.get(number), forcing.get_mut(number)) else {
            continue;
        };
        let missing_a = (pair[0].1 - pair[1].1) * late_s * run.dynamics.inverse_inductance;
        if run.grid.is_refined() {
            // The interval begins with the command.
            *cell += missing_a / motion.interval_s;
            continue;
        }
        let gain = run.steps[number].current[4];
        if gain > 0.0 {
            let end_s = instants[number].time_s + 0.5 * motion.interval_s;
            let rest_s = end_s + run.scenario.begin_s() - acts_s;
            let rest = run.dynamics.over(rest_s, motion.direction == 0.0);
            *cell += rest.apply([missing_a, 0.0], [0.0; 2])[0] / gain;
        }
    }
    forcing
}

/// A tangent and the states of its terms along a run.
struct ForcingState<'a> {
    tangent: &'a Tangent,
    own: Vec<f64>,
    /// Largest voltage, torque and friction along the run, for [`Tangent::Power`].
    most: Sums,
    /// Forcing of the current by a delay of the commands, for each interval.
    delay_forcing: Vec<f64>,
}

impl<'a> ForcingState<'a> {
    fn new(tangent: &'a Tangent, run: &LinearisedRun<'_>) -> Self {
        let states = match tangent {
            Tangent::Terms(terms) | Tangent::Power { terms, .. } => terms.states(),
            Tangent::Change { from, to, .. } => from.states() + to.states(),
            // The voltage behind the capacitor.
            Tangent::Lagging { .. } => 1,
            _ => 0,
        };
        let mut most = Sums::default();
        if let Tangent::Power { terms, .. } = tangent {
            let mut own = vec![0.0; states];
            for (at, motion) in run.grid.instants.iter().zip(&run.grid.motions) {
                let sums = advanced(&**terms, at, &mut own, motion.interval_s);
                most = combined(&most, &sums, |most, own| most.max(own.abs()));
            }
            (most.current_rate_gain, most.inertia_gain) = (0.0, 0.0);
        }
        let delay_forcing = match tangent {
            Tangent::CommandDelay(late_s) => delay_forcing(run, *late_s),
            _ => vec![],
        };
        Self { tangent, own: vec![0.0; states], most, delay_forcing }
    }

    /// Terms of the tangent at the middle of an interval; advances their states.
    fn sums(&mut self, at: &Instant, interval_s: f64) -> Sums {
        match self.tangent {
            Tangent::Terms(terms) => advanced(&**terms, at, &mut self.own, interval_s),
            Tangent::Event { parts, .. } => {
                parts.iter().fold(Sums::default(), |sum, (weight, terms)| {
                    combined(&sum, &terms.sums(at, &[]), |sum, own| sum + weight * own)
                })
            }
            Tangent::Change { from, to, over } => {
                let (of_from, of_to) = self.own.split_at_mut(from.states());
                let from = advanced(&**from, at, of_from, interval_s);
                let to = advanced(&**to, at, of_to, interval_s);
                combined(&from, &to, |from, to| (to - from) / over)
            }
            Tangent::Power { terms, power, share } => {
                let sums = advanced(&**terms, at, &mut self.own, interval_s);
                combined(&sums, &self.most, |value, most| {
                    if value != 0.0 && most > 0.0 {
                        share * value * (value / most).abs().powf(*power)
                    } else {
                        0.0
                    }
                })
            }
            Tangent::Stretched { terms, factor, share } => {
                let slow = Instant {
                    current_a: at.current_a / factor,
                    speed_rad_s: at.speed_rad_s / factor,
                    ..*at
                };
                let (slow, own) = (terms.sums(&slow, &[]), terms.sums(at, &[]));
                Sums {
                    current_rate_gain: 0.0,
                    inertia_gain: 0.0,
                    ..combined(&slow, &own, |slow, own| share * (slow - own))
                }
            }
            Tangent::Lagging { terms, time_constant_s } => {
                let (lag, settled_v) = (interval_s / time_constant_s, terms.voltage_v(at, &[]));
                let (behind_v, kept) = (self.own[0] - settled_v, (-lag).exp());
                self.own[0] = settled_v + behind_v * kept;
                // The mean of the difference over the interval.
                let mean_v = behind_v * (1.0 - kept) / lag;
                Sums { voltage_v: if lag > 0.0 { mean_v } else { behind_v }, ..Sums::default() }
            }
            _ => Sums::default(),
        }
    }
}

/// Terms at the middle of an interval; advances their states over it.
fn advanced(terms: &dyn Terms, at: &Instant, own: &mut [f64], interval_s: f64) -> Sums {
    if own.is_empty() {
        return terms.sums(at, own);
    }
    terms.advance(at, own, 0.5 * interval_s);
    let sums = terms.sums(at, own);
    terms.advance(at, own, 0.5 * interval_s);
    sums
}

/// Sine and cosine of a wave at the intervals of one chunk.
struct Waves {
    order: f64,
    each: [[f64; 2]; CHUNK],
}

impl Waves {
    /// Sets the order; the next higher one costs one product a sample (angle addition).
    fn to(&mut self, order: f64, instants: &[Instant]) {
        if order.to_bits() == self.order.to_bits() {
            return;
        }
        let is_next = (order - self.order - 1.0).abs() < f64::EPSILON;
        for (wave, at) in self.each.iter_mut().zip(instants) {
            *wave = if is_next { at.angle.next_wave(*wave) } else { at.angle.wave(order) };
        }
        self.order = order;
    }
}

/// Propagates at most [`LANES`] tangents along `run`. `output` receives the first sample of each chunk and the whitened innovations
/// of its samples: current, speed, current, ... Chunks before the begin of all tangents are skipped.
pub(super) fn propagate(
    run: &LinearisedRun<'_>,
    tangents: &[&Tangent],
    mut output: impl FnMut(usize, &[Lane]),
) {
    let mut forcing_states: Vec<_> =
        tangents.iter().map(|tangent| ForcingState::new(tangent, run)).collect();
    let mut deviations = Deviations::default();
    let mut forcing = [[[0.0; LANES]; 2]; CHUNK];
    let mut white = [[0.0; LANES]; 2 * CHUNK];
    let mut sensor_error = [[0.0; LANES]; 2];
    let mut late: Vec<(usize, [f64; 2])> = Vec::new();
    for (lane, tangent) in tangents.iter().enumerate() {
        match tangent {
            Tangent::Offset(offset) => {
                (sensor_error[0][lane], sensor_error[1][lane]) = (offset[0], offset[1]);
            }
            Tangent::ReadingDelay(by_s) => late.push((lane, *by_s)),
            _ => {}
        }
    }
    let grid = &run.grid;
    let (steps, n) = (grid.steps(&run.steps), grid.motions.len());
    let mut sensing = run.sensing();
    let begins_s = tangents.iter().map(|tangent| match tangent {
        Tangent::Event { begins_s, .. } => *begins_s,
        _ => f64::NEG_INFINITY,
    });
    let begin_s = begins_s.fold(f64::INFINITY, f64::min);
    let silent = grid.instants.partition_point(|instant| instant.time_s < begin_s);
    for first in (0..n).step_by(CHUNK).skip(silent / CHUNK) {
        let range = first..(first + CHUNK).min(n);
        // No wave has this order: the first one of a chunk is computed.
        let mut waves = Waves { order: f64::NEG_INFINITY, each: [[0.0; 2]; CHUNK] };
        for (lane, forcing_state) in forcing_states.iter_mut().enumerate() {
            let put = |k: usize, [current, speed]: [f64; 2]| {
                (forcing[k][0][lane], forcing[k][1][lane]) = (current, speed);
            };
            force(run, forcing_state, range.clone(), &mut waves, put);
        }
        let first_sample = grid.sample_from(first);
        let mut sample = first_sample;
        for (interval, forcing) in range.zip(&forcing) {
            deviations.advance(&steps[interval], forcing);
            if let Some(sensing) = &mut sensing {
                sensing.follow(&deviations, grid.motions[interval].interval_s);
            }
            if !grid.ends_at(interval, sample) {
                continue;
            }
            for (lane, by_s) in &late {
                for (signal, sensor_error) in sensor_error.iter_mut().enumerate() {
                    sensor_error[*lane] = -by_s[signal] * run.filtered.rates[sample][signal];
                }
            }
            let (restarts, update) =
                (run.gains.transitions[sample].restarts, &run.gains.updates[sample]);
            let own = 2 * (sample - first_sample);
            let both = if let Some(sensing) = &mut sensing {
                sensing.whiten(&mut deviations, update, &sensor_error, restarts)
            } else {
                if restarts {
                    deviations.reset_to_measurement(&sensor_error);
                }
                deviations.whiten(update, &sensor_error)
            };
            white[own..own + 2].copy_from_slice(&both);
            sample += 1;
        }
        output(first_sample, &white[..2 * (sample - first_sample)]);
    }
}

/// Sensors that lag behind the deviations.
pub(super) struct Sensing {
    sensors: SensorPath<LANES>,
    time_s: f64,
}

impl Sensing {
    fn new(path: Path) -> Self {
        let rest = Reading { time_s: 0.0, current_a: [0.0; LANES], speed_rad_s: [0.0; LANES] };
        Self { sensors: SensorPath::new(path, rest), time_s: 0.0 }
    }

    fn follow(&mut self, deviations: &Deviations, interval_s: f64) {
        self.time_s += interval_s;
        let [current_a, speed_rad_s, ..] = deviations.0;
        self.sensors.follow(Reading { time_s: self.time_s, current_a, speed_rad_s });
    }

    /// As [`Deviations::whiten`], of the readings; the sensors are corrected with the motion.
    fn whiten(
        &mut self,
        deviations: &mut Deviations,
        update: &Update,
        sensor_error: &[Lane; 2],
        restarts: bool,
    ) -> [Lane; 2] {
        let before = [deviations.0[0], deviations.0[1]];
        let read = self.sensors.read();
        let behind: [Lane; 2] = from_fn(|signal| {
            from_fn(|k| read[signal][k] - before[signal][k] + sensor_error[signal][k])
        });
        if restarts {
            deviations.reset_to_measurement(&behind);
        }
        let white = deviations.whiten(update, &behind);
        let [change_a, change_rad_s] =
            from_fn(|signal| from_fn(|k| deviations.0[signal][k] - before[signal][k]));
        self.sensors.correct(&change_a, &change_rad_s);
        self.sensors.begin_mean();
        white
    }
}

impl LinearisedRun<'_> {
    /// The sensors of deviations; `None` where the measurement is the motion.
    fn sensing(&self) -> Option<Sensing> {
        let terms = self.model.effects.iter().map(terms_of);
        let path =
            terms.map(|terms| terms.path()).fold(Path::of(self.scenario.sensors), Path::plus);
        let lags = Path { current_offset_a: 0.0, speed_offset_rad_s: 0.0, ..path };
        (self.grid.is_refined() && !lags.measures_directly()).then(|| Sensing::new(lags))
    }
}

/// `sin(x) / x`: the mean of a wave over an interval of `2 x`, over its value in the middle.
fn sinc(x: f64) -> f64 {
    let square = x * x;
    if square < 0.25 {
        // The next term is below 2e-8.
        1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0))
    } else {
        x.sin() / x
    }
}

/// Voltage across the inductance without the drops of effects.
fn inductive_v(run: &LinearisedRun<'_>, at: &Instant) -> f64 {
    let value = |key| run.model.motor.get(key).unwrap_or(0.0);
    let (r, ke) = (value(MotorKey::Resistance), value(MotorKey::BackEmf));
    at.voltage_v - r * at.current_a - ke * at.speed_rad_s
}

/// The forcing of one tangent at the intervals of a chunk.
fn force(
    run: &LinearisedRun<'_>,
    forcing_state: &mut ForcingState<'_>,
    range: std::ops::Range<usize>,
    waves: &mut Waves,
    mut put: impl FnMut(usize, [f64; 2]),
) {
    let instants = &run.grid.instants[range.clone()];
    let motions = &run.grid.motions[range.clone()];
    let inductance = run.dynamics.inverse_inductance;
    let inertia = run.dynamics.inverse_inertia;
    let of_rate = run.dynamics.balanced_kg_m2.unwrap_or(1.0);
    let along = || instants.iter().zip(motions).enumerate();
    match forcing_state.tangent {
        Tangent::Offset(_) | Tangent::ReadingDelay(_) => {}
        Tangent::CommandDelay(_) => {
            let is_balance = run.dynamics.balanced_kg_m2.is_some();
            for (k, pulse) in forcing_state.delay_forcing[range].iter().enumerate() {
                put(k, if is_balance { [0.0, *pulse] } else { [*pulse, 0.0] });
            }
        }
        Tangent::Motor(key, by) => {
            for (k, (at, motion)) in along() {
                let forcing = motor_forcing(run, *key, at, motion.direction, motion.rates);
                put(k, forcing.map(|forcing| by * forcing));
            }
        }
        Tangent::Wave(wave) => {
            waves.to(wave.order, instants);
            for (k, (at, motion)) in along() {
                let torque = wave_torque(wave, at, motion.interval_s, &waves.each[k]);
                put(k, [0.0, -torque * inertia]);
            }
        }
        Tangent::Curve { most, values } => {
            for (k, at) in instants.iter().enumerate() {
                let torque = interpolated(*most, values, at.speed_rad_s);
                put(k, [0.0, -torque * inertia]);
            }
        }
        Tangent::Hat { axis, centre, width, size } => {
            let hat = |x: f64| size * (1.0 - ((x - centre) / width).abs()).max(0.0);
            for (k, at) in instants.iter().enumerate() {
                let forcing = match axis {
                    Axis::Current => [-hat(at.current_a) * inductance, 0.0],
                    _ => [0.0, -hat(at.speed_rad_s) * inertia],
                };
                put(k, forcing);
            }
        }
        _ => {
            for (k, (at, motion)) in along() {
                let sums = forcing_state.sums(at, motion.interval_s);
                let inductive_v = sums.current_rate_gain * inductive_v(run, at);
                let acceleration = sums.inertia_gain * of_rate * motion.rates[1];
                let torque_n_m = sums.torque_n_m + motion.direction * sums.friction_n_m;
                put(
                    k,
                    [
                        (inductive_v - sums.voltage_v) * inductance,
                        -torque_n_m * inertia - acceleration,
                    ],
                );
            }
        }
    }
}

/// Torque of a wave over an interval about an instant at which its sine and cosine are these.
fn wave_torque(wave: &Wave, at: &Instant, interval_s: f64, [sin, cos]: &[f64; 2]) -> f64 {
    // Mean over the interval: a wave through which the shaft turns within a sample averages out.
    let mean = sinc(0.5 * wave.order * at.speed_rad_s * interval_s);
    let driving = at.torque_n_m_per_a * at.current_a;
    let per = if wave.of_current { driving } else { 1.0 };
    mean * wave.size * per * if wave.sine { sin } else { cos }
}

/// A curve at a speed by its values at equidistant speeds between plus and minus the largest.
fn interpolated(most: f64, values: &[f64], speed_rad_s: f64) -> f64 {
    let steps = (values.len() - 1) as f64;
    let place = (0.5 * (speed_rad_s / most + 1.0) * steps).clamp(0.0, steps);
    let left = whole(place.floor()).min(values.len() - 2);
    let share = place - left as f64;
    values[left] + share * (values[left + 1] - values[left])
}

/// Derivatives of the rates of current and speed by a parameter of the motor.
fn motor_forcing(
    run: &LinearisedRun<'_>,
    key: MotorKey,
    at: &Instant,
    direction: f64,
    rates: [f64; 2],
) -> [f64; 2] {
    let Dynamics { inverse_inductance: inductance, inverse_inertia: inertia, .. } = run.dynamics;
    let is_tied = run.model.motor.get(MotorKey::TorqueConstant).is_none();
    let (i, w) = (at.current_a, at.speed_rad_s);
    match key {
        MotorKey::Resistance => [-i * inductance, 0.0],
        MotorKey::Inductance => [-rates[0] * inductance, 0.0],
        MotorKey::BackEmf if is_tied => [-w * inductance, i * inertia],
        MotorKey::BackEmf => [-w * inductance, 0.0],
        MotorKey::TorqueConstant => [0.0, i * inertia],
        MotorKey::Inertia => [0.0, -rates[1] * inertia],
        MotorKey::LoadTorque => [0.0, -direction * inertia],
    }
}

/// Whether the tangents are derivatives of the model. They are not with a second inertia, or where the current hardly settles between
/// two samples.
pub(super) fn are_tangents(model: &Model, scenario: &Scenario) -> bool {
    let terms: Vec<Box<dyn Terms>> = model.effects.iter().map(terms_of).collect();
    let paths = terms.iter().map(|terms| terms.path());
    let path = paths.fold(Path::of(scenario.sensors), Path::plus);
    terms.iter().all(|terms| terms.coupling().is_none())
        && needs_refinement(model, scenario, &path).is_some()
}

/// Derivative by a parameter of an effect: of a coefficient for `unit` of it, of a shape by a difference over `step`, which is `over` in
/// its coordinate. `None` for a shape of an effect with states.
pub(super) fn parameter_tangent(
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
    unit: f64,
    (step, over): (f64, f64),
) -> Option<Tangent> {
    let specs = effect.parameters();
    if specs[index].is_coefficient() {
        let mut alone = values.to_vec();
        let coefficients = alone.iter_mut().zip(specs);
        for (value, _) in coefficients.filter(|(_, spec)| spec.is_coefficient()) {
            *value = 0.0;
        }
        alone[index] = unit;
        let late_s = effect.terms(&alone).path().command_delay_s;
        if late_s > 0.0 {
            return Some(Tangent::CommandDelay(late_s));
        }
        return coefficient_tangent(effect, &alone, index);
    }
    let mut moved = values.to_vec();
    moved[index] += step;
    let (from, to) = (effect.terms(values), effect.terms(&moved));
    let is_wave = effect.card().harmonic.is_some();
    let acts_on_path = from.path() != Path::default();
    (from.states() == 0 && !is_wave && !acts_on_path).then_some(Tangent::Change { from, to, over })
}

/// The tangent of one coefficient of an effect, all others at zero; `None` where that is no small forcing.
pub(super) fn coefficient_tangent(
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
) -> Option<Tangent> {
    if let Some(harmonic) = effect.card().harmonic {
        let order = effect.parameters().iter().position(|spec| spec.key == "order");
        return Some(Tangent::Wave(Wave {
            order: order.map_or(1.0, |order| values[order]),
            sine: index == 0,
            size: values[index],
            of_current: harmonic == Harmonic::OfCurrent,
        }));
    }
    let terms = effect.terms(values);
    let path = terms.path();
    if path.measures_directly() && !path.delays_command() && terms.coupling().is_none() {
        return Some(Tangent::Terms(terms));
    }
    let offsets = Path {
        current_offset_a: path.current_offset_a,
        speed_offset_rad_s: path.speed_offset_rad_s,
        ..Path::default()
    };
    let offset = Tangent::Offset([path.current_offset_a, path.speed_offset_rad_s]);
    (path == offsets).then_some(offset)
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use super::*;
    use crate::joint::kalman::{DISTURBED, hole};
    use crate::kit::{self, nameplate, truth};
    use drivebench_model::plant::testing::record;
    use drivebench_model::plant::{State, UnknownInput};

    const ALL: Range<usize> = 0..usize::MAX;

    /// Moves one way only: where a shaft breaks away differences are no tangents.
    fn run(period_s: f64) -> Scenario {
        let events = vec![(0.0, 30.0), (0.6, 60.0), (1.2, 25.0), (1.8, 70.0)];
        record(&nameplate(), events, period_s, 2.5, 11)
    }

    fn linearised(scenario: &Scenario) -> LinearisedRun<'_> {
        LinearisedRun::new(&nameplate(), scenario, State::default(), DISTURBED).unwrap()
    }

    /// Relative distance of the column of a tangent, in some rows, to the difference that another model makes.
    fn distance(
        run: &LinearisedRun<'_>,
        tangent: &Tangent,
        with: &Model,
        rows: Range<usize>,
    ) -> f64 {
        let mut column = Vec::new();
        propagate(run, &[tangent], |first, white| {
            assert_eq!(column.len(), 2 * first);
            column.extend(white.iter().map(|row| row[0]));
        });
        let difference = run.difference(with, run.scenario, 1.0).into_iter();
        let pairs =
            column.into_iter().zip(difference.map(f64::from)).skip(rows.start).take(rows.len());
        let squares =
            pairs.fold([0.0, 0.0], |[apart, own], (a, b)| [apart + (a - b).powi(2), own + b * b]);
        (squares[0] / squares[1]).sqrt()
    }

    #[test]
    fn a_tangent_is_the_difference_of_two_filtered_runs() {
        let (model, scenario, by_s) = (nameplate(), run(1e-3), 2e-5);
        let mut cases = vec![(Tangent::CommandDelay(by_s), truth("command_delay", &[by_s]))];
        for (id, late_s) in [("current_filter", [by_s, 0.0]), ("speed_delay", [0.0, by_s])] {
            cases.push((Tangent::ReadingDelay(late_s), truth(id, &[by_s])));
        }
        let effects: [(&str, &[f64]); 9] = [
            ("viscous_friction", &[1e-4]),
            ("quadratic_load", &[5e-7]),
            ("lagged_load", &[5e-7, 0.2]),
            ("constant_load", &[5e-3]),
            ("voltage_offset", &[0.05]),
            ("supply_sag", &[0.01]),
            ("cogging", &[0.004, 0.0, 3.0]),
            ("current_offset", &[0.02]),
            ("speed_offset", &[0.1]),
        ];
        cases.extend(effects.map(|(id, values)| {
            let with = truth(id, values);
            let terms = terms_of(&with.effects[0]);
            let path = terms.path();
            let offset = Tangent::Offset([path.current_offset_a, path.speed_offset_rad_s]);
            let tangent = if path.measures_directly() { Tangent::Terms(terms) } else { offset };
            (tangent, with)
        }));
        let keys = MotorKey::ALL.into_iter().filter(|key| *key != MotorKey::TorqueConstant);
        cases.extend(keys.map(|key| {
            let (mut with, value) = (model.clone(), model.motor.get(key).unwrap());
            with.motor.set(key, 1.002 * value);
            (Tangent::Motor(key, 0.002 * value), with)
        }));
        for (number, (tangent, with)) in cases.iter().enumerate() {
            let apart = distance(&linearised(&scenario), tangent, with, ALL);
            assert!(apart < 0.05, "case {number} {:?}: {apart}", with.effects);
        }
    }

    #[test]
    fn tangents_hold_behind_sensors_that_lag_and_with_a_current_that_settles_between_samples() {
        let of_effects = |effects: &[(&str, &[f64])]| kit::with(nameplate(), effects);
        let filters: [(&str, &[f64]); 2] = [("current_filter", &[2e-3]), ("speed_delay", &[3e-3])];
        for (period_s, own, averages_current) in
            [(1e-3, &filters[..], false), (1e-2, &filters[..1], false), (4e-2, &[], true)]
        {
            let model = of_effects(own);
            let mut scenario = record(&model, run(period_s).events, period_s, 2.5, 11);
            scenario.sensors.averages_current = averages_current;
            let linearised =
                LinearisedRun::new(&model, &scenario, State::default(), DISTURBED).unwrap();
            let keys = MotorKey::ALL.into_iter().filter(|key| *key != MotorKey::TorqueConstant);
            let of_motor = keys.map(|key| {
                let (mut with, value) = (model.clone(), model.motor.get(key).unwrap());
                with.motor.set(key, 1.002 * value);
                (Tangent::Motor(key, 0.002 * value), with)
            });
            let others: [(&str, &[f64]); 4] = [
                ("viscous_friction", &[1e-4]),
                ("voltage_offset", &[0.05]),
                ("constant_load", &[5e-3]),
                ("command_delay", &[2e-5]),
            ];
            let of_others = others.map(|(id, values)| {
                let with = of_effects(&[own, &[(id, values)]].concat());
                let tangent = match id {
                    "command_delay" => Tangent::CommandDelay(values[0]),
                    _ => Tangent::Terms(terms_of(&with.effects[own.len()])),
                };
                (tangent, with)
            });
            for (number, (tangent, with)) in of_motor.chain(of_others).enumerate() {
                let apart = distance(&linearised, &tangent, &with, ALL);
                assert!(apart < 0.1, "{period_s} s, case {number}: {apart}");
            }
        }
    }

    #[test]
    fn behind_a_hole_readings_are_what_was_measured() {
        let mut scenario = run(1e-3);
        let [first, last] = [620, 680];
        let [from_s, to_s] = [first, last].map(|row| scenario.sample_time_s[row]);
        scenario.unknown_input = vec![UnknownInput {
            restart: Some([scenario.current_a[last], scenario.speed_rad_s[last]]),
            ..hole(from_s, to_s, 0.0)
        }];
        for (id, offset) in [("current_offset", [0.4, 0.0]), ("speed_offset", [0.0, 3.0])] {
            let with = truth(id, &[offset[0] + offset[1]]);
            let run = linearised(&scenario);
            let rows = 2 * last..2 * last + 100;
            let apart = distance(&run, &Tangent::Offset(offset), &with, rows);
            assert!(apart < 1e-6, "{id}: {apart}");
        }
    }

    #[test]
    fn a_wave_is_the_difference_of_two_runs_at_any_sampling() {
        for (period_s, order, most) in [(1e-3, 2.5, 0.02), (1e-3, 23.0, 0.1), (1e-2, 1.0, 0.15)] {
            let scenario = run(period_s);
            let of = [("cogging", false, 0.004), ("torque_ripple", true, 0.02)];
            for ((id, of_current, size), sine) in
                of.into_iter().flat_map(|of| [(of, true), (of, false)])
            {
                let wave = Tangent::Wave(Wave { order, sine, size, of_current });
                let [sines, cosines] = if sine { [size, 0.0] } else { [0.0, size] };
                let with = truth(id, &[sines, cosines, order]);
                let apart = distance(&linearised(&scenario), &wave, &with, ALL);
                assert!(apart < most, "{id} {order} {period_s}: {apart}");
            }
        }
    }

    #[test]
    fn colouring_undoes_the_whitening() {
        let scenario = run(1e-3);
        let linearised = linearised(&scenario);
        let forcing = [[300.0; LANES], [-20.0; LANES]];
        let (mut free, mut filtered, mut back) = <(Deviations, Deviations, Deviations)>::default();
        for (step, update) in linearised.steps.iter().zip(&linearised.gains.updates) {
            free.advance(step, &forcing);
            filtered.advance(step, &forcing);
            back.advance_unforced(step);
            let white = filtered.whiten(update, &[[0.0; LANES]; 2]);
            let readings = back.colour(update, &white);
            for (reading, free) in readings.iter().flatten().zip(free.0[..2].iter().flatten()) {
                let apart = (reading - free).abs();
                assert!(apart < 1e-6 * free.abs().max(1.0), "{reading} {free}");
            }
        }
        assert!(free.0[1][0].abs() > 1.0, "the forcing does something");
    }
}
