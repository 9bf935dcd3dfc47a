//! Where the model fails: which equation, and over which speeds, currents, angles, times.
//!
//! ```text
//! model, run -> balance    what each equation lacks in overlapping windows, with the floor that noise alone gives
//!                  |-> own        what a change of the motor's own values would explain (told, or taken out)
//!                  |-> axis       how much of it follows speed, current, angle, time, voltage edges, a line in frequency
//!                  |-> region     the narrowest range that holds most of it
//!                  |-> words      one sentence each
//!                  '-> map        the error over speed x current, with counts
//! ```
//!
//! DISCOVERY.md 2.9. One mechanism at every sampling period: the model is started afresh from the measurement at the
//! begin of each window, and the weak form is taken of the *difference* between measurement and model. What a coarse
//! quadrature makes of a current with corners is the same in both and cancels; the noise of the start obeys the model's
//! own equations and is annihilated; effects, filters and delays of the model need no regressor of their own.

mod axis;
mod balance;
mod fit;
mod line;
mod map;
mod own;
mod region;
mod words;

use serde::Serialize;

use self::axis::Axis;
use self::balance::Windows;
pub use self::map::ErrorMap;
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::FitError;
use crate::plant::{Input, Model, Scenario};

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
    pub sentence: String,
}

/// What one equation lacks altogether.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EquationBalance {
    pub equation: &'static str,
    pub unit: &'static str,
    /// Error of the balance over what noise alone gives: one when the equation is right; null where no noise is known.
    pub nres: Option<f64>,
    /// The same after the equation's own parameters were allowed to move: what no value of them explains.
    pub nres_refitted: Option<f64>,
    /// Which moves of the own parameters, relative to the model's values, would explain most of the error.
    pub own_changes: Vec<OwnChange>,
    /// Root mean square of what the equation lacks.
    pub rms: f64,
    /// The same over the root mean square of the equation's drive (voltage, or torque of the current).
    pub relative: f64,
    /// Share of both equations' error beyond the noise, each in units of its noise; null where only one can be asked.
    pub share_of_error: Option<f64>,
    /// Share of the squared error beyond noise while the shaft turned forward, and the share of the time that it did.
    pub forward_share_of_error: Option<f64>,
    pub forward_share_of_time: Option<f64>,
    pub windows: usize,
    /// Whether what is located is the error after the own parameters moved, because only the structure was asked for, or
    /// because the moves are small.
    pub refitted: bool,
    /// Whether the located error is more than the noise, and more than the arithmetic.
    pub fails: bool,
    pub sentence: String,
}

/// How far one of the motor's values is from what this equation asks for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OwnChange {
    pub key: &'static str,
    /// Positive where the model's value is too low.
    pub by: f64,
    /// Of the model's value.
    pub share: f64,
}

/// Everything that is known of the places where a model fails.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Located {
    /// The worse equation first; in it the variable that it follows most. Empty where nothing fails.
    pub locations: Vec<FailureLocation>,
    /// The worse first.
    pub balances: Vec<EquationBalance>,
    pub map: Option<ErrorMap>,
    /// What could not be asked, and why.
    pub notes: Vec<String>,
}

/// Which error is located.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorOf {
    /// The model with its values as they are: a wrong resistance shows as an error that follows the current.
    Model,
    /// What the baseline's own parameters cannot explain, each balance for itself: where something is missing. A fit of
    /// the whole model spreads a missing torque over both balances; this takes that back.
    Structure,
}

/// One of the two equations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Equation {
    Torque,
    Voltage,
}

impl Equation {
    const fn name(self) -> &'static str {
        match self {
            Self::Torque => "torque",
            Self::Voltage => "voltage",
        }
    }

    const fn unit(self) -> &'static str {
        match self {
            Self::Torque => "N.m",
            Self::Voltage => "V",
        }
    }
}

