//! Screening of forms by their marginal likelihood before the selection: of effects with many forms only those that a run could
//! tell of get a column.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use super::columns::{
    ColumnInformation, FAR_MEAN_SQUARE, Linear, LinearisedRun, Part, Source, squares,
};
use super::tangent::{LANES, Lane, Tangent, carry};
use super::whitened::Whitened;
use drivebench_model::plant::Scenario;

/// Forms of one effect that are kept.
const KEPT: usize = 6;
/// The beginning of a run that is looked at first is one part of so many.
const LOOK: usize = 6;
/// Standard deviations by which the beginning has to tell all of an effect from none of it.
const PLAIN_SIGMAS: f64 = 20.0;
/// Share of an effect, as the beginning has it, below which it is not there wholly.
const REFUTED_SHARE: f64 = 0.2;

/// Forms of one column or two that are carried side by side, and their products with all that matters.
struct Group {
    part: usize,
    forms: Vec<usize>,
    products: Vec<Lane>,
}

/// Leaves of each part with many forms those that explain most of what the model leaves, beside the `base` columns with
/// the `precision` that they have beforehand. What the forms share beforehand is not touched: who drops out takes his
/// share along.
pub(super) fn keep_likeliest(
    parts: &mut [Part],
    runs: &[LinearisedRun<'_>],
    base: &[Whitened],
    precision: &[f64],
) {
    let mut groups = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        let many = part.sources.len() > KEPT && part.sources[0].len() <= 2;
        // Small steps of the load at all times add up to a disturbance: they are not dropped.
        let stays = part.candidate.in_model || part.candidate.is_disturbance_step();
        let mut sources = part.sources.iter().flatten();
        let tangents = sources.all(|own| matches!(own, Source::Tangent(_) | Source::In(..)));
        if many && tangents && !stays {
            let width = part.sources[0].len();
            for own in part.by_run() {
                groups.extend(own.chunks(LANES / width).map(|forms| Group {
                    part: number,
                    forms: forms.to_vec(),
                    products: vec![],
                }));
            }
        }
    }
    let residuals: Vec<&[[f64; 2]]> = runs.iter().map(|run| &run.followed.white[..]).collect();
    let Some(given) = Base::of_runs(&residuals, base, precision) else {
        return;
    };
    groups.par_iter_mut().with_max_len(1).for_each(|group| {
        let forms = group.forms.iter();
        let sources = forms.flat_map(|form| &parts[group.part].sources[*form]);
        group.products = vec![[0.0; LANES]; precision.len() + 3];
        for (number, (run, base)) in runs.iter().zip(base).enumerate() {
            let tangents = sources.clone().filter_map(|own| own.tangent(number));
            let tangents: Vec<&Tangent> = tangents.collect();
            if !tangents.is_empty() {
                let columns: Vec<&[f32]> = base.columns.iter().map(|own| &own[..]).collect();
                let residual = &run.followed.white;
                add_products(run, &columns, residual, &tangents, &mut group.products);
            }
        }
    });
    for (number, part) in parts.iter_mut().enumerate() {
        let mut gains: Vec<(usize, f64)> = Vec::new();
        for group in groups.iter().filter(|group| group.part == number) {
            let width = part.sources[0].len();
            for (place, form) in group.forms.iter().enumerate() {
                if part.candidate.is_event() {
                    let unit = part.candidate.variants[*form].columns[0].unit;
                    let information = given.information(&group.products, place, unit);
                    part.candidate.moments.push(information);
                }
                gains.push((*form, given.gain(&group.products, place * width, width)));
            }
        }
        if gains.is_empty() {
            continue;
        }
        gains.sort_by(|a, b| b.1.total_cmp(&a.1));
        let mut kept: Vec<usize> = Vec::new();
        for own in part.by_run() {
            let gains = gains.iter().filter(|gain| own.contains(&gain.0));
            kept.extend(gains.take(KEPT).map(|gain| gain.0));
        }
        let variants = part.candidate.variants.iter().enumerate();
        let rivals = variants.filter(|variant| variant.1.is_rival);
        kept.extend(rivals.map(|variant| variant.0));
        part.keep(|form| kept.contains(&form));
    }
}

impl Part {
    /// The forms of an event of each run; of what all runs share all forms.
    fn by_run(&self) -> Vec<Vec<usize>> {
        let run = |form: &usize| {
            let mut moments = self.candidate.variants[*form].moments();
            moments.next().map_or(0, |moment| moment.0)
        };
        let forms: Vec<usize> = (0..self.sources.len()).collect();
        let of_runs = forms.chunk_by(|a, b| run(a) == run(b));
        of_runs.map(<[usize]>::to_vec).collect()
    }

    fn keep(&mut self, wanted: impl Fn(usize) -> bool) {
        let mut form = 0..;
        self.sources.retain(|_| form.next().is_some_and(&wanted));
        let (mut form, variants) = (0.., &mut self.candidate.variants);
        variants.retain(|_| form.next().is_some_and(&wanted));
    }
}

