//! Findings of a diagnosis as blocks of a page: cards, curves, candidates, the next run.

use super::card::Card;
use super::page::{Cell, Page, Table};
use super::plot::{AxisChart, PointSet, Style};
use drivebench_diagnose::{
    AxisMap, Candidate, CurvePoint, Diagnosis, EffectCurve, Reached, Status,
};
use drivebench_model::plant::effect;
use drivebench_model::sample::{ParameterEstimate, TWO_SIDED_95};
use drivebench_model::text::lines::capitalised;
use drivebench_model::text::number::{fixed, probability, share, significant};

/// Pictures of curves that an error follows, at most.
const MOST_CURVES: usize = 3;

/// Card and curve of each effect that was named, and what it cannot be told from; where none was, the curve of the error.
pub(super) fn effects(page: &mut Page, diagnosis: &Diagnosis, curves: &[EffectCurve]) {
    let named = diagnosis.effects.iter();
    let named: Vec<_> = named.filter_map(|id| effect::find(id)).collect();
    if named.is_empty() {
        if let Some(curve) = curves.first() {
            page.section("What the equations lack");
            effect_curve(page, curve);
        }
        return;
    }
    page.section("What was found");
    for effect in named {
        let card = effect.card();
        page.paragraph(format!(
            "{} ({}): {}",
            capitalised(card.name),
            card.id,
            card.equation
        ));
        page.list(vec![
            format!("Possible causes: {}.", card.causes),
            format!("Looks like: {}.", card.looks_like),
            format!("Remedy: {}.", card.remedy),
        ]);
        let mut own = curves.iter();
        if let Some(curve) = own.find(|curve| curve.effect == Some(card.id)) {
            effect_curve(page, curve);
        }
    }
    let mut rivals: Vec<String> = diagnosis
        .confusable
        .iter()
        .map(|[name, rival]| format!("{name} and {rival} cannot be told apart by these runs."))
        .collect();
    let never = diagnosis.equivalences.iter();
    rivals.extend(never.map(|sentence| format!("{}.", capitalised(sentence))));
    page.list(rivals);
}

/// Effects of a list that are shown, at most.
const MOST_LISTED: usize = 4;

/// Effects that are likely beside others, and whose refit does not lower the error.
fn not_borne_out_in_words(effects: &[String]) -> Option<String> {
    let names = listed(effects)?;
    Some(format!(
        "{names}: likely beside the others, but not borne out by a refit"
    ))
}

/// What was named with cause and remedy, what may be as well, and what was not asked.
pub(super) fn on_card(card: &mut Card, diagnosis: &Diagnosis) {
    let of_named = |text: fn(&effect::Card) -> &'static str| {
        let named = diagnosis.effects.iter().filter_map(|id| effect::find(id));
        named.map(move |effect| format!("{}: {}", effect.card().name, text(effect.card())))
    };
    card.say("cause", of_named(|card| card.causes), 1);
    card.say("remedy", of_named(|card| card.remedy), 1);
    let unnamed = diagnosis.candidates.iter();
    let unnamed = unnamed.filter(|own| !diagnosis.effects.contains(&own.effect));
    let rivals = unnamed.clone().filter_map(|own| {
        let other = own.as_good_as?;
        Some(format!(
            "{} explains as much as {other}; these runs cannot tell them apart",
            own.effect
        ))
    });
    card.say("rival", rivals, 1);
    let with = |status: Status| {
        let of_status = unnamed.clone().filter(move |own| own.status == status);
        of_status.filter(|own| own.as_good_as.is_none())
    };
    let possible = with(Status::Possible).filter(|own| !own.is_not_borne_out());
    let possible = possible.map(|own| {
        let most = own
            .at_most()
            .map_or_else(String::new, |most| format!(", {most}"));
        format!("{} ({}{most})", own.effect, probability(own.probability))
    });
    card.say("possible", listed(&possible.collect::<Vec<_>>()), 1);
    let not_borne_out = with(Status::Possible).filter(|own| own.is_not_borne_out());
    let not_borne_out: Vec<String> = not_borne_out.map(|own| own.effect.to_owned()).collect();
    card.say("not named", not_borne_out_in_words(&not_borne_out), 1);
    // What is ruled out is a size.
    let ruled_out: Vec<String> = with(Status::RuledOut)
        .map(|own| {
            let most = own.at_most();
            most.map_or_else(
                || own.effect.to_owned(),
                |most| format!("{} ({most})", own.effect),
            )
        })
        .collect();
    card.say("ruled out", listed(&ruled_out), 1);
    let (open, unseen): (Vec<&Candidate>, Vec<&Candidate>) =
        with(Status::NotExcited).partition(|own| own.is_open);
    let ids = |of: &[&Candidate]| {
        listed(
            &of.iter()
                .map(|own| own.effect.to_owned())
                .collect::<Vec<_>>(),
        )
    };
    card.say("left open", ids(&open), 1);
    card.say("not shown", ids(&unseen), 1);
    card.say(
        "unknown",
        diagnosis.unknown.iter().map(|part| part.sentence.as_str()),
        1,
    );
    if let Some(map) = diagnosis.axis_map.first().filter(|map| map.is_followed()) {
        card.say("curve", [map.sentence.as_str()], 1);
    }
    let notes = diagnosis.limits.iter().map(String::as_str);
    card.say(
        "note",
        notes.chain(diagnosis.equivalences.iter().copied()),
        1,
    );
}

