//! Speed loops in virtual time, for both papers: machines, every regulator on them, what a trace shows.
//!
//! ```text
//! Bench (model, machine, timing, limits) + Kind --> regulator --Trial--> trace --> steps, load changes, effort
//!                                                                             \--> every regulator on the same cases
//! ```

use drivebench::tabulated;
use serde::Serialize;

use drivebench::control::tuning::{Request, Tuning, tune};
use drivebench::control::{
    Actuator, Addc, AddcSettings, AntiWindup, CurrentLimit, Holding, Limiter, LinearPlant,
    LoadObserving, LoadObservingSettings, LoopTiming, Measured, Mrac, MracScales, PaperB,
    PaperBPlant, PaperBSettings, Pi, Response, SpeedController, Trial, TrialMachine, TrialPoint,
    response,
};
use drivebench::numerics::count::whole;
use drivebench::plant::{Model, MotorKey};

/// The models are written down in this program: what is made of them does not fail.
const FIXED: &str = "made from a model and settings that are written down here";

tabulated! {
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Kind {
        #[default]
        Pi = "pi (fixed)",
        Addc = "addc",
        /// Not in the table: ADDC as paper A has it, without a watch for jumps.
        AddcForgetting = "addc, forgetting alone",
        MracConnected = "mrac, always connected",
        MracDisconnected = "mrac, disconnected in saturation",
        PaperB = "paper-b",
        LoadObserver = "load-observer",
    }
    pub const fn name(self) -> &'static str;
}

impl Kind {
    /// Those of the table.
    pub const COMPARED: [Self; 6] = [
        Self::Pi,
        Self::Addc,
        Self::MracConnected,
        Self::MracDisconnected,
        Self::PaperB,
        Self::LoadObserver,
    ];
}

/// A motor behind a voltage command, what its loop takes in time, and the model of its regulators.
#[derive(Clone, Debug)]
pub(super) struct Bench {
    pub name: &'static str,
    /// The model of the regulators; the truth of a trial may have another inertia.
    pub model: Model,
    pub timing: LoopTiming,
    pub current_limit_a: f64,
    pub voltage_limit_v: f64,
    pub speed_noise_rad_s: f64,
    pub current_noise_a: f64,
    /// Full speed of the adaptive rival's scales, rad/s.
    pub scale_rad_s: f64,
    /// Of ADDC's estimate, per sample.
    pub forgetting: f64,
    pub paper_b: PaperBSettings,
    pub observer: LoadObservingSettings,
}

impl Bench {
    pub(super) fn value(&self, key: MotorKey) -> f64 {
        self.model.motor.get(key).expect(FIXED)
    }

    pub(super) fn inertia(&self) -> f64 {
        self.value(MotorKey::Inertia)
    }

    /// The same with regulators for an inertia `ratio` times as large.
    pub(super) fn with_inertia_ratio(&self, ratio: f64) -> Self {
        let mut bench = self.clone();
        let inertia = ratio * self.inertia();
        bench.model.motor.set(MotorKey::Inertia, inertia);
        bench
    }

