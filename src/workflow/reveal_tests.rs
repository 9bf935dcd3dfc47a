use serde_json::json;

use super::*;
use crate::emulator::mystery::draw;

/// The first seed whose mystery is of this kind.
fn truth(wanted: impl Fn(&Truth) -> bool) -> Truth {
    (0..2000).map(|seed| draw(seed).truth).find(wanted).unwrap()
}

fn of_effect(id: &str) -> Truth {
    truth(|truth| truth.effect().is_some_and(|effect| effect.id == id))
}

fn outcome(truth: &Truth, answer: &Answer) -> Outcome {
    reveal(truth.clone(), Some(answer.clone()), None)
        .outcome
        .unwrap()
}

#[test]
fn an_answer_is_scored_by_what_it_claims() {
    use Outcome::{Abstained, Right, Wrong};
    let nothing = truth(|truth| truth.effects.is_empty());
    let drop = of_effect("voltage_drop");
    let shaker = of_effect("shaker");
    let table = [
        (&nothing, "none", Right),
        (&nothing, "cogging", Wrong),
        (&nothing, "unexplained", Abstained),
        (&drop, "voltage_drop", Right),
        (&drop, "supply_sag", Wrong),
        (&drop, "none", Wrong),
        (&drop, "unexplained", Abstained),
        (&drop, "abstain", Abstained),
        (&shaker, "unexplained", Right),
        (&shaker, "cogging", Wrong),
        (&shaker, "none", Wrong),
        (&shaker, "abstain", Abstained),
    ];
    for (truth, word, expected) in table {
        let found = outcome(truth, &Answer::word(word));
        assert_eq!(found, expected, "{:?} {word}", truth.effect());
    }
}

#[test]
fn a_diagnosis_that_says_why_it_cannot_see_it_is_right() {
    let hidden = of_effect("inductance_saturation");
    let diagnosis = json!({
        "verdict": "none", "effect": null, "effects": [],
        "candidates": [{ "effect": "inductance_saturation", "status": "not_excited", "parameters": {} }],
    });
    let answer = Answer::from_json(&diagnosis).unwrap();
    assert_eq!(outcome(&hidden, &answer), Outcome::Right);
    assert_eq!(outcome(&of_effect("voltage_drop"), &answer), Outcome::Wrong);
}

#[test]
fn an_extra_name_is_a_wrong_answer_and_an_open_one_may_have_the_best_guess() {
    let drop = of_effect("voltage_drop");
    let said = |verdict: &str, effects: &[&str]| {
        let json = json!({ "verdict": verdict, "effect": effects[0], "effects": effects, "candidates": [] });
        reveal(drop.clone(), Answer::from_json(&json), None)
    };
    for (verdict, effects, expected, best_guess_right) in [
        ("effect", ["voltage_drop", "cogging"], Outcome::Wrong, true),
        (
            "ambiguous",
            ["voltage_drop", "supply_sag"],
            Outcome::Abstained,
            true,
        ),
        (
            "ambiguous",
            ["supply_sag", "voltage_drop"],
            Outcome::Abstained,
            false,
        ),
    ] {
        let found = said(verdict, &effects);
        let scored = (found.outcome, found.best_guess_right);
        assert_eq!(scored, (Some(expected), best_guess_right), "{effects:?}");
    }
}

#[test]
fn what_the_best_guess_cannot_be_told_from_is_left_open_with_it() {
    let hidden = of_effect("speed_delay");
    let diagnosis = json!({
        "verdict": "ambiguous", "effect": "speed_filter", "effects": ["speed_filter"],
        "confusable": [["speed_filter", "speed_delay"], ["cogging", "backlash"]], "candidates": [],
    });
    let answer = Answer::from_json(&diagnosis).unwrap();
    assert_eq!(answer.effects, ["speed_filter", "speed_delay"]);
    let told = reveal(hidden, Some(answer), None);
    assert_eq!(told.outcome, Some(Outcome::Abstained));
    assert!(!told.best_guess_right);
    let reason = told.reason.unwrap();
    assert!(
        reason.contains("left open: speed_filter, speed_delay"),
        "{reason}"
    );
}

#[test]
fn a_number_without_a_unit_has_none() {
    let ratio = reveal(of_effect("load_dependent_friction"), None, None).text();
    assert!(ratio.contains("(ratio = 0."), "{ratio}");
    assert!(!ratio.contains(" -)"), "{ratio}");
}

