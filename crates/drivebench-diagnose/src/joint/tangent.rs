//! Forward sensitivities of a linearised run: what small forcings along its trajectory do to the innovations, eight side by side;
//! and which of them are the slopes over what is free in its model.

use super::kalman::{Dynamics, Passage, Update};
use super::process_noise::{combined, terms_of};
use super::run::LinearisedRun;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::median_step;
use drivebench_model::plant::effect::{Axis, Harmonic};
use drivebench_model::plant::{
    Effect, Input, Instant, Model, MotorKey, Path, Scenario, Sums, Terms,
};

/// Deviations that pass a run at once: the step's coefficients are read once for all of them, and they fill registers.
pub(super) const LANES: usize = 8;
/// Samples that are forced, passed and handed on at once, so that all of it stays in the cache.
pub(super) const CHUNK: usize = 128;

/// A number for each lane.
pub(super) type Lane = [f64; LANES];

/// One passage as the coefficients of current and speed, on: current, speed, disturbance, voltage's error, forcing of the
/// current, forcing of the speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    current: [f64; 6],
    speed: [f64; 6],
    forget: f64,
    keeps: f64,
}

impl Step {
    pub(super) fn of(passage: &Passage, forget: f64, dynamics: &Dynamics) -> Self {
        let moves = f64::from(u8::from(passage.direction != 0.0));
        let apply = |x, g| passage.propagator.apply(x, g);
        let on = [
            apply([1.0, 0.0], [0.0; 2]),
            apply([0.0, passage.kept], [0.0; 2]),
            apply([0.0; 2], [0.0, -dynamics.inverse_inertia * moves]),
            apply([0.0; 2], dynamics.per_input),
            apply([0.0; 2], [1.0, 0.0]),
            apply([0.0; 2], [0.0, moves]),
        ];
        Self {
            current: on.map(|to| to[0]),
            speed: on.map(|to| to[1] * moves),
            forget,
            keeps: passage.input_keeps,
        }
    }

