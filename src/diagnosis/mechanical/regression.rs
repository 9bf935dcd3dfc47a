//! Least squares of the torque balance: coefficients linear, forms of effects by search over them.

use nalgebra::{DMatrix, DVector};

use super::terms;
use crate::identification::torque_rows::TorqueRows;
use crate::identification::verdict::judge;
use crate::numerics::count::whole;
use crate::numerics::{least_squares, statistics};
use crate::plant::{Balance, Model, MotorKey, ParameterRole, Slot};
use crate::sample::{ParameterEstimate, Verdict};

/// Shortest block of the clustered covariance, s (DISCOVERY.md 2.12), and the fewest blocks.
const BLOCK_S: f64 = 0.25;
const FEWEST_BLOCKS: f64 = 20.0;
/// Intervals of a fit whose residual is not white are this much wider (DISCOVERY.md 2.12).
const WIDENED: f64 = 2.0;
/// Autocorrelation of neighbouring rows beyond what overlapping windows give.
const NOT_WHITE: f64 = 0.4;
/// First step of the search over a form: relative for logarithmic ones; and the halvings that follow.
const FIRST_STEP: f64 = 0.35;
const HALVINGS: usize = 7;
/// Passes for coefficients that are only nearly proportional.
const PASSES: usize = 4;
const PROPORTIONAL: f64 = 1e-6;

/// The fitted balance.
#[derive(Clone, Debug)]
pub(in crate::diagnosis) struct BalanceFit {
    pub(super) model: Model,
    /// Every parameter of the model, in the order of its slots.
    pub(super) parameters: Vec<ParameterEstimate>,
    pub(super) residual: Vec<f64>,
}

impl BalanceFit {
    pub(super) fn rms(&self) -> f64 {
        let squares: f64 = self.residual.iter().map(|r| r * r).sum();
        (squares / self.residual.len().max(1) as f64).sqrt()
    }
}

/// Whether a slot is a linear unknown of the torque balance.
fn is_linear(slot: &Slot, model: &Model) -> bool {
    match slot {
        Slot::Motor(key) => matches!(key, MotorKey::Inertia | MotorKey::LoadTorque),
        Slot::Effect { index, spec, .. } => {
            spec.is_coefficient()
                && model.effects[*index]
                    .effect
                    .card()
                    .enters
                    .includes(Balance::Torque)
        }
    }
}

/// Motor slots are there even where the model leaves them out.
fn unknowns(model: &Model) -> Vec<Slot> {
    let mut slots = vec![
        Slot::Motor(MotorKey::Inertia),
        Slot::Motor(MotorKey::LoadTorque),
    ];
    slots.extend(
        model
            .slots()
            .into_iter()
            .filter(|slot| matches!(slot, Slot::Effect { .. }) && is_linear(slot, model)),
    );
    slots
}

fn is_fixed(model: &Model, slot: &Slot) -> bool {
    model.fixed.contains(&slot.key()) && model.get(slot).is_some()
}

/// What one unit of the unknown contributes to each row.
pub(super) fn column(model: &Model, slot: &Slot, rows: &TorqueRows) -> Vec<f64> {
    match *slot {
        Slot::Motor(MotorKey::Inertia) => rows.inertia.clone(),
        Slot::Motor(_) => {
            let signs: Vec<f64> = rows.at.iter().map(|at| at.speed_rad_s.signum()).collect();
            rows.column(&signs)
        }
        Slot::Effect {
            index,
            parameter,
            spec,
            ..
        } => {
            let active = &model.effects[index];
            let values = active.values_or_guess();
            let probe = active.values[parameter]
                .filter(|value| *value != 0.0)
                .unwrap_or(spec.scale);
            terms::column(active.effect, &values, parameter, probe, rows)
        }
    }
}

/// What the model, as it stands, says of the torque in each row.
pub(super) fn predicted(model: &Model, rows: &TorqueRows) -> Vec<f64> {
    let mut sum = vec![0.0; rows.rows()];
    for slot in unknowns(model) {
        let value = model.get(&slot).unwrap_or(0.0);
        for (sum, cell) in sum.iter_mut().zip(column(model, &slot, rows)) {
            *sum += value * cell;
        }
    }
    sum
}

