//! Findings of a diagnosis as blocks of a document: cards of effects, curves, candidates, the next run.

use super::plot::{AxisChart, AxisPanel, Drawn, Place, PointSet, Style};
use super::wording::{
    candidate, diagnosis as words, limits, listed, location, next_run as run_words,
};
use super::{Cell, Document, Table};
use drivebench_diagnose::{
    AxisMap, Candidate, CurvePoint, Diagnosis, EffectCurve, NextExperiment, Reached, Status,
};
use drivebench_model::plant::{Effect, effect};
use drivebench_model::sample::{ParameterEstimate, TWO_SIDED_95};
use drivebench_model::text::lines::capitalised;
use drivebench_model::text::number::{fixed, probability, share, significant};

/// Most pictures of axis maps.
const MOST_CURVES: usize = 3;

/// Card and curve of each effect that was named; where none was, the curve of the error.
pub(super) fn effects(document: &mut Document, diagnosis: &Diagnosis, curves: &[EffectCurve]) {
    let named: Vec<_> = diagnosis.effects.iter().filter_map(|id| effect::find(id)).collect();
    if named.is_empty() {
        document.section("Errors of the equations");
        curves.iter().take(1).for_each(|curve| effect_curve(document, curve));
    }
    document.section("Effects found");
    for (index, effect) in named.into_iter().enumerate() {
        let card = effect.card();
        let (name, least) = (capitalised(card.name), usize::from(index == 0));
        document.paragraph(format!("{name} ({}): {}", card.id, card.equation));
        document.say("cause", [format!("{}: {}", card.name, card.causes)], least);
        document.labelled("signature", [card.looks_like]);
        document.say("remedy", [format!("{}: {}", card.name, card.remedy)], least);
        let mut own = curves.iter();
        if let Some(curve) = own.find(|curve| curve.effect == Some(card.id)) {
            effect_curve(document, curve);
        }
    }
}

/// Equation, causes, signature, excitation and remedy of an effect.
pub fn card_facts(document: &mut Document, card: &effect::Card) {
    document.labelled("equation", [card.equation]);
    document.labelled("causes", [card.causes]);
    document.labelled("signature", [card.looks_like]);
    document.labelled("excite it", [card.excite]);
    document.labelled("remedy", [card.remedy]);
}

/// The page of one effect on a screen, with its findings where the runs are judged.
pub fn effect_document(effect: &dyn Effect, judged: Option<&Candidate>) -> Document {
    let card = effect.card();
    let mut document = Document::new(format!("{} ({})", card.name, card.id), "");
    if let Some(own) = judged {
        let status = if own.is_open { "left open" } else { candidate::status(own.status) };
        document.labelled("here", [format!("{status}: {}", candidate::evidence(own))]);
        let sizes = own.parameters.iter().map(|parameter| {
            let reason = parameter.reason.as_deref();
            let reason = reason.map_or_else(String::new, |reason| format!(" ({reason})"));
            format!("{}{reason}, 95 % interval", size(parameter))
        });
        let bounds = candidate::at_most(own).into_iter().chain(candidate::detectable_from(own));
        document.labelled("size", sizes.chain(bounds));
        let peaks = own.reached.iter().flat_map(Reached::peaks);
        document.labelled("reached", peaks.map(|peak| candidate::peak(&peak, TWO_SIDED_95)));
        let is_named = !own.parameters.is_empty();
        document.labelled("intervals", candidate::widened(own).filter(|_| is_named));
        let percent = probability(own.probability);
        let training = own.error_after.map_or_else(String::new, |after| {
            format!("; training error {:.2} -> {after:.2}", own.error_before)
        });
        document.labelled("rank", [format!("{}; probability {percent}{training}", own.rank)]);
    }
    card_facts(&mut document, card);
    document
}

