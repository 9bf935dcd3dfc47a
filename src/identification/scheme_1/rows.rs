//! Rows of eq. (13) and (17) from consecutive samples, in differences.
//!
//! `w_k - 2 w_{k-1} + w_{k-2} = -p (w_{k-1} - w_{k-2}) - q w_{k-2} + c (u_{k-1} + u_{k-2}) + b3 sgn(-w) + d (u_{k-1} - u_{k-2})`
//! with `p = 2 - a1`, `q = 1 - a1 - a2`, `c = (b1 + b2)/2`, `d = (b1 - b2)/2`: the same regression, but with the
//! coefficients that carry the motor.

/// One sample: the speed at its instant and the mean voltage of the interval that ends there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reading {
    pub(super) voltage_v: f64,
    pub(super) speed_rad_s: f64,
    /// Sign of the motion, zero where it has none.
    pub(super) direction: i8,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) regressor: [f64; 5],
    pub(super) value: f64,
}

/// The row that ends at `now`, where the motion keeps its direction; `before` and `earlier` are one and two periods back.
pub(super) fn row(earlier: &Reading, before: &Reading, now: &Reading) -> Option<Row> {
    let sign = now.direction;
    if sign == 0 || before.direction != sign || earlier.direction != sign {
        return None;
    }
    whatever_direction(earlier, before, now)
}

/// The row without regard to the direction, signed by the last; `None` where a value is missing.
pub(super) fn whatever_direction(
    earlier: &Reading,
    before: &Reading,
    now: &Reading,
) -> Option<Row> {
    let (u1, u2) = (now.voltage_v, before.voltage_v);
    let (w0, w1, w2) = (now.speed_rad_s, before.speed_rad_s, earlier.speed_rad_s);
    let built = Row {
        regressor: [w2 - w1, -w2, u1 + u2, -f64::from(now.direction), u1 - u2],
        value: (w0 - w1) - (w1 - w2),
    };
    (built.value.is_finite() && built.regressor.iter().all(|x| x.is_finite())).then_some(built)
}

/// The last two samples.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Rows {
    earlier: Option<Reading>,
    before: Option<Reading>,
}

impl Rows {
    pub(super) fn push(&mut self, now: Reading) -> Option<Row> {
        let built = self
            .earlier
            .zip(self.before)
            .and_then(|(earlier, before)| row(&earlier, &before, &now));
        self.earlier = self.before;
        self.before = Some(now);
        built
    }
}
