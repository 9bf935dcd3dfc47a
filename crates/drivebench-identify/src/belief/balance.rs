//! The balances of voltage and torque over some rows, their terms as ranges.

use super::{Range, Settings};

/// A motor as the balances need it; the torque constant is that of the back-EMF.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plate {
    pub resistance_ohm: f64,
    pub inductance_h: f64,
    pub back_emf_v_s_per_rad: f64,
    pub inertia_kg_m2: f64,
    pub friction_n_m: f64,
}

/// The units of the shares in the settings: rated values, or limits where nothing is rated.
#[derive(Clone, Copy, Debug, Default)]
pub struct Scale {
    pub volts: f64,
    pub amps: f64,
    pub rad_s: f64,
}

/// What one cycle adds to the balances: means of two samples, and their changes.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    pub seconds: f64,
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub current_change_a: f64,
    pub speed_change_rad_s: f64,
    /// By which the speed of the shaft leads its reading behind a filter, rad/s: the filter's time constant times its slope.
    pub speed_lead_rad_s: f64,
    /// Angle turned, rad, where it is measured.
    pub turned_rad: Option<f64>,
    /// Voltage that may have been in force, V; `None`: not known.
    pub volts: Option<Range>,
    pub exact: bool,
    pub limited: bool,
}

impl Row {
    /// A filter of the speed that is longer than the row hides when the shaft accelerates.
    pub fn hides_acceleration(&self) -> bool {
        self.speed_lead_rad_s.abs() > self.speed_change_rad_s.abs()
    }

    /// Current and speed of its second sample, A and rad/s.
    pub fn ends(&self) -> (f64, f64) {
        let speed_rad_s = self.speed_rad_s + 0.5 * self.speed_change_rad_s;
        (self.current_a + 0.5 * self.current_change_a, speed_rad_s)
    }
}

impl Plate {
    pub fn steady_v(&self, current_a: f64, speed_rad_s: f64) -> f64 {
        self.resistance_ohm * current_a + self.back_emf_v_s_per_rad * speed_rad_s
    }

    pub fn steady_rad_s(&self, volts: f64, current_a: f64) -> f64 {
        (volts - self.resistance_ohm * current_a) / self.back_emf_v_s_per_rad
    }

    pub fn torque_n_m(&self, current_a: f64) -> f64 {
        self.back_emf_v_s_per_rad * current_a.abs()
    }

    /// A current that turns a free shaft, whatever its friction is, beyond that of the nameplate, A.
    pub fn turning_a(&self) -> f64 {
        1.7 * self.friction_n_m / self.back_emf_v_s_per_rad
    }

    /// Voltage of the winding in a row, V.
    pub fn current_v(&self, row: &Row) -> f64 {
        self.resistance_ohm * row.current_a + self.inductance_h * row.current_change_a / row.seconds
    }

    /// Error of the trapezoidal rule between two samples, as a share of the change, for the shaft.
    pub(super) fn mechanical_error(&self, seconds: f64) -> f64 {
        let time_s = self.resistance_ohm * self.inertia_kg_m2 / (self.back_emf_v_s_per_rad.powi(2));
        (seconds / (3.0 * time_s)).min(0.5)
    }

    /// Uncertainty of both terms by the change within the cycle, V.
    pub(super) fn uncertainty_v(&self, row: &Row) -> (f64, f64) {
        let winding = (row.seconds * self.resistance_ohm / (6.0 * self.inductance_h)).min(0.5);
        let shaft = self.mechanical_error(row.seconds);
        let back_emf = shaft * self.back_emf_v_s_per_rad * row.speed_change_rad_s.abs();
        (winding * self.resistance_ohm * row.current_change_a.abs(), back_emf)
    }

