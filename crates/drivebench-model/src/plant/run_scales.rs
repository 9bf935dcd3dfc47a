//! Scales of a run, to which ranges of shapes, windows and sub-steps are in proportion: a motor of a milliwatt and a mill are the
//! same equations in other units.

use super::scenario::{Input, Scenario};
use crate::numerics::least_squares::fit_normal;
use crate::numerics::statistics::{largest, mean_step, variance};
use crate::signal;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunScales {
    /// Stall current at the largest voltage; where a run does not determine the resistance, the largest measured current.
    pub current_a: f64,
    pub speed_rad_s: f64,
    /// Time of response of the speed to the input: the mechanical time constant where a voltage drives.
    pub response_s: f64,
    pub period_s: f64,
    pub length_s: f64,
}

/// The scale of a run to which a range of values is in proportion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// The same in every run: a ratio, a number of teeth, or what a user states.
    Absolute,
    Current,
    Speed,
    Response,
    /// One over a time of response.
    Frequency,
    /// Angle through which the largest speed turns in a time of response.
    Angle,
    Length,
}

impl Measure {
    /// Its value in the run of the reference, in SI.
    pub fn reference(self) -> f64 {
        RunScales::REFERENCE.scale(self)
    }

    /// Key in JSON, and the scale in a text.
    pub const fn names(self) -> (&'static str, &'static str) {
        match self {
            Self::Absolute => ("absolute", ""),
            Self::Current => ("current", "of the stall current at the run's largest voltage"),
            Self::Speed => ("speed", "of the run's largest speed"),
            Self::Response => ("response", "times of response"),
            Self::Frequency => ("frequency", "periods in a time of response"),
            Self::Angle => ("angle", "of the turn at the largest speed in a time of response"),
            Self::Length => ("length", "of the run's length"),
        }
    }
}

/// Share of the largest speed below which a balance of torques is not used: around a reversal friction is between stiction and
/// sliding.
pub const REVERSAL_SHARE: f64 = 0.015;

impl RunScales {
    /// The run to which the ranges of the catalogue refer: the motor of paper A at 110 V in steps.
    pub const REFERENCE: Self = Self {
        current_a: 100.0,
        speed_rad_s: 290.0,
        response_s: 0.04,
        period_s: 4e-3,
        length_s: 10.0,
    };

    /// Of a recorded run. Where the speed gives no time of response, it is that of the reference for a run of this length.
    pub(super) fn of(scenario: &Scenario) -> Self {
        let times = &scenario.sample_time_s;
        let length_s = times[times.len() - 1] - scenario.begin_s();
        let period_s = mean_step(times);
        let speed_rad_s = largest(&scenario.speed_rad_s);
        let largest_a = match largest(&scenario.current_a) {
            none if none <= 0.0 => Self::REFERENCE.current_a,
            largest_a => largest_a,
        };
        let intervals = intervals(scenario, [largest_a, speed_rad_s]);
        let winding =
            fit(&intervals, |own| ([own.current, own.speed, own.current_change], own.input))
                .filter(|[resistance, back_emf, _]| *resistance > 0.0 && *back_emf > 0.0);
        let current_a = winding.map_or(largest_a, |[resistance, ..]| largest_a / resistance);
        let of_length = Self::REFERENCE.response_s / Self::REFERENCE.length_s * length_s;
        let response_s = response_s(scenario, &intervals, winding).unwrap_or(of_length);
        // A tenth of a period is not observable, and a tenth of the run is no response but a drift. A balance of torques needs a
        // hundred windows.
        let most = if scenario.input == Input::Voltage { 0.1 } else { 0.01 };
        let (least_s, most_s) = (0.1 * period_s, most * length_s);
        let response_s = response_s.min(most_s).max(least_s);
        let scales = Self { current_a, speed_rad_s, response_s, period_s, length_s };
        let all = [speed_rad_s, response_s, period_s, length_s];
        // A run at rest has no scale of speed.
        if all.iter().all(|scale| scale.is_finite() && *scale > 0.0) {
            scales
        } else {
            Self::REFERENCE
        }
    }

