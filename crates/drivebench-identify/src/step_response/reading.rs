//! Reading of one voltage step: Harriott's 73 % method and the areas above the curve (see the module above).

use nalgebra::{DMatrix, DVector};

use super::Read;
use drivebench_model::numerics::root::halved;
use drivebench_model::numerics::statistics;
use drivebench_model::plant::{Input, Scenario};

/// A step of voltage out of rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub at_s: f64,
    pub until_s: f64,
    pub voltage_v: f64,
}

/// What was read of the response. Speeds and currents have the sign of the run.
#[derive(Clone, Debug)]
pub struct Reading {
    pub step: Step,
    pub final_speed_rad_s: Read,
    /// `None` where the run has no current.
    pub final_current_a: Option<Read>,
    /// Time to 63 % of the final speed, s: the graphical TM of a first-order lag.
    pub rise_time_s: f64,
    pub mechanical_time_constant_s: Read,
    pub electrical_time_constant_s: Result<Read, String>,
    pub resistance_ohm: Result<Read, String>,
    pub inductance_h: Result<Read, String>,
    /// Time that the Coulomb torque delays the start, s, as far as the current shows it.
    pub friction_delay_s: f64,
}

impl Reading {
    /// What was done and how crude it is.
    pub fn sentence(&self) -> String {
        let Step { at_s, until_s, voltage_v } = self.step;
        let friction = if self.final_current_a.is_some() {
            let ms = 1e3 * self.friction_delay_s;
            format!("friction delays the start by about {ms:.1} ms, which the curve leaves out")
        } else {
            "how far friction bends it is not known without a current".to_owned()
        };
        format!(
            "step-response: one step of {voltage_v:.2} V out of rest at {at_s:.3} s, held for {:.3} s; 63 % of the final \
             speed after {:.1} ms; time constants from the 73 % time and the height at half of TM (Harriott), their \
             uncertainty from the areas beside it; {friction}. A plain baseline: one curve of one size in one direction, \
             everything in the friction that is not Coulomb's goes into the values",
            until_s - at_s,
            1e3 * self.rise_time_s
        )
    }
}

/// Reads the largest step out of rest whose response settles; else why there is none.
pub fn read(scenario: &Scenario) -> Result<Reading, String> {
    if scenario.input != Input::Voltage {
        return Err("the run has no voltage, so no step of it".to_owned());
    }
    let mut steps = steps(scenario);
    steps.sort_by(|a, b| b.voltage_v.abs().total_cmp(&a.voltage_v.abs()));
    let mut refusal = None;
    for step in steps {
        match Response::of(scenario, step).and_then(|response| response.read()) {
            Ok(reading) => return Ok(reading),
            Err(reason) => {
                refusal.get_or_insert(reason);
            }
        }
    }
    Err(refusal.unwrap_or_else(|| {
        "no step of voltage out of rest: start from standstill at zero volts, then hold one voltage until the speed is \
         steady"
            .to_owned()
    }))
}

/// Steps from zero voltage and standstill, in the order of time.
fn steps(scenario: &Scenario) -> Vec<Step> {
    let volts: Vec<f64> = scenario.events.iter().map(|event| event.1).collect();
    let most_v = statistics::largest(&volts);
    let most_rad_s = statistics::largest(&scenario.speed_rad_s);
    let end_s = scenario.sample_time_s.last().copied().unwrap_or(0.0);
    // Levels: begin and voltage; a held value that is written on every row, or that noise moves, is one level.
    let mut levels: Vec<(f64, f64)> = Vec::new();
    for &(at_s, volts) in &scenario.events {
        let differs = |level: &(f64, f64)| {
            (volts - level.1).abs() > (0.02 * level.1.abs()).max(0.005 * most_v)
        };
        if levels.last().is_none_or(differs) {
            levels.push((at_s, volts));
        }
    }
    let mut steps = Vec::new();
    for (index, pair) in levels.windows(2).enumerate() {
        let (before, level) = (pair[0], pair[1]);
        let until_s = levels.get(index + 2).map_or(end_s, |next| next.0);
        let step_sample = scenario.sample_time_s.partition_point(|t| *t <= level.0);
        let first = step_sample.saturating_sub(20);
        let rest = statistics::finite(&scenario.speed_rad_s[first..step_sample]);
        let still = rest.len() >= 2 && statistics::median(&rest).abs() <= 0.02 * most_rad_s;
        let out_of_rest = before.1.abs() <= 0.02 * most_v && level.1.abs() > 0.02 * most_v;
        if out_of_rest && still && until_s > level.0 {
            let during = |event: &&(f64, f64)| event.0 >= level.0 && event.0 < until_s;
            let held = scenario.events.iter().filter(during);
            let held: Vec<f64> = held.map(|event| event.1).collect();
            steps.push(Step { at_s: level.0, until_s, voltage_v: statistics::mean(&held) });
        }
    }
    steps
}

