//! The whole page on a fixed input, and on a real diagnosis of a simulated motor.

use super::html::escape;
use super::testing::{candidate, comparison, diagnosis, next_experiment, rung};
use super::wording::candidate::{at_most, detectable_from};
use super::*;
use drivebench_diagnose::{
    Candidate, Comparison, DiagnosisVerdict, ErrorOf, Evidence, Limit, NextExperiment,
    ResidualLights, Status, compare, diagnose,
};
use drivebench_model::plant::{Model, Motor, Scenario, testing};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Reason, Run};

/// Checks that every tag is closed in the right order; enough of HTML for pages of our own.
fn assert_balanced(html: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = html;
    while let Some(start) = rest.find('<') {
        rest = &rest[start + 1..];
        let (tag, after) = rest.split_at(rest.find('>').expect("a tag ends"));
        rest = &after[1..];
        let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap();
        if tag.starts_with('!') || tag.ends_with('/') || ["meta", "br", "wbr"].contains(&name) {
            continue;
        }
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes of <{tag}>");
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "</{name}> after {open:?}");
        } else if name == "script" || name == "style" {
            rest = &rest[rest.find(&format!("</{name}>")).expect("closed") + name.len() + 3..];
        } else {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "left open: {open:?}");
}

#[test]
fn markup_becomes_text() {
    let text = "<b a='1'>\"x\" & y</b>\u{0}";
    assert_eq!(escape(text), "&lt;b a=&#39;1&#39;&gt;&quot;x&quot; &amp; y&lt;/b&gt;\u{fffd}");
    let crossed = std::panic::catch_unwind(|| assert_balanced("<p><b>x</p></b>"));
    assert!(crossed.is_err(), "the checker finds tags that cross");
}

fn context() -> Context {
    Context {
        target: Target::Emulator,
        date: "2026-01-02 03:04:05 UTC".into(),
        motor: "ZK-22FC".into(),
        run_folders: vec!["20260102T030405Z-fit".into(), "20260102T030420Z-select".into()],
        identity: vec![("product".into(), "drivebench software drive <1>".into())],
        plan: vec![("peak current".into(), "9.1 A of 30 A".into())],
        link: vec![("exchanges".into(), "2000 sent, 1999 ok, 1 timeout".into())],
        seed: Some(7),
        versions: vec![("drivebench".into(), "0.1.0".into())],
        ..Context::default()
    }
}

#[test]
fn the_verdict_is_first_and_every_figure_has_its_uncertainty() {
    let mut diagnosis = diagnosis();
    let own = |key: &str, unit, value, std| {
        ParameterEstimate::found(format!("stribeck_friction.{key}"), unit, value, std, None)
    };
    diagnosis.candidates[0].parameters = vec![
        own("stribeck_n_m", "N.m", 0.1204, 0.0011),
        own("stribeck_speed_rad_s", "rad/s", 8.91, 0.12),
    ];
    let motor = |resistance: (f64, f64), inertia: (f64, f64), doubt: Option<&str>| {
        let uncertain = "relative uncertainty 80 % at a period of 10.0 ms";
        let found = |key, unit, (value, std), doubt: Option<&str>| {
            let doubt = doubt.map(|doubt| (Reason::Uncertain, doubt.to_owned()));
            ParameterEstimate::found(key, unit, value, std, doubt)
        };
        vec![
            found("resistance_ohm", "ohm", resistance, None),
            ParameterEstimate::not_observable("inductance_h", "H", Reason::NotExcited, uncertain),
            found("inertia_kg_m2", "kg.m2", inertia, doubt),
        ]
    };
    let before = motor((1.1432, 0.0041), (0.004_61, 0.000_19), Some("relative uncertainty 4.1 %"));
    let mut after = motor((1.1003, 0.0007), (0.004_501, 0.000_003), None);
    after.extend(diagnosis.candidates[0].parameters.clone());
    (diagnosis.baseline.parameters, diagnosis.model.parameters) = (before, after);
    diagnosis.ladder = vec![rung(vec![], 5.1), rung(vec!["stribeck_friction"], 1.03)];
    let (old, new) = (comparison(0.76), comparison(0.155));
    let new = Comparison {
        locations: vec![],
        residual: ResidualLights {
            white: true,
            autocorrelation_outside_99_percent: 0.04,
            ..new.residual
        },
        limits: vec![Limit::NoAngle],
        ..new
    };
    let report = CommissionReport {
        kind: "Commission",
        title: "ZK-22FC",
        context: &context(),
        nameplate: Some(&Model::baseline(Motor::zk_22fc())),
        before: &old,
        after: &new,
        diagnosis: &diagnosis,
        confirm: Some(&[rung(vec![], 5.0), rung(vec!["stribeck_friction"], 1.04)]),
        series: None,
        curves: &[],
        truth: &["stribeck_friction of 0.12 N.m".to_owned()],
    };
    insta::assert_snapshot!(report.document().markdown());
    let html = report.document().html();
    assert_balanced(&html);
    assert!(html.contains("software drive &lt;1&gt;"));
    // On hardware the truth is unknown, whatever the caller passes.
    let hardware = Context { target: Target::Hardware, ..context() };
    let on_hardware = CommissionReport { context: &hardware, ..report.clone() };
    assert!(report.document().markdown().contains("Truth of the emulator"));
    assert!(!on_hardware.document().markdown().contains("Truth"));
    assert!(!html.contains("http"), "nothing is fetched from elsewhere");
}

