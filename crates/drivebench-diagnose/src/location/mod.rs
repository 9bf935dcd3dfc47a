//! Location of the error, with sign: which equation, over which speeds, currents, angles, times, and its error as a curve.
//!
//! ```text
//! model, run -> windows   error of each equation in overlapping windows, with its deviation by noise, and the part that
//!                  |      a change of the motor's own values explains (reported, or removed)
//!                  |-> regression  the error on hat functions or harmonics of a variable, or on a line in frequency
//!                  |     |-> failures      how much of it follows each variable, and the narrowest range that holds most
//!                  |     |-> curve         the error as a curve over a variable, with its uncertainty
//!                  |     |-> effect_curve  the same without an effect and with it, and the effect drawn through the points
//!                  |     '-> provisional_ranking  effects by the share of the error that each explains, during a run
//!                  |-> torque_map  friction over speed, cogging over a turn, for other programs
//!                  '-> the error over speed x current, with counts
//! ```
//!
//! One mechanism at every sampling period: the model is started afresh from the measurement at the
//! begin of each window, and the weak form is taken of the *difference* between measurement and model. What a coarse
//! quadrature makes of a current with corners is the same in both and cancels; the noise of the initial state obeys the model's
//! own equations and is annihilated; effects, filters and delays of the model need no regressor of their own.

mod curve;
mod effect_curve;
mod failures;
mod provisional_ranking;
mod regression;
mod torque_map;
mod windows;

use serde::Serialize;

pub use self::curve::{AxisFinding, AxisMap, axis_map};
pub(super) use self::effect_curve::with_candidate;
pub use self::effect_curve::{AxisReason, CurvePoint, EffectCurve, effect_curve, error_curve};
pub use self::provisional_ranking::{RankedEffect, provisional_ranking};
pub use self::torque_map::{MapError, MeasuredMap, torque_map};

use self::windows::{FEWEST_HALF, Window, Windows, own_keys};
use super::limits::Limit;
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::findings;
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::statistics::{extent, mean};
use drivebench_model::plant::{Balance, Input, Model, MotorKey, Scenario};

/// A region that holds much of the error of one equation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FailureLocation {
    pub equation: &'static str,
    /// `speed_rad_s`, `current_a`, `angle_rad`, `time_s`, `direction`, `frequency_hz`, `voltage_edge_s` (the error
    /// follows the steps of the voltage, as if they came late), `acceleration_rad_s2`, `current_rate_a_s`.
    pub variable: &'static str,
    pub from: f64,
    pub to: f64,
    /// Share of the equation's squared error beyond the noise that lies from `from` to `to`.
    pub share_of_error: f64,
    pub share_of_time: f64,
    /// Share of the equation's squared error beyond the noise that follows this variable.
    pub follows: f64,
    /// Squared error that follows the variable in units of what chance gives: the larger, the more certain.
    pub strength: f64,
    #[serde(rename = "code")]
    pub form: ErrorForm,
}

findings! {
    /// In which form an error goes with its variable.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum ErrorForm {
        /// Most of it lies below a value, in either direction where the variable's size counts; times count from `begin_s`.
        Below { either_way: bool, begin_s: f64 } = "lies_below",
        Above { either_way: bool, begin_s: f64 } = "lies_above",
        Between { either_way: bool, begin_s: f64 } = "lies_between",
        /// Over nearly all that the run reached.
        Throughout = "follows_throughout",
        /// Equivalent to a motor's value `own` that is too low by `by`.
        ModelValue { key: MotorKey, by: f64, own: f64 } = "model_value_is_off",
        /// Short windows give `own + by` where the fit to the whole run gives `own`.
        WindowValue { key: MotorKey, by: f64, own: f64 } = "windows_contradict_the_fit",
        /// The model has no value.
        ValueBeside { key: MotorKey, by: f64 } = "value_beside_the_model",
        /// Equivalent to a delay of the voltage; whether the sampling resolves it.
        VoltageTiming { delay_s: f64, is_resolved: bool } = "voltage_timing",
        PerTurn { order: usize, amplitude: f64 } = "repeats_per_turn",
        Line { amplitude: f64 } = "line_in_frequency",
        /// Equivalent to a resistance that changes by so much from begin to end.
        ResistanceDrift { by_ohm: f64 } = "resistance_drifts",
        Offset { by: f64 } = "same_everywhere",
        OneWay { forward: bool } = "one_direction_of_motion",
    }
}