/// The samples of one step: time since the step, normalised speed, current.
struct Response {
    step: Step,
    /// `(time since the step, speed over final speed)`.
    speed: Vec<(f64, f64)>,
    /// `(time since the step, current)`.
    current: Vec<(f64, f64)>,
    final_speed: Read,
    /// Noise of one normalised speed.
    noise: f64,
    period_s: f64,
}

impl Response {
    fn of(scenario: &Scenario, step: Step) -> Result<Self, String> {
        let series = |values: &[f64]| -> Vec<(f64, f64)> {
            let points = scenario.sample_time_s.iter().zip(values);
            points
                .filter(|(t, value)| **t > step.at_s && **t < step.until_s && value.is_finite())
                .map(|(t, value)| (t - step.at_s, *value))
                .collect()
        };
        let speed = series(&scenario.speed_rad_s);
        let fewest = 20;
        if speed.len() < fewest {
            return Err(format!(
                "{} samples of the speed during the step of {:.2} V at {:.3} s, at least {fewest} are needed",
                speed.len(),
                step.voltage_v,
                step.at_s
            ));
        }
        let fifth = speed.len() / 5;
        let values = |range: &[(f64, f64)]| range.iter().map(|point| point.1).collect::<Vec<_>>();
        let last = values(&speed[speed.len() - fifth..]);
        let before = values(&speed[speed.len() - 2 * fifth..speed.len() - fifth]);
        let (end, earlier) = (statistics::mean(&last), statistics::mean(&before));
        let sigma = statistics::variance(&last).sqrt();
        let error = sigma / (fifth as f64).sqrt();
        let turned = end * step.voltage_v > 0.0;
        if !turned || end.abs() < 5.0 * error {
            return Err(format!(
                "the shaft does not turn with the voltage: {end:.3} rad/s at the end of the step of {:.2} V",
                step.voltage_v
            ));
        }
        if (end - earlier).abs() > 0.02 * end.abs() + 3.0 * error {
            return Err(format!(
                "no steady state: the speed changes by {:.1} % in the last fifth of the step of {:.2} V at {:.3} s; hold \
                 it longer",
                100.0 * (end / earlier - 1.0).abs(),
                step.voltage_v,
                step.at_s
            ));
        }
        Ok(Self {
            step,
            period_s: (speed[speed.len() - 1].0 - speed[0].0) / (speed.len() - 1) as f64,
            speed: speed.iter().map(|point| (point.0, point.1 / end)).collect(),
            current: series(&scenario.current_a),
            final_speed: Read {
                value: end,
                // The approach that is not yet over, added to the noise.
                std: error.hypot(0.5 * (end - earlier)),
            },
            noise: sigma / end.abs(),
        })
    }

