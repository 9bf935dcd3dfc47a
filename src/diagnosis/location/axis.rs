//! How much of an equation's error follows each variable.
//!
//! Every variable has its columns, averaged over each window with the test function, so that what passes through many
//! turns or many amperes within one window counts as what it is there. Their adjusted share of the error is compared.

use std::f64::consts::{PI, TAU};

use super::balance::{Weights, Window, Windows};
use super::fit::{Fitted, fit};
use super::region::{Point, Region, narrowest};
use super::{Equation, FailureLocation, line, own, words};
use crate::plant::{Model, MotorKey};

/// Hat functions along speed and current, and along time.
const HATS: usize = 16;
const HATS_OF_TIME: usize = 24;
/// Periods per turn that are looked for.
const ORDERS: usize = 36;
/// Windows (by their weight) in which a wave must be visible.
const FEWEST_SEEN: f64 = 30.0;
/// Share of the error that must follow a variable to be worth a sentence, and its multiple of chance.
const WORTH_MENTIONING: f64 = 0.1;
const CERTAIN: f64 = 4.0;
/// Time explains nothing by itself, and a line hides in every periodic excitation: they are named first only where no
/// physical variable comes near.
const WEIGHT_OF_TIME: f64 = 0.85;
const WEIGHT_OF_LINE: f64 = 0.9;
/// One wrong value of the motor explains as much as a curve with one column: preferred down to this share of it.
const PARSIMONY: f64 = 1.03;
/// A direction holds the error if it has this share of it, in at most that share of the time.
const ONE_SIDED: f64 = 0.75;
const TIME_ONE_SIDED: f64 = 0.6;

/// What form the dependence has.
pub(super) enum Shape {
    /// A curve over the variable.
    Curve,
    /// One of the motor's own values differs by this much.
    Own {
        key: MotorKey,
        by: f64,
        share: f64,
    },
    /// So many periods per turn, with this amplitude.
    Turns {
        order: usize,
        amplitude: f64,
    },
    /// A curve over time; of the resistance, from its begin to its end, or of the equation itself.
    Drift {
        resistance: Option<[f64; 2]>,
    },
    Line {
        amplitude: f64,
    },
    /// The voltage seems to come later by this time, s.
    Late {
        delay_s: f64,
        resolved: bool,
    },
    OneWay {
        forward: bool,
    },
    /// The same everywhere.
    Offset {
        by: f64,
    },
}

pub(super) struct Axis {
    pub equation: Equation,
    pub variable: &'static str,
    pub shape: Shape,
    pub region: Region,
    pub follows: f64,
    strength: f64,
    weight: f64,
}

impl Axis {
    pub(super) fn into_location(self) -> FailureLocation {
        FailureLocation {
            equation: self.equation.name(),
            variable: self.variable,
            from: if self.region.of_size && self.region.from_lowest {
                -self.region.to
            } else {
                self.region.from
            },
            to: self.region.to,
            share_of_error: self.region.share_of_error,
            share_of_time: self.region.share_of_time,
            follows: self.follows,
            strength: self.strength,
            sentence: words::sentence(&self),
        }
    }
}

/// The variables that the error follows, the one that it follows most first.
pub(super) fn ranked(
    windows: &Windows<'_>,
    equation: Equation,
    refitted: bool,
    model: &Model,
) -> Vec<Axis> {
    let search = Search {
        windows,
        equation,
        with_own: refitted,
    };
    let mut found = Vec::new();
    if !refitted {
        found.extend(search.own(model));
    }
    found.extend(search.curve("speed_rad_s"));
    match equation {
        Equation::Voltage => {
            found.extend(search.curve("current_a"));
            found.extend(search.late(model));
        }
        // Not the current: it drives this balance, so that whatever is missing shows in it.
        Equation::Torque => {
            found.extend(search.turns());
            found.extend(search.line());
        }
    }
    found.extend(search.offset());
    found.extend(search.drift());
    found.extend(search.one_way());
    found.sort_by(|a: &Axis, b| b.weight.total_cmp(&a.weight));
    // One variable, one sentence: the better form of it.
    let mut kept: Vec<Axis> = Vec::new();
    for axis in found {
        if kept.iter().all(|before| before.variable != axis.variable) {
            kept.push(axis);
        }
    }
    kept
}

