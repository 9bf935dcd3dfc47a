//! Every page of the screen, with something on it.

use super::*;
use crate::tui::screens::Page;
use crate::workflow::CommandContext;

/// A reference that is followed, a while after the load has changed.
fn speed() -> Snapshot {
    let trace = trace(8.4).into_iter().map(|point| TracePoint {
        reference_rad_s: if point.time_s < 4.0 { 150.0 } else { -100.0 },
        ..point
    });
    Snapshot {
        segment: Some("pass 2 of 3".to_owned()),
        trace: Arc::new(trace.collect()),
        ..running()
    }
}

/// An inertia that had a value a while ago and has none now.
pub(super) fn between_two_values() -> Model {
    let mut model = ranked(running());
    let mut later = running();
    let mut estimates = running().estimates.to_vec();
    let reason = "the speed has not changed for a while";
    estimates[3] =
        ParameterEstimate::not_observable("inertia_kg_m2", "kg.m2", Reason::TooFewRows, reason);
    (later.elapsed_s, later.estimates) = (11.6, Arc::new(estimates));
    model.update(Event::Snapshot(Arc::new(later)));
    model
}

/// The end of a commissioning, with what can follow.
fn offers() -> Model {
    finished(with(&model(done()), |own| {
        let mut workflow = workflow(true);
        workflow.steps.extend([Step::Experiment, Step::SpeedLoop].map(|step| StepView {
            state: StepState::Offered,
            command: step.command(&CommandContext::default()),
            ..StepView::new(step)
        }));
        own.update(Event::Workflow(Arc::new(workflow)));
    }))
}

pub(in crate::tui) fn pages() -> Vec<Page> {
    let run = ranked(running());
    let waiting = model(hardware());
    let steps = with(&run, |own| {
        report(own, false);
        own.page = super::Page::Steps;
    });
    let fault = Snapshot { drive_state: Some(DriveState::Fault), ..hardware() };
    let mut lost = running();
    (lost.phase, lost.outcome) = (Some(Phase::LinkLost), Some("link_lost"));
    lost.reopening = Some("link lost, reopening (attempt 3)…".to_owned());
    let states = [
        ("starting", Model::new(None)),
        ("running", run.clone()),
        ("speed", model(speed())),
        ("missing", model(missing())),
        ("parameters", with(&run, |own| own.page = super::Page::Parameters)),
        ("between_two_values", between_two_values()),
        ("hardware", waiting.clone()),
        ("confirm", with(&waiting, |own| own.confirm_start = true)),
        ("fault", model(fault)),
        ("tripped", model(tripped())),
        ("trip_over", finished(model(tripped()))),
        ("lost", model(lost)),
        ("frozen", pressed(run.clone(), "f")),
        ("steps", steps.clone()),
        ("steps_explained", pressed(steps, "⏎")),
        ("done", finished(model(done()))),
        ("report", offers()),
        ("report_end", with(&offers(), |own| own.scroll = 99)),
        ("help", pressed(run, "?")),
    ];
    let page = |(name, model): (&'static str, Model)| -> Page {
        (name, Box::new(move |frame| view(&model, frame)))
    };
    states.map(page).into()
}
