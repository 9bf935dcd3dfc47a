//! A model compared with a measurement: the page of `compare`, and its blocks, which the page of a commissioning has too:
//! figures of each signal, residual tests, balances, and where the model fails.

use super::plot::MapChart;
use super::traces::{ConfirmRun, traces};
use super::wording::{self, change, limits, location, residual};
use super::{Bars, Cell, Context, Document, Table, Tone, findings, tables};
use drivebench_diagnose::{
    AddResult, Comparison, EffectCurve, FailureLocation, HoldoutFrom, MapCell, MapDigits,
    SignalComparison, SignalScore, Signals, Where,
};
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::effect;
use drivebench_model::text::lines::capitalised;
use drivebench_model::text::number::{fit, fixed, r_min, share, significant};
use drivebench_model::units::rpm_from_rad_s;

#[derive(Clone, Debug)]
pub struct ComparisonReport<'a> {
    pub title: &'a str,
    pub context: &'a Context,
    pub comparison: &'a Comparison,
    pub model: &'a str,
    /// Whether there is an objection to the hold-out; the notes of the context have the reason.
    pub holdout_objected: bool,
    /// The model's free run over what is held out, where there is a voltage.
    pub series: Option<&'a ConfirmRun>,
    /// The error of the worse equation over its axis.
    pub curve: Option<&'a EffectCurve>,
}

impl ComparisonReport<'_> {
    /// How good the model is, in a sentence.
    fn verdict(&self) -> (Tone, &'static str, String) {
        let found = self.comparison;
        let from = match found.holdout_from {
            HoldoutFrom::Run if self.holdout_objected => {
                "the given hold-out run, to which there is an objection (see below),"
            }
            HoldoutFrom::Run => "a run not used in the fit",
            HoldoutFrom::Split => "the last part of the run",
        };
        if let Some(reason) = location::not_fitted(found) {
            let sentence = format!(
                "{reason}: the model predicts {from} no better, and its residual is no evidence on the machine."
            );
            return (Tone::Bad, "Not fitted", sentence);
        }
        let fails = found.balances.iter().any(|balance| balance.fails);
        let (tone, verdict, rest) = if found.noise_floor_from == FloorSource::None {
            let rest = "its scale; without a noise floor this cannot be rated.";
            (Tone::Attention, "No noise floor", rest)
        } else if found.is_at_the_floor() && !fails {
            let rest = "the noise floor: the model explains the run.";
            (Tone::Good, "At the noise floor", rest)
        } else if found.is_at_the_floor() {
            let rest = "the noise floor, but one of its equations fails: an effect is missing.";
            (Tone::Attention, "An equation fails", rest)
        } else {
            let rest = "the noise floor: an effect is missing.";
            (Tone::Attention, "Above the noise floor", rest)
        };
        let error = fixed(found.holdout_rmse, 2);
        (tone, verdict, format!("On {from} the error is {error} times {rest}"))
    }

    pub fn document(&self) -> Document {
        let mut document = Document::new(self.title, "Comparison of a model with a run");
        tables::about(&mut document, self.context);
        let (tone, verdict, sentence) = self.verdict();
        document.lead(tone, verdict, sentence);
        document.say("model", [self.model], 1);
        tables::data_notes(&mut document, self.context);
        let models = [("model", self.comparison)];
        document.section("Model and measurement");
        if let Some(run) = self.series {
            traces(&mut document, run);
        }
        figures(&mut document, &models, HELD_OUT);
        document.section("Errors of the equations");
        if let Some(curve) = self.curve {
            findings::effect_curve(&mut document, curve);
        }
        places(&mut document, &models);
        tables::conditions(&mut document, self.context);
        document
    }
}

/// A comparison alone, for a screen: errors, residual tests, where the model fails.
pub fn comparison_document(comparison: &Comparison) -> Document {
    let mut document = Document::new("", "");
    let models = [("model", comparison)];
    figures(&mut document, &models, HELD_OUT);
    places(&mut document, &models);
    document
}

