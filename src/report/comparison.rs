//! A model beside a measurement: the page of `compare`, and its blocks, which the page of a commission has too: figures of
//! each signal, residual lights, balances, and the places where the model fails.

use super::page::{Cell, Page, Table, Tone};
use super::plot::MapChart;
use super::{Context, tables};
use crate::diagnosis::{
    Comparison, FailureLocation, HoldoutFrom, SignalComparison, SignalScore, Signals,
};
use crate::identification::noise::FloorSource;
use crate::sample::ParameterEstimate;
use crate::text::lines::capitalised;
use crate::text::number::{fixed, percent, r_min, share, significant};
use crate::units::rpm_from_rad_s;

/// Places that are worth a line each.
const MOST_PLACES: usize = 4;

/// Everything that the page of a comparison is made of.
#[derive(Clone, Debug)]
pub struct ComparisonReport<'a> {
    pub title: &'a str,
    pub context: &'a Context,
    pub comparison: &'a Comparison,
    /// Whether something speaks against the hold-out; the notes of the context say what.
    pub holdout_objected: bool,
    /// Of the model that is compared; may be empty.
    pub parameters: &'a [ParameterEstimate],
}

impl ComparisonReport<'_> {
    pub fn html(&self) -> String {
        self.page().html()
    }

    pub fn page(&self) -> Page {
        let found = self.comparison;
        let mut page = Page::new(self.title, "Comparison of a model with a run");
        tables::about(&mut page, self.context);
        let from = match found.holdout_from {
            HoldoutFrom::Run if self.holdout_objected => {
                "the run that was named to judge by, against which something speaks (see below),"
            }
            HoldoutFrom::Run => "a run that the fit has not seen",
            HoldoutFrom::Split => "the last part of the run",
        };
        let fails = found.balances.iter().any(|balance| balance.fails);
        let (tone, word, rest) = if found.noise_floor_from == FloorSource::None {
            let rest = "its scale; without a noise floor nobody can say how good that is.";
            (Tone::Attention, "No noise floor", rest)
        } else if found.is_at_the_floor() && !fails {
            let rest = "the noise floor: the model explains the run.";
            (Tone::Good, "At the noise floor", rest)
        } else if found.is_at_the_floor() {
            let rest =
                "the noise floor, but one of its equations fails: the model misses something.";
            (Tone::Attention, "An equation fails", rest)
        } else {
            let rest = "the noise floor: the model misses something.";
            (Tone::Attention, "Above the noise floor", rest)
        };
        let error = fixed(found.holdout_rmse, 2);
        page.lead(
            tone,
            word,
            format!("On {from} the error is {error} times {rest}"),
        );
        tables::data_notes(&mut page, self.context);
        let models = [("model", Some(found))];
        page.section("Model beside measurement");
        figures(&mut page, &models);
        places(&mut page, &models);
        if !self.parameters.is_empty() {
            tables::parameter_section(&mut page, None, &[], self.parameters);
        }
        tables::conditions(&mut page, self.context);
        page
    }
}

/// A comparison with what its model is called.
pub(super) type Named<'a> = (&'static str, Option<&'a Comparison>);

/// Figures of one signal under one model: terminal, screen and page show these.
#[derive(Clone, Debug)]
pub struct SignalFigures {
    pub signal: &'static str,
    /// With the length of the windows, where the figures are of those.
    pub name: String,
    pub unit: &'static str,
    pub holdout: SignalScore,
    pub noise_floor: Option<f64>,
    pub fit_percent: f64,
    pub rmse: f64,
    pub one_step_rmse: Option<f64>,
}

