//! Effects that are not terms of a balance: what lies between command, motor and measurement, and a second inertia.

/// The way of the command to the motor and of the measurement back; all zero is the direct way.
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
    /// What a sensor adds to the truth.
    pub current_offset_a: f64,
    pub speed_offset_rad_s: f64,
}

impl Path {
    /// Both ways one after the other.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            command_delay_s: self.command_delay_s + other.command_delay_s,
            start_delay_s: self.start_delay_s + other.start_delay_s,
            restart_delay_s: self.restart_delay_s + other.restart_delay_s,
            speed_delay_s: self.speed_delay_s + other.speed_delay_s,
            speed_filter_s: self.speed_filter_s + other.speed_filter_s,
            current_filter_s: self.current_filter_s + other.current_filter_s,
            current_offset_a: self.current_offset_a + other.current_offset_a,
            speed_offset_rad_s: self.speed_offset_rad_s + other.speed_offset_rad_s,
        }
    }

    pub fn delays_command(&self) -> bool {
        self.command_delay_s > 0.0 || self.start_delay_s > 0.0 || self.restart_delay_s > 0.0
    }

    /// Whether what is measured is the truth.
    pub fn measures_directly(&self) -> bool {
        [
            self.speed_delay_s,
            self.speed_filter_s,
            self.current_filter_s,
            self.current_offset_a,
            self.speed_offset_rad_s,
        ]
        .iter()
        .all(|value| *value == 0.0)
    }
}

/// The load as a second inertia behind an elastic shaft, with or without play (DISCOVERY.md 2.1).
///
/// `J1 = (1 - r) J` carries the motor and its speed sensor, `J2 = r J` the load; `k = (2 pi f)^2 J r (1 - r)`,
/// `d = 2 zeta sqrt(k J r (1 - r))`. The shaft's torque is `T = k z + d (w - w2)`, where `z` is the twist beyond half the
/// play to either side and zero within. The damping acts within the play too, as that of oil or grease between the
/// flanks: so the torque has no jump at contact, and the play closes on a film instead of on nothing.
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
