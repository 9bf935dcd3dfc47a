//! Parameter of an effect: its key, unit, bounds and typical size, and how a fit finds it.

/// Periods per turn that are tried for a wave over the shaft's angle.
pub(super) const WAVE_ORDERS: &[f64] = &[
    2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0,
    19.0, 20.0, 21.0, 22.0, 23.0, 24.0,
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterRole {
    /// The effect is proportional to it, or nearly: zero is no effect.
    Coefficient,
    /// Gives the effect its form: tried on a grid by the screen, then fitted within its bounds.
    Shape,
    /// Taken from the grid as it is: the number of cogs is a whole number, and a fit of it would find no way from one
    /// to the next.
    Choice,
    /// When something happened, s after the run's first command. Differs from run to run: found anew in each. The grid
    /// gives shares of the run's length.
    EventTime,
}

#[derive(Debug)]
pub struct ParameterSpec {
    pub key: &'static str,
    pub unit: &'static str,
    pub min: f64,
    pub max: f64,
    /// A typical size: probe of the score screen and unit of the fit.
    pub scale: f64,
    pub role: ParameterRole,
    /// Fitted as a logarithm (positive parameters without a natural zero) instead of linearly.
    pub logarithmic: bool,
    /// Values that the score screen tries; empty for a coefficient.
    pub shapes: &'static [f64],
}

impl ParameterSpec {
    /// A coefficient of either sign: the effect is proportional to it.
    pub const fn coefficient(key: &'static str, unit: &'static str, scale: f64) -> Self {
        Self {
            key,
            unit,
            min: -f64::MAX,
            max: f64::MAX,
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

    /// A positive shape parameter within bounds, fitted as a logarithm.
    pub const fn shape(
        key: &'static str,
        unit: &'static str,
        range: (f64, f64),
        shapes: &'static [f64],
    ) -> Self {
        Self {
            key,
            unit,
            min: range.0,
            max: range.1,
            scale: shapes[0],
            role: ParameterRole::Shape,
            logarithmic: true,
            shapes,
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

    /// The moment from which on the effect is there, s after the run's first command.
    pub(super) const EVENT_TIME: Self = Self {
        key: "time_s",
        unit: "s",
        min: 0.0,
        max: f64::MAX,
        scale: 0.1,
        role: ParameterRole::EventTime,
        logarithmic: false,
        shapes: &[0.08, 0.15, 0.22, 0.29, 0.36, 0.43, 0.5, 0.57, 0.64, 0.71, 0.78, 0.85, 0.92],
    };

    pub const fn is_coefficient(&self) -> bool {
        matches!(self.role, ParameterRole::Coefficient)
    }

    /// Where a fit starts when nothing better is known.
    pub const fn guess(&self) -> f64 {
        if self.is_coefficient() { self.scale } else { self.shapes[self.shapes.len() / 2] }
    }
}