    /// The motor of the model in its trial; the inertia comes with the inputs.
    pub(super) fn machine(&self) -> TrialMachine {
        TrialMachine {
            resistance_ohm: self.value(MotorKey::Resistance),
            inductance_h: self.value(MotorKey::Inductance),
            back_emf_v_s_per_rad: self.value(MotorKey::BackEmf),
            torque_n_m_per_a: self.model.motor.torque_constant().expect(FIXED),
            friction_n_m: self.model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0),
            viscous_n_m_s_per_rad: 0.0,
            coupling: None,
            drive_current_limit_a: 1.14 * self.current_limit_a,
            period_s: self.timing.period_s,
            delay_periods: whole(self.timing.delay_cycles().round()),
            speed_noise_rad_s: self.speed_noise_rad_s,
            current_noise_a: self.current_noise_a,
        }
    }

    /// A trial on this machine with the inertia of the model.
    pub(super) fn trial<'a>(&self, reference_rad_s: impl Fn(f64) -> f64 + 'a) -> Trial<'a> {
        Trial::new(self.machine(), self.limiter(), self.inertia(), reference_rad_s)
    }

    fn limiter(&self) -> Limiter {
        Limiter {
            output: self.voltage_limit_v,
            current: Some(CurrentLimit {
                current_a: self.current_limit_a,
                resistance_ohm: self.value(MotorKey::Resistance),
                back_emf_v_s_per_rad: self.value(MotorKey::BackEmf),
                ahead_s: self.timing.dead_time_s(),
            }),
        }
    }

    pub(super) fn plant(&self) -> LinearPlant {
        LinearPlant::voltage(&self.model, 0.0).expect(FIXED)
    }

    pub(super) fn holding(&self) -> Holding {
        Holding::of(&self.model, Actuator::Voltage, 0.0)
    }

    /// Gains by the modulus optimum for an inertia `ratio` times the model's.
    pub(super) fn tuning(&self, ratio: f64) -> Tuning {
        let plant = self.plant().with_inertia_ratio(ratio);
        tune(&plant, &self.timing, &Request::default()).expect(FIXED)
    }

    pub(super) fn pi(&self) -> Pi {
        let pi = Pi::new(self.tuning(1.0).gains, AntiWindup::Hold, self.holding());
        pi.leaving_after(self.timing.leaving_s())
    }

    pub(super) fn addc(&self) -> Addc {
        let settings = AddcSettings {
            forgetting: self.forgetting,
            ..AddcSettings::new(self.holding(), self.speed_noise_rad_s)
        };
        Addc::new(&self.model, &self.plant(), &self.timing, &settings).expect(FIXED)
    }

    pub(super) fn mrac(&self, disconnects: bool) -> Mrac {
        let scales = MracScales { speed_rad_s: self.scale_rad_s, current_a: self.current_limit_a };
        Mrac::new(&self.plant(), &self.timing, scales, disconnects).expect(FIXED)
    }

    pub(super) fn paper_b(&self, settings: PaperBSettings) -> PaperB {
        PaperB::new(self.paper_b_plant(), settings).expect(FIXED)
    }

    /// What paper B makes of this motor: its back-EMF left out.
    pub(super) fn paper_b_plant(&self) -> PaperBPlant {
        let motor = &self.model.motor;
        PaperBPlant::new(
            self.timing.period_s,
            motor.electrical_time_constant_s().expect(FIXED),
            motor.mechanical_time_constant_s().expect(FIXED),
            self.value(MotorKey::BackEmf),
        )
    }

    pub(super) fn controller(&self, kind: Kind) -> Box<dyn SpeedController> {
        match kind {
            Kind::Pi => Box::new(self.pi()),
            Kind::Addc => Box::new(self.addc()),
            Kind::AddcForgetting => Box::new(self.addc().without_change_detection()),
            Kind::MracConnected => Box::new(self.mrac(false)),
            Kind::MracDisconnected => Box::new(self.mrac(true)),
            Kind::PaperB => Box::new(WithBackEmf::new(
                self.paper_b(self.paper_b),
                self.value(MotorKey::BackEmf),
            )),
            Kind::LoadObserver => Box::new(
                LoadObserving::new(&self.model, &self.plant(), &self.timing, &self.observer)
                    .expect(FIXED),
            ),
        }
    }
}

pub(super) fn cycles(seconds: f64, period_s: f64) -> usize {
    whole((seconds / period_s).round())
}

/// A fixed PI regulator whose adaptation starts at a cycle: 0 for always, `usize::MAX` for never.
pub(super) struct Joining {
    fixed: Pi,
    adaptive: Addc,
    joins_at: usize,
    cycle: usize,
    output: f64,
    /// Inertia over the model's, where the estimate is settled, and the proportional gain, after each cycle.
    pub(super) ratios: Vec<f64>,
    pub(super) proportional: Vec<f64>,
}

impl Joining {
    pub(super) fn new(fixed: Pi, adaptive: Addc, joins_at: usize) -> Self {
        Self {
            fixed,
            adaptive,
            joins_at,
            cycle: 0,
            output: 0.0,
            ratios: Vec::new(),
            proportional: Vec::new(),
        }
    }

    const fn joined(&self) -> bool {
        self.cycle >= self.joins_at
    }
}