findings! {
    /// Whether an equation holds.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    pub enum EquationState {
        #[default]
        Holds = "equation_holds",
        /// Its error depends on no variable, and no noise is known to compare it with.
        Unknown = "equation_not_judged",
        Follows = "equation_fails",
        FollowsNothing = "equation_fails_along_nothing",
    }
}

findings! {
    /// Two locations that are not significantly different.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum Undecided {
        Equations { equations: [&'static str; 2] } = "equations_fail_alike",
        Variables { equation: &'static str, variables: [&'static str; 2], follows: [f64; 2] } = "variables_followed_alike",
    }
}

/// Error of one equation over the run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct EquationBalance {
    pub equation: &'static str,
    pub unit: &'static str,
    /// Error of the balance in units of its noise: one when the equation is right; null where no noise is known.
    pub nres: Option<f64>,
    /// The same after a fit of the equation's own parameters.
    pub nres_refitted: Option<f64>,
    /// Changes of the own parameters, relative to the model's values, that explain most of the error.
    pub own_changes: Vec<OwnChange>,
    /// Root mean square of the equation's error.
    pub rms: f64,
    /// The same over the root mean square of the equation's drive (voltage, or torque of the current).
    pub relative: f64,
    /// Share of both equations' error beyond the noise, each in units of its noise; null where the run has only one.
    pub share_of_error: Option<f64>,
    /// Share of the squared error beyond noise while the shaft turned forward, and the share of the time that it did.
    pub forward_share_of_error: Option<f64>,
    pub forward_share_of_time: Option<f64>,
    pub windows: usize,
    /// Whether the located error is that after a fit of the own parameters, because only the structure is judged, or
    /// because their changes are small.
    pub refitted: bool,
    /// Whether the located error is more than the noise, and more than rounding.
    pub fails: bool,
    #[serde(rename = "code")]
    pub state: EquationState,
}

/// Change of one of the motor's values that this equation estimates.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OwnChange {
    pub key: &'static str,
    /// Positive where the model's value is too low.
    pub by: f64,
    /// Relative to the model's value.
    pub share: f64,
}

/// The locations of a model's error.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Located {
    /// The equation with the larger error first; in it the variable with the largest share. Empty where none fails.
    pub locations: Vec<FailureLocation>,
    /// The larger error first.
    pub balances: Vec<EquationBalance>,
    pub map: Option<ErrorMap>,
    /// Limits of the location.
    pub notes: Vec<Limit>,
}

/// Which error is located.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorOf {
    /// The model with its values unchanged: a wrong resistance is an error proportional to the current.
    Model,
    /// The error that the baseline's own parameters cannot explain, each balance for itself: missing structure. A fit of
    /// the whole model spreads a missing torque over both balances; this reverses it.
    Structure,
}

/// Fewest windows of a balance.
const FEWEST_WINDOWS: usize = 40;
/// A change of an own parameter from this share of its value on is a wrong value, not a bias of the fit.
const MATERIAL_SHARE: f64 = 0.03;
/// A change of a resistance, a back-EMF constant or an inertia from this share on is another machine than the fitted
/// one: removed, the rest of the error would be located where the machine did not change.
const ANOTHER_SHARE: f64 = 0.5;

/// The equations that a run has: without a voltage there is no balance of it.
const fn equations(input: Input) -> &'static [Balance] {
    match input {
        Input::Voltage => &[Balance::Torque, Balance::Voltage],
        Input::Current | Input::Torque => &[Balance::Torque],
    }
}

