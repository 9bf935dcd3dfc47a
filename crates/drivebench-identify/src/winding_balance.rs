//! Resistance and back-EMF constant of a run that a commanded current drives: the voltage balance `u = R i + Ke w + U0 sgn(i)`
//! between the steps of the current, where it is constant and the inductance has no part. `U0` takes what drops whatever the
//! current is, else the resistance would.

use nalgebra::{DMatrix, DVector};

use super::verdict::{judge, unknown};
use drivebench_model::numerics::least_squares;
use drivebench_model::numerics::statistics::{largest, median_step};
use drivebench_model::plant::{Model, MotorKey, Scenario, Slot};
use drivebench_model::sample::{ParameterEstimate, Reason};

#[derive(Clone, Debug, PartialEq)]
pub struct Winding {
    /// Resistance, inductance and back-EMF constant, but for those that the model fixes.
    pub parameters: Vec<ParameterEstimate>,
    /// `U0` with its standard deviation, V.
    pub drop_v: (f64, f64),
    /// `R`, `Ke` and `U0`, and the first two of the fit without the drop.
    with_drop: [f64; 3],
    without_drop: [f64; 2],
}

impl Winding {
    /// Root mean square errors of the voltage in another run, V: without the drop and with it.
    pub fn errors_v(&self, run: &Scenario) -> Option<[f64; 2]> {
        let rows = rows_of(run).cells;
        let rms = |values: [f64; 3]| {
            let error = |[amperes, speed, sign, volts]: &[f64; 4]| {
                volts - values[0] * amperes - values[1] * speed - values[2] * sign
            };
            (rows.iter().map(|row| error(row).powi(2)).sum::<f64>() / rows.len() as f64).sqrt()
        };
        let [r, ke] = self.without_drop;
        (!rows.is_empty()).then(|| [rms([r, ke, 0.0]), rms(self.with_drop)])
    }
}

/// Rows between the steps: current, speed, sign of the current and voltage; the step before each, and the rate of the speed.
struct Rows {
    cells: Vec<[f64; 4]>,
    steps: Vec<usize>,
    rates: Vec<f64>,
}

fn rows_of(scenario: &Scenario) -> Rows {
    let times = &scenario.sample_time_s;
    let period_s = median_step(times);
    // Below, the drive may have released the motor, whose terminals it then does not hold.
    let least_a = 0.05 * largest(scenario.events.iter().map(|event| event.1));
    let steps_s = &scenario.current_steps_s;
    let (mut cells, mut steps, mut rates) = (Vec::new(), Vec::new(), Vec::new());
    // Over some samples on either side, where the current is constant as well.
    let rate = |sample: usize| {
        let (from, to) = (sample.saturating_sub(1), (sample + 1).min(times.len() - 1));
        let speeds = &scenario.speed_rad_s;
        let change = (speeds[to] - speeds[from]) / (times[to] - times[from]);
        if change.is_finite() { change } else { 0.0 }
    };
    for (sample, volts) in scenario.voltage_v.iter().enumerate() {
        let (time_s, speed_rad_s) = (times[sample], scenario.speed_rad_s[sample]);
        let amperes = scenario.input_at(time_s);
        let step = steps_s.partition_point(|step_s| *step_s <= time_s);
        let from_s = step.checked_sub(1).map_or(f64::NEG_INFINITY, |step| steps_s[step]);
        // The next step shows in the voltage before it shows in the speed.
        let until_s = steps_s.get(step).copied().unwrap_or(f64::INFINITY);
        // A current loop settles within milliseconds.
        let is_settled = time_s - from_s > 1.5 * period_s && until_s - time_s > period_s;
        let is_whole = volts.is_finite() && speed_rad_s.is_finite();
        if is_settled && is_whole && amperes.abs() > least_a {
            cells.push([amperes, speed_rad_s, amperes.signum(), *volts]);
            steps.push(step);
            rates.push(rate(sample));
        }
    }
    Rows { cells, steps, rates }
}

