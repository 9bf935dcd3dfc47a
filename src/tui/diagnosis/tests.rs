//! Screens on a fixed diagnosis, keys in every state, and any data at any size.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::layout::{Position, Rect};

mod answers;
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
    AddResult, AxisMap, Diagnosis, DiagnosisVerdict, EffectCurve, ErrorOf, Event as Found,
    NextExperiment, Status, effect_curve, error_curve,
};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::plant::effect::CATALOGUE;
use drivebench_model::plant::testing::with_a_fan;
use drivebench_model::sample::Channel;

/// What is left once the effect is in the model.
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
        sentence: "nothing is missing: held-out error 1.03 times the noise floor".to_owned(),
        baseline: fitted(&["stribeck_friction"]),
        ..diagnosis()
    }
}

fn added(effect: &'static str, accepted: bool) -> News {
    News::Added(Box::new(AddResult {
        effect,
        accepted,
        forced: false,
        reason: format!("{effect} helps only in training (4.80 -> 4.20)"),
        before: comparison(0.76),
        after: comparison(0.155),
        parameters: Vec::new(),
        ladder: vec![rung(Vec::new(), 5.1), rung(vec![effect], 1.03)],
        confirm: None,
        fit: fitted(&["stribeck_friction"][..usize::from(accepted)]),
    }))
}

fn hear(state: &mut State, news: News) {
    assert_eq!(state.update(Event::News(news)), None);
}

fn press(state: &mut State, press: Press) -> Option<Effect> {
    state.update(Event::Press(press))
}

fn begun() -> State {
    let mut state = State::new("run-a, held out run-b".to_owned());
    hear(&mut state, News::Compared(Box::new(comparison(0.76))));
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
        hear(&mut state, News::Progress(Found::Screened { effect, share }));
    }
    hear(&mut state, News::Progress(Found::Refitted { effect: "stribeck_friction", error: 1.01 }));
    state
}

fn answered() -> State {
    let mut state = searching();
    hear(&mut state, News::Diagnosed(Box::new(diagnosis())));
    state
}

/// After the effect was added.
fn at_the_floor() -> State {
    let mut state = answered();
    press(&mut state, Press::Add);
    hear(&mut state, added("stribeck_friction", true));
    hear(&mut state, News::Diagnosed(Box::new(nothing_more())));
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
    hear(&mut state, News::Traced(Box::new(fan_traces(false))));
    let mut found = diagnosis();
    found.candidates[0] = candidate(1, "quadratic_load", Status::Supported, 1.03);
    (found.effect, found.effects) = (Some("quadratic_load"), vec!["quadratic_load"]);
    found.sentence = found.sentence.replace("stribeck_friction", "quadratic_load");
    answer(&mut state, found);
    hear(&mut state, News::Curves(fan_curves()));
    state
}

/// The fan was added; its fall is drawn half.
fn falling() -> State {
    let mut state = of_a_fan();
    press(&mut state, Press::Add);
    hear(&mut state, added("quadratic_load", true));
    hear(&mut state, News::Traced(Box::new(fan_traces(true))));
    for _ in 0..FRAMES / 2 {
        state.update(Event::Frame);
    }
    state
}

/// Nothing but a comparison.
/// A run that tripped, compared: the traces open where it was stopped.
fn stopped() -> State {
    let mut state = State::of_a_comparison("run-a, held out run-b".to_owned(), ErrorOf::Model);
    state.stops_at(Some(StoppedAt {
        run: "run-a".to_owned(),
        at_s: 4.5,
        shows: Some(Channel::Current),
        text: "stopped: over-current at 4.50 s, zero confirmed after 18 ms".to_owned(),
    }));
    hear(&mut state, News::Compared(Box::new(comparison(0.76))));
    hear(&mut state, News::Traced(Box::new(fan_traces(false))));
    hear(&mut state, News::Curves(fan_curves()));
    state
}

fn compared_alone() -> State {
    let mut state = State::of_a_comparison("run-a, held out run-b".to_owned(), ErrorOf::Model);
    hear(&mut state, News::Compared(Box::new(comparison(0.76))));
    hear(&mut state, News::Traced(Box::new(fan_traces(false))));
    hear(&mut state, News::Curves(fan_curves()));
    state
}

