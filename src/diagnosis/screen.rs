//! Score screen: how much each effect would explain, from one simulation per coefficient and shape.
//!
//! DISCOVERY.md 2.6. The residual and every probe are projected on what the baseline's own parameters cannot explain;
//! the part of the residual that a probe then explains ranks the effects, gives the refit a start, and tells what size
//! could have been seen at all.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::linear_response::responses;
use super::progress::{Event, Progress, Stage};
use super::shapes::shape_grid;
use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{Fit, FitError, FreeRun, weighted_residual};
use crate::numerics::levenberg_marquardt::Problem as _;
use crate::plant::effect::CATALOGUE;
use crate::plant::{
    ActiveEffect, Effect, Model, ParameterRole, Plant, Scenario, State, typical_size,
};

/// Choices of one effect that are simulated.
const MOST_CHOICES: usize = 3;
/// Standard deviations at which an effect counts as visible.
pub(super) const DETECTION_SIGMA: f64 = 5.0;
/// Longest step of a baseline parameter that the linear solution may suggest.
const LONGEST_SHIFT: f64 = 0.7;
/// A coefficient that must be positive starts no lower than this share of its typical size: at zero it has no slope to
/// go by.
const LEAST_START: f64 = 0.05;

/// Damping of a normal matrix as a share of its trace. The baseline's, whose parameters may be all but tied, so that a step
/// stays finite; and the coefficients', so that one that does nothing in this run stays at zero.
const HAIR: f64 = 1e-9;
const HALF_A_HAIR: f64 = 1e-12;
/// Smallest trace that is damped: a matrix of zeros must have a factor too.
const NOT_ZERO: f64 = 1e-300;
/// Share of a column left at right angles to the others below which it says what they say, but for rounding.
const DEPENDENT: f64 = 1e-9;

/// What the screen says of one effect.
#[derive(Clone)]
pub(super) struct Screened {
    pub(super) effect: &'static dyn Effect,
    /// The baseline moved to where it would be with the effect, and the effect with its best coefficients and shapes:
    /// where a refit starts.
    pub(super) start: Model,
    /// Reduction of the cost that the effect would bring, to first order.
    pub(super) gain: f64,
    /// The same as a share of what the baseline's parameters leave unexplained.
    pub(super) share: f64,
    pub(super) detectable: Detectable,
}

/// The size from which this run would show an effect (5 sigma, white noise).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Detectable {
    /// Smallest size of its first coefficient, in its unit; infinite where the run does not show it whatever its size.
    From(f64),
    /// Largest natural frequency, Hz: the softer a shaft is, the more it shows.
    SofterThan(f64),
}

impl Detectable {
    /// The smallest size; none for what has none, or what the run does not show at all.
    pub(super) fn smallest(self) -> Option<f64> {
        match self {
            Self::From(size) => Some(size).filter(|size| size.is_finite()),
            Self::SofterThan(_) => None,
        }
    }
}

/// What the screen alone says of an effect: a ranking in a fraction of the time of a diagnosis, and no verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScreenedEffect {
    pub effect: &'static str,
    /// Share of the error beyond the baseline's own parameters that the effect would explain, to first order.
    pub share: f64,
    /// Smallest size of its first parameter that this run would show (5 sigma, white noise), in the unit of that parameter;
    /// none where no size would show, or where the effect is the larger the smaller the parameter is.
    pub minimum_detectable: Option<f64>,
}

/// Screens every effect of the catalogue that `baseline` does not have, on the run that it was fitted on; the one that
/// would explain most comes first.
pub fn screen(baseline: &Fit, training: &Scenario, progress: Progress<'_>) -> Vec<ScreenedEffect> {
    let screen = Screen::new(baseline, training);
    let effects: Vec<&'static dyn Effect> = CATALOGUE
        .iter()
        .copied()
        .filter(|effect| !baseline.model.has(effect.card().id))
        .collect();
    let error = screen.error().max(f64::MIN_POSITIVE);
    let mut screened = screen.all(&effects, progress);
    screened.sort_by(|a, b| b.gain.total_cmp(&a.gain));
    screened
        .iter()
        .map(|screened| ScreenedEffect {
            effect: screened.effect.card().id,
            share: screened.gain / error,
            minimum_detectable: screened.detectable.smallest(),
        })
        .collect()
}

/// The baseline's fit, made ready for projecting.
pub(super) struct Screen<'a> {
    baseline: &'a Model,
    training: &'a Scenario,
    noise: NoiseFloor,
    residual: DVector<f64>,
    /// The residual without what the baseline's parameters can explain.
    unexplained: DVector<f64>,
    /// Orthonormal basis of what the baseline's parameters can explain.
    basis: DMatrix<f64>,
    jacobian: &'a DMatrix<f64>,
    /// Of the normal matrix, a hair damped; none where even that has no inverse.
    factor: Option<Cholesky<f64, Dyn>>,
    x: &'a [f64],
    /// None where the baseline cannot be simulated on this run.
    at_x: Option<AtX>,
}

