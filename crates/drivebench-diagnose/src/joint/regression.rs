//! Linear regression for the selection: candidates with the columns of their forms, normal equations, and the Schur complement of
//! some columns given others.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::tangent::{Lane, Tangent};
use super::whitened::Whitened;
use drivebench_model::plant::{Effect, Model, RunScales};

/// Prior deviation of the size of an effect, in typical sizes (0.03 of the largest torque or voltage).
pub(super) const SLAB: f64 = 2.0;
/// Mean square of the innovations (1 under the model) above which the linearisation is not trusted to reject a form.
pub(super) const FAR_MEAN_SQUARE: f64 = 3.0;
/// Prior deviation of the share of an effect of fixed size (1: present as tried, 0: absent): its column has slab units of this
/// share.
const FIXED_SIZE_SD: f64 = 0.15;

/// One column of a form.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Column {
    /// Index among all columns.
    pub(super) at: usize,
    /// Index of its parameter; none for an error of the form.
    pub(super) parameter: Option<usize>,
    /// Size of its unit, in the unit of its parameter.
    pub(super) unit: f64,
    /// Value that the model has already, in `unit`.
    pub(super) present: f64,
    /// Of an event: the run and its time there, s after the run's first command.
    pub(super) event_time: Option<(usize, f64)>,
}

impl Column {
    pub(super) fn of(parameter: Option<usize>, unit: f64, present: f64) -> Self {
        Self { parameter, unit, present, ..Self::default() }
    }
}

/// One form of an effect.
#[derive(Clone, Debug, Default)]
pub(super) struct Variant {
    pub(super) columns: Vec<Column>,
    /// Values of all parameters, coefficients at the slab.
    pub(super) values: Vec<f64>,
    /// Whether it has the time of another event of the model, so that the two can be compared.
    pub(super) is_rival: bool,
    /// Prior mean of its first column, in its unit, of an effect of fixed size; else zero.
    pub(super) mean: f64,
    pub(super) positive: bool,
    pub(super) log_prior: f64,
}

impl Variant {
    /// The numbers of its columns.
    pub(super) fn numbers(&self) -> impl Iterator<Item = usize> + '_ {
        self.columns.iter().map(|column| column.at)
    }

    /// Of an event the runs in which it happens, each with its time.
    pub(super) fn event_times(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.columns.iter().filter_map(|column| column.event_time)
    }
}

/// Fisher information and score (gradient of the log likelihood at zero) of one column given others, in slabs.
#[derive(Clone, Copy, Debug)]
pub(super) struct ColumnInformation {
    pub(super) information: f64,
    pub(super) score: f64,
    /// The slab, in the unit of its parameter.
    pub(super) unit: f64,
}

#[derive(Clone, Default)]
pub(super) struct Candidate {
    pub(super) id: &'static str,
    /// None: a curve that is no effect.
    pub(super) effect: Option<&'static dyn Effect>,
    pub(super) in_model: bool,
    pub(super) log_odds: f64,
    pub(super) variants: Vec<Variant>,
    /// Information about an event at each time of the grid, also at those without a column.
    pub(super) event_information: Vec<ColumnInformation>,
    /// Candidates that cannot be in a set with this one.
    pub(super) excludes: Vec<usize>,
}

impl Candidate {
    /// Whether it has shape parameters and no coefficient, as a shaft's elasticity: it is present at its size or absent.
    pub(super) fn has_fixed_size(&self) -> bool {
        self.variants[0].mean > 0.0
    }

    /// Whether `size` of a form of fixed size differs from that size by more than a half, so that the linear solution does not
    /// hold. An effect of the model is exempt: its shapes are refitted.
    pub(super) fn exceeds_linear_range(&self, size: f64, form: &Variant) -> bool {
        !self.in_model && form.mean > 0.0 && (size / form.mean - 1.0).abs() > 0.5
    }

