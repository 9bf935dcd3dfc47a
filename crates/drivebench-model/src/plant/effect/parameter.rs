//! Parameter of an effect: its key, unit, bounds and typical size, and how a fit finds it.

use crate::plant::run_scales::{Measure, RunScales};

/// Orders of a harmonic of the shaft angle that are tried.
pub(super) const WAVE_ORDERS: &[f64] = &[
    2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0,
    19.0, 20.0, 21.0, 22.0, 23.0, 24.0,
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterRole {
    /// The effect is proportional to it, or nearly: zero is no effect.
    Coefficient,
    /// Changes the form of the effect: tried on a grid by the score test, then fitted within its bounds.
    Shape,
    /// Taken from the grid without a fit: an integer, such as the number of teeth, over which the cost has local minima.
    Choice,
    /// Time of an event, s after the run's first command, estimated in each run.
    EventTime,
}

/// Bounds, scale and grid are those in the run of [`RunScales::REFERENCE`]: see [`ParameterSpec::in_run`].
#[derive(Debug)]
pub struct ParameterSpec {
    pub key: &'static str,
    pub unit: &'static str,
    /// By what bounds, scale and grid change from run to run.
    pub of: Measure,
    pub min: f64,
    pub max: f64,
    /// Longest time of a parameter, as a share of the run's length.
    pub most_of_length: f64,
    /// A typical size: step of the score test and unit of the fit.
    pub scale: f64,
    pub role: ParameterRole,
    /// Fitted as a logarithm (positive parameters without a natural zero) instead of linearly.
    pub logarithmic: bool,
    /// Grid of the score test; empty for a coefficient.
    pub shapes: &'static [f64],
}

impl ParameterSpec {
    /// A coefficient of either sign: the effect is proportional to it.
    pub const fn coefficient(key: &'static str, unit: &'static str, scale: f64) -> Self {
        Self {
            key,
            unit,
            of: Measure::Absolute,
            min: -f64::MAX,
            max: f64::MAX,
            most_of_length: f64::INFINITY,
            scale,
            role: ParameterRole::Coefficient,
            logarithmic: false,
            shapes: &[],
        }
    }

    /// A coefficient that physics keeps at zero or above, such as a delay.
    pub const fn positive(key: &'static str, unit: &'static str, scale: f64) -> Self {
        Self { min: 0.0, ..Self::coefficient(key, unit, scale) }
    }

    pub(super) const fn up_to(self, max: f64) -> Self {
        Self { max, ..self }
    }

    pub(super) const fn of(self, of: Measure) -> Self {
        Self { of, ..self }
    }

    /// A positive shape parameter within bounds, fitted as a logarithm.
    pub const fn shape(
        key: &'static str,
        unit: &'static str,
        range: (f64, f64),
        shapes: &'static [f64],
    ) -> Self {
        Self {
            min: range.0,
            max: range.1,
            role: ParameterRole::Shape,
            logarithmic: true,
            shapes,
            ..Self::coefficient(key, unit, shapes[0])
        }
    }

    /// A shape parameter within bounds that may be zero, fitted in units of `scale`.
    pub(super) const fn linear_shape(
        key: &'static str,
        unit: &'static str,
        range: (f64, f64),
        scale: f64,
        shapes: &'static [f64],
    ) -> Self {
        Self { scale, logarithmic: false, ..Self::shape(key, unit, range, shapes) }
    }

    pub const fn choice(
        key: &'static str,
        unit: &'static str,
        range: (f64, f64),
        shapes: &'static [f64],
    ) -> Self {
        Self { role: ParameterRole::Choice, ..Self::shape(key, unit, range, shapes) }
    }

    /// Time at which the effect begins, s after the run's first command.
    pub(super) const EVENT_TIME: Self = Self {
        of: Measure::Length,
        role: ParameterRole::EventTime,
        shapes: &[0.8, 1.5, 2.2, 2.9, 3.6, 4.3, 5.0, 5.7, 6.4, 7.1, 7.8, 8.5, 9.2],
        ..Self::positive("time_s", "s", 0.1)
    };

    pub const fn is_coefficient(&self) -> bool {
        matches!(self.role, ParameterRole::Coefficient)
    }

    /// Default start of a fit in the run of the reference.
    pub const fn guess(&self) -> f64 {
        if self.is_coefficient() { self.scale } else { self.shapes[self.shapes.len() / 2] }
    }

    /// Bounds, scale and grid in a run with these scales.
    pub fn in_run(&self, scales: &RunScales) -> SearchRange {
        let factor = scales.factor(self.of);
        let min = self.min * factor;
        let most = (self.most_of_length * scales.length_s).max(min);
        let max = (self.max * factor).min(f64::MAX).min(most);
        SearchRange {
            min,
            max,
            scale: self.scale * factor,
            guess: (self.guess() * factor).min(max),
            grid: self.shapes,
            factor,
        }
    }

    /// Whether a model may have this value: a range of the search that follows from the run is no bound of it.
    pub fn admits(&self, value: f64) -> bool {
        let (min, max) = match self.of {
            Measure::Absolute => (self.min, self.max),
            _ if self.logarithmic => (f64::MIN_POSITIVE, f64::MAX),
            _ => (self.min, f64::MAX),
        };
        (min..=max).contains(&value)
    }

    /// The values that it may have, for a text.
    pub fn allowed(&self) -> String {
        match (self.of, self.is_coefficient()) {
            (Measure::Absolute, false) if self.unit == "-" => {
                format!("{} to {}", self.min, self.max)
            }
            (Measure::Absolute, false) => format!("{} to {} {}", self.min, self.max, self.unit),
            (Measure::Absolute, true) => "a finite number".to_owned(),
            _ if self.logarithmic => format!("more than 0 {}", self.unit),
            _ => format!("{} {} or more", self.min, self.unit),
        }
    }
}

/// Bounds, scale and grid of a parameter in one run, in its unit.
#[derive(Clone, Copy, Debug)]
pub struct SearchRange {
    pub min: f64,
    pub max: f64,
    pub scale: f64,
    pub guess: f64,
    grid: &'static [f64],
    factor: f64,
}

impl SearchRange {
    /// Grid of the score test; empty for a coefficient.
    pub fn shapes(&self) -> impl DoubleEndedIterator<Item = f64> + Clone + use<> {
        let Self { factor, max, .. } = *self;
        // A grid has one form at least.
        let is_inside = move |(k, shape): &(usize, &f64)| *k == 0 || *shape * factor <= max;
        let inside = self.grid.iter().enumerate().filter(is_inside);
        inside.map(move |(_, shape)| (shape * factor).min(max))
    }
}