/// Staircase both ways with passages through zero; `shift` makes another run of it.
fn record(model: &Model, shift: usize, seed: u64) -> Scenario {
    let levels =
        [30.0, 60.0, 90.0, 40.0, 3.0, -3.0, -40.0, -90.0, -50.0, 4.0, 0.0, 70.0, -70.0, 20.0];
    let level = |step: usize| levels[(step + 3 * shift) % levels.len()];
    let steps = (0..levels.len()).map(|step| (0.5 + 0.5 * step as f64, level(step)));
    let events = std::iter::once((0.0, 0.0)).chain(steps).collect();
    let mut scenario = testing::record(model, events, 0.004, 7.5, seed);
    let samples = scenario.samples();
    // The link lost half a second's speed, and single samples of both.
    scenario.speed_rad_s[1000..1100].fill(f64::NAN);
    for k in (150..samples).step_by(177) {
        scenario.current_a[k] = f64::NAN;
        scenario.speed_rad_s[k] = f64::NAN;
    }
    scenario
}

fn commission(truth: &Model) -> String {
    let nameplate = Model::baseline(Motor::zk_22fc());
    let runs = |shift: usize| record(truth, shift, 40 + shift as u64);
    let evidence = Evidence::new(runs(0), Some(runs(1)), Some(runs(2)));
    let found = diagnose(&nameplate, evidence.clone()).unwrap();
    let compare = |model: &Model| compare(model, &evidence, ErrorOf::Structure).unwrap();
    let confirm = evidence.confirm.as_ref().unwrap();
    let (baseline, model) = (&found.baseline.model, &found.model.model);
    let named = !found.effects.is_empty();
    let (before, after) = (compare(baseline), compare(model));
    let run = ConfirmRun::of(baseline, named.then_some(model), confirm, &evidence.noise).unwrap();
    let curve = |id: &str| found.curve_of(Some(id), confirm, &evidence.noise).unwrap();
    let curves: Vec<_> = (found.effects.iter()).filter_map(|id| curve(id)).collect();
    let confirmed = found.rungs_on(confirm, &evidence.noise).unwrap();
    let report = CommissionReport {
        kind: "Commission",
        title: "ZK-22FC on the emulator",
        context: &context(),
        nameplate: Some(&nameplate),
        before: &before,
        after: &after,
        diagnosis: &found,
        confirm: Some(&confirmed),
        series: Some(&run),
        curves: &curves,
        truth: &["stribeck_friction 0.12 N.m".to_owned()],
    };
    report.document().html()
}