/// The baseline at `x`, its state at the start, and `(sample, is_speed)` of every residual.
type AtX = (Model, State, Vec<(usize, bool)>);

impl<'a> Screen<'a> {
    pub(super) fn new(fit: &'a Fit, training: &'a Scenario) -> Self {
        let basis = orthonormal_basis(&fit.minimum.jacobian);
        let residual = DVector::from_column_slice(&fit.minimum.residual);
        let (jacobian, x) = (&fit.minimum.jacobian, &fit.minimum.x[..]);
        let normal = jacobian.tr_mul(jacobian);
        let damping = HAIR * normal.trace().max(NOT_ZERO);
        let damped = &normal + DMatrix::identity(normal.nrows(), normal.ncols()) * damping;
        let at_x = FreeRun::new(&fit.model, training, fit.noise).map(|problem| {
            let rows = problem.rows().to_vec();
            (problem.model_at(x), problem.initial_state(x), rows)
        });
        Self {
            factor: damped.cholesky(),
            at_x: at_x.ok(),
            baseline: &fit.model,
            training,
            noise: fit.noise,
            unexplained: project(&basis, residual.clone()),
            residual,
            basis,
            jacobian,
            x,
        }
    }

    /// Square of what the baseline's parameters leave unexplained.
    pub(super) fn error(&self) -> f64 {
        self.unexplained.norm_squared()
    }