    /// Whether it begins at an unknown time of each run.
    pub(super) fn is_event(&self) -> bool {
        self.variants[0].event_times().next().is_some()
    }

    /// Whether it is a curve that no effect gives.
    pub(super) fn is_unknown(&self) -> bool {
        self.effect.is_none()
    }
}

/// Computation of a column.
pub(super) enum Source {
    /// Difference quotient of two simulations.
    Difference {
        model: Model,
        step: f64,
    },
    Tangent(Tangent),
    /// Tangent in the run of this number only.
    In(usize, Tangent),
    /// Already computed for the beginning of the first run, and not needed beyond.
    Known(Vec<f32>),
}

impl Source {
    pub(super) fn difference(model: Model, step: f64) -> Self {
        Self::Difference { model, step }
    }

    /// Its tangent in the run of this number, if it has one there.
    pub(super) const fn tangent(&self, number: usize) -> Option<&Tangent> {
        match self {
            Self::Tangent(tangent) => Some(tangent),
            Self::In(run, tangent) if *run == number => Some(tangent),
            _ => None,
        }
    }
}

/// A candidate whose columns have no numbers yet.
pub(super) struct Part {
    pub(super) candidate: Candidate,
    /// Where the columns of each variant come from.
    pub(super) sources: Vec<Vec<Source>>,
}

impl Part {
    pub(super) fn new(effect: &'static dyn Effect) -> Self {
        let share = effect.card().share_beforehand;
        Self::named(effect.card().id, Some(effect), (share / (1.0 - share)).ln())
    }

    pub(super) fn named(
        id: &'static str,
        effect: Option<&'static dyn Effect>,
        log_odds: f64,
    ) -> Self {
        let candidate = Candidate { id, effect, log_odds, ..Candidate::default() };
        Self { candidate, sources: vec![] }
    }

    pub(super) fn push(&mut self, form: Form) {
        self.candidate.variants.push(form.variant);
        self.sources.push(form.sources);
    }

    pub(super) fn keep(&mut self, wanted: impl Fn(usize) -> bool) {
        let mut form = 0..;
        self.sources.retain(|_| form.next().is_some_and(&wanted));
        let (mut form, variants) = (0.., &mut self.candidate.variants);
        variants.retain(|_| form.next().is_some_and(&wanted));
    }
}

/// A variant under construction.
pub(super) struct Form {
    pub(super) variant: Variant,
    sources: Vec<Source>,
}

impl Form {
    pub(super) fn new(values: Vec<f64>, log_prior: f64) -> Self {
        let variant = Variant { values, log_prior, ..Variant::default() };
        Self { variant, sources: vec![] }
    }

    /// The column of an effect of fixed size: `other` is the model without it if it is in the model, else with it.
    pub(super) fn fixed_size(&mut self, other: Model, in_model: bool) {
        self.variant.mean = 1.0 / FIXED_SIZE_SD;
        let (sign, present) = if in_model { (-1.0, 1.0 / FIXED_SIZE_SD) } else { (1.0, 0.0) };
        let source = Source::difference(other, sign / FIXED_SIZE_SD);
        self.column(source, Column::of(None, 0.0, present));
    }

    pub(super) fn column(&mut self, source: Source, column: Column) {
        self.sources.push(source);
        self.variant.columns.push(column);
    }
}

/// The linear problem of one or several runs.
#[derive(Clone)]
pub(super) struct Linear {
    /// Prior deviations of the nuisances: the motor's parameters and errors of the time stamps.
    pub(super) nuisances: Vec<f64>,
    pub(super) candidates: Vec<Candidate>,
    pub(super) gram: DMatrix<f64>,
    pub(super) right: DVector<f64>,
    pub(super) squares: f64,
    /// Whitened columns of each run.
    pub(super) columns: Vec<Whitened>,
    pub(super) present: DVector<f64>,
    /// Of the first run.
    pub(super) scales: RunScales,
}