#[test]
fn sizes_are_compared_and_those_of_a_commissioning_count_more() {
    let cogging = of_effect("cogging");
    let value = |key: &str| {
        let parameters = &cogging.effects[0].parameters;
        parameters.iter().find(|one| one.key == key).unwrap().value
    };
    let amplitude = value("sin_n_m").hypot(value("cos_n_m"));
    let document = json!({
        "diagnosis": {
            "verdict": "effect", "effect": "cogging", "effects": ["cogging"],
            "candidates": [{ "effect": "cogging", "status": "supported", "parameters": {
                "order": { "value": value("order") }, "sin_n_m": { "value": 99.0 },
                "cos_n_m": { "value": value("cos_n_m") + 0.1 * amplitude },
            } }],
        },
        "parameters": [
            { "key": "resistance_ohm", "value": 1.02 * cogging.motor.resistance_ohm, "unit": "ohm" },
            { "key": "cogging.sin_n_m", "value": value("sin_n_m"), "unit": "N.m" },
        ],
    });
    let answer = Answer::from_json(&document);
    let revealed = reveal(cogging.clone(), answer, Some("eccentric_load"));
    for (key, error_percent) in [
        ("order", 0.0),
        ("sin_n_m", 0.0),
        ("cos_n_m", 10.0),
        ("resistance_ohm", 2.0),
    ] {
        let size = revealed.sizes.iter().find(|size| size.key == key).unwrap();
        assert!(
            (size.error_percent - error_percent).abs() < 1e-9,
            "{size:?}"
        );
    }
    assert!(revealed.guess.as_ref().is_some_and(|guess| !guess.right));
    let text = revealed.text();
    for part in [
        "hidden: cogging",
        "eccentric_load: not it",
        "right: cogging was named",
        "what shows it: ",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let json = serde_json::to_value(&revealed).unwrap();
    let parameters = &json["truth"]["effects"][0]["parameters"];
    assert_eq!(parameters["order"]["value"], value("order"));
    assert_eq!(json["outcome"], "right");
}

#[test]
fn a_wave_of_another_order_is_not_what_is_hidden() {
    for id in ["cogging", "torque_ripple"] {
        let hidden = of_effect(id);
        let mut orders = hidden.effects[0].parameters.iter();
        let order = orders.find(|one| one.key == "order").unwrap().value;
        let said = |order: f64| {
            let json = json!({
                "verdict": "effect", "effect": id, "effects": [id],
                "candidates": [{ "effect": id, "parameters": { "order": { "value": order } } }],
            });
            reveal(hidden.clone(), Answer::from_json(&json), None)
        };
        for (order, expected, is_right) in [
            (order, Outcome::Right, true),
            (2.0 * order, Outcome::Wrong, false),
        ] {
            let found = said(order);
            let scored = (found.outcome, found.best_guess_right);
            assert_eq!(scored, (Some(expected), is_right), "{id} {order}");
            let reason = found.reason.unwrap();
            assert_eq!(reason.contains("waves in a turn"), !is_right, "{reason}");
        }
    }
}

#[test]
fn sizes_are_those_of_what_was_named() {
    let drop = of_effect("voltage_drop");
    let said = |verdict: &str, effects: &[&str]| {
        let json = json!({
            "verdict": verdict, "effects": effects,
            "candidates": [
                { "effect": "supply_sag", "parameters": { "sag_ohm": { "value": 0.3 } } },
                { "effect": "voltage_drop", "parameters": { "drop_v": { "value": 1.1 } } },
            ],
        });
        let revealed = reveal(drop.clone(), Answer::from_json(&json), None);
        let mut sizes = revealed.sizes.iter();
        sizes.any(|size| size.effect == "voltage_drop")
    };
    for (verdict, effects, has_size) in [
        ("effect", &["voltage_drop"][..], true),
        ("ambiguous", &["supply_sag", "voltage_drop"], true),
        ("effect", &["supply_sag"], false),
        ("unexplained", &[], false),
    ] {
        assert_eq!(said(verdict, effects), has_size, "{verdict} {effects:?}");
    }
}

#[test]
fn a_document_without_a_verdict_is_no_diagnosis() {
    assert_eq!(Answer::from_json(&json!({ "signals": {} })), None);
}