#[test]
fn the_page_of_a_real_diagnosis_is_whole_and_names_the_effect() {
    let mut truth = Model::baseline(Motor::zk_22fc()).with_effect("stribeck_friction").unwrap();
    truth.effects[0].values = vec![Some(0.12), Some(9.0)];
    let html = commission(&truth);
    assert_balanced(&html);
    assert!(html.contains("Effect found") && html.contains("stribeck_<wbr>friction"));
    for series in ["model before", "model after", "measured", "command"] {
        let label = format!("data-label=\"{series}\"");
        assert!(html.contains(&label), "{series}");
    }
    assert!(!html.contains("NaN") && html.len() < 600_000, "{}", html.len());
}

#[test]
fn a_model_without_a_missing_effect_has_a_page_without_an_after() {
    let html = commission(&Model::baseline(Motor::zk_22fc()));
    assert_balanced(&html);
    assert!(html.contains("Nothing missing") && !html.contains("model after"));
}

#[test]
fn the_page_of_a_run_is_whole() {
    let scenario = record(&Model::baseline(Motor::zk_22fc()), 0, 3);
    let mut run = Run::new("first <run>", scenario.sample_time_s.clone()).unwrap();
    let mut command = vec![f64::NAN; run.rows()];
    for (time_s, value) in &scenario.events {
        command[run.time_s().partition_point(|t| *t < time_s - 1e-9)] = *value;
    }
    for (channel, cells, origin) in [
        (Channel::VoltageCmd, command, Origin::Commanded),
        (Channel::Current, scenario.current_a, Origin::Measured),
        (Channel::Speed, scenario.speed_rad_s, Origin::Measured),
    ] {
        run.set_column(channel, cells, origin).unwrap();
    }
    let doubt = Some((Reason::Uncertain, "relative uncertainty 4.1 %".to_owned()));
    let resistance = ParameterEstimate::found("resistance_ohm", "ohm", 1.12, 0.05, doubt);
    let report = RunReport {
        title: "Run \"first\" & only",
        context: &context(),
        run: &run,
        nameplate: Some(&Model::baseline(Motor::zk_22fc())),
        parameters: &[resistance],
        timing: &vec![("period asked".into(), "4 ms".into())],
        early_end: None,
        last_seconds: None,
        speed_loop: None,
    };
    let html = report.document().html();
    assert_balanced(&html);
    assert!(html.contains("first &lt;run&gt;") && html.contains("&quot;first&quot; &amp; only"));
}

#[test]
fn the_next_run_has_the_figure_of_its_question() {
    let mut found = diagnosis();
    found.verdict = DiagnosisVerdict::Ambiguous;
    for (pair, figure, verdicts) in [
        (next_experiment().pair, "expected separation", [">distinguishes", ">does not"]),
        (None, "expected precision", [">shows at least one", ">shows none"]),
    ] {
        let next = next_experiment();
        found.next_experiment = Some(NextExperiment { pair, ..next });
        let mut document = Document::new("title", "subtitle");
        findings::next_run(&mut document, found.next_experiment.as_ref());
        let html = document.html();
        assert_balanced(&html);
        assert!(html.contains(figure), "{html}");
        for (program, verdict) in ["slow_<wbr>ramp", "dither"].into_iter().zip(verdicts) {
            let from = &html[html.find(program).unwrap()..];
            let row = &from[..from.find("</tr>").unwrap()];
            assert!(row.contains("612") && row.contains(verdict), "{row}");
        }
    }
}

#[test]
fn a_bound_is_in_the_unit_of_what_gives_the_effect_its_size() {
    for (effect, bound) in [
        ("stribeck_friction", "0.0020 N.m"),
        ("discontinuous_conduction", "0.0020 ohm"),
        ("backlash", "0.0020 rad"),
        ("load_dependent_friction", "0.0020"),
    ] {
        let own = candidate(1, effect, Status::RuledOut, 5.08);
        assert_eq!(at_most(&own), Some(format!("at most {bound}")), "{effect}");
        assert_eq!(detectable_from(&own), Some(format!("detectable from {bound}")), "{effect}");
        for unknown in [None, Some(f64::NAN)] {
            let own = Candidate { upper_bound: unknown, ..own.clone() };
            assert_eq!(at_most(&own), None, "{effect} {unknown:?}");
        }
    }
}
