//! Whether what is missing shows in the records, and nothing where nothing is: by fits of the plain machine that share no line
//! with the program's.

use super::bench::{Log, Run};
use super::clean::Plain;
use super::judge::{Case, Truth};

/// Longest step of the plain machine, s.
const STEP_S: f64 = 1e-4;
/// Error of the plain machine, in units of the noise, from which on something is missing without a doubt.
const CLEAR: f64 = 2.0;
const ITERATIONS: usize = 25;
/// Length of a window of the balance of torques, s.
const WINDOW_S: f64 = 0.16;

struct Record {
    time_s: Vec<f64>,
    voltage_v: Vec<f64>,
    /// Current and speed.
    measured: [Vec<f64>; 2],
    noise: [f64; 2],
}

fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (square / values.len() as f64).sqrt()
}

/// Standard deviation that a sensor of steps has at least: of the smallest difference of two readings, evenly spread.
fn of_steps(values: &[f64]) -> f64 {
    let steps = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let least = steps.filter(|step| *step > 1e-9).fold(f64::INFINITY, f64::min);
    least / 12_f64.sqrt()
}

impl Record {
    fn of(log: &Log, map: &str) -> Option<Self> {
        let signal = |target: &str| log.signal(map, target);
        let (time_s, voltage_v) = (signal("time_s")?, signal("voltage_v")?);
        let measured = [signal("current_a")?, signal("speed_rad_s")?];
        let rest = voltage_v.iter().take_while(|u| u.abs() < 1e-9).count();
        let noise = [0, 1].map(|n: usize| {
            let measured: &Vec<f64> = &measured[n];
            deviation(&measured[..rest]).max(of_steps(measured))
        });
        Some(Self { time_s, voltage_v, measured, noise })
    }

    /// What the plain machine of these parameters (their logarithms) would have shown, less what was measured, in units of the noise.
    fn errors(&self, logarithms: &[f64; 5]) -> Vec<f64> {
        let mut plain = Plain::of(logarithms.map(f64::exp));
        let mut errors = Vec::with_capacity(2 * self.time_s.len());
        for (row, time_s) in self.time_s.iter().enumerate() {
            errors.push((plain.current_a - self.measured[0][row]) / self.noise[0]);
            errors.push((plain.speed_rad_s - self.measured[1][row]) / self.noise[1]);
            let until_s = self.time_s.get(row + 1).unwrap_or(time_s);
            let steps = ((until_s - time_s) / STEP_S).ceil().max(1.0);
            let step_s = (until_s - time_s) / steps;
            let mut done = 0.0;
            while done < steps {
                plain.step(self.voltage_v[row], step_s);
                done += 1.0;
            }
        }
        errors
    }
}