/// Leaves out forms of what is there wholly or not at all that the beginning of a run refutes already: each that is left
/// costs a simulation of every run. Where it refutes all, that which comes nearest stays with what is known of it. Nothing
/// is refuted where the model is far off, or where the beginning says too little.
pub(super) fn drop_refuted(
    parts: &mut [Part],
    run: &LinearisedRun<'_>,
    base: &Whitened,
    precision: &[f64],
) {
    if squares(std::slice::from_ref(run)) > FAR_MEAN_SQUARE * run.follower.rows as f64 {
        return;
    }
    let beginning = beginning(run.scenario, run.scenario.samples().div_ceil(LOOK));
    let base = base.beginning(2 * beginning.samples());
    let residual = &run.followed.white[..beginning.samples()];
    let Some(given) = Base::of_runs(&[residual], std::slice::from_ref(&base), precision) else {
        return;
    };
    // How much of the effect is there, and its column.
    let look = |source: &Source, mean: f64| -> Option<(f64, Vec<f32>)> {
        let Source::Difference { model, step } = source else {
            return None;
        };
        let column = run.difference(model, &beginning, *step);
        let products = base.products(&column, residual);
        let k = precision.len();
        let cross = products.rows(0, k).into_owned();
        let [own, rest] = given.left(&cross, products[k], products[k + 1]);
        (own * mean * mean > PLAIN_SIGMAS * PLAIN_SIGMAS).then(|| (rest / own / mean, column))
    };
    let whole = |part: &Part| !part.candidate.in_model && part.candidate.variants[0].mean > 0.0;
    let wholes = parts.par_iter_mut().filter(|part| whole(part));
    wholes.for_each(|part| {
        let mean = part.candidate.variants[0].mean;
        let forms = part.sources.par_iter().with_max_len(1);
        let looks: Vec<Option<(f64, Vec<f32>)>> =
            forms.map(|sources| look(&sources[0], mean)).collect();
        let refuted = |look: &Option<(f64, Vec<f32>)>| {
            look.as_ref().is_some_and(|look| look.0 < REFUTED_SHARE)
        };
        if !looks.iter().all(refuted) {
            part.keep(|form| !refuted(&looks[form]));
            return;
        }
        let looks = looks.into_iter().enumerate();
        let looks = looks.filter_map(|(form, look)| Some((form, look?)));
        if let Some((nearest, (_, column))) = looks.max_by(|a, b| a.1.0.total_cmp(&b.1.0)) {
            part.sources[nearest] = vec![Source::Known(column)];
            part.keep(|form| form == nearest);
        }
    });
}

/// The run's first samples.
fn beginning(scenario: &Scenario, samples: usize) -> Scenario {
    let mut beginning = scenario.clone();
    beginning.sample_time_s.truncate(samples);
    beginning.current_a.truncate(samples);
    beginning.speed_rad_s.truncate(samples);
    beginning.time_half_width_s.truncate(samples);
    beginning.scored = 0..samples;
    beginning
}

/// Products of the tangents with these columns, with the residual, with themselves, and of each even one with the next.
pub(super) fn add_products(
    run: &LinearisedRun<'_>,
    columns: &[&[f32]],
    residual: &[[f64; 2]],
    tangents: &[&Tangent],
    products: &mut [Lane],
) {
    let (with_base, others) = products.split_at_mut(columns.len());
    let [with_rest, squares, pairs] = others else {
        return;
    };
    carry(run, tangents, |first, white| {
        for (sum, column) in with_base.iter_mut().zip(columns) {
            let mut part = [0.0; LANES];
            // A column may end early.
            let left = column.get(2 * first..).unwrap_or_default();
            for (value, row) in left.iter().zip(white) {
                let value = f64::from(*value);
                for k in 0..LANES {
                    part[k] += value * row[k];
                }
            }
            for k in 0..LANES {
                sum[k] += part[k];
            }
        }
        for (values, rows) in residual[first..].iter().zip(white.chunks_exact(2)) {
            for (value, row) in values.iter().zip(rows) {
                for k in 0..LANES {
                    with_rest[k] += value * row[k];
                }
            }
        }
        for row in white {
            for k in 0..LANES {
                squares[k] += row[k] * row[k];
            }
            for k in (0..LANES).step_by(2) {
                pairs[k] += row[k] * row[k + 1];
            }
        }
    });
}

/// The normal equations of columns that are in, beside which others are held.
pub(super) struct Base {
    factor: Cholesky<f64, Dyn>,
    right: DVector<f64>,
}

impl Base {
    /// Of some columns of all runs.
    pub(super) fn of_columns(linear: &Linear, columns: &[usize]) -> Option<Self> {
        let right = DVector::from_fn(columns.len(), |r, _| linear.right[columns[r]]);
        let factor = linear.factor(columns)?;
        Some(Self { factor, right })
    }