impl SpeedController for Joining {
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        if !self.joined() {
            return self.fixed.step(reference_rad_s, now, period_s);
        }
        if self.cycle == self.joins_at && self.cycle > 0 {
            self.adaptive.reset(now, self.output);
        }
        self.adaptive.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        let pi = if self.joined() {
            self.adaptive.applied(output);
            let ratio = self.adaptive.inertia_ratio();
            let settled = self.adaptive.is_settled();
            self.ratios.push(if settled { ratio } else { f64::NAN });
            self.adaptive.pi()
        } else {
            self.fixed.applied(output);
            self.ratios.push(f64::NAN);
            &self.fixed
        };
        self.proportional.push(pi.gains().proportional);
        self.output = output;
        self.cycle += 1;
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.fixed.reset(now, output);
        self.adaptive.reset(now, output);
        self.output = output;
    }
}

/// Paper B's regulator on a motor with a back-EMF: the voltage that holds the reference at no load is added to its own.
pub(super) struct WithBackEmf {
    inner: PaperB,
    back_emf_v_s_per_rad: f64,
    fed_forward_v: f64,
}

impl WithBackEmf {
    pub(super) const fn new(inner: PaperB, back_emf_v_s_per_rad: f64) -> Self {
        Self { inner, back_emf_v_s_per_rad, fed_forward_v: 0.0 }
    }
}

impl SpeedController for WithBackEmf {
    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.fed_forward_v = self.back_emf_v_s_per_rad * reference_rad_s;
        self.fed_forward_v + self.inner.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        self.inner.applied(output - self.fed_forward_v);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.fed_forward_v = self.back_emf_v_s_per_rad * now.speed_rad_s;
        self.inner.reset(now, output - self.fed_forward_v);
    }
}

/// No regulator: a held voltage.
pub(super) struct Held(pub f64);

impl SpeedController for Held {
    fn step(&mut self, _: f64, _: &Measured, _: f64) -> f64 {
        self.0
    }

    fn applied(&mut self, _: f64) {}

    fn reset(&mut self, _: &Measured, output: f64) {
        self.0 = output;
    }
}

/// A trace with its name; in JSON the name only.
#[derive(Clone, Debug, Serialize)]
pub struct Named {
    pub name: String,
    #[serde(skip)]
    pub trace: Vec<TrialPoint>,
}

impl Named {
    pub fn new(name: impl Into<String>, trace: Vec<TrialPoint>) -> Self {
        Self { name: name.into(), trace }
    }

    pub fn all<const N: usize>(names: [&str; N], traces: [Vec<TrialPoint>; N]) -> Vec<Self> {
        let pairs = names.into_iter().zip(traces);
        pairs.map(|(name, trace)| Self::new(name, trace)).collect()
    }
}

