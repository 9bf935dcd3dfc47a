//! Screening of forms by their marginal likelihood before the selection (sure independence screening: Fan and Lv, J. R. Stat. Soc.
//! B 70, 2008): of effects with many forms only the likeliest get a column.

use rayon::prelude::*;

use super::regression::{Base, FAR_MEAN_SQUARE, Part, Source};
use super::run::{LinearisedRun, squares};
use super::tangent::{LANES, Lane, Tangent, propagate};
use super::whitened::Whitened;
use drivebench_model::plant::Scenario;

/// Forms of one effect that are kept in each run.
const KEPT: usize = 6;

/// Forms whose columns are propagated in the lanes of one pass, and their products with base, residual and each other.
struct Group {
    part: usize,
    forms: Vec<usize>,
    products: Vec<Lane>,
}

/// Keeps of each part with many forms those with the largest likelihood ratio, given the `base` columns with their prior
/// `precision`. The priors of the kept forms are not renormalised.
pub(super) fn keep_likeliest(
    parts: &mut [Part],
    runs: &[LinearisedRun<'_>],
    base: &[Whitened],
    precision: &[f64],
) {
    let mut groups = Vec::new();
    for (number, part) in parts.iter().enumerate() {
        let (candidate, width) = (&part.candidate, part.sources[0].len());
        // Load steps at all times together approximate a random-walk disturbance: they are not screened.
        let is_step = candidate.effect.is_some_and(|own| own.card().is_disturbance_step);
        let mut sources = part.sources.iter().flatten();
        if part.sources.len() > KEPT
            && width <= 2
            && !candidate.in_model
            && !is_step
            && sources.all(|own| matches!(own, Source::Tangent(_) | Source::In(..)))
        {
            for own in part.by_run() {
                groups.extend(own.chunks(LANES / width).map(|forms| Group {
                    part: number,
                    forms: forms.to_vec(),
                    products: vec![[0.0; LANES]; precision.len() + 3],
                }));
            }
        }
    }
    let residuals: Vec<&[[f64; 2]]> = runs.iter().map(|run| &run.filtered.white[..]).collect();
    let Some(given) = Base::of_runs(&residuals, base, precision) else {
        return;
    };
    groups.par_iter_mut().with_max_len(1).for_each(|group| {
        let forms = group.forms.iter();
        let sources = forms.flat_map(|form| &parts[group.part].sources[*form]);
        for (number, (run, base)) in runs.iter().zip(base).enumerate() {
            let tangents: Vec<&Tangent> =
                sources.clone().filter_map(|own| own.tangent(number)).collect();
            if !tangents.is_empty() {
                let columns: Vec<&[f32]> = base.columns.iter().map(|own| &own[..]).collect();
                let residual = &run.filtered.white;
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
                    part.candidate.event_information.push(information);
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
        kept.extend(variants.filter(|own| own.1.is_rival).map(|own| own.0));
        part.keep(|form| kept.contains(&form));
    }
}

impl Part {
    /// Indices of the forms, grouped by the run of the event; one group for an effect that all runs share.
    fn by_run(&self) -> Vec<Vec<usize>> {
        let run = |form: &usize| {
            let mut event_times = self.candidate.variants[*form].event_times();
            event_times.next().map_or(0, |event_time| event_time.0)
        };
        let forms: Vec<usize> = (0..self.sources.len()).collect();
        let of_runs = forms.chunk_by(|a, b| run(a) == run(b));
        of_runs.map(<[usize]>::to_vec).collect()
    }
}

/// Drops forms of effects of fixed size that the first sixth of the run refutes, because each form costs a simulation of every
/// run. If all are refuted, the nearest stays with its column of that part. Nothing is dropped where the model is far from the
/// data or the first sixth holds too little information.
pub(super) fn drop_refuted(
    parts: &mut [Part],
    run: &LinearisedRun<'_>,
    base: &Whitened,
    precision: &[f64],
) {
    if squares(std::slice::from_ref(run)) > FAR_MEAN_SQUARE * run.gains.rows as f64 {
        return;
    }
    // A sixth of the run.
    let beginning = beginning(run.scenario, run.scenario.samples().div_ceil(6));
    let base = base.beginning(2 * beginning.samples());
    let residual = &run.filtered.white[..beginning.samples()];
    let Some(given) = Base::of_runs(&[residual], std::slice::from_ref(&base), precision) else {
        return;
    };
    // Estimated size over the fixed one, and the column, if the effect makes at least 20 standard deviations.
    let look = |source: &Source, mean: f64| -> Option<(f64, Vec<f32>)> {
        let Source::Difference { model, step } = source else {
            return None;
        };
        let column = run.difference(model, &beginning, *step);
        let products = base.products(&column, residual);
        let k = precision.len();
        let cross = products.rows(0, k).into_owned();
        let [own, rest] = given.schur_complement(&cross, products[k], products[k + 1]);
        (own * mean * mean > 20.0 * 20.0).then(|| (rest / own / mean, column))
    };
    let parts = parts.par_iter_mut();
    let fixed_sizes = parts.filter(|own| !own.candidate.in_model && own.candidate.has_fixed_size());
    fixed_sizes.for_each(|part| {
        let mean = part.candidate.variants[0].mean;
        let forms = part.sources.par_iter().with_max_len(1);
        let looks: Vec<Option<(f64, Vec<f32>)>> =
            forms.map(|sources| look(&sources[0], mean)).collect();
        // An estimate below a fifth of the fixed size refutes the effect.
        let refuted =
            |look: &Option<(f64, Vec<f32>)>| look.as_ref().is_some_and(|look| look.0 < 0.2);
        if !looks.iter().all(refuted) {
            part.keep(|form| !refuted(&looks[form]));
            return;
        }
        let looks = looks.into_iter().enumerate().filter_map(|(form, look)| Some((form, look?)));
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
    propagate(run, tangents, |first, white| {
        for (sum, column) in with_base.iter_mut().zip(columns) {
            let mut part = [0.0; LANES];
            // A column may end early.
            let left = column.get(2 * first..).unwrap_or_default();
            for (value, row) in left.iter().zip(white) {
                add_scaled(&mut part, f64::from(*value), row);
            }
            add_scaled(sum, 1.0, &part);
        }
        for (value, row) in residual[first..].iter().flatten().zip(white) {
            add_scaled(with_rest, *value, row);
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

#[inline]
fn add_scaled(sum: &mut Lane, factor: f64, row: &Lane) {
    for k in 0..LANES {
        sum[k] += factor * row[k];
    }
}

#[cfg(test)]
mod tests {
    use super::KEPT;
    use crate::joint::columns::linearise;
    use crate::joint::events::Hypothesis;
    use crate::joint::kalman::DISTURBED;
    use crate::joint::regression::{Candidate, Variant};
    use crate::joint::run::LinearisedRun;
    use crate::kit::{nameplate, truth};
    use drivebench_model::plant::effect::CATALOGUE;
    use drivebench_model::plant::testing::record;
    use drivebench_model::plant::{Model, State};

    /// Candidates besides `model` in a run of `truth`, by their names.
    fn candidates(model: &Model, truth: &Model) -> impl Fn(&str) -> Candidate + use<> {
        let levels_v = [30.0, -40.0, 60.0, -20.0, 50.0, -60.0, 25.0, -45.0, 80.0, -30.0];
        let events = levels_v.iter().enumerate().map(|(k, level_v)| (0.25 * k as f64, *level_v));
        let scenario = record(truth, events.collect(), 1e-3, 2.5, 5);
        let runs = [LinearisedRun::new(model, &scenario, State::default(), DISTURBED).unwrap()];
        let linear = linearise(&Hypothesis::of(model), CATALOGUE, &runs, false).unwrap();
        move |id| {
            let mut found = linear.candidates.iter().filter(|own| own.id == id);
            found.next().unwrap().clone()
        }
    }

    /// Whether the form next to this value is among those that were kept: frequencies are 16 % apart.
    fn keeps(candidate: &Candidate, place: usize, value: f64) -> bool {
        let mut forms = candidate.variants.iter();
        forms.any(|form| (form.values[place] / value - 1.0).abs() < 0.08)
    }

    #[test]
    fn the_right_order_is_kept_and_of_what_is_absent_one_form() {
        let find = candidates(&nameplate(), &truth("cogging", &[0.01, 0.01, 7.0]));
        let cogging = find("cogging");
        assert_eq!(cogging.variants.len(), KEPT);
        assert!(keeps(&cogging, 2, 7.0));
        // The prior of those that were dropped is not shared.
        assert!((cogging.variants[0].log_prior + 23.0_f64.ln()).abs() < 1e-9);
        for id in ["elastic_coupling", "backlash"] {
            assert_eq!(find(id).variants.len(), 1, "{id}");
        }
        let coupled = truth("elastic_coupling", &[28.0, 0.35, 0.03, 0.5]);
        let find = candidates(&nameplate(), &coupled);
        assert!(keeps(&find("elastic_coupling"), 0, 28.0), "refuted");
    }

    #[test]
    fn an_event_is_weighed_at_the_moment_of_another() {
        let stepped = truth("load_step", &[0.1, 1.13]);
        let pull = candidates(&stepped, &stepped)("one_sided_load");
        let mut event_times = pull.variants.iter().flat_map(Variant::event_times);
        assert!(event_times.any(|(_, time_s)| (time_s - 1.13).abs() < 1e-9));
        // Times without columns have their information, too.
        assert!(pull.event_information.len() > pull.variants.len());
    }
}
