//! Terms that effects add to the equations of the baseline, and their construction from a single law.

use super::ShaftAngle;
use crate::plant::motor::{Motor, MotorKey};
use crate::plant::run_scales::RunScales;
use crate::plant::scenario::Scenario;
use crate::sample::Sensors;

/// The instant at which terms are evaluated, and the motor that they act on.
#[derive(Clone, Copy, Debug)]
pub struct Instant {
    /// Since the run's first command.
    pub time_s: f64,
    pub voltage_v: f64,
    /// Full voltage of the supply in this run, see [`Scenario::supply_v`](crate::plant::Scenario::supply_v).
    pub supply_v: f64,
    /// See [`RunScales::onset_s`] and [`RunScales::drop_a`].
    pub onset_s: f64,
    pub drop_a: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle: ShaftAngle,
    /// Of the cold winding.
    pub resistance_ohm: f64,
    pub back_emf_v_s_per_rad: f64,
    pub torque_n_m_per_a: f64,
}

/// At rest and zero, in a run with the scales of the reference.
impl Default for Instant {
    fn default() -> Self {
        Self {
            time_s: 0.0,
            voltage_v: 0.0,
            supply_v: 0.0,
            onset_s: RunScales::REFERENCE.onset_s(),
            drop_a: RunScales::REFERENCE.drop_a(),
            current_a: 0.0,
            speed_rad_s: 0.0,
            angle: ShaftAngle::default(),
            resistance_ohm: 0.0,
            back_emf_v_s_per_rad: 0.0,
            torque_n_m_per_a: 0.0,
        }
    }
}

impl Instant {
    /// An instant at rest with the constants of `motor`; what the motor leaves out is not a number.
    pub fn of(motor: &Motor) -> Self {
        let value = |key| motor.get(key).unwrap_or(f64::NAN);
        Self {
            resistance_ohm: value(MotorKey::Resistance),
            back_emf_v_s_per_rad: value(MotorKey::BackEmf),
            torque_n_m_per_a: motor.torque_constant().unwrap_or(f64::NAN),
            ..Self::default()
        }
    }

    /// The same with the supply and the scales of a run.
    #[must_use]
    pub fn in_run(self, scenario: &Scenario) -> Self {
        self.with(scenario.supply_v(), &scenario.scales)
    }

    pub(in crate::plant) const fn with(self, supply_v: f64, scales: &RunScales) -> Self {
        Self { supply_v, onset_s: scales.onset_s(), drop_a: scales.drop_a(), ..self }
    }
}

/// Additions of effects to the balances at one instant, with the signs of [`Terms`].
#[derive(Clone, Copy, Debug, Default)]
pub struct Sums {
    pub voltage_v: f64,
    pub torque_n_m: f64,
    pub friction_n_m: f64,
    pub current_rate_gain: f64,
    pub inertia_gain: f64,
}

impl Sums {
    pub(super) const fn all(&self) -> [f64; 5] {
        [
            self.voltage_v,
            self.torque_n_m,
            self.friction_n_m,
            self.current_rate_gain,
            self.inertia_gain,
        ]
    }
}

/// The additions of an effect to the equations of the baseline. `own` are the states of the effect.
pub trait Terms: Send + Sync {
    /// Voltage drop, V: subtracted in the voltage balance.
    fn voltage_v(&self, _at: &Instant, _own: &[f64]) -> f64 {
        0.0
    }

    /// Torque against positive motion whatever the direction, N.m: subtracted in the torque balance.
    fn torque_n_m(&self, _at: &Instant, _own: &[f64]) -> f64 {
        0.0
    }

    /// Addition to the Coulomb level, N.m: always against the motion, and it holds at rest.
    fn friction_n_m(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Relative addition to the rate of the current: `g` makes `di/dt` `1 + g` times what `L` alone gives.
    fn current_rate_gain(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Relative addition to the inertia: `g` makes `dw/dt` what all torques give over `(1 + g) J`.
    fn inertia_gain(&self, _at: &Instant) -> f64 {
        0.0
    }

    /// Adds the five above: one call through the table of methods where a simulation would need five.
    fn add_to(&self, sums: &mut Sums, at: &Instant, own: &[f64]) {
        sums.voltage_v += self.voltage_v(at, own);
        sums.torque_n_m += self.torque_n_m(at, own);
        sums.friction_n_m += self.friction_n_m(at);
        sums.current_rate_gain += self.current_rate_gain(at);
        sums.inertia_gain += self.inertia_gain(at);
    }

    /// The five above at once.
    fn sums(&self, at: &Instant, own: &[f64]) -> Sums {
        let mut sums = Sums::default();
        self.add_to(&mut sums, at, own);
        sums
    }

    /// Number of states, all starting at zero.
    fn states(&self) -> usize {
        0
    }

    fn derivative(&self, _at: &Instant, _own: &[f64], _out: &mut [f64]) {}

    /// Advances the effect's states by an interval of a record with the instant of its middle.
    fn advance(&self, at: &Instant, own: &mut [f64], interval_s: f64) {
        let mut rate = vec![0.0; own.len()];
        self.derivative(at, own, &mut rate);
        for (state, rate) in own.iter_mut().zip(rate) {
            *state += interval_s * rate;
        }
    }

    /// Its delays, filters and offsets in the path of command and measurement.
    fn path(&self) -> Path {
        Path::default()
    }

    /// The second inertia that it puts behind the shaft.
    fn coupling(&self) -> Option<Coupling> {
        None
    }
}

impl dyn Terms + '_ {
    /// The reason why it is more than a term of a balance; `None` where it is one.
    pub fn why_no_term(&self) -> Option<&'static str> {
        if self.path() != Path::default() {
            Some("it is in the path of command or measurement, not in a balance")
        } else if self.coupling().is_some() {
            Some("it is a second inertia with its own equation of motion")
        } else if self.states() > 0 {
            Some("it has a state, which is not measured")
        } else {
            None
        }
    }