    /// This run's scale over that of the reference.
    pub(super) fn factor(&self, measure: Measure) -> f64 {
        self.scale(measure) / measure.reference()
    }

    fn scale(&self, measure: Measure) -> f64 {
        match measure {
            Measure::Absolute => 1.0,
            Measure::Current => self.current_a,
            Measure::Speed => self.speed_rad_s,
            Measure::Response => self.response_s,
            Measure::Frequency => 1.0 / self.response_s,
            Measure::Angle => self.speed_rad_s * self.response_s,
            Measure::Length => self.length_s,
        }
    }

    /// So many times of response, s.
    pub const fn responses(&self, number: f64) -> f64 {
        number * self.response_s
    }

    /// Length of the blocks within which errors may be alike, s: six times of response, and at least eight blocks in a run.
    pub fn block_s(&self) -> f64 {
        self.responses(6.25).min(self.length_s / 8.0)
    }

    /// Zero input for so long before a command lets the motor come to rest, s.
    pub fn rest_s(&self) -> f64 {
        self.responses(5.0)
    }

    /// Current over which a voltage drop builds up, A: 0.1 A in the run of the reference.
    pub const fn drop_a(&self) -> f64 {
        self.current_a / 1000.0
    }

    /// Time constant of the onset of an event, s: a quarter of the time of response, within which a shaft does not show a form.
    pub const fn onset_s(&self) -> f64 {
        0.25 * self.response_s
    }
}

/// Integrals and changes over an interval, each signal over its largest value, time over the sampling period.
struct Interval {
    length: f64,
    input: f64,
    current: f64,
    speed: f64,
    direction: f64,
    current_change: f64,
    speed_change: f64,
}

fn intervals(scenario: &Scenario, most: [f64; 2]) -> Vec<Interval> {
    let unit_s = mean_step(&scenario.sample_time_s);
    let most_input = largest(scenario.events.iter().map(|event| event.1));
    let of = |values: &[f64], sample: usize, most: f64| {
        values.get(sample).map_or(f64::NAN, |value| value / most)
    };
    let row = |sample: usize| {
        let current = of(&scenario.current_a, sample, most[0]);
        [scenario.sample_time_s[sample], current, of(&scenario.speed_rad_s, sample, most[1])]
    };
    let rows: Vec<[f64; 3]> =
        (0..scenario.samples()).map(row).filter(|row| row[2].is_finite()).collect();
    let interval = |rows: &[[f64; 3]]| {
        let (first, last) = (rows[0], rows[8]);
        let areas = rows.windows(2).fold([0.0; 3], |sum, pair| {
            let length = (pair[1][0] - pair[0][0]) / unit_s;
            let [current, speed] = [1, 2].map(|signal| 0.5 * (pair[0][signal] + pair[1][signal]));
            let means = [current, speed, speed.signum()];
            [0, 1, 2].map(|k| sum[k] + means[k] * length)
        });
        Interval {
            length: (last[0] - first[0]) / unit_s,
            input: signal::integral(&scenario.events, first[0], last[0]) / (most_input * unit_s),
            current: areas[0],
            speed: areas[1],
            direction: areas[2],
            current_change: last[1] - first[1],
            speed_change: last[2] - first[2],
        }
    };
    // Of eight samples the noise of a speed that is the difference of counts is small against its change. Intervals of a short record
    // overlap.
    let stride = (rows.len() / 100).clamp(1, 8);
    rows.windows(9).step_by(stride).map(interval).collect()
}

fn fit<const N: usize>(
    intervals: &[Interval],
    row: impl Fn(&Interval) -> ([f64; N], f64),
) -> Option<[f64; N]> {
    let rows: Vec<_> = intervals.iter().map(row).collect();
    fit_normal(&rows, 1e-6).map(|fit| fit.x)
}