    /// Nothing passes: the first sample is at the run's begin.
    pub(super) const fn still() -> Self {
        Self {
            current: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            speed: [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            forget: 1.0,
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
    pub(super) fn pass(&mut self, step: &Step, forcing: &[Lane; 2]) {
        self.drift(step);
        for (state, on) in self.0.iter_mut().zip([&step.current, &step.speed]) {
            for k in 0..LANES {
                state[k] += on[4] * forcing[0][k] + on[5] * forcing[1][k];
            }
        }
    }

    /// The same without a forcing.
    #[inline]
    pub(super) fn drift(&mut self, step: &Step) {
        let [i, w, d, v] = self.0;
        for (state, on) in self.0.iter_mut().zip([&step.current, &step.speed]) {
            for k in 0..LANES {
                state[k] = (on[0] * i[k] + on[1] * w[k]) + (on[2] * d[k] + on[3] * v[k]);
            }
        }
        self.0[2] = d.map(|d| d * step.forget);
        self.0[3] = v.map(|v| v * step.keeps);
    }

    /// At a sample: whitened innovations of a prediction that deviates like this from a measurement of nothing, given
    /// what the readings have beside.
    #[inline]
    pub(super) fn correct(&mut self, update: &Update, beside: &[Lane; 2]) -> [Lane; 2] {
        let mut white = [[0.0; LANES]; 2];
        for (signal, gains) in [&update.current, &update.speed].into_iter().enumerate() {
            let mut error = self.0[signal];
            for k in 0..LANES {
                error[k] += beside[signal][k];
            }
            self.shift(gains, &error, -1.0);
            for k in 0..LANES {
                white[signal][k] = error[k] * gains[4];
            }
        }
        white
    }

    /// Behind a hole the motion is put where the readings are what was measured, whatever they have beside.
    fn take_over(&mut self, beside: &[Lane; 2]) {
        for (motion, beside) in self.0.iter_mut().zip(beside) {
            *motion = beside.map(|beside| -beside);
        }
    }

    /// The inverse of `correct`: what does this to the readings, from its whitened innovations.
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
            self.shift(gains, &error, 1.0);
        }
        readings
    }

    /// One scalar measurement: its innovation, over which the deviations are corrected with `gains`.
    #[inline]
    pub(super) fn measure(&mut self, signal: usize, value: &[f64], gains: &[f64; 5]) -> Lane {
        let mut error = [0.0; LANES];
        for k in 0..LANES {
            error[k] = value[k] - self.0[signal][k];
        }
        self.shift(gains, &error, 1.0);
        error.map(|error| error * gains[4])
    }

    #[inline]
    fn shift(&mut self, gains: &[f64; 5], error: &Lane, sign: f64) {
        for (state, gain) in self.0.iter_mut().zip(gains) {
            for k in 0..LANES {
                state[k] += sign * gain * error[k];
            }
        }
    }
}

/// A torque, or a voltage drop, of one size along a trajectory.
pub(super) enum Tangent {
    Terms(Box<dyn Terms>),
    /// A weighted sum of terms without states that do nothing before, s after the run's first command.
    Event {
        parts: Vec<(f64, Box<dyn Terms>)>,
        begins_s: f64,
    },
    /// Terms times a power of their own size: another form of the same effect.
    Bent {
        terms: Box<dyn Terms>,
        power: f64,
        share: f64,
    },
    /// Change of terms that build up more slowly, by this factor of current and speed.
    Slow {
        terms: Box<dyn Terms>,
        factor: f64,
        share: f64,
    },
    /// Change of terms that lag by a capacitor with this time constant.
    Lagging {
        terms: Box<dyn Terms>,
        time_constant_s: f64,
    },
    Wave(Wave),
    /// Falls to zero on both sides of the centre: a torque, or over the current a voltage.
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
    /// Change from terms to others, over the step of a coordinate.
    Change {
        from: Box<dyn Terms>,
        to: Box<dyn Terms>,
        over: f64,
    },
    /// Change of a parameter of the motor.
    Motor(MotorKey, f64),
    /// Commands that act later, s.
    LateCommands(f64),
    /// Sensors that show current and speed of a while ago, s.
    LateReadings([f64; 2]),
}

/// A torque over the angle, in N.m, or in proportion to the current, of which it then is this share.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wave {
    pub order: f64,
    pub sine: bool,
    pub size: f64,
    pub of_current: bool,
}

/// What commands that act `late_s` later do to the current in the interval before each sample, as a constant forcing of it.
fn pulses(run: &LinearisedRun<'_>, late_s: f64) -> Vec<f64> {
    let times = &run.scenario.sample_time_s;
    let mut forcing = vec![0.0; times.len()];
    let known_s = run.follower.late_s;
    for pair in run.scenario.events.windows(2) {
        let acts_s = pair[1].0 + known_s;
        let sample = times.partition_point(|time_s| *time_s <= acts_s);
        let (Some(time_s), Some(cell)) = (times.get(sample), forcing.get_mut(sample)) else {
            continue;
        };
        let gain = run.steps[sample].current[4];
        if gain > 0.0 {
            let missing_a = (pair[0].1 - pair[1].1) * late_s * run.dynamics.inverse_inductance;
            let rests = run.follower.passages[sample].direction == 0.0;
            let rest = run.dynamics.over(time_s - acts_s, rests);
            *cell += rest.apply([missing_a, 0.0], [0.0; 2])[0] / gain;
        }
    }
    forcing
}

/// A tangent on its way along a run.
struct Traveller<'a> {
    tangent: &'a Tangent,
    own: Vec<f64>,
    rate: Vec<f64>,
    /// Largest voltage, torque and friction of terms whose power differs.
    most: Sums,
    /// Forcing of the current by commands that are late, for each sample.
    pulses: Vec<f64>,
}

impl<'a> Traveller<'a> {
    fn new(tangent: &'a Tangent, run: &LinearisedRun<'_>) -> Self {
        let states = match tangent {
            Tangent::Terms(terms) => terms.states(),
            // The voltage behind the capacitor.
            Tangent::Lagging { .. } => 1,
            _ => 0,
        };
        let mut most = Sums::default();
        if let Tangent::Bent { terms, .. } = tangent {
            for at in &run.instants {
                most = combined(&most, &terms.sums(at, &[]), |most, own| most.max(own.abs()));
            }
            (most.current_rate_gain, most.inertia_gain) = (0.0, 0.0);
        }
        let pulses = match tangent {
            Tangent::LateCommands(late_s) => pulses(run, *late_s),
            _ => vec![],
        };
        Self { tangent, own: vec![0.0; states], rate: vec![0.0; states], most, pulses }
    }

