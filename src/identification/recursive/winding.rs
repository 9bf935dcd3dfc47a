//! Current of the winding over one sampling interval, in closed form.
//!
//! `Ta di/dt + i = (u - Ke w)/R`, `Ta = L/R`; the voltage is held piece by piece and the speed is a parabola, so each
//! piece has the solution `i = y(s) + (i_0 - y(0)) exp(-s/Ta)` with a polynomial `y`. No assumption on T against Ta.

/// R, L, Ke.
pub(super) type Winding = [f64; 3];

/// One sampling interval: `speed(s) = w0 + w1 s + w2 s^2` and the voltage pieces `(from, volts)`, the first at or before
/// zero, times in s after its begin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interval<'a> {
    pub(super) begin_s: f64,
    pub(super) length_s: f64,
    pub(super) speed: [f64; 3],
    /// `(absolute time, volts)`, in order, holding until the next; the first at or before `begin_s`.
    pub(super) voltage: &'a [(f64, f64)],
}

/// Current at the end and its integral over the interval.
pub(super) fn propagate(
    [r, l, ke]: &Winding,
    current_a: f64,
    interval: &Interval<'_>,
) -> (f64, f64) {
    let ta = l / r;
    let end_s = interval.begin_s + interval.length_s;
    let (mut current, mut charge) = (current_a, 0.0);
    for (index, &(at_s, volts)) in interval.voltage.iter().enumerate() {
        let from = at_s.max(interval.begin_s);
        let to = interval
            .voltage
            .get(index + 1)
            .map_or(end_s, |next| next.0.min(end_s));
        let h = to - from;
        if h <= 0.0 {
            continue;
        }
        let s = from - interval.begin_s;
        let [w0, w1, w2] = interval.speed;
        // The forcing as a polynomial of the time since the piece began.
        let v0 = (volts - ke * (w0 + w1 * s + w2 * s * s)) / r;
        let v1 = -ke * (w1 + 2.0 * w2 * s) / r;
        let v2 = -ke * w2 / r;
        let y0 = v0 - ta * v1 + 2.0 * ta * ta * v2;
        let y1 = v1 - 2.0 * ta * v2;
        let free = current - y0;
        let lost = -(-h / ta).exp_m1();
        current = y0 + y1 * h + v2 * h * h + free * (1.0 - lost);
        charge += h * (y0 + h * (y1 / 2.0 + h * v2 / 3.0)) + free * ta * lost;
    }
    (current, charge)
}

/// Integral of the held voltage over the interval, V.s.
pub(super) fn voltage_integral(interval: &Interval<'_>) -> f64 {
    let end_s = interval.begin_s + interval.length_s;
    interval
        .voltage
        .iter()
        .enumerate()
        .map(|(index, &(at_s, volts))| {
            let to = interval
                .voltage
                .get(index + 1)
                .map_or(end_s, |next| next.0.min(end_s));
            volts * (to - at_s.max(interval.begin_s)).max(0.0)
        })
        .sum()
}