/// Effects besides the named ones: possible, ruled out, and not shown by the runs.
pub(super) fn others(document: &mut Document, diagnosis: &Diagnosis) {
    document.section("Other effects");
    let unnamed = diagnosis.candidates.iter();
    let unnamed = unnamed.filter(|own| !diagnosis.effects.contains(&own.effect));
    let rivals = unnamed.clone().filter_map(|own| {
        let other = own.as_good_as?;
        Some(format!(
            "{} explains as much as {other}; these runs do not distinguish them",
            own.effect
        ))
    });
    let is_paired = |one: &str, other: &str| {
        let mut unnamed = unnamed.clone();
        unnamed.any(|own| own.effect == one && own.as_good_as == Some(other))
    };
    let pairs = diagnosis.confusable.iter();
    let pairs = pairs.filter(|[one, other]| !is_paired(one, other) && !is_paired(other, one));
    document.say("rival", rivals.chain(pairs.map(|[one, other]| not_distinguished(one, other))), 1);
    let with = |status: Status| {
        let of_status = unnamed.clone().filter(move |own| own.status == status);
        of_status.filter(|own| own.as_good_as.is_none())
    };
    let possible = with(Status::Possible).filter(|own| !own.is_not_confirmed_by_refit());
    let possible = possible.map(|own| {
        let most = candidate::at_most(own).map_or_else(String::new, |most| format!(", {most}"));
        format!("{} ({}{most})", own.effect, probability(own.probability))
    });
    document.say("possible", listed(possible), 1);
    let id = |own: &Candidate| own.effect.to_owned();
    let not_borne_out = with(Status::Possible).filter(|own| own.is_not_confirmed_by_refit());
    let not_borne_out = listed(not_borne_out.map(id)).map(|names| {
        format!("{names}: likely together with the others, but not confirmed by a refit")
    });
    document.say("not named", not_borne_out, 1);
    // A size is ruled out, not the effect.
    let ruled_out = with(Status::RuledOut).map(|own| match candidate::at_most(own) {
        Some(most) => format!("{} ({most})", own.effect),
        None => id(own),
    });
    document.say("ruled out", listed(ruled_out), 1);
    let unseen = |is_open: bool| with(Status::NotExcited).filter(move |own| own.is_open == is_open);
    document.say("left open", listed(unseen(true).map(id)), 1);
    document.say("not shown", listed(unseen(false).map(id)), 1);
    document.say("unknown", diagnosis.unknown.iter().map(words::unknown), 1);
}

fn not_distinguished(one: &str, other: &str) -> String {
    format!("{one} and {other} cannot be distinguished by these runs")
}

/// Open questions, and the recommended run, or why there is `none`.
pub fn open_questions(
    diagnosis: &Diagnosis,
    next: Option<&NextExperiment>,
    none: Option<&str>,
) -> Document {
    let mut document = Document::new("open questions", "");
    let pairs = diagnosis.confusable.iter();
    document.labelled("rival", pairs.map(|[one, other]| not_distinguished(one, other)));
    document.labelled("limit", diagnosis.limits.iter().map(limits::limit));
    document.labelled("by no run", diagnosis.equivalences.iter().copied());
    document.labelled("the error", diagnosis.axis_map.iter().map(location::axis_map));
    next_run(&mut document, next);
    let is_empty =
        document.blocks.is_empty().then_some("none is needed: no further run would show more");
    document.labelled("next run", none.or(is_empty));
    document
}

/// The error of an equation over its axis with the curve of the effect, and the error with the effect.
pub(super) fn effect_curve(document: &mut Document, curve: &EffectCurve) {
    let why = location::why_axis(curve);
    let why = why.map_or_else(String::new, |why| format!(" {}.", capitalised(&why)));
    let drawn = curve.clone();
    document.figure(
        move || curve_picture(&drawn),
        format!(
            "{}. Each point is a mean with its 95 % interval; a loss is positive.{}",
            capitalised(&location::curve(curve)),
            why
        ),
    );
}

/// The curve of an effect, or of an error that no effect explains, as a chart.
pub fn curve_chart(curve: &EffectCurve) -> AxisChart {
    let of = |label: &str, style, drawn, points: &[CurvePoint]| PointSet {
        label: label.to_owned(),
        style,
        drawn,
        points: (points.iter().map(|p| Place::new(p.at, p.mean, p.std))).collect(),
    };
    // Without an effect the points have no label.
    let alone = |style, drawn| (Default::default(), vec![of("", style, drawn, &curve.points)]);
    let (line, sets) = match curve.effect {
        _ if curve.is_unexplained() => alone(Style::After, Drawn::Knots),
        Some(effect) => (
            (format!("{effect} at its size"), curve.line.clone()),
            vec![
                of("without the effect", Style::Before, Drawn::Apart, &curve.points),
                of("with it", Style::After, Drawn::Apart, &curve.with_it),
            ],
        ),
        None => alone(Style::Before, Drawn::Apart),
    };
    AxisChart {
        axis: location::axis_label(curve),
        unit: curve.axis_unit,
        panels: vec![AxisPanel {
            title: location::curve_title(curve),
            height: 210.0,
            holds: vec![0.0],
            sets,
            line,
        }],
        ..AxisChart::default()
    }
}

pub fn curve_picture(curve: &EffectCurve) -> String {
    let description = format!("{} error over {}", curve.equation, location::axis_label(curve));
    curve_chart(curve).svg(&description)
}