    fn read(&self) -> Result<Reading, String> {
        let reaches = |level: f64| {
            self.crossing(level).ok_or_else(|| {
                format!("the speed is at {level:.2} of its final value from the first sample on")
            })
        };
        let rise_time_s = reaches(1.0 - (-1.0_f64).exp())?;
        let meeting_s = reaches(MEETING)?;
        // The height at half of TM needs TM, which needs the ratio that the height gives: settled in a few rounds.
        let (mut tm, mut r) = (meeting_s / 1.3, None);
        for _ in 0..20 {
            r = ratio(self.height_at(0.5 * tm));
            tm = meeting_s / meeting_time(r.unwrap_or(0.0));
        }
        let held_s = self.step.until_s - self.step.at_s;
        // The response is then at 97 % at least.
        let needed = 3.5;
        if held_s < needed * tm {
            return Err(format!(
                "no steady state: the step of {:.2} V at {:.3} s is held for {:.1} times TM as it seems ({:.1} ms), \
                 {needed} times are needed",
                self.step.voltage_v,
                self.step.at_s,
                held_s / tm,
                1e3 * tm
            ));
        }
        let (area_tm, area_ta) = self.areas();
        let current = self.steady_current();
        let resistance = self.resistance(current);
        // The shaft starts when the current reaches Mc/Kt: `i = (U/R) (1 - exp(-t/Ta))`.
        let ta = r.map(|r| r * tm);
        let friction_delay_s = match (&resistance, current, ta) {
            (Ok(resistance), Some(current), Some(ta)) => {
                let share = resistance.value * current.value / self.step.voltage_v;
                -ta * (1.0 - share.clamp(0.0, 0.9)).ln()
            }
            _ => 0.0,
        };
        let sampling_s = self.period_s.powi(2) / (8.0 * tm);
        let slope = 0.3 / tm;
        let noise_s = self.noise / slope / (1.0 + 0.1 * tm / self.period_s).sqrt();
        let spread = |difference: f64| {
            let parts = [difference, friction_delay_s, sampling_s, noise_s];
            parts.iter().map(|part| part * part).sum::<f64>().sqrt()
        };
        let electrical = ta
            .ok_or_else(|| {
                format!(
                    "the speed has the shape of a first-order lag, {:.3} of its final value at half of TM (0.393 or more \
                     shows no Ta): Ta is far below TM = {:.1} ms, or the samples are too slow",
                    self.height_at(0.5 * tm),
                    1e3 * tm
                )
            })
            .map(|ta| Read {
                value: ta,
                // Towards equal time constants the height hardly depends on the ratio any more.
                std: spread(area_ta - ta).hypot(tm * self.ratio_error(r.unwrap_or(0.0), tm)),
            });
        Ok(Reading {
            step: self.step,
            final_speed_rad_s: self.final_speed,
            final_current_a: current,
            rise_time_s,
            mechanical_time_constant_s: Read { value: tm, std: spread(area_tm - tm) },
            inductance_h: self.inductance(ta.unwrap_or(0.1 * tm)),
            electrical_time_constant_s: electrical,
            resistance_ohm: resistance,
            friction_delay_s,
        })
    }

    /// Time at which the speed first reaches `level`, from the least-squares line through the samples near it.
    fn crossing(&self, level: f64) -> Option<f64> {
        let first = self.speed.iter().position(|point| point.1 >= level)?;
        let coarse_s = self.speed[first].0;
        let beside = (0.08 * coarse_s).max(1.5 * self.period_s);
        let near = |point: &&(f64, f64)| (point.0 - coarse_s).abs() <= beside;
        let points: Vec<(f64, f64)> = self.speed.iter().filter(near).copied().collect();
        let (height, slope) = line(&points, coarse_s)?;
        let found = coarse_s + (level - height) / slope;
        (slope > 0.0 && found > 0.0).then_some(found)
    }

    /// Height of the curve at a time, from the least-squares line through the samples near it.
    fn height_at(&self, time_s: f64) -> f64 {
        let beside = (0.15 * time_s).max(1.1 * self.period_s);
        let near = |point: &&(f64, f64)| (point.0 - time_s).abs() <= beside;
        // The curve starts at zero with the step.
        let points: Vec<(f64, f64)> =
            std::iter::once(&(0.0, 0.0)).chain(&self.speed).filter(near).copied().collect();
        line(&points, time_s).map_or(f64::NAN, |(height, _)| height)
    }

    /// Standard deviation of Ta/TM by the noise of the height at TM/2.
    fn ratio_error(&self, r: f64, tm: f64) -> f64 {
        let samples = (0.15 * tm / self.period_s).max(1.0);
        let error = self.noise / samples.sqrt();
        let slope = (height(0.5, r + 0.01) - height(0.5, r)) / 0.01;
        error / slope.abs().max(1e-3)
    }

    /// TM and Ta from the areas above the curve, by the trapezoid.
    fn areas(&self) -> (f64, f64) {
        let (mut area, mut moment, mut before) = (0.0, 0.0, (0.0, 0.0));
        for point in &self.speed {
            let h = point.0 - before.0;
            let (a, b) = (1.0 - before.1, 1.0 - point.1);
            area += 0.5 * h * (a + b);
            moment += 0.5 * h * (before.0 * a + point.0 * b);
            before = *point;
        }
        (area, area - moment / area)
    }

    fn steady_current(&self) -> Option<Read> {
        let fifth = self.current.len() / 5;
        if fifth < 2 {
            return None;
        }
        let tail = &self.current[self.current.len() - fifth..];
        let values: Vec<f64> = tail.iter().map(|point| point.1).collect();
        Some(Read {
            value: statistics::mean(&values),
            std: (statistics::variance(&values) / fifth as f64).sqrt(),
        })
    }

