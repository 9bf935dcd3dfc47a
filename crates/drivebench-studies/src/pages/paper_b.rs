//! Paper B: its figures, its design (where the iterations stop, what Q/R does, what K3 and mu do), and what it does not show
//! (variance by kind of noise, speed from Hall edges, the back-EMF that it leaves out).

use drivebench::control::TrialPoint;
use drivebench::report::plot::{Panel, Style};
use serde_json::{Value, json};

use super::{
    COMPARISON, OUTPUT, Quantity, REFERENCE, SPEED, TIME, compared, of, speed_panel, trials,
};
use crate::PaperB;
use crate::charts::{CurveChart, CurvePanel};
use crate::page::{Figure, FiguresAndTables, Findings, csv, with};
use crate::paper_b::{BackEmf, Design, Disturbance, Figure4, Figure5};

impl PaperB {
    pub fn report(&self) -> Result<FiguresAndTables, String> {
        let shown = self.hall.shown.iter().map(|run| (&run.name[..], &run.trace[..]));
        let lines: [(&str, Style, Quantity); 3] = [
            ("reference", Style::Command, REFERENCE),
            ("measured", Style::Before, |point| point.measured_rad_s),
            ("true", Style::After, SPEED),
        ];
        let [open, closed] = back_emf_series(&self.back_emf);
        let (convergence, changes) = convergence(&self.design);
        Findings::new(self, with(self.more(), compared(&self.comparison)))
            .figure("figure-4", "speed and error to a polyline reference with and without compensation", &figure_4_series(&self.figure_4))
            .figure("figure-5", "speed and voltage while a load comes on and goes off", &figure_5_series(&self.figure_5))
            .picture("convergence", convergence)
            .series("convergence", changes)
            .figure("hall", "speed from Hall edges and true speed over the polyline", &trials(shown, 120.0, &lines))
            .figure("back-emf", "speed under a constant voltage with and without back-EMF", &open)
            .figure("back-emf-closed", "closed loop over the motor with back-EMF: bare, with compensation, with the back-EMF fed forward", &closed)
            .on(&[include_str!("../layouts/paper_b.md"), COMPARISON])
    }

    fn more(&self) -> Value {
        let variance = |of| self.noise.of(of).map(|found| found.speed_variance);
        let loads = self.figure_5.courses.iter().flat_map(|course| {
            let changes = [("applied", course.applied), ("removed", course.removed)];
            changes.map(|(load, change)| {
                let about = json!({"load": load, "share_of_k3": course.share_of_k3, "effort_v": course.effort_v});
                with(change, about)
            })
        });
        let radii = &self.design.radii;
        let by_share = radii.shares.iter().zip(&radii.damping).zip(&radii.radius);
        let by_share = by_share.map(|((share, damping), radius)| {
            json!({"share": share, "damping": damping, "radius": radius})
        });
        let ways = ["true speed", "Hall edges", "Hall edges, slower design"];
        let observed = self.hall.speeds.iter().flat_map(|at| {
            [0, 1, 2].map(|way: usize| {
                json!({
                    "speed_rad_s": at.speed_rad_s, "interval_periods": at.interval_periods, "name": ways[way],
                    "std_rad_s": at.std_rad_s[way], "mean_error_rad_s": at.mean_error_rad_s[way], "effort_v": at.effort_v[way],
                })
            })
        });
        json!({
            "stop": self.design.stops.iter().find(|stop| stop.tolerance < 1e-5),
            "sensor": variance(Disturbance::Sensor),
            "load": variance(Disturbance::Load),
            "loads": loads.collect::<Vec<_>>(),
            "by_share": by_share.collect::<Vec<_>>(),
            "observed": observed.collect::<Vec<_>>(),
        })
    }
}

type Traces<'a> = [&'a [TrialPoint]; 3];

/// The same quantity without compensation and with it, in a panel of their own or behind what is in the latest one.
fn both(figure: Figure, [without, with, _]: Traces<'_>, quantity: Quantity) -> Figure {
    figure.line("without compensation", Style::Before, &of(without, quantity)).line(
        "with",
        Style::After,
        &of(with, quantity),
    )
}

