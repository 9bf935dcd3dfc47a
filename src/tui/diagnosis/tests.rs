//! Screens on a fixed diagnosis, keys in every state, and any data at any size.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::layout::{Position, Rect};

mod any;

use super::state::{Event, Over, State};
use super::view::view;
use crate::report::testing::{candidate, comparison, diagnosis, fitted, next_experiment, rung};
use crate::tui::application::{Effect, Exit};
use crate::tui::keys::Press;
use crate::tui::screens::Page;
use crate::tui::testing::{self, fan_model, fan_traces};
use crate::tui::traces::{FRAMES, StoppedAt};
use crate::workflow::{News, Order};
use drivebench_diagnose::{
    AddResult, AxisFinding, AxisMap, ChangeFinding, Diagnosis, DiagnosisVerdict, EffectCurve,
    ErrorOf, Event as Found, NextExperiment, Status, effect_curve, error_curve,
};
use drivebench_identify::frequency_response::Compared;
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::testing::with_a_fan;
use drivebench_model::sample::Channel;

fn nothing_more() -> Diagnosis {
    Diagnosis {
        verdict: DiagnosisVerdict::None,
        effect: None,
        effects: Vec::new(),
        holdout_before: 1.03,
        holdout_after: 1.03,
        explained_percent: 0.0,
        candidates: vec![
            candidate(1, "cogging", Status::RuledOut, 1.03),
            candidate(2, "inductance_saturation", Status::NotExcited, 1.03),
        ],
        baseline: fitted(&["stribeck_friction"]),
        ..diagnosis()
    }
}

fn added(effect: &'static str, accepted: bool) -> News {
    News::Added(Box::new(AddResult {
        effect,
        accepted,
        forced: false,
        name: effect,
        finding: ChangeFinding::NotThere { beside: Vec::new(), would_show: true },
        probability: 0.04,
        superfluous: Vec::new(),
        refused: None,
        aside: None,
        before: comparison(0.76),
        after: comparison(0.155),
        parameters: Vec::new(),
        ladder: vec![rung(Vec::new(), 5.1), rung(vec![effect], 1.03)],
        winding_drop: None,
        confirm: None,
        fit: fitted(&["stribeck_friction"][..usize::from(accepted)]),
    }))
}

fn receive(state: &mut State, news: News) {
    assert_eq!(state.update(Event::News(news)), None);
}

fn press(state: &mut State, press: Press) -> Option<Effect> {
    state.update(Event::Press(press))
}

fn begun() -> State {
    let mut state = State::new("run-a, held out run-b".to_owned());
    receive(&mut state, News::Compared(Box::new(comparison(0.76))));
    state
}

/// While the effects are being judged.
fn searching() -> State {
    let mut state = begun();
    for (effect, share) in [
        ("viscous_friction", 0.11),
        ("stribeck_friction", 0.97),
        ("cogging", 0.4),
        ("voltage_drop", 0.02),
    ] {
        receive(&mut state, News::Progress(Found::Screened { effect, share }));
    }
    receive(
        &mut state,
        News::Progress(Found::Refitted { effect: "stribeck_friction", error: 1.01 }),
    );
    state
}

fn answered() -> State {
    let mut state = searching();
    receive(&mut state, News::Diagnosed(Box::new(diagnosis())));
    state
}

/// After the effect was added.
fn at_the_floor() -> State {
    let mut state = pressed(answered(), "a");
    receive(&mut state, added("stribeck_friction", true));
    answer(&mut state, nothing_more());
    while state.is_moving() {
        state.update(Event::Frame);
    }
    state
}

/// Curves of a run with a fan: the error alone, and the fan drawn through it.
fn fan_curves() -> Vec<EffectCurve> {
    let run = with_a_fan(1);
    let noise = NoiseFloor::from_standstill(&run).unwrap();
    let error = error_curve(&fan_model(false), &run, &noise).unwrap();
    let fan = effect_curve(&fan_model(true), "quadratic_load", &run, &noise).unwrap();
    [error, fan].into_iter().flatten().collect()
}