/// `None` where the run has no voltage with a commanded current, or too few rows of it.
pub fn fit(model: &Model, scenario: &Scenario) -> Option<Winding> {
    let Rows { cells: rows, steps, rates } = rows_of(scenario);
    let period_s = median_step(&scenario.sample_time_s);
    // Twenty for each unknown.
    if rows.len() < 60 {
        return None;
    }
    let matrix = DMatrix::from_fn(rows.len(), 3, |row, column| rows[row][column]);
    let right = DVector::from_fn(rows.len(), |row, _| rows[row][3]);
    let solution = least_squares::solve(&matrix, &right, &steps)?;
    // What a lag of the speed that is one of the current instead does to each value: it adds `Ke w' lag`. Half of it is assumed; none
    // and all of it are one standard deviation away, because most drives are near one end.
    let share_s = 0.5 * scenario.doubtful_lag_s();
    let added = DVector::from_vec(rates.iter().map(|w| solution.x[1] * w * share_s).collect());
    let by_lag = least_squares::solve(&matrix, &added, &steps)?.x;
    let std = |at: usize| solution.covariance[(at, at)].max(0.0).sqrt().hypot(by_lag[at]);
    let estimate = |key: MotorKey, at: usize| {
        judge(&Slot::Motor(key), solution.x[at], Some(std(at)), period_s)
    };
    let inductance = unknown(
        MotorKey::Inductance,
        Reason::SampledTooSlowly,
        "the drive controls the current: it is constant between its steps, and those are over between two samples",
    );
    let all = [estimate(MotorKey::Resistance, 0), inductance, estimate(MotorKey::BackEmf, 1)];
    let plain = least_squares::solve(&matrix.columns(0, 2).into_owned(), &right, &steps)?.x;
    let is_free = |own: &ParameterEstimate| !model.fixed.contains(&own.key);
    Some(Winding {
        parameters: all.into_iter().filter(is_free).collect(),
        drop_v: (solution.x[2], std(2)),
        with_drop: [solution.x[0], solution.x[1], solution.x[2]],
        without_drop: [plain[0], plain[1]],
    })
}

/// The model with the constants of a run, for its torque balance, and the relative standard deviation of the torque constant that follows.
pub fn with_constants(model: &Model, scenario: &Scenario) -> (Model, f64) {
    let mut model = model.clone();
    let found = fit(&model, scenario).map_or_else(Vec::new, |winding| winding.parameters);
    let deviation = super::balance::set_motor(&mut model, &found);
    (model, deviation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_found, judged, unknown as unknown_motor};
    use drivebench_model::plant::testing::run_of;
    use drivebench_model::sample::{Channel, Origin, Verdict};

    /// Currents of two sizes that alternate each second, a triangle of speed, and the voltage of `R` 1.1 ohm, `Ke` 0.35 V.s/rad and a
    /// drop; the row after each step has the voltage of the transient.
    fn scenario(drop_v: f64) -> Scenario {
        let times: Vec<f64> = (0..2000).map(|row| 0.01 * f64::from(row)).collect();
        let level = |time_s: f64| {
            let way: f64 = if time_s.rem_euclid(2.0) < 1.0 { 1.0 } else { -1.0 };
            if time_s < 1.0 { 0.0 } else { way * if time_s % 4.0 < 2.0 { 2.0 } else { 5.0 } }
        };
        let speed = |time_s: f64| 100.0 - 200.0 * (time_s.rem_euclid(2.0) - 1.0).abs();
        let is_transient = |time_s: f64| time_s.fract() < 0.012;
        let volts = |time_s: f64| {
            let amperes: f64 = level(time_s);
            let transient = if is_transient(time_s) { 8.0 * amperes.signum() } else { 0.0 };
            1.1 * amperes + 0.35 * speed(time_s) + drop_v * amperes.signum() + transient
        };
        let column = |of: &dyn Fn(f64) -> f64| times.iter().map(|time_s| of(*time_s)).collect();
        let columns = [
            (Channel::CurrentCmd, column(&level), Origin::Commanded),
            (Channel::Voltage, column(&volts), Origin::Measured),
            (Channel::Speed, column(&speed), Origin::Measured),
        ];
        Scenario::from_run(&run_of("r", times.clone(), columns)).unwrap()
    }

    #[test]
    fn resistance_and_back_emf_follow_from_the_voltage_between_the_steps() {
        for drop_v in [0.0, 1.5] {
            let winding = fit(&unknown_motor(), &scenario(drop_v)).unwrap();
            assert!((winding.drop_v.0 - drop_v).abs() < 0.02, "{:?}", winding.drop_v);
            let found = winding.parameters;
            assert_found(&found, "resistance_ohm", 1.1, 0.01);
            assert_found(&found, "back_emf_v_s_per_rad", 0.35, 0.002);
            judged(&found, "inductance_h", Verdict::NotObservable);
        }
    }

    #[test]
    fn a_fixed_value_stays_and_a_run_without_voltage_gives_nothing() {
        let run = scenario(0.0);
        let mut model = unknown_motor();
        model.fixed.push("resistance_ohm".to_owned());
        let found = fit(&model, &run).unwrap().parameters;
        assert!(found.iter().all(|own| own.key != "resistance_ohm"));
        let silent = Scenario { voltage_v: Vec::new(), ..run };
        assert_eq!(fit(&model, &silent), None);
        assert!(with_constants(&model, &silent).1.abs() < 1e-12);
    }
}