    /// At the peak of the current di/dt = 0: `u = R i + Ke w` there and in the steady state gives R and Ke.
    fn resistance(&self, steady: Option<Read>) -> Result<Read, String> {
        let Some(steady) = steady else {
            return Err(
                "the run has no current: put resistance_ohm under `fixed` in the model file if it is known".to_owned(),
            );
        };
        let sign = self.step.voltage_v.signum();
        let size = |k: usize| sign * self.current[k].1;
        let peak =
            (0..self.current.len()).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
        if peak < 2 || peak + 2 >= self.current.len() {
            return Err(format!(
                "the current is largest {:.1} ms after the step, in its sample {peak}: the peak is not resolved, sample \
                 faster",
                1e3 * self.current.get(peak).map_or(0.0, |point| point.0)
            ));
        }
        // A parabola about the peak: the largest of noisy samples is not the peak.
        let reach_s = (0.3 * self.current[peak].0).max(1.5 * self.period_s);
        let near = |point: &&(f64, f64)| (point.0 - self.current[peak].0).abs() <= reach_s;
        let around: Vec<(f64, f64)> = self.current.iter().filter(near).copied().collect();
        let (at_s, current) = vertex(&around, sign)
            .ok_or_else(|| "the current has no rounded peak: noise hides it".to_owned())?;
        let (final_speed, voltage) = (self.final_speed.value, self.step.voltage_v);
        let speed = final_speed * self.height_at(at_s);
        let room = current * final_speed - steady.value * speed;
        // Without a peak well above the steady current the two equations are nearly dependent.
        if !(sign * current > 1.5 * sign * steady.value && room * voltage * final_speed > 0.0) {
            let reason =
                "the current has no peak well above its steady value: a larger step shows it";
            return Err(reason.to_owned());
        }
        let value = voltage * (final_speed - speed) / room;
        let back_emf = (voltage - value * steady.value) / final_speed;
        // The instant of the peak is known to half a sample, in which the speed changes.
        let steepness = final_speed
            * (self.height_at(at_s + self.period_s) - self.height_at(at_s - self.period_s))
            / 2.0;
        let misplaced = back_emf * 0.5 * steepness / current;
        let one = steady.std * (self.current.len() as f64 / 5.0).sqrt();
        let noise = value * one / current.abs() / (around.len() as f64 / 3.0).max(1.0).sqrt();
        let nearest = self.current[peak - 1..=peak + 1].iter().map(|p| p.1);
        // Error of the parabola: its height against the mean of the three samples at the top.
        let shape = value * (nearest.sum::<f64>() / 3.0 / current - 1.0).abs();
        Ok(Read { value, std: misplaced.hypot(noise).hypot(shape) })
    }

    /// `L = u/(di/dt)` at the start, from a parabola without a constant through the current's first rise.
    fn inductance(&self, ta_s: f64) -> Result<Read, String> {
        let start = &self.current[..self.current.partition_point(|point| point.0 <= 0.6 * ta_s)];
        if start.len() < 4 {
            return Err(format!(
                "{} samples of the current within its first rise ({:.1} ms), at least 4 are needed: \
                 sample faster, or use burst capture",
                start.len(),
                0.6e3 * ta_s
            ));
        }
        // i = s t + q t^2: normal equations of two unknowns.
        let sum = |power: i32| start.iter().map(|p| p.0.powi(power)).sum::<f64>();
        let with = |power: i32| start.iter().map(|p| p.0.powi(power) * p.1).sum::<f64>();
        let determinant = sum(2) * sum(4) - sum(3) * sum(3);
        let slope = (with(1) * sum(4) - with(2) * sum(3)) / determinant;
        let bend = (with(2) * sum(2) - with(1) * sum(3)) / determinant;
        let misses = start.iter().map(|p| p.1 - slope * p.0 - bend * p.0 * p.0);
        let misfit: f64 = misses.map(|miss| miss.powi(2)).sum();
        let noise = (misfit / (start.len() - 2) as f64 * sum(4) / determinant).sqrt();
        // Truncation: the cubic term of the exponential, over 0.6 Ta.
        let cut_off = slope * (0.6f64).powi(2) / 30.0;
        let value = self.step.voltage_v / slope;
        Ok(Read { value, std: value.abs() * (noise / slope).hypot(cut_off / slope) })
    }
}