/// Names in one line, the rest of them counted.
fn listed(names: &[String]) -> Option<String> {
    let more = names.len().saturating_sub(MOST_LISTED);
    let shown = names
        .iter()
        .take(MOST_LISTED)
        .cloned()
        .collect::<Vec<_>>()
        .join(", ");
    match (names.len(), more) {
        (0, _) => None,
        (_, 0) => Some(shown),
        (_, more) => Some(format!("{shown} and {more} more")),
    }
}

/// What an equation lacks along its axis, the effect drawn through the points, and what it lacks with the effect.
pub(super) fn effect_curve(page: &mut Page, curve: &EffectCurve) {
    let why = curve.why_axis.iter();
    let why = why.map(|why| format!(" {}.", capitalised(why)));
    page.figure(
        effect_picture(curve),
        format!(
            "{}. Each point is a mean with its 95 % interval; a loss is positive.{}",
            capitalised(&curve.sentence()),
            why.collect::<String>()
        ),
    );
}

/// The picture of the curve of an effect.
pub fn effect_picture(curve: &EffectCurve) -> String {
    let axis = curve.axis_label();
    let of = |label, style, points: &[CurvePoint]| PointSet {
        label,
        style,
        points: points.iter().map(|p| (p.at, p.mean, p.std)).collect(),
        is_joined: false,
    };
    // Where no effect is drawn there is nothing that the points are without.
    let (label, line, without) = match curve.effect {
        Some(effect) => (
            format!("{effect} at its size"),
            curve.line.as_slice(),
            "without the effect",
        ),
        None => (String::new(), &[][..], ""),
    };
    let chart = AxisChart {
        title: curve.title(),
        axis: &axis,
        sets: vec![
            of(without, Style::Before, &curve.points),
            of("with it", Style::After, &curve.with_it),
        ],
        line: (&label, line),
    };
    chart.svg(&format!("{} error over {axis}", curve.equation))
}

/// The curves that an unexplained error follows.
pub(super) fn curves(page: &mut Page, diagnosis: &Diagnosis) {
    if diagnosis.axis_map.is_empty() {
        return;
    }
    page.section("What the error follows");
    let is_followed = |map: &&AxisMap| map.is_followed() && map.knots.len() > 1;
    let (followed, rest): (Vec<&AxisMap>, Vec<&AxisMap>) =
        diagnosis.axis_map.iter().partition(is_followed);
    let is_any = !followed.is_empty();
    for map in followed.iter().take(MOST_CURVES) {
        let axis = map.axis_label();
        let stds = map.std.iter().copied().chain(std::iter::repeat(f64::NAN));
        let points = map.knots.iter().zip(&map.values).zip(stds);
        let points = points.map(|((knot, value), std)| (*knot, *value, std));
        let chart = AxisChart {
            title: map.title(),
            axis: &axis,
            sets: vec![PointSet {
                label: "",
                style: Style::After,
                points: points.collect(),
                is_joined: true,
            }],
            line: ("", &[]),
        };
        page.figure(
            chart.svg(&format!("{} error over {axis}", map.equation)),
            format!(
                "{}. The band is the 95 % interval; a loss is positive.",
                capitalised(&map.sentence)
            ),
        );
    }
    let others = followed.into_iter().skip(MOST_CURVES).chain(rest);
    let sentence = |map: &AxisMap| format!("{}.", capitalised(&map.sentence));
    page.list(others.map(sentence).collect());
    if !is_any {
        return;
    }
    page.paragraph(
        "No effect of the catalogue explains these curves. The clearest can be added as it is, with the command drivebench add table, so that the \
         error falls while its cause is looked for.",
    );
}