/// The model with every time of an event found anew in these rows.
pub(in crate::diagnosis) fn with_events_of(model: &Model, rows: &TorqueRows) -> Model {
    let mut model = model.clone();
    let slots: Vec<Slot> = model
        .slots()
        .into_iter()
        .filter(|slot| slot.has_role(ParameterRole::EventTime))
        .collect();
    for slot in slots {
        let Slot::Effect { spec, .. } = slot else {
            continue;
        };
        let cost = |model: &Model| -> f64 {
            let pairs = rows.left.iter().zip(predicted(model, rows));
            pairs.map(|(left, sum)| (left - sum).powi(2)).sum()
        };
        let span_s = rows.time_s.last().unwrap_or(&0.0) - rows.time_s.first().unwrap_or(&0.0);
        let given = model.get(&slot);
        let tried: Vec<f64> = terms::event_times(spec.shapes, rows)
            .into_iter()
            .chain(given)
            .collect();
        let best = tried
            .into_iter()
            .map(|time_s| {
                model.set(&slot, time_s);
                (cost(&model), time_s)
            })
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((mut least, mut best_s)) = best else {
            continue;
        };
        let mut step_s = span_s / 24.0;
        for _ in 0..8 {
            for there_s in [best_s - step_s, best_s + step_s] {
                model.set(&slot, there_s.max(0.0));
                let found = cost(&model);
                if found < least {
                    (least, best_s) = (found, there_s.max(0.0));
                }
            }
            step_s *= 0.5;
        }
        model.set(&slot, best_s);
    }
    model
}

/// Fits every free parameter of the model to the rows; forms of effects start where the model has them. What can only
/// take power from the shaft is not let below zero. `None` where a term is not known in these rows, or there are too few of
/// them.
pub(super) fn fit(model: &Model, rows: &TorqueRows) -> Option<BalanceFit> {
    let mut model = model.clone();
    let forms: Vec<Slot> = forms_of(&model)
        .into_iter()
        .filter(|slot| !slot.has_role(ParameterRole::Choice))
        .collect();
    if !forms.is_empty() {
        search(&mut model, &forms, rows);
    }
    finish(model, rows)
}

/// Parameters of the torque balance that are not coefficients and not fixed.
fn forms_of(model: &Model) -> Vec<Slot> {
    let is_form = |slot: &Slot| match slot {
        Slot::Effect { index, spec, .. } => {
            !spec.is_coefficient()
                && !model.fixed.contains(&slot.key())
                && model.effects[*index]
                    .effect
                    .card()
                    .enters
                    .includes(Balance::Torque)
        }
        Slot::Motor(_) => false,
    };
    model.slots().into_iter().filter(is_form).collect()
}

/// Sum of squares that the model leaves with its forms as they are.
fn cost(model: &Model, rows: &TorqueRows) -> f64 {
    System::new(model, rows).map_or(f64::INFINITY, |system| system.cost())
}

/// Coordinate search with halving steps.
fn search(model: &mut Model, forms: &[Slot], rows: &TorqueRows) {
    let span_s = rows.time_s.last().unwrap_or(&0.0) - rows.time_s.first().unwrap_or(&0.0);
    for slot in forms {
        if let (Slot::Effect { spec, .. }, None) = (slot, model.get(slot)) {
            let start = if spec.role == ParameterRole::EventTime {
                terms::event_times(&[0.5], rows)
                    .first()
                    .copied()
                    .unwrap_or(0.0)
            } else {
                spec.guess()
            };
            model.set(slot, start);
        }
    }
    let mut best = cost(model, rows);
    let mut step = 1.0;
    for _ in 0..HALVINGS {
        for slot in forms {
            let Slot::Effect { spec, .. } = slot else {
                continue;
            };
            for direction in [1.0, -1.0] {
                let here = model.get(slot).unwrap_or_else(|| spec.guess());
                let there = if spec.role == ParameterRole::EventTime {
                    here + direction * step * span_s / 24.0
                } else if spec.logarithmic {
                    here * (direction * step * FIRST_STEP).exp()
                } else {
                    here + direction * step * spec.scale
                };
                model.set(slot, there.clamp(spec.min, spec.max));
                let found = cost(model, rows);
                if found < best {
                    best = found;
                    break;
                }
                model.set(slot, here);
            }
        }
        step *= 0.5;
    }
}

