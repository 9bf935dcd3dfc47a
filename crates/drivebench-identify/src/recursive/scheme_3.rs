//! Scheme 3: R, L, Ke, J and Mc from voltage, current and speed; no parameter is assumed to be known.
//!
//! Electrical equation: over a block of about one L/R (at most 10 ms) the current is predicted with the exact solution of
//! `winding`, and the innovation drives the recursive prediction-error step of `track` on (R, L, Ke). It starts from a
//! linear regression on integrals, `int u = R int i + L di + Ke int w`, which coarse sampling biases by some per cent to
//! some ten. After a trial the better of its track and of the first guess's is linearised again at the values found, and
//! all rows before are dropped: they were linearised about an inaccurate start.
//! Mechanical equation: `mechanical`, with the integral of the current corrected for its curvature between samples.

use super::mechanical::{self, MechanicalBalance, MechanicalRow};
use super::track::{Block, SampleNoise, Track};
use super::winding::{self, Interval, Winding};
use super::{Direction, IGNORANT, LONGEST_GAP_S, steady_period};
use crate::verdict;
use drivebench_model::numerics::recursive_least_squares::RecursiveLeastSquares;
use drivebench_model::plant::{Motor, MotorKey, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason, Verdict};
use drivebench_model::signal::holding_since;

/// Voltage that counts as zero, V: the rest of a bumpless start.
const NEARLY_ZERO_V: f64 = 0.05;
/// Rows, and relative standard deviation, at which the prediction-error method replaces the linear start.
const START_ROWS: u64 = 20;
const START_UNCERTAINTY: f64 = 0.2;
/// Noise where none was measured: share of the largest value.
const NOISE_SHARE: f64 = 1e-3;
/// Smallest number of rows of a trial. Its forgetting factor of the torque balance is smaller than later.
const TRIAL_ROWS: u32 = 40;
const TRIAL_FORGETTING: f64 = 0.95;
const KEYS: [MotorKey; 3] = [MotorKey::Resistance, MotorKey::Inductance, MotorKey::BackEmf];

/// Forgetting factors per row; a row is one block.
#[derive(Clone, Copy, Debug)]
pub struct Memory {
    pub electrical: f64,
    pub mechanical: f64,
}

impl Default for Memory {
    /// 200 rows: about 2 s.
    fn default() -> Self {
        Self { electrical: 0.995, mechanical: 0.995 }
    }
}

/// First guess of the winding: tried beside the one from the data; the smaller prediction error decides.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StartValues {
    pub resistance_ohm: f64,
    pub inductance_h: f64,
    pub back_emf_v_s_per_rad: f64,
}