fn rms(errors: &[f64]) -> f64 {
    (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Solves normal equations by elimination with pivots; `damping` is added to the diagonal in its own measure.
fn solved(mut matrix: Vec<Vec<f64>>, mut right: Vec<f64>, damping: f64) -> Vec<f64> {
    let n = right.len();
    for (k, row) in matrix.iter_mut().enumerate() {
        row[k] += damping * row[k] + f64::MIN_POSITIVE;
    }
    for k in 0..n {
        let largest = |a: &usize, b: &usize| matrix[*a][k].abs().total_cmp(&matrix[*b][k].abs());
        let pivot = (k..n).max_by(largest).unwrap_or(k);
        matrix.swap(k, pivot);
        right.swap(k, pivot);
        for other in (0..n).filter(|other| *other != k) {
            let share = matrix[other][k] / matrix[k][k];
            let own = matrix[k].clone();
            for (cell, of_pivot) in matrix[other].iter_mut().zip(own) {
                *cell -= share * of_pivot;
            }
            right[other] -= share * right[k];
        }
    }
    (0..n).map(|k| right[k] / matrix[k][k]).collect()
}

/// Gram matrix of columns, and their products with what they are to explain.
fn normal_equations(columns: &[Vec<f64>], wanted: &[f64]) -> (Vec<Vec<f64>>, Vec<f64>) {
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let gram = |a: &Vec<f64>| columns.iter().map(|b| product(a, b)).collect();
    let right = columns.iter().map(|a| product(a, wanted)).collect();
    (columns.iter().map(gram).collect(), right)
}

/// Parameters of the plain machine by Levenberg (1944) and Marquardt (1963), from a rough start.
fn fitted(record: &Record, start: [f64; 5]) -> [f64; 5] {
    let (mut best, mut damping) = (start, 1e-2);
    let mut errors = record.errors(&best);
    for _ in 0..ITERATIONS {
        let columns: Vec<Vec<f64>> = (0..5)
            .map(|n| {
                let mut beside = best;
                beside[n] += 1e-4;
                let changed = record.errors(&beside);
                let pairs = changed.iter().zip(&errors);
                pairs.map(|(b, a)| (b - a) / 1e-4).collect()
            })
            .collect();
        let (gram, right) = normal_equations(&columns, &errors);
        for _ in 0..6 {
            let step = solved(gram.clone(), right.clone(), damping);
            let trial: [f64; 5] = std::array::from_fn(|n| best[n] - step[n].clamp(-1.0, 1.0));
            let next = record.errors(&trial);
            if rms(&next) < rms(&errors) {
                (best, errors, damping) = (trial, next, 0.2 * damping);
                break;
            }
            damping *= 5.0;
        }
    }
    best
}

/// Held-out error of the plain machine in units of the noise: of the fit itself, and on the two other runs.
fn by_simulation(case: &Case, seed: u64) -> Option<[f64; 3]> {
    let records = Run::ALL.map(|run| Record::of(&(case.record)(seed, run), case.map));
    let [fit, holdout, confirm] = records;
    let (fit, holdout, confirm) = (fit?, holdout?, confirm?);
    let start = case.about.map(f64::ln);
    let own = fitted(&fit, start);
    Some([&fit, &holdout, &confirm].map(|record| rms(&record.errors(&own))))
}

/// Windows of the balance of torques: inertia and dry friction, then each column of what is missing; and the torque.
fn windows(log: &Log, case: &Case) -> Option<(Vec<Vec<f64>>, Vec<f64>)> {
    let time_s = log.signal(case.map, "time_s")?;
    let torque_n_m = log.signal(case.map, "torque_n_m")?;
    let angle_rad = log.signal(case.map, "angle_rad");
    let derived = |angle: &Vec<f64>| {
        let mut speed = vec![0.0; angle.len()];
        for n in 1..angle.len() - 1 {
            speed[n] = (angle[n + 1] - angle[n - 1]) / (time_s[n + 1] - time_s[n - 1]);
        }
        speed
    };
    let speed = log.signal(case.map, "speed_rad_s");
    let speed = speed.or_else(|| angle_rad.as_ref().map(derived))?;
    let top = speed.iter().fold(0.0, |top: f64, w| top.max(w.abs()));
    let dry = |w: &f64| (w / (0.003 * top)).tanh();
    let of_speed = |of: &dyn Fn(&f64) -> f64| speed.iter().map(of).collect::<Vec<f64>>();
    let of_angle = |of: &dyn Fn(&f64) -> f64| {
        angle_rad.as_ref().map(|angle| angle.iter().map(of).collect::<Vec<f64>>())
    };
    let mut integrated = vec![of_speed(&dry)];
    integrated.extend(of_angle(&|q| q.sin()));
    integrated.extend(of_angle(&|q| q.cos()));
    integrated.push(of_speed(&|w| {
        if angle_rad.is_some() { *w } else { w * w.abs() }
    }));
    let length = time_s.iter().position(|t| *t > WINDOW_S)?;
    let starts: Vec<usize> = (0..time_s.len() - length).step_by(length).collect();
    let over = |signal: &Vec<f64>| -> Vec<f64> {
        let window = |from: &usize| -> f64 {
            let rows = *from..from + length;
            rows.map(|n| 0.5 * (signal[n] + signal[n + 1]) * (time_s[n + 1] - time_s[n])).sum()
        };
        starts.iter().map(window).collect()
    };
    let change = starts.iter().map(|from| speed[from + length] - speed[*from]);
    let mut columns = vec![change.collect()];
    columns.extend(integrated.iter().map(over));
    Some((columns, over(&torque_n_m)))
}

/// Held-out error of the balance of torques without and with what is missing, N.m.s.
fn by_balance(case: &Case, seed: u64) -> Option<[f64; 2]> {
    let fit = windows(&(case.record)(seed, Run::Fit), case)?;
    let holdout = windows(&(case.record)(seed, Run::Holdout), case)?;
    let error = |columns: usize| {
        let (gram, right) = normal_equations(&fit.0[..columns], &fit.1);
        let own = solved(gram, right, 0.0);
        let rows = holdout.1.iter().enumerate();
        let errors = rows.map(|(row, torque)| {
            let parts = own.iter().zip(&holdout.0);
            torque - parts.map(|(size, column)| size * column[row]).sum::<f64>()
        });
        rms(&errors.collect::<Vec<f64>>())
    };
    Some([error(2), error(fit.0.len())])
}

/// What the records of a machine show: a line for the table, and whether it is as the truth says.
pub(crate) fn shown(case: &Case, seed: u64) -> (String, bool) {
    if let Some([fit, holdout, confirm]) = by_simulation(case, seed) {
        let line = format!(
            "{:<42} {seed:>4}  plain machine: fit {fit:.2}, holdout {holdout:.2}, confirm {confirm:.2} times the noise",
            case.name
        );
        let is_true = match case.truth {
            Truth::Nothing { at_most } => holdout < at_most && confirm < at_most,
            _ => holdout > CLEAR && confirm > CLEAR,
        };
        return (line, is_true);
    }
    let [before, after] = by_balance(case, seed).unwrap_or([f64::NAN; 2]);
    let line = format!(
        "{:<42} {seed:>4}  balance of torques: held out {before:.4} -> {after:.4} N.m.s",
        case.name
    );
    (line, after < 0.5 * before)
}