/// Regions and balances of both equations; empty where nothing fails.
pub fn locate(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    error_of: ErrorOf,
) -> Result<Located, FitError> {
    let mut found = Located::default();
    let mut windows = Windows::new(model, scenario, noise, FEWEST_HALF)?;
    if let Some(missing) = windows.missing_signal() {
        found.notes.push(Limit::NotMeasured { signal: missing });
        return Ok(found);
    }
    for &equation in equations(scenario.input) {
        let usable = windows.of(equation).count();
        if usable < FEWEST_WINDOWS {
            found.notes.push(Limit::FewWindows {
                equation: equation.key(),
                usable,
                needed: FEWEST_WINDOWS,
                length_s: windows.length_s(),
            });
            continue;
        }
        let mut balance = windows.balance(equation, noise);
        refit(&mut windows, equation, &mut balance, noise, model, error_of);
        let ranked = || failures::ranked(&windows, equation, balance.refitted, model, error_of);
        let axes = if balance.fails { ranked() } else { Vec::new() };
        // Without a known noise, an error that depends on no variable may be noise.
        balance.fails &= balance.nres.is_some() || !axes.is_empty();
        balance.state = match (balance.fails, balance.nres.is_some(), axes.is_empty()) {
            (false, false, _) => EquationState::Unknown,
            (false, true, _) => EquationState::Holds,
            (true, _, false) => EquationState::Follows,
            (true, _, true) => EquationState::FollowsNothing,
        };
        found.balances.push(balance);
        found.locations.extend(axes);
    }
    rank(&mut found);
    if scenario.angle.is_empty() && !found.balances.is_empty() {
        found.notes.push(Limit::NoAngle);
    }
    found.map = ErrorMap::of(&windows);
    Ok(found)
}

/// Error of the equations in the first of two runs of one excitation less that in the second, each with its own values of
/// the motor: its locations, the larger error first. Empty where it is no more than the noise of both.
pub(super) fn locate_difference(
    model: &Model,
    [first, second]: [&Scenario; 2],
    noise: &NoiseFloor,
) -> Result<Vec<FailureLocation>, FitError> {
    let equations = [Balance::Torque, Balance::Voltage];
    let mut windows = Windows::new(model, first, noise, FEWEST_HALF)?;
    let mut other = Windows::new(model, second, noise, FEWEST_HALF)?;
    for equation in equations {
        for run in [&mut windows, &mut other] {
            run.fit_own(equation);
        }
    }
    windows.subtract(&other);
    let mut found = Located::default();
    for equation in equations {
        if windows.of(equation).count() < FEWEST_WINDOWS {
            continue;
        }
        let balance = windows.balance(equation, noise);
        if balance.fails {
            let axes = failures::ranked(&windows, equation, true, model, ErrorOf::Structure);
            found.locations.extend(axes);
        }
        found.balances.push(balance);
    }
    rank(&mut found);
    Ok(found.locations)
}

/// Fits the equation's own parameters. Their changes are removed from the windows where only the structure is judged, and
/// where they are small: the fit of a model that lacks an effect has biased values, to which a balance is
/// sensitive. Large ones are reported as wrong values.
fn refit(
    windows: &mut Windows<'_>,
    equation: Balance,
    balance: &mut EquationBalance,
    noise: &NoiseFloor,
    model: &Model,
    error_of: ErrorOf,
) {
    let Some(changes) = windows.fit_own(equation) else { return };
    let changed = own_keys(equation).iter().zip(&changes).map(|(key, by)| OwnChange {
        key: key.key(),
        by: *by,
        share: by / model.motor.get(*key).unwrap_or(f64::NAN),
    });
    balance.own_changes = changed.collect();
    let after = windows.balance(equation, noise);
    balance.nres_refitted = after.nres;
    let is_small = |change: &OwnChange| change.share.abs() < MATERIAL_SHARE;
    let unsure = [MotorKey::LoadTorque, MotorKey::Inductance].map(MotorKey::key);
    let is_another =
        |change: &OwnChange| change.share.abs() > ANOTHER_SHARE && !unsure.contains(&change.key);
    balance.refitted = match error_of {
        ErrorOf::Structure => !balance.own_changes.iter().any(is_another),
        ErrorOf::Model => balance.own_changes.iter().all(is_small),
    };
    if balance.refitted {
        balance.fails = after.fails;
        balance.forward_share_of_error = after.forward_share_of_error;
    } else {
        let back: Vec<f64> = changes.iter().map(|by| -by).collect();
        windows.take_out(equation, &back);
    }
}

/// Located error of a balance in units of its noise.
const fn nres(balance: &EquationBalance) -> Option<f64> {
    if balance.refitted { balance.nres_refitted } else { balance.nres }
}

/// Criterion by which two failing balances are ordered. An error that depends on a variable counts more than a larger one that
/// depends on none.
fn badness(balance: &EquationBalance, locations: &[FailureLocation]) -> f64 {
    let own = locations.iter().find(|location| location.equation == balance.equation);
    let follows = own.map_or(0.0, |location| location.follows);
    nres(balance).unwrap_or(balance.relative) * (0.3 + 0.7 * follows).sqrt()
}