impl SignalFigures {
    /// Speed, current and torque, as far as they are compared.
    pub fn all(signals: &Signals) -> Vec<Self> {
        let of = |signal, name, unit, own: SignalComparison| Self {
            signal,
            name,
            unit,
            holdout: own.holdout,
            noise_floor: own.noise_floor,
            fit_percent: own.fit_percent,
            rmse: own.rmse,
            one_step_rmse: Some(own.one_step_rmse),
        };
        let speed = signals.speed_rad_s;
        let speed = speed.map(|own| of("speed", signals.speed_name(), "rad/s", own));
        let current = signals.current_a;
        let current = current.map(|own| of("current", "current".to_owned(), "A", own));
        let torque = signals.torque_n_m.as_ref().map(|own| Self {
            signal: "torque",
            name: "torque".to_owned(),
            unit: "N.m",
            holdout: own.holdout,
            noise_floor: own.noise_floor,
            fit_percent: own.fit_percent,
            rmse: own.rmse,
            one_step_rmse: None,
        });
        [speed, current, torque].into_iter().flatten().collect()
    }

    /// The held-out error over the noise floor, where that is known.
    pub fn times_noise(&self) -> Option<String> {
        self.noise_floor
            .map(|floor| fixed(self.holdout.rmse / floor, 2))
    }

    fn cell(&self, value: f64) -> Cell {
        let cell = Cell::text(format!("{} {}", significant(value, 3), self.unit));
        if self.unit == "rad/s" && value.is_finite() {
            cell.with_note(r_min(value))
        } else {
            cell
        }
    }
}