fn columns(figure: Figure, [without, with, printed]: Traces<'_>) -> Figure {
    figure
        .column("speed_printed_k3_rad_s", &of(printed, SPEED))
        .column("output_printed_k3_v", &of(printed, OUTPUT))
        .column("speed_without_rad_s", &of(without, SPEED))
        .column("speed_with_rad_s", &of(with, SPEED))
        .column("output_without_v", &of(without, OUTPUT))
        .column("output_with_v", &of(with, OUTPUT))
}

fn figure_4_series(figure: &Figure4) -> Figure {
    let traces = figure.courses.each_ref().map(|course| &course.trace[..]);
    let reference = of(traces[0], REFERENCE);
    let series = Figure::over_time(of(traces[0], TIME))
        .panel(speed_panel("(a) speed", 220.0))
        .series("reference_rad_s", "reference", Style::Command, &reference);
    let series = both(series, traces, SPEED).panel(speed_panel("(b) error", 180.0));
    let off: Quantity = |point| point.reference_rad_s - point.speed_rad_s;
    let series = both(series, traces, off)
        .panel(speed_panel("(c) error with K3 as printed", 140.0))
        .line("K3 as printed", Style::Measured, &of(traces[2], off))
        .line("usable share", Style::After, &of(traces[1], off));
    columns(series, traces)
}

fn figure_5_series(figure: &Figure5) -> Figure {
    let traces = figure.courses.each_ref().map(|course| {
        let begin = course.trace.partition_point(|point| point.time_s < 0.6);
        &course.trace[begin..]
    });
    let series = Figure::over_time(of(traces[0], TIME)).panel(speed_panel("speed", 200.0)).line(
        "reference",
        Style::Command,
        &of(traces[0], REFERENCE),
    );
    let voltage = Panel::new("voltage", "V").with_height(110.0);
    let series = both(both(series, traces, SPEED).panel(voltage), traces, OUTPUT)
        .panel(speed_panel("speed with K3 as printed", 140.0))
        .line("K3 as printed", Style::Measured, &of(traces[2], SPEED))
        .line("usable share", Style::After, &of(traces[1], SPEED));
    columns(series, traces)
}

/// How both gains converge: picture and series.
fn convergence(design: &Design) -> (String, String) {
    let changes = [&design.filter_changes, &design.feedback_changes];
    let most = changes.map(Vec::len).into_iter().fold(0, usize::max);
    let iterations: Vec<f64> = (1..=most).map(|n| n as f64).collect();
    let curve = |changes: &Vec<f64>| {
        let points = iterations.iter().copied().zip(changes.iter().copied());
        points.collect()
    };
    let panel = CurvePanel {
        title: "relative change of the gain".to_owned(),
        curves: changes.map(curve).into(),
    };
    let labels = ["K (Kalman filter)", "gamma (feedback)"];
    let chart = CurveChart {
        axis: "iteration".to_owned(),
        labels: labels.map(str::to_owned).into(),
        panels: vec![panel],
        decades: (-9, 0),
    };
    let [filter, feedback] = changes.map(Vec::clone);
    let columns = [("filter_change", filter), ("feedback_change", feedback)];
    (
        chart.svg("relative change of both gains over the iterations"),
        csv("iteration", &iterations, &columns),
    )
}

/// Open loop, and closed over the motor with its back-EMF.
fn back_emf_series(found: &BackEmf) -> [Figure; 2] {
    let drawn = |title: String, runs: &[(&str, Style, &Vec<TrialPoint>)]| {
        let first = runs.first().map_or(&[][..], |(_, _, trace)| trace);
        let figure = Figure::over_time(of(first, TIME)).panel(speed_panel(title, 150.0));
        runs.iter().fold(figure, |figure, (name, style, trace)| {
            figure.line(name, *style, &of(trace, SPEED))
        })
    };
    let runs = found.open.iter().zip([Style::Before, Style::After]);
    let runs = runs.map(|(run, style)| (&run.name[..], style, &run.trace));
    let title = format!("open loop at {} V: speed", found.open_voltage_v);
    let open = drawn(title, &runs.collect::<Vec<_>>());
    let lines = [
        ("without compensation", Style::Before),
        ("with", Style::After),
        ("fed forward", Style::Measured),
    ];
    let on_motor = found.closed.iter().filter(|row| row.full_motor).zip(lines);
    let on_motor = on_motor.map(|(row, (name, style))| (name, style, &row.trace));
    let title = "closed over the motor with back-EMF: speed".to_owned();
    [open, drawn(title, &on_motor.collect::<Vec<_>>())]
}