/// Windows below which nothing is said.
const FEWEST_WINDOWS: usize = 40;
/// A balance within this multiple of the noise lacks nothing that can be seen.
const LARGEST_NRES: f64 = 1.15;
/// A move of an own parameter from this share of its value on is a wrong value, not the trace of a fit.
const MATERIAL: f64 = 0.03;
/// Without a known noise: share of the drive below which an error is arithmetic.
const ARITHMETIC: f64 = 1e-4;

/// Regions and balances of both equations; empty where nothing fails.
pub fn locate(
    model: &Model,
    scenario: &Scenario,
    noise: &NoiseFloor,
    error_of: ErrorOf,
) -> Result<Located, FitError> {
    let mut found = Located::default();
    let mut windows = Windows::new(model, scenario, noise)?;
    if windows.too_few_signals(&mut found.notes) {
        return Ok(found);
    }
    let mut equations = vec![Equation::Torque];
    if scenario.input == Input::Voltage {
        equations.push(Equation::Voltage);
    }
    for equation in equations {
        let usable = windows.usable(equation);
        if usable < FEWEST_WINDOWS {
            found.notes.push(format!(
                "{} equation: {usable} usable windows of {:.0} ms, at least {FEWEST_WINDOWS} are needed to say where it \
                 fails: record a longer run{}",
                equation.name(),
                1e3 * windows.length_s(),
                if equation == Equation::Torque { " in which the shaft turns" } else { "" }
            ));
            continue;
        }
        let mut balance = windows.balance(equation, noise);
        let refitted = refit(&mut windows, &mut balance, noise, model, error_of);
        let axes = if balance.fails {
            axis::ranked(&windows, equation, refitted, model)
        } else {
            Vec::new()
        };
        // Without a known noise, what follows nothing may be the noise.
        balance.fails &= balance.nres.is_some() || !axes.is_empty();
        words::describe(&mut balance, axes.first());
        found.balances.push(balance);
        found
            .locations
            .extend(axes.into_iter().map(Axis::into_location));
    }
    rank(&mut found);
    if scenario.angle.is_empty() && !found.balances.is_empty() {
        found.notes.push(
            "no angle was measured: it is integrated from the speed and drifts, so that an error that follows the angle \
             may go unseen"
                .to_owned(),
        );
    }
    found.map = map::of(&windows);
    Ok(found)
}

/// What the equations lack in the first of two runs of one excitation and not in the second, each with its own values of
/// the motor: what it follows, the worse equation first. Empty where that is no more than the noise of both.
pub(super) fn locate_difference(
    model: &Model,
    [first, second]: [&Scenario; 2],
    noise: &NoiseFloor,
) -> Result<Vec<FailureLocation>, FitError> {
    let mut windows = Windows::new(model, first, noise)?;
    let mut other = Windows::new(model, second, noise)?;
    for equation in [Equation::Torque, Equation::Voltage] {
        for run in [&mut windows, &mut other] {
            if let Some(changes) = own::changes(run, equation) {
                own::take_out(run, equation, &changes);
            }
        }
    }
    windows.subtract(&other);
    let mut found = Located::default();
    for equation in [Equation::Torque, Equation::Voltage] {
        if windows.usable(equation) < FEWEST_WINDOWS {
            continue;
        }
        let balance = windows.balance(equation, noise);
        if balance.fails {
            let axes = axis::ranked(&windows, equation, true, model);
            found
                .locations
                .extend(axes.into_iter().map(Axis::into_location));
        }
        found.balances.push(balance);
    }
    rank(&mut found);
    Ok(found.locations)
}