struct Search<'a> {
    windows: &'a Windows<'a>,
    equation: Equation,
    /// Whether the equation's own columns stand beside every variable's, because the error is what they leave.
    with_own: bool,
}

impl Search<'_> {
    fn own_columns(&self) -> usize {
        if self.with_own {
            own::count(self.equation)
        } else {
            0
        }
    }

    /// Fits own columns (where they are to be there) and those of the variable.
    fn fit(&self, columns: usize, mut fill: impl FnMut(&Window, &mut [f64])) -> Option<Fitted> {
        let own = self.own_columns();
        let fitted = fit(self.windows, self.equation, own + columns, |window, row| {
            row[..own].copy_from_slice(&own::columns(window, self.equation)[..own]);
            fill(window, &mut row[own..]);
        })?;
        (fitted.follows >= WORTH_MENTIONING && fitted.strength >= CERTAIN).then_some(fitted)
    }

    /// Values of a fit in every window, with the window's place along `at`.
    fn points<'w>(
        &'w self,
        fitted: &Fitted,
        at: impl Fn(&Window) -> f64,
        mut fill: impl FnMut(&Window, &mut [f64]),
    ) -> Vec<Point<'w>> {
        let own = self.own_columns();
        let mut row = vec![0.0; fitted.columns];
        self.windows
            .of(self.equation)
            .filter(|window| at(window).is_finite())
            .map(|window| {
                row.fill(0.0);
                row[..own].copy_from_slice(&own::columns(window, self.equation)[..own]);
                fill(window, &mut row[own..]);
                let value = row
                    .iter()
                    .zip(&fitted.coefficients)
                    .map(|(c, x)| c * x)
                    .sum();
                Point {
                    at: at(window),
                    fitted: value,
                    window,
                }
            })
            .collect()
    }

    fn axis(
        &self,
        variable: &'static str,
        shape: Shape,
        region: Region,
        fitted: &Fitted,
        weight: f64,
    ) -> Axis {
        Axis {
            equation: self.equation,
            variable,
            shape,
            region,
            follows: fitted.follows,
            strength: fitted.strength,
            weight: weight * fitted.adjusted,
        }
    }

    /// Quantiles of a variable over the windows: sharp where the run spent much time.
    fn knots(&self, at: impl Fn(&Window) -> f64, most: usize) -> Option<Vec<f64>> {
        let mut values: Vec<f64> = self
            .windows
            .of(self.equation)
            .map(at)
            .filter(|value| value.is_finite())
            .collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().checked_sub(1)?;
        let span = values[last] - values[0];
        let mut knots: Vec<f64> = (0..most).map(|k| values[k * last / (most - 1)]).collect();
        if most == HATS {
            let largest = values[0].abs().max(values[last].abs());
            let near_zero = [0.02, 0.04, 0.08, 0.16, 0.32].map(|share| share * largest);
            let both = near_zero
                .iter()
                .flat_map(|edge| [-edge, *edge])
                .chain([0.0]);
            knots.extend(both.filter(|edge| *edge > values[0] && *edge < values[last]));
            knots.sort_by(f64::total_cmp);
        }
        knots.dedup_by(|later, earlier| *later - *earlier <= 0.002 * span);
        (knots.len() >= 3 && span > 0.0).then_some(knots)
    }

    /// A curve of hats over speed or current.
    fn curve(&self, variable: &'static str) -> Option<Axis> {
        let scenario = self.windows.scenario;
        let is_speed = variable == "speed_rad_s";
        let values = if is_speed {
            &scenario.speed_rad_s
        } else {
            &scenario.current_a
        };
        let at = move |window: &Window| {
            if is_speed {
                window.speed_rad_s
            } else {
                window.current_a
            }
        };
        let knots = self.knots(at, HATS)?;
        let mut weights = Weights::default();
        let span = 2 * self.windows.half;
        let mut fill = |window: &Window, row: &mut [f64]| {
            let range = window.begin..=window.begin + span;
            weights.fill(&scenario.sample_time_s[range.clone()]);
            for (weight, value) in weights.mean.iter().zip(&values[range]) {
                hat(&knots, *value, *weight, row);
            }
        };
        let fitted = self.fit(knots.len(), &mut fill)?;
        let points = self.points(&fitted, at, &mut fill);
        let region = narrowest(&points, self.equation)?;
        Some(self.axis(variable, Shape::Curve, region, &fitted, 1.0))
    }

    /// Each of the equation's own parameters alone.
    fn own(&self, model: &Model) -> Vec<Axis> {
        let candidates: &[(usize, MotorKey, &'static str)] = match self.equation {
            Equation::Voltage => &[
                (0, MotorKey::Resistance, "current_a"),
                (1, MotorKey::Inductance, "current_rate_a_s"),
                (2, MotorKey::BackEmf, "speed_rad_s"),
            ],
            Equation::Torque => &[
                (0, MotorKey::Inertia, "acceleration_rad_s2"),
                (1, MotorKey::LoadTorque, "direction"),
            ],
        };
        let one = |&(column, key, variable): &(usize, MotorKey, &'static str)| {
            let value = |window: &Window| own::columns(window, self.equation)[column];
            let fill = |window: &Window, row: &mut [f64]| row[0] = value(window);
            let fitted = self.fit(1, fill)?;
            let by = fitted.coefficients[0];
            let region = if key == MotorKey::LoadTorque {
                everywhere(-1.0, 1.0)
            } else {
                narrowest(&self.points(&fitted, value, fill), self.equation)?
            };
            let share = by / model.motor.get(key).unwrap_or(f64::NAN);
            let shape = Shape::Own { key, by, share };
            Some(self.axis(variable, shape, region, &fitted, PARSIMONY))
        };
        candidates.iter().filter_map(one).collect()
    }

    /// The steps of the voltage: `v = -delay <du/dt>` where it comes late.
    fn late(&self, model: &Model) -> Option<Axis> {
        let fill = |window: &Window, row: &mut [f64]| row[0] = window.input_rate;
        let fitted = self.fit(1, fill)?;
        // The loss is u(t) - u(t - delay).
        let delay_s = fitted.coefficients[self.own_columns()];
        let region = everywhere(delay_s.min(0.0), delay_s.max(0.0));
        let value = |key| model.motor.get(key).unwrap_or(f64::NAN);
        let time_constant_s = value(MotorKey::Inductance) / value(MotorKey::Resistance);
        // Samples that miss the armature's transient tell that there is a delay, not how long it is.
        let period_s = self.windows.length_s() / (2 * self.windows.half) as f64;
        let resolved = period_s < 0.5 * time_constant_s;
        Some(self.axis(
            "voltage_edge_s",
            Shape::Late { delay_s, resolved },
            region,
            &fitted,
            1.0,
        ))
    }

    /// The order per turn that explains most.
    fn turns(&self) -> Option<Axis> {
        let angle = self.angle_at_samples()?;
        let span = 2 * self.windows.half;
        let mut weights = Weights::default();
        let times = &self.windows.scenario.sample_time_s;
        let period_s = self.windows.length_s() / span as f64;
        // Averages of the waves of all orders at once: [cos, sin] of each.
        let mut waves = vec![[0.0; 2]; ORDERS + 1];
        let mut average = |window: &Window, highest: usize, waves: &mut [[f64; 2]]| {
            waves.fill([0.0; 2]);
            weights.fill(&times[window.begin..=window.begin + span]);
            // A wave that turns by more than half between two samples is seen as another: its average is nothing.
            let visible = (PI / (window.speed_rad_s.abs() * period_s).max(1e-9)).min(1e6);
            for (offset, weight) in weights.mean.iter().enumerate() {
                let (sin, cos) = angle[window.begin + offset].sin_cos();
                let (mut re, mut im) = (cos, sin);
                for (order, wave) in waves.iter_mut().enumerate().take(highest + 1).skip(1) {
                    if order as f64 > visible {
                        break;
                    }
                    wave[0] += weight * re;
                    wave[1] += weight * im;
                    (re, im) = (re * cos - im * sin, re * sin + im * cos);
                }
            }
        };
        // Normal equations of two columns for each order.
        let mut sums = vec![[0.0; 6]; ORDERS + 1];
        for window in self.windows.of(self.equation) {
            average(window, ORDERS, &mut waves);
            let error = window.error(self.equation);
            for (sum, [c, s]) in sums.iter_mut().zip(&waves) {
                let size = c * c + s * s;
                let products = [c * c, c * s, s * s, c * error, s * error, size * size];
                for (total, product) in sum.iter_mut().zip(products) {
                    *total += product;
                }
            }
        }
        let explained = |[cc, cs, ss, ce, se, fourth]: [f64; 6]| {
            let determinant = cc * ss - cs * cs;
            // Seen in few windows only, as a high order is, it explains whatever happened there.
            let seen_in = (cc + ss).powi(2) / fourth;
            if determinant > 1e-6 * cc * ss && seen_in > FEWEST_SEEN {
                (ce * ce * ss - 2.0 * ce * se * cs + se * se * cc) / determinant
            } else {
                0.0
            }
        };
        let order =
            (1..=ORDERS).max_by(|a, b| explained(sums[*a]).total_cmp(&explained(sums[*b])))?;
        let fitted = self.fit(2, |window, row| {
            average(window, order, &mut waves);
            row.copy_from_slice(&waves[order]);
        })?;
        let own = self.own_columns();
        let amplitude = fitted.coefficients[own].hypot(fitted.coefficients[own + 1]);
        let shape = Shape::Turns { order, amplitude };
        Some(self.axis("angle_rad", shape, everywhere(0.0, TAU), &fitted, 1.0))
    }

    fn angle_at_samples(&self) -> Option<Vec<f64>> {
        let points = self.windows.scenario.shaft_angle();
        if points.len() < 2 {
            return None;
        }
        let mut next = 1;
        let at = |time_s: &f64| {
            while next + 1 < points.len() && points[next].0 < *time_s {
                next += 1;
            }
            let (before, after) = (points[next - 1], points[next]);
            before.1 + (after.1 - before.1) * (time_s - before.0) / (after.0 - before.0)
        };
        Some(self.windows.scenario.sample_time_s.iter().map(at).collect())
    }

    fn line(&self) -> Option<Axis> {
        let frequency_hz = line::strongest(self.windows, self.equation)?;
        let fitted = self.fit(2, |window, row| {
            let (sin, cos) = (TAU * frequency_hz * window.time_s).sin_cos();
            row.copy_from_slice(&[cos, sin]);
        })?;
        let own = self.own_columns();
        let amplitude = fitted.coefficients[own].hypot(fitted.coefficients[own + 1]);
        // As sharp as the length of the run allows.
        let times = &self.windows.scenario.sample_time_s;
        let half_hz = 0.5 / (times[times.len() - 1] - times[0]);
        let mut region = everywhere(frequency_hz - half_hz, frequency_hz + half_hz);
        region.share_of_error = fitted.follows;
        Some(self.axis(
            "frequency_hz",
            Shape::Line { amplitude },
            region,
            &fitted,
            WEIGHT_OF_LINE,
        ))
    }

    /// A curve over time: of the equation itself, or (voltage) of its resistance; the better.
    fn drift(&self) -> Option<Axis> {
        let at = |window: &Window| window.time_s;
        let knots = self.knots(at, HATS_OF_TIME)?;
        let of_itself = |window: &Window, row: &mut [f64]| hat(&knots, window.time_s, 1.0, row);
        let of_resistance =
            |window: &Window, row: &mut [f64]| hat(&knots, window.time_s, window.current_a, row);
        // Friction acts against the motion: a load that changes does so too.
        let of_friction = |window: &Window, row: &mut [f64]| {
            hat(&knots, window.time_s, window.direction, row);
        };
        let own = self.own_columns();
        let plain = self.fit(knots.len(), of_itself);
        let modulated = match self.equation {
            Equation::Voltage => self.fit(knots.len(), of_resistance),
            Equation::Torque => self.fit(knots.len(), of_friction),
        };
        let better = match (&plain, &modulated) {
            (Some(plain), Some(modulated)) => modulated.adjusted > plain.adjusted,
            (None, Some(_)) => true,
            _ => false,
        };
        let fitted = if better { modulated? } else { plain? };
        let points = match (better, self.equation) {
            (false, _) => self.points(&fitted, at, of_itself),
            (true, Equation::Voltage) => self.points(&fitted, at, of_resistance),
            (true, Equation::Torque) => self.points(&fitted, at, of_friction),
        };
        let region = narrowest(&points, self.equation)?;
        let ends = [
            fitted.coefficients[own],
            fitted.coefficients[own + knots.len() - 1],
        ];
        let resistance = (better && self.equation == Equation::Voltage).then_some(ends);
        Some(self.axis(
            "time_s",
            Shape::Drift { resistance },
            region,
            &fitted,
            WEIGHT_OF_TIME,
        ))
    }

    /// What is the same in every window.
    fn offset(&self) -> Option<Axis> {
        let fitted = self.fit(1, |_, row| row[0] = 1.0)?;
        let by = fitted.coefficients[self.own_columns()];
        let variable = match self.equation {
            Equation::Torque => "offset_n_m",
            Equation::Voltage => "offset_v",
        };
        Some(self.axis(
            variable,
            Shape::Offset { by },
            everywhere(by.min(0.0), by.max(0.0)),
            &fitted,
            PARSIMONY,
        ))
    }

    /// Whether nearly all of the error falls in one direction of motion.
    fn one_way(&self) -> Option<Axis> {
        let mut sums = [(0.0, 0_usize); 2];
        for window in self.windows.of(self.equation) {
            if window.speed_rad_s.abs() > self.windows.dead_zone_rad_s {
                let side = &mut sums[usize::from(window.speed_rad_s > 0.0)];
                side.0 += window.error(self.equation).powi(2) - window.floor(self.equation).powi(2);
                side.1 += 1;
            }
        }
        let power: f64 = sums.iter().map(|side| side.0.max(0.0)).sum();
        let count: usize = sums.iter().map(|side| side.1).sum();
        let forward = sums[1].0 > sums[0].0;
        let side = sums[usize::from(forward)];
        let (share, time) = (side.0 / power, side.1 as f64 / count.max(1) as f64);
        if !(share >= ONE_SIDED && time <= TIME_ONE_SIDED && side.1 >= 20) {
            return None;
        }
        let mut region = if forward {
            everywhere(0.0, 1.0)
        } else {
            everywhere(-1.0, 0.0)
        };
        (region.share_of_error, region.share_of_time) = (share, time);
        Some(Axis {
            equation: self.equation,
            variable: "direction",
            shape: Shape::OneWay { forward },
            region,
            follows: share,
            strength: side.1 as f64,
            // Always after the variables that say more.
            weight: 0.0,
        })
    }
}

const fn everywhere(from: f64, to: f64) -> Region {
    Region {
        from,
        to,
        share_of_error: 1.0,
        share_of_time: 1.0,
        of_size: false,
        from_lowest: true,
        to_highest: true,
    }
}

/// Adds `weight` times the hat functions over `knots` at `value`; outside, the last ones.
fn hat(knots: &[f64], value: f64, weight: f64, row: &mut [f64]) {
    let last = knots.len() - 1;
    let after = knots.partition_point(|knot| *knot <= value);
    if after == 0 {
        row[0] += weight;
    } else if after > last {
        row[last] += weight;
    } else {
        let share = (value - knots[after - 1]) / (knots[after] - knots[after - 1]);
        row[after - 1] += weight * (1.0 - share);
        row[after] += weight * share;
    }
}