/// Fit and error of every signal, what is left in the residual, and its lights.
pub(super) fn figures(page: &mut Page, comparisons: &[Named<'_>]) {
    let known = comparisons.iter();
    let known: Vec<_> = known
        .filter_map(|(label, own)| Some((*label, (*own)?)))
        .collect();
    let mut rows = Vec::new();
    for (label, own) in &known {
        let figures = SignalFigures::all(&own.signals).into_iter();
        rows.extend(figures.map(|figures| (*label, figures)));
    }
    // Each signal under one model after the other.
    let place = |signal| ["speed", "current"].iter().position(|one| *one == signal);
    rows.sort_by_key(|(_, row)| place(row.signal).unwrap_or(2));
    let or = |value: Option<f64>, row: &SignalFigures, word: &str| {
        value.map_or_else(|| Cell::text(word), |value| row.cell(value))
    };
    page.table(
        Table::of(rows)
            .column("signal", |(_, row)| row.name.clone())
            .column("model", |(label, _)| *label)
            .column("held-out fit", |(_, row)| percent(row.holdout.fit_percent))
            .column("held-out rms error", |(_, row)| row.cell(row.holdout.rmse))
            .column("noise floor", |(_, row)| {
                or(row.noise_floor, row, "not known")
            })
            .column("training fit", |(_, row)| percent(row.fit_percent))
            .column("training rms error", |(_, row)| row.cell(row.rmse))
            .column("one-step rms error", |(_, row)| {
                or(row.one_step_rmse, row, "-")
            }),
    );
    let residual = |(label, comparison): &(&str, &Comparison)| {
        let residual = &comparison.residual;
        if !residual.enough_samples {
            return format!(
                "Residual of the {label}: too few samples to say whether only noise is left."
            );
        }
        let white = if residual.white {
            "it is white, as noise is"
        } else {
            "there is more than noise in it"
        };
        format!(
            "Residual of the {label}: {white} ({} of the autocorrelation lags lie outside their 99 % band; 1 % is \
             chance).",
            share(residual.autocorrelation_outside_99_percent)
        )
    };
    page.list(known.iter().map(residual).collect());
    lights(page, &known);
}

/// The residual lights of each model, in multiples of their 99 % band.
fn lights(page: &mut Page, models: &[(&'static str, &Comparison)]) {
    let of_model = |(label, own): &(&'static str, &Comparison)| {
        let label = *label;
        let signals = own.residual.named();
        signals
            .map(move |(signal, lights)| (signal, label, lights))
            .collect::<Vec<_>>()
    };
    let rows: Vec<_> = models.iter().flat_map(of_model).collect();
    if rows.is_empty() {
        return;
    }
    page.paragraph(
        "Residual lights, lags 0 to 25: the largest correlation over its 99 % band. A right model stays near 1; a wrong one \
         shows 18 to 42 in the first column.",
    );
    let heads = [
        "whiteness",
        "input",
        "input squared",
        "squares",
        "error x input",
    ];
    let table = Table::of(rows)
        .column("signal", |(signal, ..)| *signal)
        .column("model", |(_, label, _)| *label);
    let table = heads
        .into_iter()
        .enumerate()
        .fold(table, |table, (place, head)| {
            table.column(head, |(_, _, lights)| {
                let (_, light) = lights.named()[place];
                let word = if light.passes { "ok" } else { "outside" };
                format!("{} {word}", significant(light.largest_over_band, 2))
            })
        });
    page.table(table.column("Ljung-Box (of 99 % limit)", |(_, _, lights)| {
        let (found, limit) = (lights.ljung_box, lights.ljung_box_limit);
        format!("{} of {}", significant(found, 3), significant(limit, 3))
    }));
}

/// Where each model fails: sentences, balances, the map.
pub(super) fn places(page: &mut Page, comparisons: &[Named<'_>]) {
    page.section("Where the model fails");
    for (label, comparison) in comparisons {
        let Some(comparison) = comparison else {
            continue;
        };
        let label = capitalised(label);
        if comparison.locations.is_empty() {
            page.paragraph(format!("{label}: {}.", comparison.headline()));
        } else {
            let undecided = comparison.undecided().unwrap_or_default();
            page.paragraph(format!("{label}: {undecided}").trim_end().to_owned());
            let places = comparison.locations.iter().take(MOST_PLACES);
            page.list(places.map(place).collect());
        }
        balances(page, comparison);
        map(page, comparison);
        let limits = comparison.limits.iter();
        page.list(limits.map(|limit| capitalised(limit)).collect());
    }
}

/// A place's sentence; r/min is added where it lies along the speed.
fn place(location: &FailureLocation) -> String {
    let sentence = capitalised(&location.sentence);
    if location.variable == "speed_rad_s" {
        let from = significant(rpm_from_rad_s(location.from), 3);
        format!("{sentence} [{from} to {}]", r_min(location.to))
    } else {
        sentence
    }
}

/// What each equation lacks, with its share of the error.
fn balances(page: &mut Page, comparison: &Comparison) {
    let known = |value: Option<f64>| {
        value.map_or_else(|| "not known".to_owned(), |value| significant(value, 3))
    };
    let part = |part: Option<f64>| part.map_or_else(|| "-".to_owned(), share);
    page.table(
        Table::of(&comparison.balances)
            .column("equation", |own| {
                Cell::text(own.equation).with_note(capitalised(&own.sentence))
            })
            .column("what it lacks, rms", |own| {
                format!("{} {}", significant(own.rms, 3), own.unit)
            })
            .column("times its noise", |own| known(own.nres))
            .column("with its values free", |own| known(own.nres_refitted))
            .column("share of the error", |own| part(own.share_of_error))
            .column("forward", |own| {
                let time = part(own.forward_share_of_time);
                let error = Cell::text(part(own.forward_share_of_error));
                error.with_note(format!("{time} of the time"))
            }),
    );
}

/// The map of the equation that fails worse; nothing where none fails.
fn map(page: &mut Page, comparison: &Comparison) {
    let Some((map, worst)) = comparison.map.as_ref().zip(comparison.failing()) else {
        return;
    };
    let chart = MapChart {
        title: format!("{} error, {}", worst.equation, worst.unit),
        across: ("current, A", &map.current_edges_a),
        upwards: ("speed, rad/s", &map.speed_edges_rad_s),
        values: map.cells(worst.equation),
        counts: &map.count,
    };
    page.figure(
        chart.svg("error of the model over speed and current"),
        format!(
            "Root mean square of what the {} equation lacks, over speed and current, on the held-out run. Where there is no \
             cell the run never was.",
            worst.equation
        ),
    );
}