/// The answer to a run with a fan, with its traces and curves.
fn of_a_fan() -> State {
    let mut state = begun();
    receive(&mut state, News::Traced(Box::new(fan_traces(false))));
    let mut found = diagnosis();
    found.candidates[0] = candidate(1, "quadratic_load", Status::Supported, 1.03);
    (found.effect, found.effects) = (Some("quadratic_load"), vec!["quadratic_load"]);
    answer(&mut state, found);
    receive(&mut state, News::Curves(fan_curves()));
    state
}

fn just_added() -> State {
    let mut state = pressed(of_a_fan(), "a");
    receive(&mut state, added("quadratic_load", true));
    receive(&mut state, News::Traced(Box::new(fan_traces(true))));
    state
}

fn falling() -> State {
    let mut state = just_added();
    for _ in 0..FRAMES / 2 {
        state.update(Event::Frame);
    }
    state
}

/// Nothing but a comparison, of a run that was stopped there if it was: the traces open at that place.
fn compared_of(stop: Option<StoppedAt>) -> State {
    let mut state = State::of_a_comparison("run-a, held out run-b".to_owned(), ErrorOf::Model);
    state.stops_at(stop);
    receive(&mut state, News::Compared(Box::new(comparison(0.76))));
    receive(&mut state, News::Traced(Box::new(fan_traces(false))));
    receive(&mut state, News::Curves(fan_curves()));
    state
}

fn compared_alone() -> State {
    compared_of(None)
}

fn stopped() -> State {
    compared_of(Some(StoppedAt {
        run: "run-a".to_owned(),
        at_s: 4.5,
        shows: Some(Channel::Current),
        text: "stopped: over-current at 4.50 s, zero confirmed after 18 ms".to_owned(),
    }))
}

/// The state after these keys, and the effect of the last one.
fn after(mut state: State, keys: &str) -> (State, Option<Effect>) {
    let effect = keys.chars().map(|key| press(&mut state, testing::key(key))).last().flatten();
    (state, effect)
}

fn pressed(state: State, keys: &str) -> State {
    after(state, keys).0
}

fn terminal(state: &State, width: u16, height: u16) -> Terminal<TestBackend> {
    testing::terminal((width, height), |frame| view(state, frame))
}

fn text(state: &State, width: u16, height: u16) -> String {
    terminal(state, width, height).backend().to_string()
}

fn shows(state: &State, parts: &[&str]) {
    let shown = text(state, 80, 24);
    for part in parts {
        assert!(shown.contains(part), "{part}: {shown}");
    }
}

pub(in crate::tui) fn pages() -> Vec<Page> {
    let traces = pressed(of_a_fan(), "v");
    let curve = pressed(of_a_fan(), "c");
    let states = [
        ("begun", begun()),
        ("searching", searching()),
        ("answered", answered()),
        ("fan", of_a_fan()),
        ("falling", falling()),
        ("at_the_floor", at_the_floor()),
        ("refused", refused()),
        ("failed", failed(begun())),
        ("card", pressed(answered(), "⏎")),
        ("map", pressed(of_a_fan(), "e")),
        ("next", pressed(ambiguous(), "n")),
        ("curve", curve.clone()),
        ("curve_cursor", pressed(curve, "←←")),
        ("traces", traces.clone()),
        ("worst", pressed(of_a_fan(), "j→")),
        ("signals", pressed(traces, "o↓")),
        ("drawn_over", pressed(falling(), "v")),
        ("compared", compared_alone()),
        ("stopped", stopped()),
        ("help", pressed(answered(), "?")),
    ];
    let page = |(name, state): (&'static str, State)| -> Page {
        (name, Box::new(move |frame| view(&state, frame)))
    };
    states.map(page).into()
}

const OVER: [Over; 7] = [
    Over::Card(3),
    Over::Map(0),
    Over::Map(1),
    Over::Next(1),
    Over::Curve(0, Some(2)),
    Over::Curve(7, None),
    Over::Traces,
];

/// `a` was pressed for an effect that is refused.
fn refused() -> State {
    let mut state = pressed(answered(), "↓a");
    receive(&mut state, added("cogging", false));
    state
}

/// A pair that these runs do not separate, and the run that would.
fn ambiguous() -> State {
    let mut state = answered();
    let confusable = vec![["viscous_friction", "quadratic_load"]];
    answer(&mut state, Diagnosis { confusable, ..diagnosis() });
    receive(&mut state, News::Recommended(Some(Box::new(next_experiment()))));
    state
}