impl StartValues {
    /// `None` where the motor leaves one of them out or has one that is not positive.
    pub fn from_motor(motor: &Motor) -> Option<Self> {
        let [r, l, ke] = KEYS.map(|key| motor.get(key).filter(|value| *value > 0.0));
        Some(Self { resistance_ohm: r?, inductance_h: l?, back_emf_v_s_per_rad: ke? })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Trial {
    /// The linear start is still in use.
    Waiting,
    /// Rows so far.
    On(u32),
    Over,
}

#[derive(Clone, Copy, Debug)]
struct Reading {
    time_s: f64,
    current_a: f64,
    speed_rad_s: f64,
    direction: i8,
    /// The drive was saturated: the voltage differed from the command.
    limited: bool,
}

/// The estimator: [`Self::voltage_applied`] and [`Self::push`] in the order of time.
#[derive(Clone, Debug)]
pub struct Scheme3 {
    memory: Memory,
    torque_n_m_per_a: Option<f64>,
    guess: Option<Winding>,
    /// The linear start, until the prediction-error method replaces it.
    starting: Option<RecursiveLeastSquares<3>>,
    /// Prediction-error steps, from the guess and from the linear start; one after the trial.
    tracks: Vec<Track>,
    trial: Trial,
    /// Last Kt/J, rad/(A.s^2).
    acceleration: Option<f64>,
    balance: MechanicalBalance,
    direction: Direction,
    readings: Vec<Reading>,
    /// `(time, volts)`, in order; pruned at each block.
    voltage: Vec<(f64, f64)>,
    energised: bool,
    current_at_rest: Spread,
    speed_at_rest: Spread,
    largest_current_a: f64,
    /// End of the last electrical row: the next one shares its sample.
    last_end_s: f64,
    current_innovation_a: Option<f64>,
    period_s: f64,
    /// Whether the drive is saturated at the next samples.
    limited: bool,
    /// Half-width of the stamps of the next samples, s.
    half_width_s: f64,
}

impl Scheme3 {
    pub fn new(memory: Memory, torque_n_m_per_a: Option<f64>, start: Option<StartValues>) -> Self {
        let sizes = [1.0, 1e-2, 0.1];
        let starting = RecursiveLeastSquares::new([0.0; 3], sizes, 1e8, memory.electrical);
        Self {
            memory,
            torque_n_m_per_a,
            guess: start.map(|s| [s.resistance_ohm, s.inductance_h, s.back_emf_v_s_per_rad]),
            // Sizes of R, L, Ke, and a prior wide enough for any machine.
            starting: Some(starting),
            tracks: Vec::with_capacity(2),
            trial: Trial::Waiting,
            acceleration: None,
            balance: MechanicalBalance::new(memory.mechanical),
            direction: Direction::default(),
            readings: Vec::with_capacity(32),
            voltage: Vec::with_capacity(32),
            energised: false,
            current_at_rest: Spread::default(),
            speed_at_rest: Spread::default(),
            largest_current_a: 0.0,
            last_end_s: f64::NAN,
            current_innovation_a: None,
            period_s: f64::NAN,
            limited: false,
            half_width_s: 0.0,
        }
    }

    /// Half-width of the stamp of the next sample, s; zero where the drive stamped it.
    pub fn set_half_width(&mut self, half_width_s: f64) {
        self.half_width_s = half_width_s;
    }

    /// Time between two samples, s; not a number before the second.
    pub const fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Whether the drive is saturated at the next samples. Between such samples, and in the intervals before and after, the
    /// voltage differs from the command, and no row is used.
    pub fn set_limited(&mut self, limited: bool) {
        self.limited = limited;
    }

    /// The voltage that holds from `time_s` on, before the first sample after that instant.
    pub fn voltage_applied(&mut self, time_s: f64, voltage_v: f64) {
        if !(time_s.is_finite() && voltage_v.is_finite()) {
            return;
        }
        self.energised |= voltage_v.abs() > NEARLY_ZERO_V;
        if self.voltage.len() >= 4096 {
            // Commands without a usable sample: they are pruned with the blocks, and there are none.
            self.voltage.drain(..2048);
        }
        let position = self.voltage.partition_point(|event| event.0 < time_s);
        match self.voltage.get_mut(position) {
            Some(event) if event.0.total_cmp(&time_s).is_eq() => event.1 = voltage_v,
            _ => self.voltage.insert(position, (time_s, voltage_v)),
        }
    }

    /// The voltage up to the next command is not known: the next block begins at the sample after it.
    pub fn interrupt(&mut self) {
        self.readings.clear();
    }

    /// Takes one sample; one that is not finite or not later than the last is left out.
    pub fn push(&mut self, time_s: f64, current_a: f64, speed_rad_s: f64) {
        if !(time_s.is_finite() && current_a.is_finite() && speed_rad_s.is_finite()) {
            return;
        }
        if let Some(last) = self.readings.last() {
            let step_s = time_s - last.time_s;
            if step_s <= 0.0 {
                return;
            }
            self.period_s = steady_period(self.period_s, step_s);
            if step_s > LONGEST_GAP_S {
                self.readings.clear();
            }
        }
        if !self.energised {
            self.current_at_rest.add(current_a);
            self.speed_at_rest.add(speed_rad_s);
            self.direction.noise_rad_s = self.speed_at_rest.deviation().unwrap_or(0.0);
        }
        self.largest_current_a = self.largest_current_a.max(current_a.abs());
        let reading = Reading {
            time_s,
            current_a,
            speed_rad_s,
            direction: self.direction.of(speed_rad_s),
            limited: self.limited,
        };
        self.readings.push(reading);
        let begin_s = self.readings[0].time_s;
        if self.voltage.first().is_none_or(|first| first.0 > begin_s) {
            // The voltage at the beginning of the block is not known.
            self.readings.clear();
            self.readings.push(reading);
            return;
        }
        if self.readings.len() > 1 && time_s - begin_s >= self.block_s() * (1.0 - 1e-6) {
            self.take_block(begin_s, time_s);
            self.readings.clear();
            self.readings.push(reading);
            let kept = holding_since(&self.voltage, time_s).len();
            self.voltage.drain(..self.voltage.len() - kept);
        }
    }

    fn block_s(&self) -> f64 {
        self.winding().map_or(f64::INFINITY, |[r, l, _]| l / r).min(0.01)
    }

    /// R, L, Ke of the prediction-error step, before that the guess.
    fn winding(&self) -> Option<Winding> {
        self.best().map(Track::winding).or(self.guess)
    }

    /// Track from which the verdicts on R, L, Ke follow.
    fn electrical(&self) -> Option<&RecursiveLeastSquares<3>> {
        self.best().map(Track::estimator).or(self.starting.as_ref())
    }

    /// The track with the smaller prediction error.
    fn best(&self) -> Option<&Track> {
        self.tracks.iter().min_by(|a, b| a.misfit().total_cmp(&b.misfit()))
    }

    /// The samples two by two and what is between them, with this Kt/J, rad/(A.s^2).
    fn intervals(
        &self,
        acceleration: f64,
    ) -> impl Iterator<Item = (&Reading, &Reading, Interval<'_>)> {
        self.readings.windows(2).map(move |pair| {
            let (a, b) = (&pair[0], &pair[1]);
            let moving = a.direction != 0 || b.direction != 0;
            let interval = Interval {
                begin_s: a.time_s,
                length_s: b.time_s - a.time_s,
                speed: [a.speed_rad_s, b.speed_rad_s],
                acceleration_per_ampere: if moving { acceleration } else { 0.0 },
                voltage: holding_since(&self.voltage, a.time_s),
            };
            (a, b, interval)
        })
    }

    /// Kt/J where it is off by as much as it is not known: by what the rows since would have it be, and by the uncertainty
    /// of that. A load that does not follow leaves the rotor's own inertia, taken as half of all at least.
    fn doubtful_acceleration(&self) -> f64 {
        let Some(used) = self.acceleration else { return 0.0 };
        let doubt = (self.balance)
            .acceleration_with_std()
            .map_or(used, |(now, std)| (now - used).hypot(std));
        used + doubt.min(used)
    }

    /// Current at the end of the block, predicted from its begin with this Kt/J.
    fn predict(
        &self,
        acceleration: f64,
        winding: &Winding,
        begin_a: f64,
        speed_errors: [f64; 2],
    ) -> f64 {
        let [mut first, last] = speed_errors;
        let end = self.readings.len().saturating_sub(2);
        let mut current = begin_a;
        for (index, (_, _, mut interval)) in self.intervals(acceleration).enumerate() {
            interval.speed[0] -= std::mem::take(&mut first);
            if index == end {
                interval.speed[1] -= last;
            }
            current = winding::propagate(winding, current, &interval).0;
        }
        current
    }

    fn take_block(&mut self, begin_s: f64, end_s: f64) {
        let continues = begin_s.total_cmp(&self.last_end_s).is_eq();
        self.current_innovation_a = None;
        let stuck = self.may_have_stuck();
        let limited = self.readings.iter().any(|reading| reading.limited);
        let taken = !self.is_at_rest() && !stuck && !limited;
        if taken {
            self.take_start_row(end_s - begin_s);
            self.take_prediction_error(end_s - begin_s, continues);
        } else {
            self.tracks.iter_mut().for_each(Track::interrupt);
        }
        self.last_end_s = end_s;
        let mut row = self.mechanical_row(begin_s, end_s);
        if stuck || limited {
            row.direction = 0;
        }
        self.balance.take(&row);
        if let Some((value, std)) = self.balance.acceleration_with_std()
            && value > 0.0
            && std < 0.05 * value
        {
            self.acceleration = Some(value);
        }
    }

    /// The shaft breaks away, comes to rest or turns inside an interval: when, and so the shape of the speed, is not
    /// known. Between two samples of one direction it may have come back from a stop.
    fn may_have_stuck(&self) -> bool {
        let acceleration = self.acceleration.unwrap_or(0.0);
        let zone = self.direction.dead_zone_rad_s();
        self.readings.windows(2).any(|pair| {
            let (a, b) = (&pair[0], &pair[1]);
            let step_s = b.time_s - a.time_s;
            // A change of the current that comes at once in the middle bends the speed by a quarter of this.
            let bend = 0.25 * acceleration * step_s * (b.current_a - a.current_a).abs();
            let least = a.speed_rad_s.abs().min(b.speed_rad_s.abs());
            a.direction != b.direction || (a.direction != 0 && least < zone + bend)
        })
    }

    /// No voltage, motion or current: such a block contains noise only and would reduce the covariance wrongly.
    fn is_at_rest(&self) -> bool {
        let begin_s = self.readings[0].time_s;
        let noise = self.current_at_rest.deviation().unwrap_or(0.0);
        let least = (5.0 * noise).max(0.01 * self.largest_current_a);
        holding_since(&self.voltage, begin_s).iter().all(|event| event.1.abs() <= NEARLY_ZERO_V)
            && self.readings.iter().all(|r| r.direction == 0 && r.current_a.abs() <= least)
    }

    fn track(&self, start: Winding, certain: bool) -> Track {
        Track::new(start, self.noise(), self.memory.electrical, certain)
    }

    /// Noise of one sample: from standstill, else from the prediction errors.
    fn noise(&self) -> SampleNoise {
        let by_rows = |variance: Option<f64>| variance.map(f64::sqrt);
        let least = |value: f64, largest: f64| {
            value.max(1e-2 * NOISE_SHARE * largest).max(f64::MIN_POSITIVE.sqrt())
        };
        SampleNoise {
            current_a: least(
                self.current_at_rest
                    .deviation()
                    .or_else(|| by_rows(self.best()?.estimator().noise_variance()))
                    .unwrap_or(NOISE_SHARE * self.largest_current_a),
                self.largest_current_a,
            ),
            speed_rad_s: least(
                self.speed_at_rest
                    .deviation()
                    .or_else(|| by_rows(self.balance.noise_variance()))
                    .unwrap_or(NOISE_SHARE * self.direction.largest_rad_s),
                self.direction.largest_rad_s,
            ),
            by_stamp: 1.0,
        }
    }

    fn take_start_row(&mut self, length_s: f64) {
        if self.starting.is_none() {
            return;
        }
        let (mut charge, mut angle, mut volt_s) = (0.0, 0.0, 0.0);
        for (a, b, interval) in self.intervals(0.0) {
            charge += 0.5 * (a.current_a + b.current_a) * interval.length_s;
            angle += 0.5 * (a.speed_rad_s + b.speed_rad_s) * interval.length_s;
            volt_s += winding::voltage_integral(&interval);
        }
        let (first, last) = (self.readings[0], self.readings[self.readings.len() - 1]);
        let regressor =
            [charge, last.current_a - first.current_a, angle].map(|integral| integral / length_s);
        let Some(estimator) = &mut self.starting else { return };
        estimator.update(&regressor, volt_s / length_s);
        let found = estimator.parameters();
        let rows = estimator.rows();
        let certain = |j: usize| {
            estimator
                .standard_deviations()
                .is_some_and(|stds| found[j] > 0.0 && stds[j] < START_UNCERTAINTY * found[j])
        };
        if rows < START_ROWS || !certain(0) || !certain(2) {
            return;
        }
        let [r, _, ke] = found;
        let rivals: Vec<Winding> = if certain(1) {
            vec![found]
        } else if rows >= 60 {
            // Where L/R is short against the period, a regression on integrals does not show the inductance.
            [0.6, 0.25, 0.1, 0.04].map(|share| [r, share * self.period_s * r, ke]).to_vec()
        } else {
            return;
        };
        self.starting = None;
        self.trial = Trial::On(0);
        self.balance = MechanicalBalance::new(TRIAL_FORGETTING);
        let starts = rivals.into_iter().chain(self.guess);
        self.tracks = starts.map(|start| self.track(start, false)).collect();
    }

    /// Noise of a sample of this block: that of its sensor and what the signal does within the stamp's interval.
    fn stamped_noise(&self, length_s: f64) -> SampleNoise {
        let noise = self.noise();
        let share = self.half_width_s / (3f64.sqrt() * length_s);
        let (first, last) = (self.readings[0], self.readings[self.readings.len() - 1]);
        let current_a = noise.current_a.hypot(share * (last.current_a - first.current_a));
        let speed_step_rad_s = last.speed_rad_s - first.speed_rad_s;
        SampleNoise {
            current_a,
            speed_rad_s: noise.speed_rad_s.hypot(share * speed_step_rad_s),
            by_stamp: current_a / noise.current_a,
        }
    }

    fn take_prediction_error(&mut self, length_s: f64, continues: bool) {
        let noise = self.stamped_noise(length_s);
        let mut tracks = std::mem::take(&mut self.tracks);
        let known = self.acceleration.unwrap_or(0.0);
        let block = Block {
            predict: |acceleration, winding: &Winding, begin_a, speed_errors| {
                self.predict(acceleration, winding, begin_a, speed_errors)
            },
            acceleration: [known, self.doubtful_acceleration()],
            first_current_a: self.readings[0].current_a,
            last_current_a: self.readings[self.readings.len() - 1].current_a,
            length_s,
            intervals: (self.readings.len() - 1) as f64,
            continues,
        };
        let mut innovation = None;
        for track in tracks.iter_mut().rev() {
            innovation = track.take(&block, noise);
        }
        self.tracks = tracks;
        self.current_innovation_a = innovation;
        if let Trial::On(rows) = self.trial {
            self.trial = Trial::On(rows + 1);
            if rows + 1 >= TRIAL_ROWS {
                self.end_trial(rows + 1);
            }
        }
    }

    /// Restarts from the values of the trial until a trial changes them little.
    fn end_trial(&mut self, rows: u32) {
        let Some(best) = self.best() else { return };
        let values = best.estimator().parameters();
        // The inductance is not needed where the transient of the winding ends between two samples.
        let needed = |j: &usize| *j != 1 || !self.is_gone(&values);
        let near = self.acceleration.is_some()
            && (best.estimator().standard_deviations())
                .is_some_and(|stds| (0..3).filter(needed).all(|j| stds[j] < 0.1 * values[j]));
        if !near && rows < 80 {
            return;
        }
        let last = near && (0..3).filter(needed).all(|j| best.moved(j) < 0.05);
        let from = best.winding();
        let start = std::array::from_fn(|j| values[j].clamp(from[j] / 2.0, from[j] * 2.0));
        self.tracks = vec![self.track(start, last)];
        let (memory, trial) = if last {
            (self.memory.mechanical, Trial::Over)
        } else {
            (TRIAL_FORGETTING, Trial::On(0))
        };
        (self.balance, self.trial) = (MechanicalBalance::new(memory), trial);
    }

    /// Whether the transient of the winding ends between two samples.
    fn is_gone(&self, [r, l, _]: &Winding) -> bool {
        self.period_s * r > 3.0 * l
    }

    fn mechanical_row(&self, begin_s: f64, end_s: f64) -> MechanicalRow {
        let winding = self.winding();
        // The chord through the measured ends, and what the winding bends away from a chord.
        let charge = |winding: Option<Winding>| -> f64 {
            self.intervals(self.acceleration.unwrap_or(0.0))
                .map(|(a, b, interval)| {
                    let h = interval.length_s;
                    let chord = 0.5 * h * (a.current_a + b.current_a);
                    chord
                        + winding.map_or(0.0, |winding| {
                            let (end, charge) =
                                winding::propagate(&winding, a.current_a, &interval);
                            charge - 0.5 * h * (a.current_a + end)
                        })
                })
                .sum()
        };
        let (first, last) = (self.readings[0], self.readings[self.readings.len() - 1]);
        let same = self.readings.iter().all(|r| r.direction == first.direction);
        let noise = self.noise();
        MechanicalRow {
            begin_s,
            end_s,
            speed_step_rad_s: last.speed_rad_s - first.speed_rad_s,
            current_integral_a_s: charge(winding),
            doubtful_integral_a_s: charge(winding.map(|w| self.with_doubtful_inductance(w))),
            direction: if same { first.direction } else { 0 },
            speed_rad_s: 0.5 * (first.speed_rad_s + last.speed_rad_s),
            carry: mechanical::carry(
                self.acceleration.unwrap_or(0.0) * noise.current_a * (end_s - begin_s)
                    / noise.speed_rad_s,
                (self.readings.len() - 1) as f64,
            ),
        }
    }

    /// The inductance plus one standard deviation: it determines the current between samples.
    fn with_doubtful_inductance(&self, [r, l, ke]: Winding) -> Winding {
        let std = self.best().and_then(|track| track.estimator().standard_deviations());
        let std = std.map_or(l, |stds| stds[1]);
        [r, l * (1.0 + (std / l).min(1.0)), ke]
    }

    /// How far the data carry R, L, Ke, Kt/J, Mc/J: 0 nothing learnt, 1 learnt.
    pub fn excitation(&self) -> [f64; 5] {
        let [r, l, ke] = self
            .electrical()
            .map_or([1.0; 3], |estimator| [0, 1, 2].map(|j| estimator.variance_ratio(j)));
        let [a, b] = self.balance.variance_ratio();
        [r, l, ke, a, b].map(|variance_ratio| (1.0 - variance_ratio).clamp(0.0, 1.0))
    }

    /// Standard deviation of the speed at standstill, rad/s, where there was one.
    pub fn speed_noise_rad_s(&self) -> Option<f64> {
        self.speed_at_rest.deviation()
    }

    /// Torque constant and its standard deviation: the given one, else the back-EMF constant.
    pub fn torque_constant(&self) -> Option<(f64, f64)> {
        if let Some(given) = self.torque_n_m_per_a {
            return Some((given, 0.0));
        }
        let estimator = self.electrical()?;
        let (value, std) = (estimator.parameters()[2], estimator.standard_deviations()?[2]);
        (estimator.variance_ratio(2) < IGNORANT && value > 0.0).then_some((value, std))
    }

    /// R, L, Ke, J, Mc with verdicts.
    pub fn estimates(&self) -> Vec<ParameterEstimate> {
        let mut out = self.electrical_estimates();
        if let Some(reason) = self.on_trial() {
            let keys = [MotorKey::Inertia, MotorKey::LoadTorque];
            let unknown = |key| verdict::unknown(key, Reason::TooFewRows, reason.clone());
            out.extend(keys.map(unknown));
            return out;
        }
        let (torque, moved) = (self.torque_constant(), &self.direction);
        out.extend((self.balance).estimates(torque, moved, self.period_s, [0.0; 2]));
        // Prediction error of the current over its noise.
        let misfit = (self.current_at_rest.deviation().and(self.best()))
            .map(|track| track.misfit().sqrt())
            .filter(|times| *times > 3.0);
        // R and Ke share one voltage and determine the current between two samples: without R nothing is settled.
        let resistance = ParameterEstimate::find(&out, MotorKey::Resistance.key());
        let open = resistance.is_none_or(|resistance| resistance.verdict != Verdict::Settled);
        let (code, doubt) = if self.limited {
            (Reason::VoltageLimited, "stands still: a limit of the drive holds its output, so that the motor has another voltage than was commanded".to_owned())
        } else if let Some(times) = misfit {
            (
                Reason::ModelMisses,
                format!(
                    "the measured current misses the prediction by {times:.1} times its noise: \
                     an effect is missing, a signal is wrong, or the estimate went astray"
                ),
            )
        } else if open {
            (Reason::DependsOnAnother, "rests on the resistance, which the run does not settle: it takes a current that changes at every speed".to_owned())
        } else {
            return out;
        };
        for parameter in &mut out {
            parameter.unsettle(code, doubt.as_str());
        }
        out
    }

    /// Why the integral of the current between samples is not known yet, once the shaft has moved.
    fn on_trial(&self) -> Option<String> {
        let moved = self.direction.largest_rad_s > self.direction.dead_zone_rad_s();
        let rows = match self.trial {
            Trial::Waiting => self.starting.as_ref()?.rows().to_string(),
            Trial::On(rows) => format!("{rows} of the {TRIAL_ROWS} or more of a trial"),
            Trial::Over => return None,
        };
        moved.then(|| {
            format!(
                "the current between two samples ({:.1} ms) is not known before R, L and Ke are: {rows} rows so far",
                1e3 * self.period_s
            )
        })
    }

    fn electrical_estimates(&self) -> Vec<ParameterEstimate> {
        let Some(estimator) = self.electrical() else { return Vec::new() };
        let starting = self.tracks.is_empty();
        let values = estimator.parameters();
        let stds = match self.best() {
            _ if estimator.rows() < START_ROWS => None,
            Some(track) => track.standard_deviations(),
            None => estimator.standard_deviations(),
        };
        let certain = |j: usize| {
            estimator.variance_ratio(j) < IGNORANT
                && stds.is_some_and(|stds| stds[j] < START_UNCERTAINTY * values[j])
        };
        // In steady state the noise of the current passes for its excitation and R and Ke share one voltage: the linear
        // start gives neither without the other.
        let moved = self.direction.largest_rad_s > self.direction.dead_zone_rad_s();
        let confounded = starting && moved && !(certain(0) && certain(2));
        (0..3)
            .map(|j| {
                let key = KEYS[j];
                let excited = estimator.variance_ratio(j) < IGNORANT && values[j] > 0.0 && !confounded;
                let Some(stds) = stds.filter(|_| excited) else {
                    let reason = self.why_not(key, estimator.rows());
                    return verdict::unknown(key, Reason::NotExcited, reason);
                };
                let time_constant_s = values[1] / values[0];
                // With few rows L/R itself is too uncertain for this statement.
                let known = !starting && stds[0] < 0.01 * values[0];
                if key == MotorKey::Inductance && known && self.is_gone(&values) {
                    // The rest of the transient after one period is below the noise.
                    let reason = format!(
                        "L/R = {:.1} ms or less against a period of {:.1} ms; sample faster, or use burst capture",
                        1e3 * time_constant_s,
                        1e3 * self.period_s
                    );
                    return verdict::unknown(key, Reason::SampledTooSlowly, reason);
                }
                let slot = Slot::Motor(key);
                let mut judged = verdict::judge(&slot, values[j], Some(stds[j]), self.period_s);
                if starting {
                    let reason = "from the linear start: biased by coarse sampling";
                    judged.unsettle(Reason::MethodBiased, reason);
                } else if let Trial::On(rows) = self.trial {
                    judged.unsettle(Reason::TooFewRows, format!(
                        "{rows} rows since the linear start, linearised again after {TRIAL_ROWS}"
                    ));
                }
                judged
            })
            .collect()
    }

    fn why_not(&self, key: MotorKey, rows: u64) -> String {
        let current = self.largest_current_a;
        let speed = self.direction.largest_rad_s;
        let zone = self.direction.dead_zone_rad_s();
        if self.voltage.is_empty() {
            return "no voltage command yet".into();
        }
        if rows < START_ROWS {
            return format!("{rows} rows so far, at least {START_ROWS} are needed");
        }
        if key == MotorKey::BackEmf && speed <= zone {
            return format!(
                "not moved yet: largest speed {speed:.2} rad/s, dead zone {zone:.2} rad/s"
            );
        }
        if key == MotorKey::Inductance {
            let period_ms = 1e3 * self.period_s;
            return self.winding().map_or_else(
                || format!("the current does not change enough at a period of {period_ms:.1} ms (largest {current:.2} A)"),
                |[r, l, _]| format!(
                    "the current does not change enough: period {period_ms:.1} ms, L/R about {:.1} ms",
                    1e3 * l / r
                ),
            );
        }
        format!("not excited: largest current {current:.2} A, largest speed {speed:.2} rad/s")
    }

    /// Innovations of the last block: current, A, and speed, rad/s; `None` at standstill, at a reversal and at the start.
    pub fn innovation(&self) -> Option<(f64, f64)> {
        Some((self.current_innovation_a?, self.balance.innovation_rad_s()?))
    }
}

/// Mean and variance (Welford).
#[derive(Clone, Copy, Debug, Default)]
struct Spread {
    count: u32,
    mean: f64,
    squares: f64,
}

impl Spread {
    fn add(&mut self, value: f64) {
        self.count = self.count.saturating_add(1);
        let before = value - self.mean;
        self.mean += before / f64::from(self.count);
        self.squares += before * (value - self.mean);
    }

    /// From ten values on.
    fn deviation(&self) -> Option<f64> {
        (self.count >= 10).then(|| (self.squares / f64::from(self.count - 1)).sqrt())
    }
}