/// The axis maps of an unexplained error.
pub(super) fn curves(document: &mut Document, diagnosis: &Diagnosis) {
    document.section("Axis maps of the error");
    let is_followed = |map: &&AxisMap| map.is_followed() && map.knots.len() > 1;
    let (followed, rest): (Vec<&AxisMap>, Vec<&AxisMap>) =
        diagnosis.axis_map.iter().partition(is_followed);
    let is_any = !followed.is_empty();
    for map in followed.iter().take(MOST_CURVES) {
        let drawn = EffectCurve::from(*map);
        document.figure(
            move || curve_picture(&drawn),
            format!(
                "{}. The band is the 95 % interval; a loss is positive.",
                capitalised(&location::axis_map(map))
            ),
        );
    }
    let clearest = followed.first().map(|map| location::axis_map(map));
    document.say("curve", clearest, 1);
    let others = followed.into_iter().skip(MOST_CURVES).chain(rest);
    let sentence = |map: &AxisMap| format!("{}.", capitalised(&location::axis_map(map)));
    document.list(others.map(sentence));
    if is_any {
        document.paragraph(
            "No effect of the catalogue explains these curves. The clearest can be added as a table, with the command drivebench add table, so that the \
             error falls while its cause is looked for.",
        );
    }
}

/// Every effect that was tried: status, error, share, size with interval, what it reached.
pub(super) fn candidates(document: &mut Document, diagnosis: &Diagnosis) {
    document.section("Effects that were tried");
    let mut named =
        diagnosis.candidates.iter().filter(|c| lowers_error(c) && !c.parameters.is_empty());
    if let Some(words) = named.find_map(candidate::widened) {
        document.paragraph(format!("Intervals of sizes: {words}."));
    }
    let dash = || "-".to_owned();
    document.table(
        Table::of(&diagnosis.candidates)
            .column("rank", |own| own.rank.to_string())
            .column("effect", |own| Cell::code(own.effect))
            .column(
                "status",
                |own| if own.is_open { "left open" } else { candidate::status(own.status) },
            )
            .column("held-out error", |own| {
                let before = fixed(own.holdout_before, 2);
                own.holdout_after
                    .map_or_else(dash, |after| format!("{before} -> {}", fixed(after, 2)))
            })
            .column("explains", |own| {
                own.explained_percent.map_or_else(dash, |percent| share(percent / 100.0))
            })
            .column("probability", |own| match own.status {
                Status::NotExcited => dash(),
                _ => probability(own.probability),
            })
            .column("size ± 95 %, evidence", |own| {
                let size = sizes(own).or_else(|| candidate::at_most(own)).unwrap_or_else(dash);
                Cell::text(size).with_note(capitalised(&candidate::evidence(own)))
            }),
    );
}

const fn lowers_error(candidate: &Candidate) -> bool {
    matches!(candidate.status, Status::Supported | Status::Possible)
}

/// Sizes of an effect that lowers the error, and their peaks; for another the evidence has its detectable size.
fn sizes(own: &Candidate) -> Option<String> {
    let peaks = own.reached.iter().flat_map(Reached::peaks);
    let peaks = peaks.map(|peak| candidate::peak(&peak, TWO_SIDED_95));
    let sizes: Vec<String> = own.parameters.iter().map(size).chain(peaks).collect();
    (lowers_error(own) && !sizes.is_empty()).then(|| sizes.join("; "))
}

/// Key, value with its 95 % interval, unit.
fn size(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    format!("{key} {}", parameter.text(TWO_SIDED_95))
}

/// The recommended run, and the menu of runs within the limits.
pub(super) fn next_run(document: &mut Document, next: Option<&NextExperiment>) {
    let Some(next) = next else { return };
    document.say("next run", [run_words::next_run(next)], 1);
    if next.menu.is_empty() {
        return;
    }
    // A run for a pair distinguishes the two; another one shows effects that the present runs would not have shown.
    let [what, figure, from, yes, no] = if next.pair.is_some() {
        [
            "its expected separation, and the separation that distinguishes the pair",
            "expected separation",
            "needed",
            "distinguishes",
            "does not",
        ]
    } else {
        [
            "the expected precision of the effect that it shows best, and the precision that is needed",
            "expected precision",
            "needed",
            "shows at least one",
            "shows none",
        ]
    };
    document.paragraph(format!("Every run that the limits allow, with {what}."));
    document.table(
        Table::of(&next.menu)
            .column("run", |entry| Cell::code(entry.program))
            .column(figure, |entry| significant(entry.expected_separation, 2))
            .column(from, |entry| significant(entry.needed, 2))
            .column("verdict", |entry| if entry.is_separated() { yes } else { no }),
    );
}