/// Standard deviations within which two values are not significantly different.
const ALIKE_SIGMAS: f64 = 2.0;

/// Whether two equations fail, or two variables explain the error of the worse one, without a significant difference, so that
/// another run or a slightly different model could put the other first.
pub(super) fn undecided(
    balances: &[EquationBalance],
    locations: &[FailureLocation],
) -> Option<Undecided> {
    let worst = balances.first().filter(|balance| balance.fails)?;
    // Neighbouring windows share half of their samples.
    let apart = |balance: &EquationBalance| 0.5 * balance.windows.max(1) as f64;
    if let Some(other) = balances.get(1).filter(|other| other.fails) {
        let size = |balance: &EquationBalance| {
            let size = badness(balance, locations);
            (size, size / (2.0 * apart(balance)).sqrt())
        };
        let ((worse, doubt), (less, other_doubt)) = (size(worst), size(other));
        if worse - less < ALIKE_SIGMAS * doubt.hypot(other_doubt) {
            return Some(Undecided::Equations { equations: [worst.equation, other.equation] });
        }
    }
    let mut of_worst = locations.iter().filter(|l| l.equation == worst.equation);
    let (first, second) = (of_worst.next()?, of_worst.next()?);
    // Of a share of variance from so many values.
    let doubt = |share: f64| {
        let share = share.clamp(0.0, 1.0);
        2.0 * share.sqrt() * (1.0 - share) / apart(worst).sqrt()
    };
    let both = doubt(first.follows).hypot(doubt(second.follows));
    ((first.follows - second.follows).abs() < ALIKE_SIGMAS * both).then_some(Undecided::Variables {
        equation: worst.equation,
        variables: [first.variable, second.variable],
        follows: [first.follows, second.follows],
    })
}

/// The equation with the larger error first: in units of the noise, else relative to its drive.
fn rank(found: &mut Located) {
    let size = |balance: &EquationBalance| badness(balance, &found.locations);
    found.balances.sort_by(|a, b| b.fails.cmp(&a.fails).then(size(b).total_cmp(&size(a))));
    let order: Vec<&str> = found.balances.iter().map(|b| b.equation).collect();
    let place =
        |location: &FailureLocation| order.iter().position(|name| *name == location.equation);
    // A stable sort: within an equation the order of the axes stays.
    found.locations.sort_by_key(place);
    if found.balances.len() == 2 && found.balances.iter().all(|b| nres(b).is_some()) {
        let beyond =
            |balance: &EquationBalance| (nres(balance).unwrap_or(0.0).powi(2) - 1.0).max(0.0);
        let total: f64 = found.balances.iter().map(beyond).sum();
        if total > 0.0 {
            for balance in &mut found.balances {
                balance.share_of_error = Some(beyond(balance) / total);
            }
        }
    }
}

/// Cells along each axis.
const CELLS: usize = 12;

/// Root mean square of each equation's error in the cells of speed x current. Rows are speeds, columns are
/// currents, both from their lowest edge; null in cells that the run did not visit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorMap {
    pub speed_edges_rad_s: Vec<f64>,
    pub current_edges_a: Vec<f64>,
    /// Windows in each cell.
    pub count: Vec<Vec<usize>>,
    pub torque_rms_n_m: Vec<Vec<Option<f64>>>,
    pub voltage_rms_v: Vec<Vec<Option<f64>>>,
    /// Means of the same: positive where the model's torque against positive motion, or its voltage drop, is too low.
    pub torque_mean_n_m: Vec<Vec<Option<f64>>>,
    pub voltage_mean_v: Vec<Vec<Option<f64>>>,
}

/// Sign of a model's error in a cell of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Off {
    TooLow,
    TooHigh,
    /// Of either sign.
    BothWays,
}

/// One cell of the map: from 0 to 9, its largest error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapCell {
    pub digit: usize,
    pub off: Off,
}

impl MapCell {
    /// Digits where the model is too low, letters where it is too high, shades where it is both; readable without colour.
    pub fn glyph(self) -> char {
        let of = |glyphs: &str| glyphs.chars().nth(self.digit).unwrap_or('?');
        match self.off {
            Off::TooLow => of("0123456789"),
            Off::TooHigh => of("0abcdefghi"),
            Off::BothWays => of("0░░░▒▒▒▓▓▓"),
        }
    }
}