    /// The terms over these rows, V; `None`: a voltage is not known, or there is no row.
    pub fn window<'r>(&self, rows: impl Iterator<Item = &'r Row>) -> Option<Window> {
        let terms = |row: &Row| {
            let volts = row.volts?;
            let (current_v, speed_v) =
                (self.current_v(row), self.back_emf_v_s_per_rad * row.speed_rad_s);
            let (current_by, speed_by) = self.uncertainty_v(row);
            let lead_v = self.back_emf_v_s_per_rad * row.speed_lead_rad_s;
            Some(Window {
                volts,
                current: Range::around(current_v, current_by),
                // A filter may be another than is stated: with and without it.
                speed: Range::around(speed_v, speed_by)
                    .union(Range::around(speed_v + lead_v, speed_by)),
                mean: [volts.middle(), current_v, speed_v + lead_v],
            })
        };
        let terms: Vec<Window> = rows.map(terms).collect::<Option<_>>()?;
        let n = terms.len() as f64;
        let mut window = terms.into_iter().reduce(Window::and)?;
        window.mean = window.mean.map(|sum| sum / n);
        Some(window)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    Current,
    Speed,
}

/// The terms of the voltage balance over a window, V.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    pub volts: Range,
    pub current: Range,
    pub speed: Range,
    /// Means of the rows: voltage, terms of current and speed.
    pub mean: [f64; 3],
}

impl Window {
    /// Residual of the balance where current and speed may be off by these factors, V; 0: they fit.
    pub fn gap(&self, current: Range, speed: Range, drop_v: f64) -> f64 {
        self.volts.gap(self.current.times(current).plus(self.speed.times(speed)).wider(drop_v))
    }

    /// It fits a motor with a warm winding and the flux of another specimen.
    pub fn fits(&self, drop_v: f64) -> bool {
        self.gap(Settings::WINDING_FACTOR, Settings::FLUX_FACTOR, drop_v) <= 0.0
    }

    /// No reading within its tolerance makes it fit.
    pub fn misfits(&self, drop_v: f64) -> bool {
        self.gap(Settings::ANY_FACTOR, Settings::ANY_FACTOR, drop_v) > 0.0
    }

    /// Mean term of a reading, and of the other one, V.
    pub const fn terms(&self, reading: Reading) -> (f64, f64) {
        match reading {
            Reading::Current => (self.mean[1], self.mean[2]),
            Reading::Speed => (self.mean[2], self.mean[1]),
        }
    }

    /// A reading of at least this size fits only with the opposite sign, V.
    pub fn is_mirrored(&self, reading: Reading, least_v: f64, slack_v: f64) -> bool {
        let (own, other) = self.terms(reading);
        let (rest, size) = (self.mean[0] - other, own.abs());
        let as_read = (rest - own).abs() - 0.5 * self.volts.width();
        size > least_v && as_read > size + slack_v && (rest + own).abs() < 0.5 * size + slack_v
    }

    /// What the term of a reading may be by voltage and the other one, V.
    pub fn plausible(&self, reading: Reading, drop_v: f64) -> Range {
        let other = match reading {
            Reading::Current => self.speed,
            Reading::Speed => self.current,
        };
        let by_other = self.volts.plus(other.times(Settings::ANY_FACTOR).negative());
        by_other.wider(drop_v).times(Settings::ANY_FACTOR)
    }

    #[must_use]
    pub fn with_speed_reversed(self) -> Self {
        Self { speed: self.speed.negative(), ..self }
    }

    /// The same of a current without a sign.
    #[must_use]
    pub fn with_magnitude(mut self) -> Self {
        let most = self.current.low.abs().max(self.current.high.abs());
        self.current = Range::new(-most, most);
        self.mean[1] = self.mean[1].abs().copysign(self.mean[0]);
        self
    }

    fn and(self, row: Self) -> Self {
        Self {
            volts: self.volts.union(row.volts),
            current: self.current.union(row.current),
            speed: self.speed.union(row.speed),
            mean: std::array::from_fn(|term| self.mean[term] + row.mean[term]),
        }
    }
}