/// A square wave that begins `high`, each level for `half_s`.
pub(super) fn square(half_s: f64, high: f64, low: f64) -> impl Fn(f64) -> f64 {
    // A hundredth of a step of rounding must not decide on which side of an edge a cycle lies.
    move |t| {
        if ((t / half_s + 1e-9).floor() % 2.0).abs() < 0.5 { high } else { low }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct Step {
    pub at_s: f64,
    pub from_rad_s: f64,
    pub to_rad_s: f64,
    /// From the speed at the instant of the step: a loop that swings does not begin at the old reference.
    #[serde(flatten)]
    pub response: Response,
    /// Overshoot over the step of the reference, per cent.
    pub overshoot_of_reference_percent: f64,
    /// Cycles in which a limit held the output, per cent.
    pub limited_percent: f64,
    /// Root mean square of the output's change from cycle to cycle, V.
    pub effort_v: f64,
}

/// A load that comes on or goes off at a constant reference.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LoadChange {
    pub at_s: f64,
    /// Largest error while the load changes the speed, rad/s.
    pub dip_rad_s: f64,
    /// After which the error stays below 0.5 % of the reference, s; `None` if it never does.
    pub recovery_s: Option<f64>,
    /// Mean error over the last fifth of the time that is looked at, rad/s.
    pub lasting_rad_s: f64,
}

/// Every step of the reference, cut where it changes; the first begins at standstill.
pub(super) fn steps(trace: &[TrialPoint]) -> Vec<Step> {
    let chunks = trace.chunk_by(|a, b| a.reference_rad_s.to_bits() == b.reference_rad_s.to_bits());
    let mut before_rad_s = 0.0;
    let step = |chunk: &[TrialPoint]| {
        let first = chunk[0];
        let points: Vec<_> = chunk.iter().map(|p| (p.time_s, p.speed_rad_s)).collect();
        let to_rad_s = first.reference_rad_s;
        let from_rad_s = std::mem::replace(&mut before_rad_s, to_rad_s);
        let response = response(&points, first.speed_rad_s, to_rad_s);
        let covered = (to_rad_s - first.speed_rad_s) / (to_rad_s - from_rad_s);
        Step {
            at_s: first.time_s,
            from_rad_s,
            to_rad_s,
            response,
            overshoot_of_reference_percent: covered * response.overshoot_percent,
            limited_percent: limited_percent(chunk),
            effort_v: effort_v(chunk),
        }
    };
    chunks.map(step).collect()
}

/// What a change of the load at `at_s` did until `until_s`.
pub(super) fn load_change(trace: &[TrialPoint], at_s: f64, until_s: f64) -> LoadChange {
    let interval = within(trace, at_s, until_s);
    let outside = |p: &TrialPoint| error(p).abs() > 0.005 * p.reference_rad_s.abs();
    let recovered = match interval.iter().rposition(outside) {
        None => interval.first(),
        Some(last) => interval.get(last + 1),
    };
    LoadChange {
        at_s,
        dip_rad_s: interval.iter().map(|p| error(p).abs()).fold(0.0, f64::max),
        recovery_s: recovered.map(|point| point.time_s - at_s),
        lasting_rad_s: lasting_rad_s(&interval),
    }
}

/// The part of a trace from an instant until another.
pub(super) fn within(trace: &[TrialPoint], from_s: f64, until_s: f64) -> Vec<TrialPoint> {
    let inside = |point: &&TrialPoint| point.time_s >= from_s && point.time_s < until_s;
    trace.iter().filter(inside).copied().collect()
}

pub(super) fn error(point: &TrialPoint) -> f64 {
    point.reference_rad_s - point.speed_rad_s
}

/// Mean error of the last fifth, rad/s.
pub(super) fn lasting_rad_s(trace: &[TrialPoint]) -> f64 {
    let end = &trace[trace.len() - trace.len() / 5..];
    end.iter().map(error).sum::<f64>() / end.len().max(1) as f64
}

/// Cycles in which a limit held the output, per cent.
pub(super) fn limited_percent(trace: &[TrialPoint]) -> f64 {
    100.0 * trace.iter().filter(|point| point.limited).count() as f64 / trace.len() as f64
}

/// Root mean square of the output's change from cycle to cycle, V.
pub(super) fn effort_v(trace: &[TrialPoint]) -> f64 {
    rms(trace.windows(2).map(|pair| pair[1].output_v - pair[0].output_v))
}

pub(super) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for value in values {
        sum += value * value;
        count += 1.0;
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Mean of the speed, and its standard deviation about it.
pub(super) fn mean_and_std(trace: &[TrialPoint]) -> (f64, f64) {
    let speeds = || trace.iter().map(|point| point.speed_rad_s);
    let mean = speeds().sum::<f64>() / trace.len().max(1) as f64;
    (mean, rms(speeds().map(|speed| speed - mean)))
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Case {
    #[default]
    Nominal,
    Lighter,
    Heavier,
    Start,
    Load,
}

impl Case {
    pub const ALL: [Self; 5] =
        [Self::Nominal, Self::Lighter, Self::Heavier, Self::Start, Self::Load];

    /// Inertia over the model's before and after the jump.
    const fn ratio(self) -> f64 {
        match self {
            Self::Lighter => 0.25,
            Self::Heavier => 5.0,
            _ => 1.0,
        }
    }
}

/// One regulator in one case: the worst of the steps that count, or of the two changes of the load.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CaseRow {
    pub controller: Kind,
    pub case: Case,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overshoot_percent: Option<f64>,
    /// `None` (in JSON left out) where the case has no step, `Some(None)` (null) where a step never settled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settling_s: Option<Option<f64>>,
    /// Mean over the steps, rad; over both changes of the load there.
    pub absolute_error_rad: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dip_rad_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_s: Option<Option<f64>>,
    /// Root mean square of the output's change from cycle to cycle, V.
    pub effort_v: f64,
}

#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    pub bench: String,
    pub period_s: f64,
    pub delay_cycles: f64,
    pub levels_rad_s: [f64; 2],
    pub half_period_s: f64,
    pub start_rad_s: f64,
    pub load_n_m: f64,
    /// What `paper-b` was given on this bench.
    pub paper_b: PaperBSettings,
    pub rows: Vec<CaseRow>,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub levels_rad_s: [f64; 2],
    pub half_s: f64,
    pub start_rad_s: f64,
    pub load_n_m: f64,
}

pub(super) fn comparison(bench: &Bench, sizes: &Sizes) -> Comparison {
    let rows = Kind::COMPARED
        .into_iter()
        .flat_map(|kind| Case::ALL.map(|case| row(bench, sizes, kind, case)))
        .collect();
    Comparison {
        bench: bench.name.to_owned(),
        period_s: bench.timing.period_s,
        delay_cycles: bench.timing.delay_cycles(),
        levels_rad_s: sizes.levels_rad_s,
        half_period_s: sizes.half_s,
        start_rad_s: sizes.start_rad_s,
        load_n_m: sizes.load_n_m,
        paper_b: bench.paper_b,
        rows,
    }
}

/// Eight steps of the reference, or a load that comes and goes; the inertia jumps after two steps, and those from the second
/// one after the jump on count.
fn row(bench: &Bench, sizes: &Sizes, kind: Kind, case: Case) -> CaseRow {
    let half_s = sizes.half_s;
    let [low, high] = sizes.levels_rad_s;
    let reference: Box<dyn Fn(f64) -> f64> = match case {
        Case::Start => Box::new(square(half_s, sizes.start_rad_s, 0.0)),
        Case::Load => Box::new(move |_| 0.5 * (low + high)),
        _ => Box::new(square(half_s, high, low)),
    };
    let jump_s = 2.0 * half_s;
    let [on_s, off_s, end_s] = [2.0, 3.0, 4.0].map(|halves| halves * half_s);
    let loaded = move |t: f64| case == Case::Load && t >= on_s && t < off_s;
    let load = |t| if loaded(t) { sizes.load_n_m } else { 0.0 };
    let trace = (bench.trial(reference))
        .with_inertia(|t| bench.inertia() * if t >= jump_s { case.ratio() } else { 1.0 })
        .with_load(load)
        .run(&mut *bench.controller(kind), 8.0 * half_s);
    let found = if case == Case::Load {
        of_load(&trace, [on_s, off_s, end_s])
    } else {
        of_steps(&steps(&trace)[3..])
    };
    CaseRow { controller: kind, case, ..found }
}

/// The longest of these times; none where one of them never comes.
fn longest(times_s: impl IntoIterator<Item = Option<f64>>) -> Option<f64> {
    let mut times_s = times_s.into_iter();
    times_s.try_fold(0.0, |worst: f64, time_s| Some(worst.max(time_s?)))
}

fn of_steps(counted: &[Step]) -> CaseRow {
    let mean =
        |of: fn(&Step) -> f64| counted.iter().map(of).sum::<f64>() / counted.len().max(1) as f64;
    let overshoot = counted.iter().map(|step| step.response.overshoot_percent);
    let settling = counted.iter().map(|step| step.response.settling_s);
    CaseRow {
        overshoot_percent: Some(overshoot.fold(0.0, f64::max)),
        settling_s: Some(longest(settling)),
        absolute_error_rad: mean(|step| step.response.absolute_error_rad),
        effort_v: mean(|step| step.effort_v),
        ..CaseRow::default()
    }
}

fn of_load(trace: &[TrialPoint], [on_s, off_s, end_s]: [f64; 3]) -> CaseRow {
    let changes = [load_change(trace, on_s, off_s), load_change(trace, off_s, end_s)];
    let interval = within(trace, on_s, end_s);
    let period_s = trace[1].time_s - trace[0].time_s;
    let errors = interval.iter().map(|point| error(point).abs());
    CaseRow {
        absolute_error_rad: period_s * errors.sum::<f64>(),
        dip_rad_s: Some(changes[0].dip_rad_s.max(changes[1].dip_rad_s)),
        recovery_s: Some(longest(changes.map(|change| change.recovery_s))),
        effort_v: effort_v(&interval),
        ..CaseRow::default()
    }
}