fn pressed(mut state: State, keys: &[Press]) -> State {
    for key in keys {
        assert_eq!(press(&mut state, *key), None, "{key:?}");
    }
    state
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

/// Every page of the screen.
pub(in crate::tui) fn pages() -> Vec<Page> {
    let refused = || {
        let mut state = pressed(answered(), &[Press::Move(1)]);
        press(&mut state, Press::Add);
        hear(&mut state, added("cogging", false));
        state
    };
    let next = || {
        let mut state = answered();
        let mut found = diagnosis();
        found.confusable = vec![["viscous_friction", "quadratic_load"]];
        answer(&mut state, found);
        hear(&mut state, News::Recommended(Some(Box::new(next_experiment()))));
        pressed(state, &[Press::Next])
    };
    let failed = || {
        let mut state = begun();
        let reason = "the run is too short: 12 rows, at least 200 are needed";
        hear(&mut state, News::Failed(reason.to_owned()));
        state
    };
    let traces = pressed(of_a_fan(), &[Press::Traces]);
    let curve = pressed(of_a_fan(), &[Press::Curve]);
    let states = [
        ("begun", begun()),
        ("searching", searching()),
        ("answered", answered()),
        ("fan", of_a_fan()),
        ("falling", falling()),
        ("at_the_floor", at_the_floor()),
        ("refused", refused()),
        ("failed", failed()),
        ("card", pressed(answered(), &[Press::Open])),
        ("map", pressed(of_a_fan(), &[Press::Map])),
        ("next", next()),
        ("curve", curve.clone()),
        ("curve_cursor", pressed(curve, &[Press::Cursor(-1), Press::Cursor(-1)])),
        ("traces", traces.clone()),
        ("worst", pressed(of_a_fan(), &[Press::Worst, Press::Cursor(1)])),
        ("signals", pressed(traces, &[Press::Signals, Press::Move(1)])),
        ("drawn_over", pressed(falling(), &[Press::Traces])),
        ("compared", compared_alone()),
        ("stopped", stopped()),
        ("help", pressed(answered(), &[Press::Help])),
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

#[test]
fn every_small_size() {
    let more = [of_a_fan(), falling(), compared_alone()];
    for state in [begun(), searching(), answered(), at_the_floor()].into_iter().chain(more) {
        for over in OVER.into_iter().chain([Over::Nothing]) {
            let mut state = state.clone();
            state.over = over;
            for (width, height) in testing::sizes() {
                terminal(&state, width, height);
            }
        }
    }
}

#[test]
fn the_selected_row_is_always_in_sight() {
    let mut state = begun();
    for effect in CATALOGUE {
        let (effect, share) = (effect.card().id, 0.1);
        hear(&mut state, News::Progress(Found::Screened { effect, share }));
    }
    for _ in 0..40 {
        press(&mut state, Press::Move(1));
        let shown = text(&state, 80, 24);
        assert!(shown.contains('▶'), "{shown}");
    }
}

const DOWN: Press = Press::Move(1);
const UP: Press = Press::Move(-1);
const FINISHED: Option<Effect> = Some(Effect::Leave(Exit::Finished));

fn every_state() -> Vec<State> {
    let mut failed = begun();
    hear(&mut failed, News::Failed("the run is too short".to_owned()));
    let mut states = vec![
        begun(),
        searching(),
        answered(),
        at_the_floor(),
        failed,
        of_a_fan(),
        falling(),
        compared_alone(),
    ];
    for index in 0..states.len() {
        for over in OVER {
            let state = states[index].clone();
            states.push(State { over, ..state });
        }
    }
    states
}

fn selected(state: &State) -> &'static str {
    state.row().map_or("", |row| row.key())
}

fn told(state: &State) -> &str {
    state.message.as_deref().unwrap_or_default()
}

fn answer(state: &mut State, answer: Diagnosis) {
    hear(state, News::Diagnosed(Box::new(answer)));
}

#[test]
fn a_adds_the_selected_effect_and_the_ladder_shows_the_fall() {
    let mut state = answered();
    assert_eq!(selected(&state), "stribeck_friction");
    assert_eq!(press(&mut state, Press::Add), Some(Effect::Order(Order::Add("stribeck_friction"))));
    assert_eq!(press(&mut state, Press::Add), None, "not twice");
    hear(&mut state, added("stribeck_friction", true));
    assert_eq!(state.present, ["stribeck_friction"]);
    assert!(state.diagnosis.is_none() && state.working.is_some());
    answer(&mut state, nothing_more());
    let errors: Vec<f64> = state.ladder.iter().map(|step| step.error).collect();
    assert_eq!(errors, [5.1, 1.03]);
    shows(&state, &["at the floor", "NOTHING MISSING"]);
}

#[test]
fn a_refused_effect_leaves_the_model_and_says_why() {
    let mut state = answered();
    press(&mut state, DOWN);
    assert_eq!(press(&mut state, Press::Add), Some(Effect::Order(Order::Add("cogging"))));
    hear(&mut state, added("cogging", false));
    assert!(state.present.is_empty() && state.ladder.len() == 1);
    assert!(state.diagnosis.is_some() && state.working.is_none());
    shows(&state, &["refused: cogging helps only in training"]);
}

#[test]
fn r_removes_what_is_in_the_model_and_nothing_else() {
    let mut state = answered();
    assert_eq!(press(&mut state, Press::Remove), None);
    assert_eq!(told(&state), "the model has no effect yet");
    let mut state = at_the_floor();
    assert_eq!(selected(&state), "stribeck_friction", "the cursor stays on what was added");
    press(&mut state, DOWN);
    assert_eq!(press(&mut state, Press::Remove), None, "a candidate is selected");
    press(&mut state, UP);
    assert_eq!(press(&mut state, Press::Add), None);
    let removes = Effect::Order(Order::Remove("stribeck_friction"));
    assert_eq!(press(&mut state, Press::Remove), Some(removes));
}

#[test]
fn u_takes_the_last_change_back_and_b_looks_before_it() {
    let mut state = answered();
    assert_eq!(press(&mut state, Press::Undo), None);
    assert!(told(&state).starts_with("nothing was changed by hand"));
    assert_eq!(press(&mut state, Press::Before), None);
    assert!(told(&state).starts_with("there is no change"));
    let mut state = at_the_floor();
    let shown = |state: &State| state.compared().unwrap().signals.speed_rad_s.unwrap();
    let after = shown(&state).holdout.rmse;
    press(&mut state, Press::Before);
    shows(&state, &["BEFORE the change of stribeck_friction"]);
    assert!(shown(&state).holdout.rmse > 2.0 * after);
    press(&mut state, Press::Before);
    assert!((shown(&state).holdout.rmse - after).abs() < 1e-12);
    let effect = press(&mut state, Press::Undo);
    assert_eq!(effect, Some(Effect::Order(Order::Undo)));
    hear(&mut state, News::Undone { effect: "stribeck_friction", present: Vec::new() });
    assert!(state.present.is_empty() && state.ladder.len() == 1);
    answer(&mut state, diagnosis());
    assert_eq!(selected(&state), "stribeck_friction");
    assert!(told(&state).starts_with("taken back"));
}

#[test]
fn a_again_forces_what_was_refused_and_a_refused_removal_says_the_way() {
    let mut state = answered();
    press(&mut state, DOWN);
    press(&mut state, Press::Add);
    hear(&mut state, added("cogging", false));
    shows(&state, &["refused: a again adds cogging all the same"]);
    assert_eq!(press(&mut state, Press::Add), Some(Effect::Order(Order::Force("cogging"))));
    let mut state = at_the_floor();
    press(&mut state, Press::Remove);
    let News::Added(refused) = added("stribeck_friction", false) else {
        panic!("an addition");
    };
    hear(&mut state, News::Removed(refused));
    shows(&state, &["u takes the last change back"]);
}

#[test]
fn no_tick_stands_beside_a_residual_that_is_not_white() {
    let shown = text(&answered(), 120, 40);
    let row = shown.lines().find(|row| row.contains("residual")).unwrap();
    assert!(row.contains("not white (80 % of lags outside)"), "{row}");
    assert!(!row.contains('✓'), "{row}");
}

#[test]
fn a_rival_of_the_model_stays_on_the_list_and_the_screen_is_not_green() {
    let mut state = at_the_floor();
    let mut found = nothing_more();
    found.candidates.truncate(1);
    answer(&mut state, found.clone());
    shows(&state, &["✓ NOTHING MISSING"]);
    found.remember_rivals(&[["stribeck_friction", "cogging"]]);
    answer(&mut state, found);
    let shown = text(&state, 120, 40);
    assert!(shown.contains("~ NOTHING MISSING THAT THESE RUNS COULD SHOW"), "{shown}");
    assert!(shown.contains("as good as stribeck_friction"), "{shown}");
}

#[test]
fn the_help_gives_back_the_page_that_it_explains() {
    for over in OVER {
        let mut state = State { over, ..of_a_fan() };
        press(&mut state, Press::Help);
        press(&mut state, DOWN);
        assert_eq!((state.help, state.over), (Some(1), over));
        shows(&state, &["to the shell, once nothing is energised"]);
        press(&mut state, Press::Quit);
        assert_eq!((state.help, state.over), (None, over));
    }
}

#[test]
fn a_click_selects_a_row_and_sets_the_cursor_and_the_wheel_zooms() {
    let area = Rect::new(0, 0, 120, 40);
    let click = |state: &mut State, what: &str| {
        let shown = terminal(state, area.width, area.height);
        let rows = shown.backend().buffer().content.chunks(120);
        let mut rows = rows.map(|row| row.iter().map(ratatui::buffer::Cell::symbol));
        let y = rows.position(|row| row.collect::<String>().contains(what));
        let at = Position::new(40, y.unwrap_or_else(|| panic!("{what}")) as u16);
        super::view::click(state, at, area);
    };
    let mut state = answered();
    for effect in ["viscous_friction ", "stribeck_friction ", "cogging "] {
        click(&mut state, effect);
        assert_eq!((selected(&state), &state.message), (effect.trim(), &None));
    }
    click(&mut state, "DIAGNOSIS");
    assert!(told(&state).starts_with("there is nothing to select"));
    let mut traces = pressed(of_a_fan(), &[Press::Traces]);
    let shown = |state: &State| text(state, area.width, area.height);
    assert!(!shown(&traces).contains("cursor at"));
    click(&mut traces, "speed: measured - model");
    assert!(shown(&traces).contains("cursor at"), "{}", shown(&traces));
    let before = shown(&traces);
    press(&mut traces, Press::Wheel(-1));
    assert_ne!(shown(&traces), before);
    press(&mut traces, Press::Wheel(1));
    assert_eq!(shown(&traces), before);
    let mut curve = pressed(of_a_fan(), &[Press::Curve]);
    click(&mut curve, "┤");
    assert!(matches!(curve.over, Over::Curve(0, Some(_))), "{:?}", curve.over);
}

#[test]
fn orders_wait_for_the_worker_and_q_always_leaves() {
    for state in every_state() {
        let busy = state.working.is_some();
        for key in [Press::Add, Press::Remove, Press::Write] {
            assert!(press(&mut state.clone(), key).is_none() || !busy, "{key:?} {state:?}");
        }
        let mut quits = state.clone();
        // A first q closes what lies over the screen.
        let effect = press(&mut quits, Press::Quit).or_else(|| press(&mut quits, Press::Quit));
        let exit = if busy { Exit::Quit } else { Exit::Finished };
        assert_eq!(effect, Some(Effect::Leave(exit)), "{state:?}");
        let effect = press(&mut state.clone(), Press::Interrupt);
        assert_eq!(effect, Some(Effect::Leave(Exit::Interrupted)), "{state:?}");
    }
}

#[test]
fn without_a_floor_nothing_is_said_in_multiples_of_it() {
    let without = || {
        let mut diagnosis = diagnosis();
        diagnosis.noise_floor_from = FloorSource::None;
        diagnosis.sentence = "missing: stribeck_friction".to_owned();
        diagnosis
    };
    let mut state = answered();
    answer(&mut state, without());
    press(&mut state, Press::Add);
    let News::Added(mut change) = added("stribeck_friction", true) else {
        unreachable!("it adds");
    };
    change.confirm = Some([5.1, 0.4].map(|error| rung(Vec::new(), error)));
    change.before.noise_floor_from = FloorSource::None;
    change.after.noise_floor_from = FloorSource::None;
    hear(&mut state, News::Added(change));
    let shown = text(&state, 160, 40);
    assert!(shown.contains("0.40 times the baseline's residual"), "{shown}");
    assert!(!shown.contains("times the noise"), "{shown}");
}

#[test]
fn the_selection_stays_on_its_effect_while_the_order_changes() {
    let mut state = searching();
    press(&mut state, DOWN);
    assert_eq!(selected(&state), "cogging");
    hear(&mut state, News::Progress(Found::Screened { effect: "quadratic_load", share: 0.99 }));
    assert_eq!(selected(&state), "cogging");
    for _ in 0..99 {
        press(&mut state, Press::Move(10));
    }
    assert_eq!(selected(&state), "voltage_drop");
}

#[test]
fn e_goes_through_both_equations_and_says_where_there_is_no_map() {
    let mut state = answered();
    for over in [Over::Map(0), Over::Map(1), Over::Nothing] {
        press(&mut state, Press::Map);
        assert_eq!(state.over, over);
    }
    let mut bare = State::new(String::new());
    press(&mut bare, Press::Map);
    assert_eq!(bare.over, Over::Nothing);
    assert_eq!(told(&bare), "not yet: fitting the model");
}

#[test]
fn c_draws_the_selected_effect_else_the_error_and_then_what_is_unexplained() {
    let mut state = of_a_fan();
    press(&mut state, Press::Curve);
    shows(&state, &["without the effect", "with it", "over speed, rad/s"]);
    assert_eq!((press(&mut state, Press::Curve), state.over), (None, Over::Nothing));
    // The next row has no size: the error alone.
    press(&mut state, DOWN);
    press(&mut state, Press::Curve);
    shows(&state, &["error of the model", "no effect is drawn"]);
    // What no effect explains follows, and can be added as a curve.
    let mut found = diagnosis();
    found.verdict = DiagnosisVerdict::Unexplained;
    found.axis_map = vec![AxisMap {
        equation: "torque",
        axis: "speed_rad_s",
        r2: 0.8,
        knots: vec![0.0, 50.0, 100.0],
        values: vec![0.0, 0.1, 0.05],
        std: vec![0.01; 3],
        error_over_noise: None,
        sentence: "80 % of the torque error follows the speed".to_owned(),
    }];
    answer(&mut state, found);
    press(&mut state, Press::Curve);
    assert_eq!(state.over, Over::Curve(1, None));
    shows(&state, &["80 % of the torque error follows the speed"]);
    assert_eq!(press(&mut state, Press::Table), Some(Effect::Order(Order::AddCurve(0))));
}

#[test]
fn a_change_is_drawn_frame_by_frame_towards_the_floor_and_ends_by_itself() {
    let mut state = of_a_fan();
    assert!(!state.is_moving());
    press(&mut state, Press::Add);
    hear(&mut state, added("quadratic_load", true));
    hear(&mut state, News::Traced(Box::new(fan_traces(true))));
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
    assert!(lengths[0] > 3 * lengths[lengths.len() - 1], "{lengths:?}");
    assert!(lengths.len() > 10);
}

#[test]
fn g_asks_for_the_frequency_response_and_shows_it_or_says_why_there_is_none() {
    let mut state = compared_alone();
    assert_eq!(press(&mut state, Press::Response), Some(Effect::Order(Order::Respond)));
    assert_eq!(press(&mut state, Press::Response), None, "not twice");
    let mut refused = state.clone();
    hear(&mut refused, News::Responded(Err("the run holds its voltage all the time".to_owned())));
    assert!(told(&refused).contains("holds its voltage"));
    assert_eq!(refused.over, Over::Nothing);
    hear(&mut state, News::Responded(Ok(Box::new(crate::tui::response::tests::compared()))));
    assert_eq!(state.over, Over::Response);
    shows(&state, &["current to speed", "resonance at 22.01"]);
    press(&mut state, Press::NextScreen);
    shows(&state, &["voltage to speed"]);
    press(&mut state, Press::Response);
    assert_eq!(state.over, Over::Nothing);
}

#[test]
fn a_comparison_alone_searches_only_when_it_is_asked_to() {
    let mut state = compared_alone();
    assert!(state.only_compares() && state.working.is_none());
    shows(&state, &["residual", "d diagnose"]);
    let effect = press(&mut state, Press::Diagnose);
    assert_eq!(effect, Some(Effect::Order(Order::Diagnose)));
    assert!(!state.only_compares());
    assert_eq!(press(&mut state, Press::Diagnose), None, "not twice");
    // Over a comparison, and before there is any row.
    for (mut state, expected) in [
        (pressed(compared_alone(), &[Press::Map]), "this page does not scroll"),
        (compared_alone(), "there is no list of effects yet"),
        (begun(), "not yet: no effect has been judged"),
    ] {
        press(&mut state, DOWN);
        assert!(told(&state).starts_with(expected), "{}", told(&state));
    }
}

#[test]
fn n_tells_what_is_not_told_apart_and_the_run_that_would() {
    let mut state = searching();
    press(&mut state, Press::Next);
    assert_eq!(state.over, Over::Nothing);
    let mut found = diagnosis();
    found.confusable = vec![["viscous_friction", "quadratic_load"]];
    answer(&mut state, found);
    hear(&mut state, News::Recommended(Some(Box::new(next_experiment()))));
    press(&mut state, Press::Next);
    // The dither is above the constant, below what that run needs.
    let tried = ["from which on that run tells", "612  tells", "612  does not"];
    shows(&state, &tried);
    shows(&state, &["viscous_friction and quadratic_load cannot be told apart", "run a slow ramp"]);
    press(&mut state, Press::Next);
    assert_eq!(state.over, Over::Nothing);
}

#[test]
fn none_is_asked_for_only_once_the_next_run_has_been_looked_for() {
    let mut state = searching();
    answer(&mut state, Diagnosis { limits: Vec::new(), ..diagnosis() });
    press(&mut state, Press::Next);
    shows(&state, &["being looked for"]);
    let reveals = NextExperiment { pair: None, ..next_experiment() };
    let mut shown = state.clone();
    hear(&mut shown, News::Recommended(Some(Box::new(reveals))));
    shows(&shown, &["foreseen precision", "slow_ramp"]);
    hear(&mut state, News::Recommended(None));
    shows(&state, &["none is asked for"]);
}

#[test]
fn q_waits_for_a_model_that_is_being_written() {
    let mut state = answered();
    assert_eq!(press(&mut state, Press::Write), Some(Effect::Order(Order::Write)));
    shows(&state, &["… writing the model"]);
    assert_eq!(press(&mut state, Press::Write), None, "not twice");
    assert_eq!(press(&mut state, Press::Quit), None);
    shows(&state, &["leaves when the model is written"]);
    assert_eq!(press(&mut state, Press::Add), None);
    let written = || Event::News(News::Written("model written to m.toml".to_owned()));
    assert_eq!(state.clone().update(written()), FINISHED);
    let mut stays = state.clone();
    press(&mut stays, Press::Stop);
    assert_eq!(stays.update(written()), None);
    shows(&stays, &["model written to m.toml", "ready"]);
    assert_eq!(press(&mut stays, Press::Quit), FINISHED);
    // Ctrl-C does not wait.
    assert_eq!(press(&mut state, Press::Interrupt), Some(Effect::Leave(Exit::Interrupted)));
}

#[test]
fn a_model_that_cannot_be_written_keeps_the_screen() {
    let mut state = answered();
    press(&mut state, Press::Write);
    press(&mut state, Press::Quit);
    let mut gone = state.clone();
    hear(&mut state, News::NotWritten("the disk is full".to_owned()));
    shows(&state, &["NOT WRITTEN: the disk is full"]);
    assert_eq!(press(&mut state, Press::Quit), FINISHED);
    assert_eq!(gone.update(Event::WorkerGone), None);
    shows(&gone, &["the model is NOT WRITTEN"]);
    assert_eq!(press(&mut gone, Press::Quit), FINISHED);
}

#[test]
fn a_worker_that_has_gone_is_told() {
    let mut state = searching();
    state.update(Event::WorkerGone);
    shows(&state, &["ERROR: the analysis has ended"]);
    let mut idle = answered();
    idle.update(Event::WorkerGone);
    assert_eq!(idle.failure, None);
}