/// The held-out error of each signal before and after a change.
pub fn error_changes(result: &AddResult) -> String {
    let [before, after] =
        [&result.before, &result.after].map(|own| SignalFigures::all(&own.signals));
    let changes = before.iter().filter_map(|old| {
        let new = after.iter().find(|new| new.signal == old.signal)?;
        let [old_rmse, new_rmse] = [old, new].map(|own| significant(own.holdout.rmse, 3));
        Some(format!("{old_rmse} -> {new_rmse} {}", old.unit))
    });
    changes.collect::<Vec<_>>().join(", ")
}

/// A comparison with what its model is called.
pub(super) type Named<'a> = (&'static str, &'a Comparison);

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
        let speed = speed.map(|own| of("speed", speed_name(signals), "rad/s", own));
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
        self.noise_floor.map(|floor| fixed(self.holdout.rmse / floor, 2))
    }

    fn cell(&self, value: f64) -> Cell {
        let cell = Cell::text(format!("{} {}", significant(value, 3), self.unit));
        if self.unit == "rad/s" && value.is_finite() { cell.with_note(r_min(value)) } else { cell }
    }
}

/// The speed, with the length of the windows where its figures are not those of the free run.
fn speed_name(signals: &Signals) -> String {
    let length_s = signals.speed_windows_s;
    length_s.map_or_else(|| "speed".to_owned(), |length_s| format!("speed ({length_s} s windows)"))
}

/// Result of adding or removing an effect: before and after; the command adds the next commands.
pub fn change_document(result: &AddResult) -> Document {
    let (tone, verdict) = match (result.forced, result.accepted) {
        (true, _) => (Tone::Attention, "Forced"),
        (false, true) => (Tone::Good, "Accepted"),
        (false, false) => (Tone::Attention, "Refused"),
    };
    // Cause and remedy are those of an effect that was added without force.
    let is_found = result.accepted && !result.forced && result.fit.model.has(result.effect);
    let mut document = Document::of(tone, verdict, change::change(result));
    let ladder = result.ladder.iter().zip(["before", "after"]).map(|(rung, name)| {
        let error = rung.holdout_rmse;
        (name.to_owned(), error, fixed(error, 2))
    });
    let unit = wording::unit(result.before.noise_floor_from);
    document
        .bars("ladder", Bars::new(ladder.collect(), format!("held-out error, in units of {unit}")));
    if let Some([before, after]) = &result.confirm {
        let (before, after) = (before.holdout_rmse, after.holdout_rmse);
        let times = wording::times(result.before.noise_floor_from);
        document.say("confirm", [format!("{before:.2} -> {after:.2} {times}")], 1);
    }
    if !result.accepted || result.fit.model.has(result.effect) {
        tables::parameter_section(&mut document, "size", None, &[], &result.parameters, 2);
    }
    figures(&mut document, &sides(result), HELD_OUT);
    places(&mut document, &sides(result));
    if let Some(effect) = effect::find(result.effect).filter(|_| is_found) {
        document.say("cause", [effect.card().causes], 1);
        document.say("remedy", [effect.card().remedy], 1);
    }
    document
}

fn sides(result: &AddResult) -> [Named<'_>; 2] {
    [("model before", &result.before), ("model after", &result.after)]
}

