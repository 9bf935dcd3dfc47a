//! Score screen: how much each effect would explain, from one simulation per coefficient and shape.
//!
//! DISCOVERY.md 2.6. The residual and every probe are projected on what the baseline's own parameters cannot explain;
//! the part of the residual that a probe then explains ranks the effects, gives the refit a start, and tells what size
//! could have been seen at all.

use nalgebra::{DMatrix, DVector};

use crate::identification::noise::NoiseFloor;
use crate::identification::output_error::{Fit, FitError, FreeRun};
use crate::numerics::levenberg_marquardt::Problem;
use crate::plant::{ActiveEffect, Effect, Model, Scenario, typical_size};

/// Standard deviations at which an effect counts as visible.
const DETECTION_SIGMA: f64 = 5.0;

/// What the screen says of one effect.
#[derive(Clone, Debug)]
pub(super) struct Screened {
    /// The effect with the best coefficients and shapes found: where a refit starts.
    pub(super) start: ActiveEffect,
    /// Reduction of the cost that the effect would bring, to first order.
    pub(super) gain: f64,
    /// Smallest size of the first coefficient that this run would show (5 sigma, white noise).
    pub(super) minimum_detectable: f64,
    /// Size at which the first coefficient would matter in this run.
    pub(super) typical_size: f64,
}

/// The baseline's fit, made ready for projecting.
pub(super) struct Screen<'a> {
    baseline: &'a Model,
    training: &'a Scenario,
    noise: NoiseFloor,
    residual: DVector<f64>,
    /// Orthonormal basis of what the baseline's parameters can explain.
    basis: DMatrix<f64>,
}

impl<'a> Screen<'a> {
    pub(super) fn new(fit: &'a Fit, training: &'a Scenario) -> Self {
        Self {
            baseline: &fit.model,
            training,
            noise: fit.noise,
            residual: DVector::from_column_slice(&fit.minimum.residual),
            basis: orthonormal_basis(&fit.minimum.jacobian),
        }
    }

    pub(super) fn effect(&self, effect: &'static dyn Effect) -> Result<Screened, FitError> {
        let residual = self.project(self.residual.clone());
        let mut best: Option<Screened> = None;
        for shape in shape_grid(effect) {
            let found = self.shape(effect, &shape, &residual)?;
            if best.as_ref().is_none_or(|best| found.gain > best.gain) {
                best = Some(found);
            }
        }
        Ok(best.expect("every effect has at least one shape"))
    }

    /// One combination of shape parameters: all coefficients by linear least squares.
    fn shape(
        &self,
        effect: &'static dyn Effect,
        shape: &[f64],
        residual: &DVector<f64>,
    ) -> Result<Screened, FitError> {
        let specs = effect.parameters();
        let coefficients: Vec<usize> = (0..specs.len())
            .filter(|index| specs[*index].is_coefficient())
            .collect();
        let mut probes = DMatrix::zeros(residual.len(), coefficients.len());
        for (column, &index) in coefficients.iter().enumerate() {
            let mut values = shape.to_vec();
            let size = typical_size(effect, index, self.baseline, self.training);
            values[index] = size;
            let there = self.residual_with(effect, &values)?;
            let probe = self.project((there - &self.residual) / size);
            probes.set_column(column, &probe);
        }
        let normal = probes.tr_mul(&probes);
        let projected = probes.tr_mul(residual);
        // Half a hair of damping: a coefficient that does nothing in this run stays at zero.
        let damped = &normal
            + DMatrix::identity(normal.nrows(), normal.ncols())
                * (1e-12 * normal.trace().max(1e-300));
        let solution = damped.cholesky().map_or_else(
            || projected.clone() * 0.0,
            |factor| -factor.solve(&projected),
        );
        let gain = -projected.dot(&solution);
        let mut start = ActiveEffect::new(effect);
        for (index, value) in shape.iter().enumerate() {
            start.values[index] = Some(*value);
        }
        for (column, &index) in coefficients.iter().enumerate() {
            start.values[index] = Some(solution[column]);
        }
        let norm = normal[(0, 0)].sqrt();
        Ok(Screened {
            start,
            gain,
            minimum_detectable: DETECTION_SIGMA / norm,
            typical_size: typical_size(effect, 0, self.baseline, self.training),
        })
    }

    fn residual_with(
        &self,
        effect: &'static dyn Effect,
        values: &[f64],
    ) -> Result<DVector<f64>, FitError> {
        let mut model = self.baseline.clone();
        model.effects.push(ActiveEffect {
            effect,
            values: values.iter().copied().map(Some).collect(),
        });
        let mut problem = FreeRun::new(&model, self.training, self.noise)?;
        let x = problem.start();
        let mut out = vec![0.0; problem.residual_len()];
        if problem.residual(&x, &mut out) {
            Ok(DVector::from_vec(out))
        } else {
            Err(FitError::CannotSimulate {
                run: self.training.name.clone(),
            })
        }
    }

    /// The part of `vector` that the baseline's parameters cannot explain.
    fn project(&self, vector: DVector<f64>) -> DVector<f64> {
        let explained = &self.basis * self.basis.tr_mul(&vector);
        vector - explained
    }
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
        if left > 1e-9 * size && size > 0.0 {
            columns.push(vector / left);
        }
    }
    if columns.is_empty() {
        DMatrix::zeros(jacobian.nrows(), 0)
    } else {
        DMatrix::from_columns(&columns)
    }
}

/// Every combination of the shape parameters' grids, coefficients at zero.
fn shape_grid(effect: &dyn Effect) -> Vec<Vec<f64>> {
    let specs = effect.parameters();
    let mut grid = vec![vec![0.0; specs.len()]];
    for (index, spec) in specs.iter().enumerate() {
        if !spec.is_coefficient() {
            grid = grid
                .into_iter()
                .flat_map(|values| {
                    spec.shapes.iter().map(move |shape| {
                        let mut values = values.clone();
                        values[index] = *shape;
                        values
                    })
                })
                .collect();
        }
    }
    grid
}