/// Lets the equation's own parameters move. The moves stay taken out of the windows where that is asked, and where they
/// are small: a fit of the whole model that lacks something leaves values that are a little off, and a balance sees
/// them well. Large ones are a fault of their own. Returns whether they were taken out.
fn refit(
    windows: &mut Windows<'_>,
    balance: &mut EquationBalance,
    noise: &NoiseFloor,
    model: &Model,
    error_of: ErrorOf,
) -> bool {
    let equation = if balance.equation == Equation::Torque.name() {
        Equation::Torque
    } else {
        Equation::Voltage
    };
    let Some(changes) = own::changes(windows, equation) else {
        return false;
    };
    balance.own_changes = own::keys(equation)
        .iter()
        .zip(&changes)
        .map(|(key, by)| OwnChange {
            key: key.key(),
            by: *by,
            share: by / model.motor.get(*key).unwrap_or(f64::NAN),
        })
        .collect();
    own::take_out(windows, equation, &changes);
    let after = windows.balance(equation, noise);
    balance.nres_refitted = after.nres;
    let small = balance
        .own_changes
        .iter()
        .all(|change| change.share.abs() < MATERIAL);
    if error_of == ErrorOf::Structure || small {
        balance.fails = after.fails;
        balance.forward_share_of_error = after.forward_share_of_error;
        balance.refitted = true;
        return true;
    }
    let back: Vec<f64> = changes.iter().map(|by| -by).collect();
    own::take_out(windows, equation, &back);
    false
}

/// Error of a balance in units of its noise, of what is located.
const fn nres(balance: &EquationBalance) -> Option<f64> {
    if balance.refitted {
        balance.nres_refitted
    } else {
        balance.nres
    }
}

/// By what two failing balances are compared. An error that follows something says more than a larger one that follows
/// nothing.
fn badness(balance: &EquationBalance, locations: &[FailureLocation]) -> f64 {
    let follows = locations
        .iter()
        .find(|location| location.equation == balance.equation)
        .map_or(0.0, |location| location.follows);
    nres(balance).unwrap_or(balance.relative) * (0.3 + 0.7 * follows).sqrt()
}

/// Standard deviations within which two figures are alike.
const ALIKE: f64 = 2.0;

/// Where two equations fail alike, or the error of the worse one follows two variables alike, so that another run or a
/// model that is nearly the same would put the other first: that neither is known to be the one.
pub(super) fn undecided(
    balances: &[EquationBalance],
    locations: &[FailureLocation],
) -> Option<String> {
    let worst = balances.first().filter(|balance| balance.fails)?;
    // Neighbouring windows share half of their samples.
    let apart = |balance: &EquationBalance| 0.5 * balance.windows.max(1) as f64;
    if let Some(other) = balances.get(1).filter(|other| other.fails) {
        let size = |balance: &EquationBalance| {
            let size = badness(balance, locations);
            (size, size / (2.0 * apart(balance)).sqrt())
        };
        let ((worse, doubt), (less, other_doubt)) = (size(worst), size(other));
        if worse - less < ALIKE * doubt.hypot(other_doubt) {
            return Some(format!(
                "the {} and the {} equation fail alike: which of them lacks something these runs do not tell",
                worst.equation, other.equation
            ));
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
    ((first.follows - second.follows).abs() < ALIKE * both).then(|| {
        format!(
            "the {} error follows the {} and the {} alike ({:.0} and {:.0} %): which of them these runs do not tell",
            worst.equation,
            words::name_of_variable(first.variable),
            words::name_of_variable(second.variable),
            100.0 * first.follows,
            100.0 * second.follows
        )
    })
}

/// The equation that fails worse first: by its error in units of the noise, else beside its drive.
fn rank(found: &mut Located) {
    let locations = &found.locations;
    found.balances.sort_by(|a, b| {
        let sizes = badness(b, locations).total_cmp(&badness(a, locations));
        b.fails.cmp(&a.fails).then(sizes)
    });
    let order: Vec<&str> = found.balances.iter().map(|b| b.equation).collect();
    let place =
        |location: &FailureLocation| order.iter().position(|name| *name == location.equation);
    // Stable: within an equation the order of the axes stays.
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

#[cfg(test)]
mod tests;
