//! Ranges of values: what a reading may be, by latency, resolution and tolerances.

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    pub low: f64,
    pub high: f64,
}

impl Range {
    pub const EVERY: Self = Self::new(f64::NEG_INFINITY, f64::INFINITY);

    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    pub const fn at(value: f64) -> Self {
        Self::new(value, value)
    }

    pub const fn around(value: f64, by: f64) -> Self {
        Self::new(value - by, value + by)
    }

    pub fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.fold(None, |range: Option<Self>, value| {
            Some(range.unwrap_or(Self::at(value)).with(value))
        })
    }

    /// Of values that all have to be known.
    pub fn of_known(values: impl Iterator<Item = Option<f64>>) -> Option<Self> {
        Self::of(values.collect::<Option<Vec<f64>>>()?.into_iter())
    }

    #[must_use]
    pub const fn with(self, value: f64) -> Self {
        Self::new(self.low.min(value), self.high.max(value))
    }

    #[must_use]
    pub const fn union(self, other: Self) -> Self {
        self.with(other.low).with(other.high)
    }

    #[must_use]
    pub const fn wider(self, by: f64) -> Self {
        Self::new(self.low - by, self.high + by)
    }

    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self::new(self.low + other.low, self.high + other.high)
    }

    #[must_use]
    pub const fn negative(self) -> Self {
        Self::new(-self.high, -self.low)
    }

    /// Every value of this one times every one of the factors.
    #[must_use]
    pub const fn times(self, factors: Self) -> Self {
        let (a, b) = (self.low * factors.low, self.low * factors.high);
        let (c, d) = (self.high * factors.low, self.high * factors.high);
        Self::new(a.min(b).min(c).min(d), a.max(b).max(c).max(d))
    }

    /// How far the two lie apart; 0 where they meet.
    pub const fn gap(self, other: Self) -> f64 {
        (self.low - other.high).max(other.low - self.high).max(0.0)
    }

    pub const fn middle(self) -> f64 {
        0.5 * (self.low + self.high)
    }

    pub const fn width(self) -> f64 {
        self.high - self.low
    }
}