    /// Screens every effect, in parallel over effects and shapes; an effect that cannot be simulated is left out.
    pub(super) fn all(
        &self,
        effects: &[&'static dyn Effect],
        progress: Progress<'_>,
    ) -> Vec<Screened> {
        progress(Event::Begun {
            stage: Stage::Screen,
            of: effects.len(),
        });
        effects
            .par_iter()
            .filter_map(|effect| {
                let screened = self.effect(*effect).ok()?;
                progress(Event::Screened {
                    effect: effect.card().id,
                    share: screened.share,
                });
                Some(screened)
            })
            .collect()
    }

    pub(super) fn effect(&self, effect: &'static dyn Effect) -> Result<Screened, FitError> {
        let shapes = self.worth_a_simulation(effect, shape_grid(effect, self.training));
        let found: Vec<Result<Tried, FitError>> = shapes
            .into_par_iter()
            .map(|shape| self.shape(effect, &shape))
            .collect();
        let mut best: Option<Tried> = None;
        let mut failure = None;
        for tried in found {
            match tried {
                Ok(tried) if best.as_ref().is_none_or(|best| tried.gain > best.gain) => {
                    best = Some(tried);
                }
                Ok(_) => {}
                Err(error) => failure = Some(error),
            }
        }
        match (best, failure) {
            (Some(best), _) => Ok(self.screened(effect, best)),
            (None, Some(error)) => Err(error),
            (None, None) => unreachable!("every effect has at least one shape"),
        }
    }

    /// Of many choices those few that the linear response puts first; all shapes of other effects.
    fn worth_a_simulation(
        &self,
        effect: &'static dyn Effect,
        shapes: Vec<Vec<f64>>,
    ) -> Vec<Vec<f64>> {
        let specs = effect.parameters();
        let is_choice = specs.iter().any(|spec| spec.role == ParameterRole::Choice);
        if !is_choice || shapes.len() <= MOST_CHOICES {
            return shapes;
        }
        let Ok(problem) = FreeRun::new(self.baseline, self.training, self.noise) else {
            return shapes;
        };
        let ones: Vec<usize> = (0..specs.len())
            .filter(|index| specs[*index].is_coefficient())
            .collect();
        let probes: Vec<Vec<f64>> = shapes
            .iter()
            .flat_map(|shape| {
                ones.iter().map(|&index| {
                    let mut values = shape.clone();
                    values[index] = 1.0;
                    values
                })
            })
            .collect();
        let mut sums = vec![Projected::new(ones.len(), self.basis.ncols()); shapes.len()];
        let mut basis = vec![0.0; self.basis.ncols()];
        let told = responses(
            effect,
            &probes,
            self.baseline,
            self.training,
            &problem,
            |row, each| {
                for (column, cell) in basis.iter_mut().enumerate() {
                    *cell = self.basis[(row, column)];
                }
                for (sums, each) in sums.iter_mut().zip(each.chunks(ones.len())) {
                    sums.push(each, &basis, self.unexplained[row]);
                }
            },
        );
        if told.is_none() {
            return shapes;
        }
        let mut ranked: Vec<(f64, Vec<f64>)> =
            sums.iter().map(Projected::gain).zip(shapes).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked.truncate(MOST_CHOICES);
        ranked.into_iter().map(|(_, shape)| shape).collect()
    }

    /// One combination of shape parameters: all coefficients by linear least squares.
    fn shape(&self, effect: &'static dyn Effect, shape: &[f64]) -> Result<Tried, FitError> {
        let specs = effect.parameters();
        let coefficients: Vec<usize> = (0..specs.len())
            .filter(|index| specs[*index].is_coefficient())
            .collect();
        let mut values = shape.to_vec();
        if coefficients.is_empty() {
            // Finite by nature, as a shaft's elasticity: all of it or nothing.
            let probe = self.residual_with(effect, &values)? - &self.residual;
            let along = project(&self.basis, probe.clone());
            let length = along.norm_squared();
            let share = (-along.dot(&self.unexplained) / length.max(f64::MIN_POSITIVE)).max(0.0);
            let whole = &self.unexplained + &along;
            let linear = share * share * length;
            let finite = self.unexplained.norm_squared() - whole.norm_squared();
            return Ok(Tried {
                values,
                shift: self.shift(&probe),
                gain: linear.max(finite),
                detectable: if specs[0].key == STIFFNESS {
                    Detectable::SofterThan(softest_hidden_hz(shape[0], length.sqrt()))
                } else {
                    Detectable::From(DETECTION_SIGMA * shape[0] / length.sqrt())
                },
            });
        }
        let mut probes = DMatrix::zeros(self.residual.len(), coefficients.len());
        let mut sizes = Vec::with_capacity(coefficients.len());
        for (column, &index) in coefficients.iter().enumerate() {
            let mut probed = values.clone();
            let size = typical_size(effect, index, self.baseline, self.training);
            probed[index] = size;
            let probe = (self.residual_with(effect, &probed)? - &self.residual) / size;
            probes.set_column(column, &probe);
            sizes.push(size);
        }
        let mut along = probes.clone();
        for mut column in along.column_iter_mut() {
            let projected = project(&self.basis, column.clone_owned());
            column.copy_from(&projected);
        }
        let normal = along.tr_mul(&along);
        let projected = along.tr_mul(&self.unexplained);
        let (mut solution, _) = best_coefficients(&along, &self.unexplained);
        for (column, &index) in coefficients.iter().enumerate() {
            if !(specs[index].min..=specs[index].max).contains(&solution[column]) {
                solution[column] = 0.0;
            }
        }
        let gain = -2.0 * projected.dot(&solution) - solution.dot(&(&normal * &solution));
        let change = &probes * &solution;
        for (column, &index) in coefficients.iter().enumerate() {
            let least = if specs[index].min >= 0.0 {
                LEAST_START * sizes[column]
            } else {
                f64::NEG_INFINITY
            };
            values[index] = solution[column].max(least);
        }
        Ok(Tried {
            values,
            shift: self.shift(&change),
            gain,
            detectable: Detectable::From(DETECTION_SIGMA / normal[(0, 0)].sqrt()),
        })
    }

    fn screened(&self, effect: &'static dyn Effect, best: Tried) -> Screened {
        let mut start = self.moved_baseline(&best.shift);
        start.effects.push(ActiveEffect {
            effect,
            values: best.values.into_iter().map(Some).collect(),
        });
        Screened {
            effect,
            start,
            gain: best.gain,
            share: best.gain / self.error().max(f64::MIN_POSITIVE),
            detectable: best.detectable,
        }
    }

    /// How the baseline's coordinates would move if `change` were added to the residual.
    fn shift(&self, change: &DVector<f64>) -> Vec<f64> {
        let gradient = self.jacobian.tr_mul(&(&self.residual + change));
        self.factor.as_ref().map_or_else(
            || vec![0.0; self.x.len()],
            |factor| {
                factor
                    .solve(&gradient)
                    .iter()
                    .map(|step| -step.clamp(-LONGEST_SHIFT, LONGEST_SHIFT))
                    .collect()
            },
        )
    }

    fn moved_baseline(&self, shift: &[f64]) -> Model {
        let Ok(problem) = FreeRun::new(self.baseline, self.training, self.noise) else {
            return self.baseline.clone();
        };
        let mut x: Vec<f64> = self.x.iter().zip(shift).map(|(x, dx)| x + dx).collect();
        problem.clamp(&mut x);
        problem.model_at(&x)
    }

    /// The residual with the effect of these values, the rest held at the baseline's.
    fn residual_with(
        &self,
        effect: &'static dyn Effect,
        values: &[f64],
    ) -> Result<DVector<f64>, FitError> {
        let failed = || FitError::CannotSimulate {
            run: self.training.name.clone(),
        };
        let (model, start, rows) = self.at_x.as_ref().ok_or_else(failed)?;
        let mut model = model.clone();
        model.effects.push(ActiveEffect {
            effect,
            values: values.iter().copied().map(Some).collect(),
        });
        let simulated = Plant::new(&model, self.training.input)?.simulate(self.training, *start);
        let out = DVector::from_iterator(
            rows.len(),
            rows.iter()
                .map(|row| weighted_residual(*row, &simulated, self.training, &self.noise)),
        );
        if out.iter().all(|value| value.is_finite()) {
            Ok(out)
        } else {
            Err(failed())
        }
    }
}

/// One combination of shapes with its best coefficients.
struct Tried {
    values: Vec<f64>,
    shift: Vec<f64>,
    gain: f64,
    detectable: Detectable,
}

/// The parameter of an effect without a coefficient that is its stiffness, not its size.
const STIFFNESS: &str = "frequency_hz";

/// Natural frequency from which on a shaft would not show, Hz, from what one of `frequency_hz` adds to the residual, in
/// standard deviations: what a shaft yields goes with its compliance, which goes with the inverse square of the frequency.
fn softest_hidden_hz(frequency_hz: f64, visible: f64) -> f64 {
    frequency_hz * (visible / DETECTION_SIGMA).sqrt()
}

/// Sums over the rows of a few columns, from which the gain by their projections follows.
#[derive(Clone)]
struct Projected {
    normal: DMatrix<f64>,
    /// Products with the basis that is projected out.
    along_basis: DMatrix<f64>,
    along_residual: DVector<f64>,
}

impl Projected {
    fn new(columns: usize, basis: usize) -> Self {
        Self {
            normal: DMatrix::zeros(columns, columns),
            along_basis: DMatrix::zeros(basis, columns),
            along_residual: DVector::zeros(columns),
        }
    }