/// An error that no effect explains, under the error alone.
fn unexplained() -> State {
    let mut state = pressed(of_a_fan(), "↓c");
    let map = AxisMap {
        equation: "torque",
        axis: "speed_rad_s",
        r2: 0.8,
        knots: vec![0.0, 50.0, 100.0],
        values: vec![0.0, 0.1, 0.05],
        std: vec![0.01; 3],
        error_over_noise: None,
        finding: AxisFinding::Followed { integrated: false },
    };
    let verdict = DiagnosisVerdict::Unexplained;
    answer(&mut state, Diagnosis { verdict, axis_map: vec![map], ..diagnosis() });
    state
}

/// `n` without a limit of the answer; without this news the next run is still planned.
fn next_run(recommended: Option<News>) -> State {
    let mut state = searching();
    answer(&mut state, Diagnosis { limits: Vec::new(), ..diagnosis() });
    if let Some(news) = recommended {
        receive(&mut state, news);
    }
    pressed(state, "n")
}

fn responded(response: Result<Compared, String>) -> State {
    let mut state = pressed(compared_alone(), "g");
    receive(&mut state, News::Responded(response.map(Box::new)));
    state
}

/// Left while the model is being written; then this came.
fn leaving(news: Option<News>) -> State {
    let mut state = pressed(answered(), "wq");
    if let Some(news) = news {
        receive(&mut state, news);
    }
    state
}

fn failed(mut state: State) -> State {
    let reason = "the run is too short: 12 rows, at least 200 are needed";
    receive(&mut state, News::Failed(reason.to_owned()));
    state
}

fn abandoned(mut state: State) -> State {
    assert_eq!(state.update(Event::WorkerEnded), None);
    state
}

fn every_state() -> Vec<State> {
    let mut states = vec![begun(), searching(), answered(), at_the_floor(), failed(begun())];
    states.extend([of_a_fan(), falling(), compared_alone()]);
    for index in 0..states.len() {
        states.extend(OVER.map(|over| State { over, ..states[index].clone() }));
    }
    states
}

fn selected(state: &State) -> &'static str {
    state.row().map_or("", |row| row.key())
}

fn answer(state: &mut State, answer: Diagnosis) {
    receive(state, News::Diagnosed(Box::new(answer)));
}

#[test]
fn every_small_size() {
    for state in every_state() {
        for (width, height) in testing::sizes() {
            terminal(&state, width, height);
        }
    }
}

/// A state, keys, the effect of the last one, and a part of what the screen then shows.
type Row<'a> = (&'a dyn Fn() -> State, &'a str, Option<Effect>, &'a str);

