//! Figures 5 and 6 of paper A on the page.

use super::{cells, csv, inside, named, of, rivals, seconds, times};
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::AdaptiveLoop;
use crate::workflow::reproduce::adaptive::{Figure5, Figure6, MECHANICAL_S, Saturated, SteppedBy};
use crate::workflow::reproduce::loops::{Kind, Step};

/// Speeds that Figures 5 and 6 show: without the start.
const FRAME_RAD_S: std::ops::RangeInclusive<f64> = 70.0..=130.0;

pub(super) fn in_short(found: &AdaptiveLoop) -> String {
    let figure = &found.figure_6;
    let fixed_worst: Vec<f64> = figure
        .adapted(1)
        .map(|row| row.fixed.response.overshoot_percent)
        .collect();
    let adaptive_worst = figure
        .adapted(1)
        .chain(figure.adapted(2))
        .map(|row| row.adaptive.response.overshoot_percent)
        .fold(0.0, f64::max);
    let error = |kind| {
        let run = found.figure_7.saturated_of(kind);
        fixed(run.map_or(f64::NAN, Saturated::end_error_rad_s), 1)
    };
    format!(
        "Figure 6: at TM = {} s the fixed PI overshoots by {} to {} %, the adaptive one by at most {} % from the second step after a jump. {} In saturation MRAC ends with an error of {} rad/s where it stays connected, {} rad/s where it is disconnected, ADDC with {} rad/s.",
        MECHANICAL_S[1],
        fixed(fixed_worst.iter().copied().fold(f64::INFINITY, f64::min), 0),
        fixed(fixed_worst.iter().copied().fold(0.0, f64::max), 0),
        fixed(adaptive_worst, 1),
        rivals::verdict(&found.figure_7),
        error(Kind::MracConnected),
        error(Kind::MracDisconnected),
        error(Kind::Addc),
    )
}

pub(super) fn figure_5(figure: &Figure5) -> Section {
    let t = times(&figure.trace);
    let speed = Panel::new("speed", "rad/s")
        .with(Series::sampled(
            "reference",
            Style::Command,
            &t,
            &of(&figure.trace, |p| p.reference_rad_s),
        ))
        .with(Series::sampled(
            "speed",
            Style::After,
            &t,
            &inside(&of(&figure.trace, |p| p.speed_rad_s), FRAME_RAD_S),
        ));
    let gain = Panel::new("proportional gain", "V per rad/s")
        .with_height(90.0)
        .with(Series::sampled(
            "Kp",
            Style::After,
            &t,
            &figure.proportional,
        ));
    let row = |adapts: &'static str| {
        move |step: &Step| {
            cells([
                fixed(step.at_s, 0),
                adapts.to_owned(),
                fixed(step.response.overshoot_percent, 1),
                seconds(step.response.settling_s),
                significant(step.response.absolute_error_rad, 3),
                significant(step.effort_v, 3),
            ])
        }
    };
    let before = figure.before.iter().map(row("no"));
    let rows = before.chain(figure.after.iter().map(row("yes"))).collect();
    Section {
        heading: "Figure 5: the adaptation joins".to_owned(),
        paragraphs: vec![format!(
            "Chosen by us, the text has no data: the regulator is tuned for TM = {} s, the shaft has {} s; at {} s the adaptation joins without a bump. It is told nothing of the shaft: the first step that it sees tells it.",
            figure.tuned_for_s, figure.mechanical_s, figure.joins_at_s
        )],
        pictures: vec![Picture {
            name: "figure-5",
            svg: PanelPlot::default()
                .with(speed)
                .with(gain)
                .svg("speed and gain; the adaptation joins in the middle"),
            caption: format!(
                "Fixed gains until {} s, adaptive from there on; the start from standstill is cut off.",
                figure.joins_at_s
            ),
        }],
        tables: vec![(
            "Every step of the reference but the start.".to_owned(),
            named(
                "figure-5",
                vec![
                    "at, s",
                    "adaptive",
                    "overshoot, %",
                    "settling, s",
                    "IAE, rad",
                    "effort, V",
                ],
                rows,
            ),
        )],
        data: vec![(
            "figure-5-series.csv".to_owned(),
            csv(
                "time_s",
                &t,
                &[
                    (
                        "reference_rad_s".to_owned(),
                        &of(&figure.trace, |p| p.reference_rad_s),
                    ),
                    (
                        "speed_rad_s".to_owned(),
                        &of(&figure.trace, |p| p.speed_rad_s),
                    ),
                    ("estimated_tm_s".to_owned(), &figure.estimate_s),
                    ("proportional_v_s_per_rad".to_owned(), &figure.proportional),
                ],
            ),
        )],
    }
}