    /// Whether it depends on the time since a run's first command, or has a state: in a run that is appended to another it would
    /// continue from that one.
    pub fn goes_on_over_runs(&self) -> bool {
        let at = |time_s: f64| {
            let instant = Instant { time_s, ..of_ones() };
            self.sums(&instant, &[]).all()
        };
        // False for NaN.
        let same = |(one, other): (f64, f64)| (one - other).abs() <= 1e-12 * other.abs();
        let stays = |time_s: f64| at(time_s).into_iter().zip(at(0.0)).all(same);
        // Times since a run's first command, s, by which any dependence on time shows.
        let mut changes = [0.37, 1.9, 7.3, 31.0, 611.0, 1e9].into_iter();
        self.states() > 0 || self.path().start_delay_s > 0.0 || changes.any(|time_s| !stays(time_s))
    }

    /// Whether it is a term of voltage, current, speed and angle alone: an on-line observer has neither the time since a run's first
    /// command nor the supply, and its inductance and inertia are constant.
    pub fn is_of_the_instant(&self) -> bool {
        if self.why_no_term().is_some() {
            return false;
        }
        let later = Instant { time_s: 1e9, supply_v: 2.0, ..of_ones() };
        let (sums, later) = (self.sums(&of_ones(), &[]), self.sums(&later, &[]));
        let same = |one: f64, other: f64| (one - other).abs() <= 1e-12 * one.abs();
        sums.current_rate_gain == 0.0
            && later.inertia_gain == 0.0
            && same(sums.voltage_v, later.voltage_v)
            && same(sums.torque_n_m, later.torque_n_m)
            && same(sums.friction_n_m, later.friction_n_m)
    }
}

/// An instant with all quantities and constants of the motor equal to one.
fn of_ones() -> Instant {
    Instant {
        voltage_v: 1.0,
        supply_v: 1.0,
        current_a: 1.0,
        speed_rad_s: 1.0,
        resistance_ohm: 1.0,
        back_emf_v_s_per_rad: 1.0,
        torque_n_m_per_a: 1.0,
        ..Instant::default()
    }
}

/// The path of the command to the motor and of the measurement back; all zero is the direct path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Path {
    /// The motor gets every voltage this much later than it was stamped.
    pub command_delay_s: f64,
    /// The drive applies zero for this long after the first command that is not zero.
    pub start_delay_s: f64,
    /// It applies zero for this long after every start from rest.
    pub restart_delay_s: f64,
    /// The measured speed is that of this much earlier.
    pub speed_delay_s: f64,
    /// Time constants of first-order filters in the measurement.
    pub speed_filter_s: f64,
    pub current_filter_s: f64,
    /// The measured current is the mean since the sample before.
    pub averages_current: bool,
    /// Offsets of the sensors.
    pub current_offset_a: f64,
    pub speed_offset_rad_s: f64,
}

impl Path {
    /// What is known of the sensors of a run.
    pub fn of(sensors: Sensors) -> Self {
        Self {
            speed_delay_s: sensors.speed.delay_s,
            speed_filter_s: sensors.speed.filter_s,
            averages_current: sensors.averages_current,
            ..Self::default()
        }
    }

    /// Both paths in series.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            command_delay_s: self.command_delay_s + other.command_delay_s,
            start_delay_s: self.start_delay_s + other.start_delay_s,
            restart_delay_s: self.restart_delay_s + other.restart_delay_s,
            speed_delay_s: self.speed_delay_s + other.speed_delay_s,
            speed_filter_s: self.speed_filter_s + other.speed_filter_s,
            current_filter_s: self.current_filter_s + other.current_filter_s,
            averages_current: self.averages_current || other.averages_current,
            current_offset_a: self.current_offset_a + other.current_offset_a,
            speed_offset_rad_s: self.speed_offset_rad_s + other.speed_offset_rad_s,
        }
    }

    pub fn delays_command(&self) -> bool {
        self.command_delay_s != 0.0 || self.start_delay_s > 0.0 || self.restart_delay_s > 0.0
    }

    /// Whether the sensors have no dynamics and no offsets.
    pub fn measures_directly(&self) -> bool {
        let (command_delay_s, start_delay_s, restart_delay_s) = (0.0, 0.0, 0.0);
        let sensors = Self { command_delay_s, start_delay_s, restart_delay_s, ..*self };
        sensors == Self::default()
    }
}