impl Linear {
    /// Prior precision of a column.
    pub(super) fn precision(&self, column: usize) -> f64 {
        let sd = self.nuisances.get(column);
        sd.map_or(1.0, |sd| 1.0 / (sd * sd))
    }

    /// The normal matrix of some columns with their prior precision, factored; none where it is singular.
    pub(super) fn factor(&self, columns: &[usize]) -> Option<Cholesky<f64, Dyn>> {
        let k = columns.len();
        let mut normal = DMatrix::from_fn(k, k, |r, c| self.gram[(columns[r], columns[c])]);
        for (d, column) in columns.iter().enumerate() {
            normal[(d, d)] += self.precision(*column);
        }
        normal.cholesky()
    }
}

/// Normal equations of included columns, given which others are evaluated.
pub(super) struct Base {
    pub(super) factor: Cholesky<f64, Dyn>,
    pub(super) right: DVector<f64>,
}

impl Base {
    /// Of some columns of all runs.
    pub(super) fn of_columns(linear: &Linear, columns: &[usize]) -> Option<Self> {
        let right = DVector::from_fn(columns.len(), |r, _| linear.right[columns[r]]);
        let factor = linear.factor(columns)?;
        Some(Self { factor, right })
    }

    /// Of whitened columns with their prior `precision` and the residual to be explained.
    pub(super) fn of_runs(
        residuals: &[&[[f64; 2]]],
        base: &[Whitened],
        precision: &[f64],
    ) -> Option<Self> {
        let k = precision.len();
        let mut products = DMatrix::zeros(k + 1, k + 1);
        for (residual, base) in residuals.iter().zip(base) {
            products += base.gram(residual);
        }
        let mut gram = products.view((0, 0), (k, k)).into_owned();
        for (d, precision) in precision.iter().enumerate() {
            gram[(d, d)] += precision;
        }
        let right = products.view((0, k), (k, 1)).column(0).into_owned();
        let factor = gram.cholesky()?;
        Some(Self { factor, right })
    }

    /// Information and score of a column given the base, from its products with the base (`cross`), itself (`own`) and the
    /// residual (`rest`).
    pub(super) fn schur_complement(&self, cross: &DVector<f64>, own: f64, rest: f64) -> [f64; 2] {
        let solved = self.factor.solve(cross);
        [own - cross.dot(&solved), rest - self.right.dot(&solved)]
    }

    /// Log evidence of the form in these lanes of the products of [`super::screening::add_products`].
    pub(super) fn gain(&self, products: &[Lane], lane: usize, width: usize) -> f64 {
        let m = self.right.len();
        let cross = DMatrix::from_fn(m, width, |r, c| products[r][lane + c]);
        let solved = self.factor.solve(&cross);
        let own = DMatrix::from_fn(width, width, |r, c| {
            if r == c { products[m + 1][lane + r] + 1.0 } else { products[m + 2][lane] }
        });
        let right = DVector::from_fn(width, |r, _| products[m][lane + r]);
        let rest = right - solved.tr_mul(&self.right);
        let Some(schur) = (own - cross.tr_mul(&solved)).cholesky() else {
            return f64::NEG_INFINITY;
        };
        0.5 * rest.dot(&schur.solve(&rest)) - half_log_det(&schur)
    }

    /// Information of the form of one column in this lane.
    pub(super) fn information(
        &self,
        products: &[Lane],
        lane: usize,
        unit: f64,
    ) -> ColumnInformation {
        let m = self.right.len();
        let cross = DVector::from_fn(m, |r, _| products[r][lane]);
        let [information, score] =
            self.schur_complement(&cross, products[m + 1][lane], products[m][lane]);
        ColumnInformation { information, score, unit }
    }
}

/// Half of the log determinant of a factored matrix.
pub(super) fn half_log_det(factor: &Cholesky<f64, Dyn>) -> f64 {
    factor.l().diagonal().iter().map(|d| d.ln()).sum()
}