    /// One row of the columns, of the basis and of the residual, which has nothing along the basis.
    fn push(&mut self, columns: &[f64], basis: &[f64], residual: f64) {
        for (index, value) in columns.iter().enumerate() {
            for (other, there) in columns.iter().enumerate() {
                self.normal[(other, index)] += value * there;
            }
            for (place, along) in basis.iter().enumerate() {
                self.along_basis[(place, index)] += value * along;
            }
            self.along_residual[index] += value * residual;
        }
    }

    fn gain(&self) -> f64 {
        let normal = &self.normal - self.along_basis.tr_mul(&self.along_basis);
        solved(&normal, &self.along_residual).1
    }
}

/// Coefficients of the columns that take most from `residual`, and how much of its square that is.
fn best_coefficients(along: &DMatrix<f64>, residual: &DVector<f64>) -> (DVector<f64>, f64) {
    solved(&along.tr_mul(along), &along.tr_mul(residual))
}

/// The same from the columns' normal matrix and their products with the residual.
fn solved(normal: &DMatrix<f64>, projected: &DVector<f64>) -> (DVector<f64>, f64) {
    // Half a hair of damping: a coefficient that does nothing in this run stays at zero.
    let damped = normal
        + DMatrix::identity(normal.nrows(), normal.ncols())
            * (HALF_A_HAIR * normal.trace().max(NOT_ZERO));
    let solution = damped.cholesky().map_or_else(
        || projected.clone() * 0.0,
        |factor| -factor.solve(projected),
    );
    let gain = -projected.dot(&solution);
    (solution, gain)
}

/// The part of `vector` that is at right angles to `basis`.
fn project(basis: &DMatrix<f64>, vector: DVector<f64>) -> DVector<f64> {
    let explained = basis * basis.tr_mul(&vector);
    vector - explained
}

/// Modified Gram-Schmidt on the scaled columns, twice for orthogonality; dependent columns are left out.
fn orthonormal_basis(jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    let mut columns: Vec<DVector<f64>> = Vec::new();
    for column in jacobian.column_iter() {
        let mut vector = column.into_owned();
        let size = vector.norm();
        for _ in 0..2 {
            for basis in &columns {
                let along = basis.dot(&vector);
                vector.axpy(-along, basis, 1.0);
            }
        }
        let left = vector.norm();
        if left > DEPENDENT * size && size > 0.0 {
            columns.push(vector / left);
        }
    }
    if columns.is_empty() {
        DMatrix::zeros(jacobian.nrows(), 0)
    } else {
        DMatrix::from_columns(&columns)
    }
}