/// Place and height of the top of the least-squares parabola; `None` where it has none within the points.
fn vertex(points: &[(f64, f64)], sign: f64) -> Option<(f64, f64)> {
    let centre = points.iter().map(|p| p.0).sum::<f64>() / points.len() as f64;
    let (first, last) = (points.first()?.0 - centre, points.last()?.0 - centre);
    let scale = last - first;
    let matrix = DMatrix::from_fn(points.len(), 3, |row, power| match power {
        0 => 1.0,
        1 => (points[row].0 - centre) / scale,
        _ => ((points[row].0 - centre) / scale).powi(2),
    });
    let heights = DVector::from_iterator(points.len(), points.iter().map(|p| p.1));
    let x = matrix.svd(true, true).solve(&heights, 1e-9).ok()?;
    let at = -0.5 * x[1] / x[2];
    let inside = at * scale > first && at * scale < last;
    (sign * x[2] < 0.0 && inside).then(|| (centre + at * scale, x[0] + 0.5 * x[1] * at))
}

/// Height at `at` and slope of the least-squares line; the mean where there is one point, `None` without any.
fn line(points: &[(f64, f64)], at: f64) -> Option<(f64, f64)> {
    let n = points.len() as f64;
    let centre = points.iter().map(|p| p.0).sum::<f64>() / n;
    let level = points.iter().map(|p| p.1).sum::<f64>() / n;
    let power: f64 = points.iter().map(|p| (p.0 - centre).powi(2)).sum();
    let product: f64 = points.iter().map(|p| (p.0 - centre) * (p.1 - level)).sum();
    if points.is_empty() {
        return None;
    }
    let slope = if power > 0.0 { product / power } else { 0.0 };
    Some((level + slope * (at - centre), slope))
}

// The normalised step response `1/(r s^2 + s + 1)`: time in units of TM, `r = Ta/TM`.

/// Height at which all these curves nearly meet.
const MEETING: f64 = 0.73;

fn height(x: f64, r: f64) -> f64 {
    let discriminant = 1.0 - 4.0 * r;
    if r < 1e-9 {
        1.0 - (-x).exp()
    } else if discriminant.abs() < 1e-9 {
        1.0 - (1.0 + 2.0 * x) * (-2.0 * x).exp()
    } else if discriminant > 0.0 {
        let root = discriminant.sqrt();
        let (slow, fast) = ((1.0 - root) / (2.0 * r), (1.0 + root) / (2.0 * r));
        1.0 - (fast * (-slow * x).exp() - slow * (-fast * x).exp()) / (fast - slow)
    } else {
        let (damping, turning) = (1.0 / (2.0 * r), (-discriminant).sqrt() / (2.0 * r));
        let angle = turning * x;
        1.0 - (-damping * x).exp() * (angle.cos() + damping / turning * angle.sin())
    }
}

/// Time at which the curve first reaches [`MEETING`].
fn meeting_time(r: f64) -> f64 {
    // The first rise is over before half a turn of the oscillation, and monotonic.
    let end = if r > 0.25 { std::f64::consts::PI * 2.0 * r / (4.0 * r - 1.0).sqrt() } else { 20.0 };
    halved(0.0, end.min(20.0), 60, |x| height(x, r) - MEETING < 0.0)
}

/// Ratio of the curve whose height at half of TM is `half`; `None` for a height that none of them has.
fn ratio(half: f64) -> Option<f64> {
    // At a larger ratio the response oscillates for longer than any step is held.
    let largest = 10.0;
    let within = half < height(0.5, 0.0) && half > height(0.5, largest);
    within.then(|| halved(0.0, largest, 60, |r| half - height(0.5, r) < 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_solves_its_differential_equation_in_every_regime() {
        for r in [0.0, 0.05, 0.2499, 0.25, 0.2501, 0.6, 3.0] {
            for x in [0.3, 1.0, 2.5] {
                let h = 1e-4;
                let [before, at, after] = [x - h, x, x + h].map(|x| height(x, r));
                let first = (after - before) / (2.0 * h);
                let second = (after - 2.0 * at + before) / (h * h);
                assert!((r * second + first + at - 1.0).abs() < 1e-5, "{r} {x}");
            }
        }
    }

    #[test]
    fn harriotts_rule_holds_and_the_chart_is_read_back() {
        // Harriott 1964: 73 % at 1.3 (T1 + T2) for all over-damped curves, within a few per cent.
        for r in [0.0, 0.1, 0.2, 0.25] {
            assert!((meeting_time(r) / 1.3 - 1.0).abs() < 0.03, "{r}");
        }
        for r in [0.02, 0.23, 0.25, 0.4, 1.5] {
            assert!((ratio(height(0.5, r)).unwrap() - r).abs() < 1e-6, "{r}");
            assert!((height(meeting_time(r), r) - MEETING).abs() < 1e-9);
        }
        assert_eq!(ratio(0.45), None);
        assert_eq!(ratio(f64::NAN), None);
    }
}