    /// What terms, or others in their place, do at an instant of an interval.
    fn sums(&mut self, at: &Instant, interval_s: f64) -> Sums {
        match self.tangent {
            Tangent::Terms(terms) => {
                let sums = terms.sums(at, &self.own);
                if !self.own.is_empty() {
                    terms.derivative(at, &self.own, &mut self.rate);
                    for (own, rate) in self.own.iter_mut().zip(&self.rate) {
                        *own += interval_s * rate;
                    }
                }
                sums
            }
            Tangent::Event { parts, .. } => {
                parts.iter().fold(Sums::default(), |sum, (weight, terms)| {
                    combined(&sum, &terms.sums(at, &[]), |sum, own| sum + weight * own)
                })
            }
            Tangent::Change { from, to, over } => {
                let (from, to) = (from.sums(at, &[]), to.sums(at, &[]));
                combined(&from, &to, |from, to| (to - from) / over)
            }
            Tangent::Bent { terms, power, share } => {
                combined(&terms.sums(at, &[]), &self.most, |value, most| {
                    if value != 0.0 && most > 0.0 {
                        share * value * (value / most).abs().powf(*power)
                    } else {
                        0.0
                    }
                })
            }
            Tangent::Slow { terms, factor, share } => {
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

/// Sine and cosine of a wave at the samples of one chunk.
struct Waves {
    order: f64,
    each: [[f64; 2]; CHUNK],
}

impl Waves {
    /// Goes on to `order`; the next one after the present costs one product a sample.
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

/// Carries `tangents`, no more than there are lanes, along `run`; `hand_on` gets the first sample of each chunk and the
/// whitened innovations of its samples: current, speed, current, ... Chunks before the begin of all tangents are left out.
pub(super) fn carry(
    run: &LinearisedRun<'_>,
    tangents: &[&Tangent],
    mut hand_on: impl FnMut(usize, &[Lane]),
) {
    let travellers = tangents.iter().map(|tangent| Traveller::new(tangent, run));
    let mut travellers: Vec<_> = travellers.collect();
    let mut deviations = Deviations::default();
    let mut forcing = [[[0.0; LANES]; 2]; CHUNK];
    let mut white = [[0.0; LANES]; 2 * CHUNK];
    let mut beside = [[0.0; LANES]; 2];
    let mut late: Vec<(usize, [f64; 2])> = Vec::new();
    for (lane, tangent) in tangents.iter().enumerate() {
        match tangent {
            Tangent::Offset(offset) => (beside[0][lane], beside[1][lane]) = (offset[0], offset[1]),
            Tangent::LateReadings(by_s) => late.push((lane, *by_s)),
            _ => {}
        }
    }
    let n = run.scenario.samples();
    let begins_s = tangents.iter().map(|tangent| match tangent {
        Tangent::Event { begins_s, .. } => *begins_s,
        _ => f64::NEG_INFINITY,
    });
    let begin_s = begins_s.fold(f64::INFINITY, f64::min);
    let silent = run.instants.partition_point(|instant| instant.time_s < begin_s);
    for first in (0..n).step_by(CHUNK).skip(silent / CHUNK) {
        let range = first..(first + CHUNK).min(n);
        // No order is this: the first wave of a chunk is computed anew.
        let mut waves = Waves { order: f64::NEG_INFINITY, each: [[0.0; 2]; CHUNK] };
        for (lane, traveller) in travellers.iter_mut().enumerate() {
            let put = |k: usize, [current, speed]: [f64; 2]| {
                (forcing[k][0][lane], forcing[k][1][lane]) = (current, speed);
            };
            force(run, traveller, range.clone(), &mut waves, put);
        }
        for ((sample, forcing), white) in range.clone().zip(&forcing).zip(white.chunks_exact_mut(2))
        {
            deviations.pass(&run.steps[sample], forcing);
            for (lane, by_s) in &late {
                for (signal, beside) in beside.iter_mut().enumerate() {
                    beside[*lane] = -by_s[signal] * run.followed.rates[sample][signal];
                }
            }
            if run.follower.passages[sample].begins_again {
                deviations.take_over(&beside);
            }
            white.copy_from_slice(&deviations.correct(&run.follower.updates[sample], &beside));
        }
        hand_on(first, &white[..2 * range.len()]);
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

/// Voltage across the inductance, but for what effects drop.
fn inductive_v(run: &LinearisedRun<'_>, at: &Instant) -> f64 {
    let value = |key| run.model.motor.get(key).unwrap_or(0.0);
    let (r, ke) = (value(MotorKey::Resistance), value(MotorKey::BackEmf));
    at.voltage_v - r * at.current_a - ke * at.speed_rad_s
}

/// The forcing of one tangent at the samples of a chunk.
fn force(
    run: &LinearisedRun<'_>,
    traveller: &mut Traveller<'_>,
    range: std::ops::Range<usize>,
    waves: &mut Waves,
    mut put: impl FnMut(usize, [f64; 2]),
) {
    let instants = &run.instants[range.clone()];
    let passages = &run.follower.passages[range.clone()];
    let inductance = run.dynamics.inverse_inductance;
    let inertia = run.dynamics.inverse_inertia;
    let followed = &run.followed;
    let start = range.start;
    let mean_rate = |signal: usize, k: usize, interval_s: f64| {
        let sample = start + k;
        if sample == 0 || interval_s <= 0.0 {
            return 0.0;
        }
        (followed.before[sample][signal] - followed.after[sample - 1][signal]) / interval_s
    };
    let along = || instants.iter().zip(passages).enumerate();
    match traveller.tangent {
        Tangent::Offset(_) | Tangent::LateReadings(_) => {}
        Tangent::LateCommands(_) => {
            for (k, pulse) in traveller.pulses[range].iter().enumerate() {
                put(k, [*pulse, 0.0]);
            }
        }
        Tangent::Motor(key, by) => {
            for (k, (at, passage)) in along() {
                let rates = [0, 1].map(|signal| mean_rate(signal, k, passage.interval_s));
                let forcing = of_motor(run, *key, at, passage.direction, rates);
                put(k, forcing.map(|forcing| by * forcing));
            }
        }
        Tangent::Wave(wave) => {
            waves.to(wave.order, instants);
            for (k, (at, passage)) in along() {
                let torque = wave_torque(wave, at, passage.interval_s, &waves.each[k]);
                put(k, [0.0, -torque * inertia]);
            }
        }
        Tangent::Curve { most, values } => {
            for (k, at) in instants.iter().enumerate() {
                let torque = curve(*most, values, at.speed_rad_s);
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
            for (k, (at, passage)) in along() {
                let sums = traveller.sums(at, passage.interval_s);
                let inductive_v = sums.current_rate_gain * inductive_v(run, at);
                let acceleration = sums.inertia_gain * mean_rate(1, k, passage.interval_s);
                let torque_n_m = sums.torque_n_m + passage.direction * sums.friction_n_m;
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
    // What a wave does over an interval in which the shaft turns by much of it is little.
    let mean = sinc(0.5 * wave.order * at.speed_rad_s * interval_s);
    let driving = at.torque_n_m_per_a * at.current_a;
    let per = if wave.of_current { driving } else { 1.0 };
    mean * wave.size * per * if wave.sine { sin } else { cos }
}

/// A curve at a speed by its values at equidistant speeds between plus and minus the largest.
fn curve(most: f64, values: &[f64], speed_rad_s: f64) -> f64 {
    let steps = (values.len() - 1) as f64;
    let place = (0.5 * (speed_rad_s / most + 1.0) * steps).clamp(0.0, steps);
    let left = whole(place.floor()).min(values.len() - 2);
    let share = place - left as f64;
    values[left] + share * (values[left + 1] - values[left])
}

/// What a unit more of a motor's parameter does at rates of current and speed.
fn of_motor(
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

/// Whether tangents are slopes of the whole model: a lag between motion and measurement, a second inertia and a current that
/// settles between two samples have none.
pub(super) fn are_tangents(model: &Model, scenario: &Scenario) -> bool {
    if scenario.input == Input::Voltage {
        let interval_s = median_step(&scenario.sample_time_s);
        let constant_s = model.motor.electrical_time_constant_s();
        // Up to half of the armature's time constant a current's rate is constant over an interval.
        if !constant_s.is_some_and(|constant_s| interval_s < 0.5 * constant_s) {
            return false;
        }
    }
    let terms: Vec<Box<dyn Terms>> = model.effects.iter().map(terms_of).collect();
    let paths = terms.iter().map(|terms| terms.path());
    let path = paths.fold(Path::default(), Path::plus);
    let lags_s = path.speed_delay_s + path.speed_filter_s + path.current_filter_s;
    lags_s <= 0.0 && terms.iter().all(|terms| terms.coupling().is_none())
}

/// The slope over a parameter of an effect with these values, for each `unit` of a coefficient; of a shape from a step of
/// `step`, which is `over` of its units. `None` for a shape of an effect with states.
pub(super) fn of_effect(
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
            return Some(Tangent::LateCommands(late_s));
        }
        return alone_at(effect, &alone, index);
    }
    let mut moved = values.to_vec();
    moved[index] += step;
    let (from, to) = (effect.terms(values), effect.terms(&moved));
    let is_wave = effect.card().harmonic.is_some();
    let acts_on_path = from.path() != Path::default();
    (from.states() == 0 && !is_wave && !acts_on_path).then_some(Tangent::Change { from, to, over })
}

/// The tangent of one coefficient of an effect, all others at zero; `None` where that is no small forcing.
pub(super) fn alone_at(
    effect: &'static dyn Effect,
    values: &[f64],
    index: usize,
) -> Option<Tangent> {
    if let Some(harmonic) = effect.card().harmonic {
        let order = effect.parameters().iter().position(|spec| spec.key == "order")?;
        return Some(Tangent::Wave(Wave {
            order: values[order],
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
    use crate::kit::{nameplate, truth};
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
        carry(run, &[tangent], |first, white| {
            assert_eq!(column.len(), 2 * first);
            column.extend(white.iter().map(|row| row[0]));
        });
        let difference = run.difference(with, run.scenario, 1.0).into_iter();
        let pairs = column.into_iter().zip(difference.map(f64::from));
        let pairs = pairs.skip(rows.start).take(rows.len());
        let squares =
            pairs.fold([0.0, 0.0], |[apart, own], (a, b)| [apart + (a - b).powi(2), own + b * b]);
        (squares[0] / squares[1]).sqrt()
    }

    #[test]
    fn a_tangent_is_the_difference_of_two_filtered_runs() {
        let (model, scenario, by_s) = (nameplate(), run(1e-3), 2e-5);
        let mut cases = vec![(Tangent::LateCommands(by_s), truth("command_delay", &[by_s]))];
        for (id, late_s) in [("current_filter", [by_s, 0.0]), ("speed_delay", [0.0, by_s])] {
            cases.push((Tangent::LateReadings(late_s), truth(id, &[by_s])));
        }
        let effects: [(&str, &[f64]); 8] = [
            ("viscous_friction", &[1e-4]),
            ("quadratic_load", &[5e-7]),
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
        let keys = MotorKey::ALL.into_iter();
        let keys = keys.filter(|key| *key != MotorKey::TorqueConstant);
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
        for (step, update) in linearised.steps.iter().zip(&linearised.follower.updates) {
            free.pass(step, &forcing);
            filtered.pass(step, &forcing);
            back.drift(step);
            let white = filtered.correct(update, &[[0.0; LANES]; 2]);
            let readings = back.colour(update, &white);
            for (reading, free) in readings.iter().flatten().zip(free.0[..2].iter().flatten()) {
                let apart = (reading - free).abs();
                assert!(apart < 1e-6 * free.abs().max(1.0), "{reading} {free}");
            }
        }
        assert!(free.0[1][0].abs() > 1.0, "the forcing does something");
    }
}