/// The load as a second inertia behind an elastic shaft, with or without play.
///
/// `J1 = (1 - r) J` carries the motor and its speed sensor, `J2 = r J` the load; `k = (2 pi f)^2 J r (1 - r)`,
/// `d = 2 zeta sqrt(k J r (1 - r))`. The shaft's torque is `T = k z + d (w - w2)`, where `z` is the twist beyond half the
/// play to either side and zero within. The damping acts within the play too, as that of oil or grease between the
/// flanks, so that the torque has no jump at contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    /// f: natural frequency of the two inertias against each other.
    pub frequency_hz: f64,
    /// r: share of the inertia that is behind the shaft.
    pub inertia_ratio: f64,
    /// zeta.
    pub damping_ratio: f64,
    /// Share of the Coulomb friction that acts behind the shaft.
    pub friction_split: f64,
    /// Play: the angle over which the shaft carries no torque.
    pub gap_rad: f64,
}

/// A law of the instant and the effect's values.
pub(super) trait OneLaw<const N: usize>:
    Fn(&Instant, [f64; N]) -> f64 + Send + Sync + 'static
{
}

impl<F, const N: usize> OneLaw<N> for F where
    F: Fn(&Instant, [f64; N]) -> f64 + Send + Sync + 'static
{
}

/// Terms that are one law in one method of [`Terms`], for values in the order of the effect's parameters.
macro_rules! one_law {
    ($($(#[$text:meta])* $name:ident, $method:ident($($own:ident)?);)+) => {$(
        $(#[$text])*
        pub(super) fn $name<const N: usize>(values: &[f64], law: impl OneLaw<N>) -> Box<dyn Terms> {
            struct Law<F, const N: usize>(F, [f64; N]);

            impl<F: OneLaw<N>, const N: usize> Terms for Law<F, N> {
                fn $method(&self, at: &Instant $(, $own: &[f64])?) -> f64 {
                    (self.0)(at, self.1)
                }
            }

            Box::new(Law(law, std::array::from_fn(|index| values[index])))
        }
    )+};
}

one_law! {
    /// Terms of a voltage drop, V.
    voltage, voltage_v(_own);
    /// Terms of a torque against positive motion, N.m.
    torque, torque_n_m(_own);
    /// Terms of an addition to the Coulomb level, N.m.
    friction, friction_n_m();
    /// Terms of a relative addition to the rate of the current.
    current_rate_gain, current_rate_gain();
    /// Terms of a relative addition to the inertia.
    inertia_gain, inertia_gain();
}

/// Terms of one cause in both balances: voltage drop (V) and torque (N.m).
pub(super) fn voltage_and_torque(
    size: f64,
    law: impl Fn(&Instant, f64) -> [f64; 2] + Send + Sync + 'static,
) -> Box<dyn Terms> {
    struct Both<F>(f64, F);

    impl<F: Fn(&Instant, f64) -> [f64; 2] + Send + Sync> Terms for Both<F> {
        fn voltage_v(&self, at: &Instant, _own: &[f64]) -> f64 {
            (self.1)(at, self.0)[0]
        }

        fn torque_n_m(&self, at: &Instant, _own: &[f64]) -> f64 {
            (self.1)(at, self.0)[1]
        }
    }

    Box::new(Both(size, law))
}

impl Terms for Path {
    fn path(&self) -> Path {
        *self
    }
}

/// Terms of one value in the path of command and measurement.
pub(super) fn path(value: f64, field: fn(&mut Path) -> &mut f64) -> Box<dyn Terms> {
    let mut path = Path::default();
    *field(&mut path) = value;
    Box::new(path)
}

impl Terms for Coupling {
    fn coupling(&self) -> Option<Coupling> {
        Some(*self)
    }
}

/// Logistic step from 0 to 1 at `time_s`, with the run's time constant of onsets, 10 ms in the run of the reference: the derivative
/// of a jump by its time would be zero, and a fit could not find it.
pub(super) fn begun(at: &Instant, time_s: f64) -> f64 {
    let since = (at.time_s - time_s) / at.onset_s;
    // exp(-37) = 1e-16 is below the rounding of one; the exponential would need most of the time of a free run.
    if since > 37.0 {
        1.0
    } else if since < -37.0 {
        0.0
    } else {
        1.0 / (1.0 + (-since).exp())
    }
}