fn finish(mut model: Model, rows: &TorqueRows) -> Option<BalanceFit> {
    let mut system = System::new(&model, rows)?;
    let mut x = system.solve_bounded()?;
    for _ in 0..PASSES {
        let before = system.matrix.clone();
        system.put(&mut model, &x);
        let again = System::new(&model, rows)?;
        let moved = (&again.matrix - &before).norm();
        system = again;
        if moved <= PROPORTIONAL * before.norm() {
            break;
        }
        x = system.solve_bounded()?;
    }
    system.put(&mut model, &x);
    let residual = &system.right - &system.matrix * &x;
    // Intervals of what is not held at its bound.
    let inside: Vec<usize> = (0..x.len())
        .filter(|place| !system.at_bound(&x, *place))
        .collect();
    let solution = least_squares::solve(
        &system.matrix.select_columns(&inside),
        &system.right,
        &blocks(rows, residual.as_slice()),
    )?;
    let white = statistics::autocorrelation(residual.as_slice(), 2)
        .get(1)
        .is_none_or(|rho| *rho <= NOT_WHITE);
    let std = |place: usize| {
        let at = inside.iter().position(|inside| *inside == place)?;
        let variance = solution.covariance[(at, at)];
        variance.is_finite().then(|| variance.max(0.0).sqrt())
    };
    let judged: Vec<ParameterEstimate> = system
        .free
        .iter()
        .enumerate()
        .map(|(place, slot)| {
            if !inside.contains(&place) {
                return at_its_bound(slot);
            }
            let widened = if white { 1.0 } else { WIDENED };
            judge(
                slot,
                x[place],
                std(place).map(|std| widened * std),
                rows.span_s,
            )
        })
        .collect();
    let parameters = model
        .slots()
        .iter()
        .map(|slot| {
            let key = slot.key();
            judged
                .iter()
                .find(|parameter| parameter.key == key)
                .cloned()
                .unwrap_or_else(|| not_in_the_balance(&model, slot))
        })
        .collect();
    Some(BalanceFit {
        parameters,
        residual: residual.as_slice().to_vec(),
        model,
    })
}

fn at_its_bound(slot: &Slot) -> ParameterEstimate {
    ParameterEstimate {
        key: slot.key(),
        value: Some(0.0),
        std: None,
        unit: slot.unit(),
        verdict: Verdict::Searching,
        reason: Some("held at zero: the data ask for less, and friction drives nothing".to_owned()),
    }
}

fn not_in_the_balance(model: &Model, slot: &Slot) -> ParameterEstimate {
    let found = model.get(slot);
    let (verdict, std, reason) = match slot {
        _ if is_fixed(model, slot) => (Verdict::Fixed, Some(0.0), None),
        Slot::Effect { index, .. }
            if model.effects[*index]
                .effect
                .card()
                .enters
                .includes(Balance::Torque) =>
        {
            (
                Verdict::Searching,
                None,
                Some("found by search; its uncertainty is not known".to_owned()),
            )
        }
        _ => {
            return ParameterEstimate::not_observable(
                &slot.key(),
                slot.unit(),
                "it is not in the torque balance, and the run has no voltage",
            );
        }
    };
    ParameterEstimate {
        key: slot.key(),
        value: found,
        std,
        unit: slot.unit(),
        verdict,
        reason,
    }
}

/// Blocks of at least five correlation times of the residual, but never fewer than twenty.
fn blocks(rows: &TorqueRows, residual: &[f64]) -> Vec<usize> {
    let (Some(first), Some(last)) = (rows.time_s.first(), rows.time_s.last()) else {
        return Vec::new();
    };
    let five_s = 5.0 * correlation_time_s(&rows.time_s, residual);
    let block_s = BLOCK_S.max(five_s).min((last - first) / FEWEST_BLOCKS);
    rows.time_s
        .iter()
        .map(|time_s| whole((time_s - first) / block_s.max(f64::MIN_POSITIVE)))
        .collect()
}