    /// Of whitened columns with the `precision` that they have beforehand, and what they leave to explain.
    fn of_runs(residuals: &[&[[f64; 2]]], base: &[Whitened], precision: &[f64]) -> Option<Self> {
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

    /// What is left of a column with these products with the base, with itself and with the residual: its information, and
    /// its score.
    pub(super) fn left(&self, cross: &DVector<f64>, own: f64, rest: f64) -> [f64; 2] {
        let solved = self.factor.solve(cross);
        [own - cross.dot(&solved), rest - self.right.dot(&solved)]
    }

    /// Log of the evidence of the form in these lanes of [`add_products`].
    pub(super) fn gain(&self, products: &[Lane], lane: usize, width: usize) -> f64 {
        let m = self.right.len();
        let cross = DMatrix::from_fn(m, width, |r, c| products[r][lane + c]);
        let solved = self.factor.solve(&cross);
        let own = DMatrix::from_fn(width, width, |r, c| {
            if r == c {
                products[m + 1][lane + r] + 1.0
            } else {
                products[m + 2][lane]
            }
        });
        let rest = DVector::from_fn(width, |r, _| products[m][lane + r]);
        let rest = rest - solved.tr_mul(&self.right);
        let Some(schur) = (own - cross.tr_mul(&solved)).cholesky() else {
            return f64::NEG_INFINITY;
        };
        let log_det: f64 = schur.l().diagonal().iter().map(|d| d.ln()).sum();
        0.5 * rest.dot(&schur.solve(&rest)) - log_det
    }

    /// What the runs say of the form of one column in this lane.
    fn information(&self, products: &[Lane], lane: usize, unit: f64) -> ColumnInformation {
        let m = self.right.len();
        let cross = DVector::from_fn(m, |r, _| products[r][lane]);
        let [information, score] = self.left(&cross, products[m + 1][lane], products[m][lane]);
        ColumnInformation {
            information,
            score,
            unit,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::KEPT;
    use crate::joint::columns::{Candidate, LinearisedRun, Variant, linearise};
    use crate::joint::events::Hypothesis;
    use crate::joint::follow::DISTURBED;
    use crate::kit::{nameplate, truth};
    use drivebench_model::plant::effect::CATALOGUE;
    use drivebench_model::plant::testing::record;
    use drivebench_model::plant::{Model, State};

    /// What `model` asks of the catalogue in a run of `truth`.
    fn candidates(model: &Model, truth: &Model) -> Vec<Candidate> {
        let levels = [
            30.0, -40.0, 60.0, -20.0, 50.0, -60.0, 25.0, -45.0, 80.0, -30.0,
        ];
        let events = levels.iter().enumerate();
        let events = events.map(|(k, level)| (0.25 * k as f64, *level)).collect();
        let scenario = record(truth, events, 1e-3, 2.5, 5);
        let runs = [LinearisedRun::new(model, &scenario, State::default(), DISTURBED).unwrap()];
        let linear = linearise(&Hypothesis::of(model), CATALOGUE, &runs, false);
        linear.unwrap().candidates
    }

    fn find<'a>(candidates: &'a [Candidate], id: &str) -> &'a Candidate {
        candidates
            .iter()
            .find(|candidate| candidate.id == id)
            .unwrap()
    }

    /// Whether a form with this value is among those that were kept.
    fn keeps(candidate: &Candidate, place: usize, value: f64) -> bool {
        let mut forms = candidate.variants.iter();
        forms.any(|form| (form.values[place] - value).abs() < 1e-9)
    }

    #[test]
    fn the_right_order_is_among_those_that_are_kept_and_what_is_not_there_keeps_one_form() {
        let candidates = candidates(&nameplate(), &truth("cogging", &[0.01, 0.01, 7.0]));
        let cogging = find(&candidates, "cogging");
        assert_eq!(cogging.variants.len(), KEPT);
        assert!(keeps(cogging, 2, 7.0));
        // Those that were dropped keep their share beforehand.
        assert!((cogging.variants[0].log_prior + 23.0_f64.ln()).abs() < 1e-9);
        for id in ["elastic_coupling", "backlash"] {
            assert_eq!(find(&candidates, id).variants.len(), 1, "{id}");
        }
    }

    #[test]
    fn an_event_is_held_against_another_at_its_own_moment() {
        let stepped = truth("load_step", &[0.1, 1.13]);
        let candidates = candidates(&stepped, &stepped);
        let pull = find(&candidates, "one_sided_load");
        let mut moments = pull.variants.iter().flat_map(Variant::moments);
        assert!(moments.any(|(_, time_s)| (time_s - 1.13).abs() < 1e-9));
        // What the moments say that have no columns is kept too.
        assert!(pull.moments.len() > pull.variants.len());
    }

    #[test]
    fn a_coupling_that_is_there_is_not_refuted() {
        let coupled = truth("elastic_coupling", &[28.0, 0.35, 0.03, 0.5]);
        let candidates = candidates(&nameplate(), &coupled);
        assert!(keeps(find(&candidates, "elastic_coupling"), 0, 28.0));
    }
}