fn check(rows: &[Row<'_>]) {
    for (row, (state, keys, effect, part)) in rows.iter().enumerate() {
        let (state, found) = after(state(), keys);
        assert_eq!(found, *effect, "row {row}, {keys:?}: {part}");
        let shown = text(&state, 80, 24);
        assert!(shown.contains(part), "row {row}, {keys:?}: {part}: {shown}");
    }
}

fn bare() -> State {
    State::new(String::new())
}

#[test]
fn keys_that_change_the_model_give_orders_and_messages() {
    use Order::{Add, Force, Remove, Undo};
    let order = |order| Some(Effect::Order(order));
    let undone = News::Undone { effect: "stribeck_friction", present: Vec::new() };
    let mut undone_state = pressed(at_the_floor(), "u");
    receive(&mut undone_state, undone);
    let mut removal_refused = pressed(at_the_floor(), "r");
    let News::Added(refusal) = added("stribeck_friction", false) else { panic!("an addition") };
    receive(&mut removal_refused, News::Removed(refusal));
    check(&[
        (&answered, "a", order(Add("stribeck_friction")), "… refitting with stribeck_friction"),
        (&answered, "aa", None, "not yet: refitting with stribeck_friction"),
        (&answered, "↓a", order(Add("cogging")), "▶"),
        (&just_added, "", None, "… searching for missing effects"),
        (&refused, "r", None, "the model has no effect yet"),
        (&refused, "a", order(Force("cogging")), "refitting with cogging"),
        (&answered, "r", None, "the model has no effect yet"),
        (&answered, "u", None, "there is no change by hand"),
        (&answered, "b", None, "there is no change"),
        (&at_the_floor, "↓r", None, "cogging is not in the model: a adds it"),
        (&at_the_floor, "↓↑a", None, "stribeck_friction is in the model already"),
        (&at_the_floor, "r", order(Remove("stribeck_friction")), "refitting without"),
        (&|| removal_refused.clone(), "", None, "refused; u undoes the last change"),
        (&at_the_floor, "b", None, "BEFORE the change of stribeck_friction"),
        (&at_the_floor, "bb", None, "after the change of stribeck_friction"),
        (&at_the_floor, "u", order(Undo), "undoing the last change"),
        (&|| undone_state.clone(), "", None, "undone: stribeck_friction"),
    ]);
}

#[test]
fn keys_of_pages_show_them_or_give_the_reason() {
    use Order::{AddCurve, Diagnose, Respond, Write};
    let order = |order| Some(Effect::Order(order));
    let leave = |exit| Some(Effect::Leave(exit));
    let comparing = || State::of_a_comparison(String::new(), ErrorOf::Model);
    let reveals = NextExperiment { pair: None, ..next_experiment() };
    let reveals = || News::Recommended(Some(Box::new(reveals.clone())));
    let response = crate::tui::response::tests::compared;
    let no_response = || responded(Err("the run holds its voltage all the time".to_owned()));
    let full = || leaving(Some(News::NotWritten("the disk is full".to_owned())));
    check(&[
        (&answered, "e", None, "torque error over speed x current"),
        (&answered, "ee", None, "voltage error over speed x current"),
        (&answered, "eee", None, "effects: status"),
        (&bare, "e", None, "not yet: fitting the model"),
        (&of_a_fan, "c", None, "over speed, rad/s"),
        (&of_a_fan, "cc", None, "effects: status"),
        (&of_a_fan, "↓c", None, "no effect is drawn"),
        (&unexplained, "c", None, "80 % of the torque error follows the speed"),
        (&unexplained, "ct", order(AddCurve(0)), "fitting the curve of the torque error"),
        (&compared_alone, "g", order(Respond), "estimating the frequency response"),
        (&compared_alone, "gg", None, "not yet: the frequency response"),
        (&no_response, "", None, "holds its voltage"),
        (&|| responded(Ok(response())), "", None, "resonance at 22.01"),
        (&|| responded(Ok(response())), "⇥", None, "voltage to speed"),
        (&|| responded(Ok(response())), "g", None, "d diagnose"),
        (&compared_alone, "d", order(Diagnose), "… fitting the model"),
        (&compared_alone, "dd", None, "at work already"),
        (&compared_alone, "↓", None, "there is no list of effects yet"),
        (&compared_alone, "e↓", None, "this page does not scroll"),
        (&searching, "n", None, "not yet: the diagnosis is not done"),
        (&ambiguous, "n", None, "run a slow ramp"),
        (&ambiguous, "nn", None, "effects: status"),
        (&|| next_run(None), "", None, "being computed"),
        (&|| next_run(Some(News::Recommended(None))), "", None, "none is needed"),
        (&|| next_run(Some(reveals())), "", None, "expected precision"),
        (&answered, "w", order(Write), "… writing the model"),
        (&answered, "ww", None, "not yet: the model is being written"),
        (&|| leaving(None), "", None, "leaves when the model is written"),
        (&|| leaving(None), "a", None, "leaves when the model is written"),
        (&|| leaving(None), "^", leave(Exit::Interrupted), "writing the model"),
        (&full, "", None, "NOT WRITTEN: the disk is full"),
        (&full, "q", leave(Exit::Finished), "ready"),
        (&|| abandoned(leaving(None)), "", None, "the model is NOT WRITTEN"),
        (&|| abandoned(leaving(None)), "q", leave(Exit::Finished), "NOT WRITTEN"),
        (&|| abandoned(searching()), "", None, "ERROR: the analysis has ended"),
        (&|| abandoned(answered()), "", None, "ready"),
        (&bare, "c", None, "not yet"),
        (&bare, "v", None, "not yet"),
        (&bare, "j", None, "not yet"),
        (&begun, "↓", None, "not yet: no effect has been judged"),
        (&|| failed(bare()), "v", None, "has failed"),
        (&|| failed(bare()), "e", None, "has failed"),
        (&|| failed(bare()), "c", None, "has failed"),
        (&|| failed(bare()), "d", None, "has failed"),
        (&|| failed(bare()), "↓", None, "no effect has been judged"),
        (&comparing, "d", None, "at work already: comparing"),
        (&searching, "d", None, "at work already: "),
        (&answered, "d", None, "the search is complete"),
    ]);
    // After a failure only what there is is offered.
    for (state, missing) in [(failed(bare()), "e map"), (failed(begun()), "v traces")] {
        assert!(!text(&state, 80, 24).contains(missing), "{missing}");
    }
    let written = || Event::News(News::Written("model written to m.toml".to_owned()));
    assert_eq!(leaving(None).update(written()), leave(Exit::Finished));
    let mut stays = pressed(leaving(None), "␛");
    assert_eq!(stays.update(written()), None);
    shows(&stays, &["model written to m.toml", "ready"]);
}

#[test]
fn b_compares_before_and_the_ladder_follows_each_change() {
    let error = |state: &State| state.compared().unwrap().signals.speed_rad_s.unwrap().holdout.rmse;
    let errors = |state: &State| state.ladder.iter().map(|step| step.error).collect::<Vec<f64>>();
    let floor = at_the_floor();
    assert_eq!((errors(&floor), selected(&floor)), (vec![5.1, 1.03], "stribeck_friction"));
    let before = pressed(floor.clone(), "b");
    assert!(error(&before) > 2.0 * error(&floor));
    assert!((error(&pressed(before, "b")) - error(&floor)).abs() < 1e-12);
    let mut undone = pressed(floor, "u");
    receive(&mut undone, News::Undone { effect: "stribeck_friction", present: Vec::new() });
    assert!(undone.present.is_empty() && errors(&undone) == [5.1]);
    answer(&mut undone, diagnosis());
    assert_eq!(selected(&undone), "stribeck_friction");
}

#[test]
fn a_poor_result_is_not_green() {
    let shown = text(&answered(), 120, 40);
    let row = shown.lines().find(|row| row.contains("residual")).unwrap();
    assert!(row.contains("not white (80 % of lags outside)") && !row.contains('✓'), "{row}");
    let mut state = at_the_floor();
    let mut found = nothing_more();
    found.candidates.truncate(1);
    answer(&mut state, found.clone());
    shows(&state, &["✓ NOTHING MISSING"]);
    found.mark_rivals(&[["stribeck_friction", "cogging"]]);
    answer(&mut state, found);
    let shown = text(&state, 120, 40);
    assert!(shown.contains("~ NOTHING MISSING THAT THESE RUNS COULD SHOW"), "{shown}");
    assert!(shown.contains("as good as stribeck_friction"), "{shown}");
}

#[test]
fn closing_the_help_returns_to_its_page() {
    for over in OVER {
        let state = pressed(State { over, ..of_a_fan() }, "?↓");
        assert_eq!((state.help.first, state.over), (Some(1), over));
        shows(&state, &["to the shell, once nothing is energised"]);
        let state = pressed(state, "q");
        assert_eq!((state.help.first, state.over), (None, over));
    }
}

#[test]
fn a_click_selects_a_row_or_sets_the_cursor_and_the_wheel_zooms() {
    let area = Rect::new(0, 0, 120, 40);
    let shown = |state: &State| text(state, area.width, area.height);
    let click = |state: &mut State, what: &str| {
        let y = shown(state).lines().position(|row| row.contains(what));
        let at = Position::new(40, y.unwrap_or_else(|| panic!("{what}")) as u16);
        super::view::click(state, at, area);
    };
    let mut state = answered();
    for effect in ["viscous_friction ", "stribeck_friction ", "cogging "] {
        click(&mut state, effect);
        assert_eq!((selected(&state), &state.message), (effect.trim(), &None));
    }
    click(&mut state, "DIAGNOSIS");
    shows(&state, &["there is nothing to select"]);
    let mut traces = pressed(of_a_fan(), "v");
    assert!(!shown(&traces).contains("cursor at"));
    click(&mut traces, "speed: measured - model");
    let before = shown(&traces);
    assert!(before.contains("cursor at"), "{before}");
    press(&mut traces, Press::Wheel(-1));
    assert_ne!(shown(&traces), before);
    press(&mut traces, Press::Wheel(1));
    assert_eq!(shown(&traces), before);
    let mut curve = pressed(of_a_fan(), "c");
    click(&mut curve, "┤");
    assert!(matches!(curve.over, Over::Curve(0, Some(_))), "{:?}", curve.over);
}

#[test]
fn in_every_state_orders_wait_q_leaves_and_idle_keys_explain() {
    for state in every_state() {
        let busy = state.working.is_some();
        for key in ["a", "r", "w"] {
            assert!(after(state.clone(), key).1.is_none() || !busy, "{key} {state:?}");
        }
        // A first q closes what lies over the screen.
        let leaves = after(state.clone(), "q").1.or_else(|| after(state.clone(), "qq").1);
        let exit = if busy { Exit::Quit } else { Exit::Finished };
        assert_eq!(leaves, Some(Effect::Leave(exit)), "{state:?}");
        let interrupted = Some(Effect::Leave(Exit::Interrupted));
        assert_eq!(after(state.clone(), "^").1, interrupted, "{state:?}");
        for key in ["s", "y", "f", "m", "k", "x", "l", "2", "z", "#"] {
            let (state, effect) = after(state.clone(), key);
            assert!(effect.is_none() && state.message.is_some(), "{key} {:?}", state.over);
        }
    }
}

#[test]
fn without_a_floor_nothing_is_a_multiple_of_it() {
    let mut state = answered();
    answer(&mut state, Diagnosis { noise_floor_from: FloorSource::None, ..diagnosis() });
    let mut state = pressed(state, "a");
    let News::Added(mut change) = added("stribeck_friction", true) else { panic!("it adds") };
    change.confirm = Some([5.1, 0.4].map(|error| rung(Vec::new(), error)));
    change.before.noise_floor_from = FloorSource::None;
    change.after.noise_floor_from = FloorSource::None;
    receive(&mut state, News::Added(change));
    let shown = text(&state, 160, 40);
    assert!(shown.contains("0.40 times the baseline's residual"), "{shown}");
    assert!(!shown.contains("times the noise"), "{shown}");
}

#[test]
fn the_selection_stays_on_its_effect_and_in_sight() {
    let mut state = pressed(searching(), "↓");
    assert_eq!(selected(&state), "cogging");
    let screened = |effect, share| News::Progress(Found::Screened { effect, share });
    receive(&mut state, screened("quadratic_load", 0.99));
    assert_eq!(selected(&state), "cogging");
    assert_eq!(selected(&pressed(state, &"↓".repeat(99))), "voltage_drop");
    let mut state = begun();
    for effect in CATALOGUE {
        receive(&mut state, screened(effect.card().id, 0.1));
    }
    for _ in 0..40 {
        state = pressed(state, "↓");
        shows(&state, &["▶"]);
    }
}

#[test]
fn a_change_falls_frame_by_frame_to_the_floor_and_ends() {
    assert!(!of_a_fan().is_moving());
    let mut state = just_added();
    let bar = |state: &State| {
        let shown = text(state, 120, 40);
        let row = shown.lines().find(|row| row.contains("+ quadratic_load"));
        let row = row.unwrap_or_else(|| panic!("{shown}"));
        assert!(row.contains("1.03"), "the figure is true at once: {row}");
        row.matches('█').count()
    };
    let mut lengths = vec![bar(&state)];
    while state.is_moving() {
        assert_eq!(state.update(Event::Frame), None);
        lengths.push(bar(&state));
        assert!(lengths.len() <= usize::from(FRAMES) + 1, "it ends");
    }
    assert!(lengths.windows(2).all(|pair| pair[1] <= pair[0]), "{lengths:?}");
    assert!(lengths[0] > 3 * lengths[lengths.len() - 1] && lengths.len() > 10, "{lengths:?}");
}