/// Rows below which nothing is said of how long a series remembers itself.
const TOO_FEW: usize = 8;

/// Time over which a series remembers itself: half of `1 + 2 sum rho`, in seconds; the sum stops where the correlation
/// is lost in chance.
fn correlation_time_s(time_s: &[f64], values: &[f64]) -> f64 {
    let n = values.len();
    if n < TOO_FEW {
        return 0.0;
    }
    let period_s = (time_s[time_s.len() - 1] - time_s[0]) / (n - 1) as f64;
    let chance = 2.0 / (n as f64).sqrt();
    let sum: f64 = statistics::autocorrelation(values, n / 4)
        .into_iter()
        .take_while(|rho| *rho > chance)
        .sum();
    0.5 * period_s * (1.0 + 2.0 * sum)
}

/// The linear system for given forms.
struct System {
    free: Vec<Slot>,
    /// Whether the column's coefficient may not be negative.
    takes_power: Vec<bool>,
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl System {
    fn new(model: &Model, rows: &TorqueRows) -> Option<Self> {
        let mut right = DVector::from_column_slice(&rows.left);
        let (mut free, mut cells, mut takes_power) = (Vec::new(), Vec::new(), Vec::new());
        for slot in unknowns(model) {
            let column = column(model, &slot, rows);
            if is_fixed(model, &slot) {
                let value = model.get(&slot).unwrap_or(0.0);
                right.axpy(-value, &DVector::from_vec(column), 1.0);
            } else {
                takes_power.push(takes_power_only(model, &slot, rows));
                cells.extend(column);
                free.push(slot);
            }
        }
        let known = right.iter().chain(&cells).all(|cell| cell.is_finite());
        let columns = cells.len() / rows.rows().max(1);
        (known && rows.rows() > columns).then(|| Self {
            free,
            takes_power,
            matrix: DMatrix::from_vec(rows.rows(), columns, cells),
            right,
        })
    }

    /// Least squares with nothing that takes power below zero: the most negative is held at zero until none is left.
    fn solve_bounded(&self) -> Option<DVector<f64>> {
        let columns = self.matrix.ncols();
        let mut inside: Vec<usize> = (0..columns).collect();
        loop {
            let matrix = self.matrix.select_columns(&inside);
            let (bread, _) = least_squares::inverse_where_determined(&matrix);
            let found = bread * matrix.tr_mul(&self.right);
            let share = |place: usize| found[place] * matrix.column(place).norm();
            let most_negative = (0..inside.len())
                .filter(|place| self.takes_power[inside[*place]] && found[*place] < 0.0)
                .min_by(|a, b| share(*a).total_cmp(&share(*b)));
            if let Some(place) = most_negative {
                inside.remove(place);
                continue;
            }
            let mut x = DVector::zeros(columns);
            for (place, column) in inside.iter().enumerate() {
                x[*column] = found[place];
            }
            return x.iter().all(|value| value.is_finite()).then_some(x);
        }
    }

    fn at_bound(&self, x: &DVector<f64>, place: usize) -> bool {
        self.takes_power[place] && x[place] == 0.0
    }

    fn cost(&self) -> f64 {
        self.solve_bounded().map_or(f64::INFINITY, |x| {
            (&self.right - &self.matrix * x).norm_squared()
        })
    }

    fn put(&self, model: &mut Model, x: &DVector<f64>) {
        for (slot, value) in self.free.iter().zip(x.iter()) {
            model.set(slot, *value);
        }
    }
}

/// Whether a coefficient below zero would drive the shaft.
fn takes_power_only(model: &Model, slot: &Slot, rows: &TorqueRows) -> bool {
    match *slot {
        Slot::Motor(key) => key == MotorKey::LoadTorque,
        Slot::Effect {
            index, parameter, ..
        } => {
            let active = &model.effects[index];
            let values = active.values_or_guess();
            terms::only_takes_power(active.effect, &values, parameter, &rows.at)
        }
    }
}