/// Every effect that was tried: status, error, share, size with interval, what it reached.
pub(super) fn candidates(page: &mut Page, diagnosis: &Diagnosis) {
    page.section("Effects that were tried");
    let mut named = diagnosis
        .candidates
        .iter()
        .filter(|c| has_paid(c) && !c.parameters.is_empty());
    if let Some(words) = named.find_map(Candidate::widened) {
        page.paragraph(format!("Intervals of sizes: {words}."));
    }
    let dash = || "-".to_owned();
    page.table(
        Table::of(&diagnosis.candidates)
            .column("rank", |own| own.rank.to_string())
            .column("effect", |own| Cell::code(own.effect))
            .column("status", |own| {
                if own.is_open {
                    "left open"
                } else {
                    own.status.name()
                }
            })
            .column("held-out error", |own| {
                let before = fixed(own.holdout_before, 2);
                own.holdout_after
                    .map_or_else(dash, |after| format!("{before} -> {}", fixed(after, 2)))
            })
            .column("explains", |own| {
                own.explained_percent
                    .map_or_else(dash, |percent| share(percent / 100.0))
            })
            .column("probability", |own| match own.status {
                Status::NotExcited => dash(),
                _ => probability(own.probability),
            })
            .column("size ± 95 %, evidence", |own| {
                let size = sizes(own).or_else(|| own.at_most()).unwrap_or_else(dash);
                Cell::text(size).with_note(capitalised(&own.evidence))
            }),
    );
}

const fn has_paid(candidate: &Candidate) -> bool {
    matches!(candidate.status, Status::Supported | Status::Possible)
}

/// Sizes of an effect that pays, and what they reached; of another the evidence says what would have been seen.
fn sizes(candidate: &Candidate) -> Option<String> {
    let peaks = candidate.reached.iter().flat_map(Reached::peaks);
    let peaks = peaks.map(|peak| peak.text(TWO_SIDED_95));
    let sizes: Vec<String> = candidate.parameters.iter().map(size).chain(peaks).collect();
    (has_paid(candidate) && !sizes.is_empty()).then(|| sizes.join("; "))
}

/// Key, value with its 95 % interval, unit.
fn size(parameter: &ParameterEstimate) -> String {
    let key = parameter.key.rsplit('.').next().unwrap_or(&parameter.key);
    format!("{key} {}", parameter.text(TWO_SIDED_95))
}

/// The run that would tell more.
pub(super) fn next_run(page: &mut Page, diagnosis: &Diagnosis) {
    let Some(next) = &diagnosis.next_experiment else {
        return;
    };
    page.section("Next run");
    page.paragraph(format!(
        "{}.",
        capitalised(next.sentence.trim_end_matches('.'))
    ));
    if next.menu.is_empty() {
        return;
    }
    // A run for a pair tells the two apart; another one shows effects that no run in hand would have shown.
    let [what, figure, from, yes, no] = if next.pair.is_some() {
        [
            "the separation that is expected of it, and from which on that run tells",
            "expected separation",
            "tells from",
            "tells",
            "does not",
        ]
    } else {
        [
            "the precision that is foreseen of the effect which it shows best, and from which on that is promised",
            "foreseen precision",
            "promised from",
            "shows at least one",
            "promises none",
        ]
    };
    page.paragraph(format!("Every run that the limits allow, with {what}."));
    page.table(
        Table::of(&next.menu)
            .column("run", |entry| Cell::code(entry.program))
            .column(figure, |entry| significant(entry.expected_separation, 2))
            .column(from, |entry| significant(entry.needed, 2))
            .column("verdict", |entry| if entry.is_told() { yes } else { no }),
    );
}