/// The run that errors are of, in heads of columns: fit, root mean square.
pub(super) type Heads = [&'static str; 2];
pub(super) const HELD_OUT: Heads = ["held-out fit", "held-out rms error"];
pub(super) const CONFIRMING: Heads = ["confirming fit", "confirming rms error"];

/// Fit and error of every signal, and the tests of its residual.
pub(super) fn figures(
    document: &mut Document,
    comparisons: &[Named<'_>],
    [fit_head, rms_head]: Heads,
) {
    const SPARE: &[&str] = &[
        "one-step rms error",
        "training rms error",
        "training fit",
        "noise floor",
        HELD_OUT[0],
        CONFIRMING[0],
    ];
    let mut rows = Vec::new();
    for (label, own) in comparisons {
        let figures = SignalFigures::all(&own.signals).into_iter();
        rows.extend(figures.map(|figures| (*label, figures)));
    }
    // Each signal under one model after the other.
    let order = |signal| ["speed", "current"].iter().position(|known| *known == signal);
    rows.sort_by_key(|(_, row)| order(row.signal).unwrap_or(2));
    let or = |value: Option<f64>, row: &SignalFigures, word: &str| {
        value.map_or_else(|| Cell::text(word), |value| row.cell(value))
    };
    let mut table = Table::of(rows).column("signal", |(_, row)| row.name.clone());
    if comparisons.len() > 1 {
        table = table.column("model", |(label, _)| *label);
    }
    let table = table
        .column(fit_head, |(_, row)| fit(row.holdout.fit_percent))
        .column(rms_head, |(_, row)| row.cell(row.holdout.rmse))
        .column("x noise", |(_, row)| row.times_noise().unwrap_or_else(|| "-".to_owned()))
        .column("noise floor", |(_, row)| or(row.noise_floor, row, "not known"))
        .column("training fit", |(_, row)| fit(row.fit_percent))
        .column("training rms error", |(_, row)| row.cell(row.rmse))
        .column("one-step rms error", |(_, row)| or(row.one_step_rmse, row, "-"));
    document.table_on_card("errors", table, SPARE, 2);
    for (index, (label, comparison)) in comparisons.iter().enumerate() {
        let sentence = residual::residual(&comparison.residual);
        let least = usize::from(index + 1 == comparisons.len());
        let model = label_of(comparisons, label);
        document.say("residual", [format!("{model}{sentence}")], least);
    }
    let last = comparisons.last().into_iter();
    document.say("", last.flat_map(|(_, last)| residual::details(&last.residual)), 0);
    lights(document, comparisons);
}

/// The residual tests of each model, in multiples of their 99 % band.
fn lights(document: &mut Document, models: &[Named<'_>]) {
    let of_model = |(label, own): &Named<'_>| {
        let label = *label;
        let signals = own.residual.named();
        signals.map(move |(signal, lights)| (signal, label, lights)).collect::<Vec<_>>()
    };
    let rows: Vec<_> = models.iter().flat_map(of_model).collect();
    if rows.is_empty() {
        return;
    }
    document.paragraph(
        "Residual tests, lags 0 to 25: the largest correlation over its 99 % band. A right model stays near 1; a wrong one \
         shows 18 to 42 in the first column.",
    );
    let heads = ["whiteness", "input", "input squared", "squares", "error x input"];
    let table = Table::of(rows)
        .column("signal", |(signal, ..)| *signal)
        .column("model", |(_, label, _)| *label);
    let table = heads.into_iter().enumerate().fold(table, |table, (index, head)| {
        table.column(head, |(_, _, lights)| {
            let light = lights.each()[index];
            let verdict = if light.passes { "ok" } else { "outside" };
            format!("{} {verdict}", significant(light.largest_over_band, 2))
        })
    });
    document.table(table.column("Ljung-Box (of 99 % limit)", |(_, _, lights)| {
        let (found, limit) = (lights.ljung_box, lights.ljung_box_limit);
        format!("{} of {}", significant(found, 3), significant(limit, 3))
    }));
}

/// What the sentences of a model begin with, where there is more than one.
fn label_of(models: &[Named<'_>], label: &str) -> String {
    if models.len() > 1 { format!("{label}: ") } else { String::new() }
}

/// Where each model fails: sentences, balances, the map; those of the last model are on the card.
pub(super) fn places(document: &mut Document, comparisons: &[Named<'_>]) {
    document.section("Where the model fails");
    for (index, (label, comparison)) in comparisons.iter().enumerate() {
        let is_last = index + 1 == comparisons.len();
        let mut say = |label: &str, sentences: Vec<String>, least| {
            if is_last {
                document.say(label, sentences, least);
            } else {
                document.labelled(label, sentences);
            }
        };
        let (place, places) = comparison.where_it_fails();
        let first = comparison.locations.first().filter(|_| place == Where::First);
        let in_r_min = first.and_then(range_in_r_min).unwrap_or_default();
        let sentence = location::failure(comparison);
        let model = label_of(comparisons, label);
        say("where", vec![format!("{model}{sentence}{in_r_min}")], 1);
        say("", places.iter().take(4).map(self::place).collect(), 0);
        let balances = comparison.balances.iter();
        say(
            "balance",
            balances.map(|own| location::balance(own, &comparison.locations)).collect(),
            0,
        );
        say("note", comparison.limits.iter().map(limits::limit).collect(), 1);
        self::balances(document, comparison);
        map(document, comparison);
    }
}

/// The sentence of a place, with r/min where it is a range of the speed.
fn place(found: &FailureLocation) -> String {
    capitalised(&location::location(found)) + &range_in_r_min(found).unwrap_or_default()
}

/// The range in r/min, for the end of the sentence of a place.
fn range_in_r_min(location: &FailureLocation) -> Option<String> {
    (location.variable == "speed_rad_s").then(|| {
        let from = significant(rpm_from_rad_s(location.from), 3);
        format!(" [{from} to {}]", r_min(location.to))
    })
}

/// The error of each equation, with its share of the whole error.
fn balances(document: &mut Document, comparison: &Comparison) {
    let known = |value: Option<f64>| {
        value.map_or_else(|| "not known".to_owned(), |value| significant(value, 3))
    };
    let part = |part: Option<f64>| part.map_or_else(|| "-".to_owned(), share);
    document.table(
        Table::of(&comparison.balances)
            .column("equation", |own| own.equation)
            .column("error, rms", |own| format!("{} {}", significant(own.rms, 3), own.unit))
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

/// The map in characters: ten steps up to its largest error, with its sign, a dot where there is no data.
fn map_in_digits(comparison: &Comparison) -> Vec<String> {
    let Some((map, worst)) = comparison.map.as_ref().zip(comparison.failing()) else {
        return Vec::new();
    };
    let MapDigits { largest, rows } = map.digits(worst.equation);
    if largest <= 0.0 {
        return Vec::new();
    }
    let (equation, nine, unit) = (worst.equation, significant(largest, 3), worst.unit);
    let head = format!(
        "{equation} error over speed and current: 9 model too low by {nine} {unit}, i too high, ░▒▓ both signs, . no data"
    );
    let mut lines = vec![String::new(), head];
    lines.extend(rows.iter().map(|(middle, digits)| {
        let mark = |cell: &Option<MapCell>| cell.map_or('.', MapCell::glyph).to_string();
        let marks: Vec<String> = digits.iter().map(mark).collect();
        format!("{middle:>8.0} rad/s   {}", marks.join(" "))
    }));
    let edges = &map.current_edges_a;
    let (from, to) = (edges[0], edges[edges.len() - 1]);
    lines.push(format!("                 {from:<12.1}{to:>12.1} A"));
    lines
}

/// The map of the equation that fails worse; nothing where none fails.
fn map(document: &mut Document, comparison: &Comparison) {
    let Some((map, worst)) = comparison.map.as_ref().zip(comparison.failing()) else {
        return;
    };
    let (map, worst, equation) = (map.clone(), worst.clone(), worst.equation);
    document.figure_with_text(
        move || {
            let chart = MapChart {
                title: format!("{equation} error, {}", worst.unit),
                across: ("current, A", &map.current_edges_a),
                upwards: ("speed, rad/s", &map.speed_edges_rad_s),
                values: map.cells(equation),
                counts: &map.count,
            };
            chart.svg("error of the model over speed and current")
        },
        format!(
            "Root mean square error of the {equation} equation over speed and current, on the held-out run. Where there is no cell \
            there is no data."
        ),
        map_in_digits(comparison),
    );
}