/// Mechanical time constant `R J / (Ke Kt)` by least squares over intervals; without a current that of `dw/dt = a u - b w - c sgn(w)`;
/// with a torque or a current as the input by the ratio of the speed to its rate.
fn response_s(
    scenario: &Scenario,
    intervals: &[Interval],
    winding: Option<[f64; 3]>,
) -> Option<f64> {
    let rate = if scenario.input == Input::Voltage {
        let shaft =
            fit(intervals, |own| ([own.current, own.speed, -own.direction], own.speed_change));
        let of_both = winding.zip(shaft).map(|([r, ke, _], [per_ampere, ..])| ke * per_ampere / r);
        let lag = || {
            fit(intervals, |own| ([-own.speed, own.input, -own.direction], own.speed_change))
                .map(|[rate, ..]| rate)
        };
        // After one step its voltage and the direction are the same column.
        let plain_lag = || {
            fit(intervals, |own| ([-own.speed, own.input], own.speed_change)).map(|[rate, _]| rate)
        };
        let rises = |rate: &f64| *rate > 0.0;
        of_both.filter(rises).or_else(|| lag().filter(rises)).or_else(plain_lag)?
    } else {
        let means = |of: fn(&Interval) -> f64| -> Vec<f64> {
            intervals.iter().map(|own| of(own) / own.length).collect()
        };
        let [rates, speeds] = [means(|own| own.speed_change), means(|own| own.speed)];
        // The noise is averaged over what the motion allows: the time of response is the geometric mean of ten sampling periods and
        // of the speed over its rate, of a motor in steps of the voltage 2.4 times its time constant.
        let of_motion = 2.4 * (variance(&rates) / variance(&speeds)).sqrt();
        (of_motion / 10.0).sqrt()
    };
    (rate > 0.0).then(|| mean_step(&scenario.sample_time_s) / rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::testing::{record, scaled, with_a_fan};
    use crate::plant::{Model, Motor};

    #[test]
    fn the_response_is_the_time_constant_of_the_motor_under_any_excitation() {
        let model = Model::baseline(Motor::zk_22fc());
        for hold_s in [0.02, 0.05, 0.2, 0.6] {
            let levels = [80.0, -60.0, 30.0, 90.0, -20.0, 0.0, -90.0].into_iter().cycle();
            let events = (0..).map(|step| hold_s * f64::from(step)).zip(levels);
            let events = events.take_while(|event| event.0 < 8.0).collect();
            let ratio = RunScales::of(&record(&model, events, 4e-3, 8.0, 3)).response_s / 0.042;
            assert!((0.8..1.3).contains(&ratio), "{hold_s}: {ratio}");
        }
    }

    #[test]
    fn scales_follow_the_units_of_a_run() {
        let run = with_a_fan(0);
        let here = RunScales::of(&run);
        for (volts, amps, speed, time) in
            [(0.01, 1.0, 1.0, 1.0), (1.0, 50.0, 300.0, 1.0), (1.0, 1.0, 1.0, 70.0)]
        {
            let there = scaled(&run, [volts, amps, speed, time]).scales;
            let pairs = [
                (there.current_a, here.current_a * amps),
                (there.speed_rad_s, here.speed_rad_s * speed),
                (there.response_s, here.response_s * time),
                (there.period_s, here.period_s * time),
                (there.length_s, here.length_s * time),
            ];
            assert!(pairs.iter().all(|(a, b)| (a / b - 1.0).abs() < 1e-9), "{pairs:?}");
        }
    }

    #[test]
    fn a_run_at_rest_has_the_scales_of_the_reference() {
        let mut run = with_a_fan(0);
        run.speed_rad_s.fill(0.0);
        assert_eq!(RunScales::of(&run), RunScales::REFERENCE);
        run.speed_rad_s.fill(f64::NAN);
        assert_eq!(RunScales::of(&run), RunScales::REFERENCE);
    }
}