pub(super) fn figure_6(figure: &Figure6) -> Section {
    let over: Vec<f64> = figure
        .adapted(1)
        .map(|row| row.fixed.overshoot_of_reference_percent)
        .collect();
    let row = |row: &SteppedBy| {
        let both = |show: &dyn Fn(&Step) -> String| [show(&row.fixed), show(&row.adaptive)];
        let [fixed_over, adaptive_over] = both(&|step| fixed(step.response.overshoot_percent, 1));
        let [fixed_settling, adaptive_settling] = both(&|step| seconds(step.response.settling_s));
        let [fixed_iae, adaptive_iae] =
            both(&|step| significant(step.response.absolute_error_rad, 3));
        let [fixed_effort, adaptive_effort] = both(&|step| significant(step.effort_v, 3));
        cells([
            row.mechanical_s.to_string(),
            row.step.to_string(),
            fixed_over,
            adaptive_over,
            fixed_settling,
            adaptive_settling,
            fixed(row.allowed_settling_s, 3),
            fixed_iae,
            adaptive_iae,
            fixed_effort,
            adaptive_effort,
            fixed(row.estimate_s, 3),
        ])
    };
    Section {
        heading: format!("Figure 6: TM 0.2, 0.05, 1 s with and without adaptation, beta = {}", figure.forgetting),
        paragraphs: vec![format!(
            "Overshoot counts from the speed at the instant of the step: a loop that swings does not begin at the old reference. Of the reference's own step the fixed regulator overshoots by {} to {} % at TM = 0.05 s. It does not settle there.",
            fixed(over.iter().copied().fold(f64::INFINITY, f64::min), 0),
            fixed(over.iter().copied().fold(0.0, f64::max), 0)
        ), format!(
            "Both regulators are tuned for TM = 0.2 s at T = {:.0} ms with {:.0} ms of delay. TM jumps together with a step of the reference: this first step is run with the old gains, and it is what tells the new inertia. A constant reference would tell nothing; there the estimate stands still. The settling time that an adapted step may take is 1.3 times the acceleration at the current limit and five small time constants.",
            1e3 * figure.period_s,
            1e3 * figure.delay_s
        )],
        pictures: vec![Picture {
            name: "figure-6",
            svg: figure_6_plot(figure).svg("speed with fixed and with adaptive gains while TM jumps"),
            caption: "Upper panel: fixed gains. Middle: adaptive. Lower: the shaft's TM and the one that is estimated, where the estimate is settled. The start from standstill is cut off.".to_owned(),
        }],
        tables: vec![(
            "Every step: with fixed gains / with adaptation.".to_owned(),
            named(
                "figure-6",
                vec![
                    "TM, s", "step", "overshoot fixed, %", "adaptive, %", "settling fixed, s",
                    "adaptive, s", "allowed, s", "IAE fixed, rad", "adaptive, rad",
                    "effort fixed, V", "adaptive, V", "TM estimated, s",
                ],
                figure.steps.iter().map(row).collect(),
            ),
        )],
        data: vec![("figure-6-series.csv".to_owned(), figure_6_series(figure))],
    }
}

fn figure_6_plot(figure: &Figure6) -> PanelPlot {
    let t = times(&figure.fixed);
    let speed = |title: &str, trace| {
        Panel::new(title, "rad/s")
            .with(Series::sampled(
                "reference",
                Style::Command,
                &t,
                &of(trace, |p| p.reference_rad_s),
            ))
            .with(Series::sampled(
                "speed",
                Style::After,
                &t,
                &inside(&of(trace, |p| p.speed_rad_s), FRAME_RAD_S),
            ))
    };
    let mechanical = Panel::new("TM", "s")
        .with_height(110.0)
        .with(Series::sampled(
            "shaft",
            Style::Command,
            &t,
            &figure.mechanical_s,
        ))
        .with(Series::sampled(
            "estimated",
            Style::After,
            &t,
            &figure.estimate_s,
        ));
    PanelPlot::default()
        .with(speed("without adaptation: speed", &figure.fixed))
        .with(speed("with adaptation: speed", &figure.adaptive))
        .with(mechanical)
}

fn figure_6_series(figure: &Figure6) -> String {
    let columns = [
        ("reference_rad_s", of(&figure.fixed, |p| p.reference_rad_s)),
        ("speed_fixed_rad_s", of(&figure.fixed, |p| p.speed_rad_s)),
        (
            "speed_adaptive_rad_s",
            of(&figure.adaptive, |p| p.speed_rad_s),
        ),
        ("output_fixed_v", of(&figure.fixed, |p| p.output_v)),
        ("output_adaptive_v", of(&figure.adaptive, |p| p.output_v)),
        ("tm_s", figure.mechanical_s.clone()),
        ("tm_estimated_s", figure.estimate_s.clone()),
        (
            "proportional_fixed_v_s_per_rad",
            figure.proportional[0].clone(),
        ),
        (
            "proportional_adaptive_v_s_per_rad",
            figure.proportional[1].clone(),
        ),
    ];
    let columns: Vec<(String, &[f64])> = columns
        .iter()
        .map(|(name, values)| ((*name).to_owned(), &values[..]))
        .collect();
    csv("time_s", &times(&figure.fixed), &columns)
}
