//! Measured and simulated signals of one run over time, and the residuals: the figure that the pages of a commissioning and of
//! a comparison share.

use super::Document;
use super::plot::{MOST_POINTS, Panel, Style, TIME, stacked};
use drivebench_diagnose::{Quantity, RunTraces, SignalTrace};
use drivebench_identify::noise::NoiseFloor;
use drivebench_identify::output_error::FitError;
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::sample::Channel;
use drivebench_model::units::rpm_from_rad_s;

/// The run that is plotted (the confirming one where there is one) with the free runs of both models.
#[derive(Clone, Debug)]
pub struct ConfirmRun {
    before: RunTraces,
    after: Option<RunTraces>,
}

impl ConfirmRun {
    /// Of a run that a voltage drives, and of complete models.
    pub fn of(
        before: &Model,
        after: Option<&Model>,
        run: &Scenario,
        noise: &NoiseFloor,
    ) -> Result<Self, FitError> {
        let free_run = |model: &Model| RunTraces::free_run(model, run, noise);
        Ok(Self { before: free_run(before)?, after: after.map(free_run).transpose()? })
    }
}

pub(super) fn traces(document: &mut Document, run: &ConfirmRun) {
    let panels = panels(run);
    document.figure(
        move || {
            let description = "measured and simulated current and speed over time";
            stacked(description, TIME, &panels, MOST_POINTS)
        },
        format!(
            "Free run of the model over {:?} from its voltage alone; time counts from the start of that run. A line is broken where \
             samples are missing.",
            run.before.run,
        ),
    );
}

pub(super) const fn model_names(changed: bool) -> [&'static str; 2] {
    if changed { ["model before", "model after"] } else { ["model", ""] }
}

/// Input, both signals and both residuals over one time axis.
fn panels(run: &ConfirmRun) -> Vec<Panel> {
    let (_, end_s) = run.before.span_s();
    let signals = || run.before.signals.iter().rev();
    let held = signals().filter(|signal| signal.is_held).map(|signal| {
        let times = signal.time_s.iter().copied();
        let events: Vec<_> = times.zip(signal.measured.iter().copied()).collect();
        let panel = Panel::new(signal.quantity.name(), signal.quantity.unit());
        panel.with_height(90.0).held("command", &events, end_s)
    });
    let with_model = signals().filter(|signal| signal.has_model());
    let (signals, residuals): (Vec<_>, Vec<_>) =
        with_model.map(|signal| signal_panels(run, signal)).unzip();
    held.chain(signals).chain(residuals).collect()
}

/// A signal with its models, and the residuals.
fn signal_panels(run: &ConfirmRun, own: &SignalTrace) -> (Panel, Panel) {
    let (name, unit) = (own.quantity.name(), own.quantity.unit());
    let mut signal =
        Panel::new(name, unit).sampled("measured", Style::Measured, &own.time_s, &own.measured);
    let mut residual = Panel::new(format!("{name}, measured - model"), unit).with_height(110.0);
    let mut after = run.after.iter().flat_map(|run| &run.signals);
    let after = after.find(|other| other.quantity == own.quantity);
    let [before_name, after_name] = model_names(after.is_some());
    let style = if after.is_some() { Style::Before } else { Style::After };
    let models = [(before_name, style, Some(own)), (after_name, Style::After, after)];
    for (label, style, trace) in models {
        let Some(trace) = trace else { continue };
        signal = signal.sampled(label, style, &own.time_s, &trace.model);
        let error: Vec<f64> = trace.residual().collect();
        residual = residual.sampled(label, style, &own.time_s, &error);
    }
    if let Some(noise) = own.noise {
        residual = residual.with_band("99 % of the noise", 2.576 * noise);
    }
    if own.quantity == Quantity::Channel(Channel::Speed) {
        let r_min = |panel: Panel| panel.with_second_unit("r/min", rpm_from_rad_s(1.0));
        (signal, residual) = (r_min(signal), r_min(residual));
    }
    (signal, residual)
}
