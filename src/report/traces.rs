//! Measured and simulated signals over the time of one run, and what the models leave over: the figure that the pages of a
//! commission and of a comparison share.

use super::page::Page;
use super::plot::{MOST_POINTS, Panel, Style, TIME, stacked};
use drivebench_identify::noise::{FloorSource, NoiseFloor};
use drivebench_model::plant::{Input, Scenario, Trajectory};
use drivebench_model::units::rpm_from_rad_s;

/// Standard deviations within which 99 of 100 normal residuals lie.
const BAND_99: f64 = 2.576;

/// The run that is plotted (the confirming one where there is one) with the free runs of both models.
#[derive(Clone, Copy, Debug)]
pub struct ConfirmRun<'a> {
    pub scenario: &'a Scenario,
    pub before: &'a Trajectory,
    /// `None` where nothing was added.
    pub after: Option<&'a Trajectory>,
    pub noise: &'a NoiseFloor,
}

/// Measured and simulated signals and what the models leave over.
pub(super) fn traces(page: &mut Page, run: ConfirmRun<'_>) {
    page.figure(
        stacked(
            "measured and simulated current and speed over time",
            TIME,
            &panels(run),
            MOST_POINTS,
        ),
        format!(
            "Free run of the model over {:?} from its {} alone; time counts from the start of that run. A line is broken where \
             samples are missing.",
            run.scenario.name,
            input_name(run.scenario.input).0,
        ),
    );
}

/// What the models before and after are called.
pub(super) const fn model_names(changed: bool) -> [&'static str; 2] {
    if changed {
        ["model before", "model after"]
    } else {
        ["model", ""]
    }
}

const fn input_name(input: Input) -> (&'static str, &'static str) {
    match input {
        Input::Voltage => ("voltage", "V"),
        Input::Current => ("current as input", "A"),
        Input::Torque => ("torque as input", "N.m"),
    }
}

/// Input, both signals and both residuals over one time axis.
fn panels(run: ConfirmRun<'_>) -> [Panel; 5] {
    let (scenario, noise) = (run.scenario, run.noise);
    let start_s = scenario.begin_s();
    let since = |time: f64| time - start_s;
    let events: Vec<_> = (scenario.events.iter())
        .map(|(time, value)| (since(*time), *value))
        .collect();
    let time_s: Vec<f64> = scenario.sample_time_s.iter().copied().map(since).collect();
    let end_s = time_s.last().copied().unwrap_or(0.0);
    let (name, unit) = input_name(scenario.input);
    let input = Panel::new(name, unit).with_height(90.0);
    let r_min = |panel: Panel| panel.with_second_unit("r/min", rpm_from_rad_s(1.0));
    let [current, current_left] = signal_panels(
        run,
        &time_s,
        ("current", "A", noise.current_a),
        &scenario.current_a,
        |t| &t.current_a,
    );
    let [speed, speed_left] = signal_panels(
        run,
        &time_s,
        ("speed", "rad/s", noise.speed_rad_s),
        &scenario.speed_rad_s,
        |t| &t.speed_rad_s,
    );
    [
        input.held("command", &events, end_s),
        current,
        r_min(speed),
        current_left,
        r_min(speed_left),
    ]
}

/// A signal (name, unit, noise) with its models, and what they leave over.
fn signal_panels(
    run: ConfirmRun<'_>,
    time_s: &[f64],
    (name, unit, noise): (&str, &str, f64),
    measured: &[f64],
    simulated: fn(&Trajectory) -> &Vec<f64>,
) -> [Panel; 2] {
    let mut signal = Panel::new(name, unit).sampled("measured", Style::Measured, time_s, measured);
    let mut residual = Panel::new(format!("{name}, measured - model"), unit).with_height(110.0);
    // A signal that was not measured has nothing to be compared with.
    let seen = measured.iter().any(|value| value.is_finite());
    let [before, after] = model_names(run.after.is_some());
    let style = if run.after.is_some() {
        Style::Before
    } else {
        Style::After
    };
    let models = [
        (before, style, Some(run.before)),
        (after, Style::After, run.after),
    ];
    for (label, style, trajectory) in models {
        let Some(trajectory) = trajectory.filter(|_| seen) else {
            continue;
        };
        let values = simulated(trajectory);
        signal = signal.sampled(label, style, time_s, values);
        let both = values.iter().zip(measured);
        let error: Vec<f64> = both.map(|(model, measured)| measured - model).collect();
        residual = residual.sampled(label, style, time_s, &error);
    }
    if run.noise.source != FloorSource::None {
        residual = residual.with_band("99 % of the noise", BAND_99 * noise);
    }
    [signal, residual]
}