/// The map of one equation, readable without colour.
pub struct MapDigits {
    pub largest: f64,
    /// The highest speed first: the middle of the row in rad/s, and its cells, none where the run did not visit them or there
    /// is no error at all.
    pub rows: Vec<(f64, Vec<Option<MapCell>>)>,
}

/// Digit of the largest error.
const LARGEST_DIGIT: f64 = 9.0;
/// Share of the root mean square that a mean must have for its sign to be significant.
const SIGNED_SHARE: f64 = 0.5;

impl ErrorMap {
    /// Error of one equation, cell by cell.
    pub fn cells(&self, equation: &str) -> &[Vec<Option<f64>>] {
        match equation {
            "torque" => &self.torque_rms_n_m,
            _ => &self.voltage_rms_v,
        }
    }

    pub fn digits(&self, equation: &str) -> MapDigits {
        let cells = self.cells(equation);
        let means = match equation {
            "torque" => &self.torque_mean_n_m,
            _ => &self.voltage_mean_v,
        };
        let known = |value: &Option<f64>| value.filter(|value| value.is_finite());
        let largest = cells.iter().flatten().filter_map(known).fold(0.0, f64::max);
        let cell = |(rms, mean): (&Option<f64>, &Option<f64>)| {
            let rms = known(rms).filter(|_| largest > 0.0)?;
            let mean = known(mean).unwrap_or(0.0);
            let off = if mean.abs() < SIGNED_SHARE * rms {
                Off::BothWays
            } else if mean > 0.0 {
                Off::TooLow
            } else {
                Off::TooHigh
            };
            let digit = whole((LARGEST_DIGIT * rms / largest).round());
            Some(MapCell { digit, off })
        };
        let middles = self.speed_edges_rad_s.windows(2).map(|edges| 0.5 * (edges[0] + edges[1]));
        let rows = middles.zip(cells.iter().zip(means)).rev();
        let row = |(middle, (row, means)): (f64, (&Vec<_>, &Vec<_>))| {
            (middle, row.iter().zip(means).map(cell).collect())
        };
        MapDigits { largest, rows: rows.map(row).collect() }
    }

    /// `None` where speed or current did not vary, or was not measured.
    fn of(windows: &Windows<'_>) -> Option<Self> {
        let edges = |value: fn(&Window) -> f64| {
            let values = windows.each.iter().map(value);
            let (from, to) = extent(values.filter(|value| value.is_finite()));
            let edge = |k: usize| from + (to - from) * k as f64 / CELLS as f64;
            (to > from).then(|| (0..=CELLS).map(edge).collect::<Vec<f64>>())
        };
        let (speed, current) = (edges(|w| w.speed_rad_s)?, edges(|w| w.current_a)?);
        let cell = |edges: &[f64], value: f64| {
            let width = (edges[CELLS] - edges[0]) / CELLS as f64;
            whole((value - edges[0]) / width).min(CELLS - 1)
        };
        let known = |w: &&Window| w.speed_rad_s.is_finite() && w.current_a.is_finite();
        let mut inside = vec![vec![Vec::new(); CELLS]; CELLS];
        for window in windows.each.iter().filter(known) {
            let row = cell(&speed, window.speed_rad_s);
            inside[row][cell(&current, window.current_a)].push(window);
        }
        let in_cells = |equation: Balance, value: fn(&[f64]) -> f64| {
            let cell = |own: &Vec<&Window>| {
                let errors = own.iter().map(|window| window.error(equation));
                let errors: Vec<f64> = errors.filter(|error| error.is_finite()).collect();
                (!errors.is_empty()).then(|| value(&errors))
            };
            inside.iter().map(|row| row.iter().map(cell).collect()).collect()
        };
        let rms = |errors: &[f64]| {
            (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
        };
        Some(Self {
            speed_edges_rad_s: speed,
            current_edges_a: current,
            count: inside.iter().map(|row| row.iter().map(Vec::len).collect()).collect(),
            torque_rms_n_m: in_cells(Balance::Torque, rms),
            voltage_rms_v: in_cells(Balance::Voltage, rms),
            torque_mean_n_m: in_cells(Balance::Torque, mean),
            voltage_mean_v: in_cells(Balance::Voltage, mean),
        })
    }
}

#[cfg(test)]
mod tests;
