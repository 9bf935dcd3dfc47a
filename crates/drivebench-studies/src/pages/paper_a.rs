//! Paper A: identification (Figures 2 to 4, Table 1, errors against period and noise) and adaptive control (Figures 5 to 7).

use drivebench::report::plot::{Panel, Style};
use drivebench::text::number::fixed;
use serde_json::{Value, json};

use super::{
    COMPARISON, OUTPUT, Quantity, REFERENCE, SPEED, TIME, compared, of, speed_panel, trials,
};
use crate::adaptive::{AdaptiveLoop, Figure5, Figure6, Figure7, MECHANICAL_S, Saturated, Slower};
use crate::charts::{CurveChart, CurvePanel};
use crate::figure_2::{self, KE, MC, TA, TM};
use crate::loops::Kind;
use crate::page::{Figure, FiguresAndTables, Findings, percent, with};
use crate::{Curve, Errors, Figure2, Figure3, Figure4, Method, NAMES, NoiseModel, PaperA, RatioOf};

/// Speeds that Figures 5 and 6 show: without the start.
const FRAME_RAD_S: std::ops::RangeInclusive<f64> = 70.0..=130.0;
/// Which errors are drawn and tabled: Ta, TM, Ke, J (Mc is in the JSON).
const SHOWN: [usize; 4] = [0, 1, 2, 3];
const LAYOUTS: [&str; 3] = [
    include_str!("../layouts/paper_a.md"),
    COMPARISON,
    include_str!("../layouts/iteration_time.md"),
];

impl PaperA {
    pub fn report(&self) -> Result<FiguresAndTables, String> {
        let identification = with(self, self.identification());
        let adaptation = with(adaptation(&self.adaptive), compared(&self.adaptive.comparison));
        let (saturated, shown) = (&self.adaptive.figure_7.saturated, &self.adaptive.figure_7.shown);
        let saturated = saturated.iter().map(|run| (run.controller.name(), &run.trace[..]));
        let shown = shown.iter().map(|run| (&run.name[..], &run.trace[..]));
        let mut findings = Findings::new(&identification, adaptation);
        for (name, description, figure) in [
            (
                "figure-2",
                "estimates of scheme 1 over the samples, TM doubled at k = 900",
                figure_2_series(&self.figure_2),
            ),
            ("figure-3", "estimates of scheme 2 over the samples", figure_3_series(&self.figure_3)),
            ("figure-4", "current and speed of the start", figure_4_series(&self.figure_4)),
            (
                "figure-5",
                "speed and gain; the adaptation joins in the middle",
                figure_5_series(&self.adaptive.figure_5),
            ),
            (
                "figure-6",
                "speed with fixed and with adaptive gains while TM jumps",
                figure_6_series(&self.adaptive.figure_6),
            ),
            (
                "figure-7-saturation",
                "start and brake with ADDC, with MRAC disconnected in saturation and with MRAC always connected",
                trials(saturated, 110.0, &SPEEDS),
            ),
            (
                "figure-7-adaptation",
                "ADDC, ADDC by forgetting alone and MRAC over a jump of TM, unsaturated",
                trials(shown, 150.0, &SPEEDS),
            ),
        ] {
            findings = findings.figure(name, description, &figure);
        }
        for (sweep, name) in self.sampling.sweeps.iter().zip(["sampling-ta", "sampling-tm"]) {
            let drawn = chart(sweep.against, &sweep.ratios, &sweep.curves, (-4, 3));
            let ratios: Vec<String> = sweep.ratios.iter().map(f64::to_string).collect();
            findings = errors_grids(findings, name, sweep.against, &ratios, &sweep.curves)
                .picture(name, drawn.svg("errors of each scheme against the period"));
        }
        let noise = &self.noise;
        let drawn = chart("S/N of power", &noise.signal_to_noise, &noise.curves, (-3, 3));
        let ratios: Vec<String> =
            noise.signal_to_noise.iter().map(|ratio| format!("{ratio:e}")).collect();
        let long = noise.long.curves.iter().map(|curve| {
            let errors = curve.errors.first().copied().unwrap_or_default();
            std::iter::once(label(curve.scheme)).chain(errors.0.map(or_dash)).collect()
        });
        errors_grids(findings, "noise", "S/N", &ratios, &noise.curves)
            .picture("noise", drawn.svg("errors of each scheme against signal-to-noise"))
            .grid((
                "noise-long-record",
                std::iter::once("scheme").chain(NAMES).collect(),
                long.collect(),
            ))
            .on(&LAYOUTS)
    }

    /// What the layout needs of Figure 2, Table 1 and the sweep in addition to their JSON.
    fn identification(&self) -> Value {
        let error = |noise, method| {
            let case = self.figure_2.case(noise, RatioOf::Power, method);
            case.map(|case| case.before[TA].error_percent)
        };
        let (equation, sensor) = (NoiseModel::EquationError, NoiseModel::Sensor);
        let cases = self.figure_2.cases.iter().map(|case| {
            let follows = match case.samples_to_follow {
                Some(samples) => samples.to_string(),
                None if case.method.is_batch() => "told".to_owned(),
                None => "never".to_owned(),
            };
            with(case, json!({"follows": follows}))
        });
        let rows = self.table_1.rows.iter().map(|row| {
            let mc = row.load_torque_with_noise;
            let mc = match mc.told_percent {
                few if few < 50.0 => format!("told by {} %", fixed(few, 0)),
                _ => format!("{} ± {}", fixed(mc.mean, 3), fixed(mc.std, 3)),
            };
            with(row, json!({"mc": mc}))
        });
        let at_ta = self.sampling.at_ta.iter().map(|row| {
            let sizes = row.exact.0.map(|error| error.map_or(f64::NAN, f64::abs));
            with(row, json!({"largest": sizes.into_iter().fold(0.0, f64::max)}))
        });
        json!({
            "ta_error": [
                error(equation, Method::Printed),
                error(sensor, Method::Printed),
                error(sensor, Method::InstrumentalVariables),
            ],
            "last": self.table_1.rows.last(),
            "cases": cases.collect::<Vec<_>>(),
            "rows": rows.collect::<Vec<_>>(),
            "at_ta": at_ta.collect::<Vec<_>>(),
        })
    }
}

/// What the layout needs of Figures 5 to 7 in addition to their JSON.
fn adaptation(found: &AdaptiveLoop) -> Value {
    let (figure_5, figure_6, figure_7) = (&found.figure_5, &found.figure_6, &found.figure_7);
    let [least, most] = span(figure_6.adapted(1).map(|row| row.fixed.response.overshoot_percent));
    let adapted = figure_6.adapted(1).chain(figure_6.adapted(2));
    let [_, adapted] = span(adapted.map(|row| row.adaptive.response.overshoot_percent));
    let before = figure_5.before.iter().map(|step| (false, step));
    let joined = before.chain(figure_5.after.iter().map(|step| (true, step)));
    let joined = joined.map(|(adapts, step)| with(step, json!({"adapts": adapts})));
    let cycles = figure_7.saturated.first().map_or(0, |run| run.cycles.len());
    let cycles = (0..cycles).map(|n| {
        let by = figure_7.saturated.iter().map(|run| run.cycles[n]);
        json!({"cycle": n + 1, "by": by.collect::<Vec<_>>()})
    });
    let saturated = [Kind::Addc, Kind::MracDisconnected, Kind::MracConnected]
        .map(|kind| figure_7.saturated.iter().find(|run| run.controller == kind))
        .map(|run| run.map(Saturated::end_error_rad_s));
    json!({
        "tm_s": MECHANICAL_S[1],
        "overshoot": [least, most, adapted],
        "of_reference": span(figure_6.adapted(1).map(|row| row.fixed.overshoot_of_reference_percent)),
        "who_is_sooner": verdict(figure_7),
        "saturated": saturated,
        "joined": joined.collect::<Vec<_>>(),
        "cycles": cycles.collect::<Vec<_>>(),
    })
}

/// Least, and largest above zero.
fn span(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, 0.0], |[least, most], value| [least.min(value), most.max(value)])
}

fn or_dash(error: Option<f64>) -> String {
    percent(error.unwrap_or(f64::NAN))
}

fn figure_2_series(figure: &Figure2) -> Figure {
    use Method::{Exact, InstrumentalVariables, Printed};
    use NoiseModel::{EquationError, Sensor};
    use RatioOf::{Amplitude, Power};
    use Style::{After, Before, Command, Measured};
    // Label, style and the case that the line shows.
    let equation_error: &[_] = &[
        ("S/N 10 of power", Before, Power, Printed),
        ("S/N 10 of amplitude", After, Amplitude, Printed),
    ];
    let sensor_noise: &[_] = &[
        ("instrumental variables", Measured, Power, InstrumentalVariables),
        ("printed", Before, Power, Printed),
        ("exact", After, Power, Exact),
    ];
    // Each parameter with the range of its frame.
    let shown = [
        (TM, "TM", "s", 0.0..=1.0),
        (TA, "Ta", "s", 0.0..=0.2),
        (KE, "Ke", "V.s/rad", 0.0..=0.8),
        (MC, "Mc", "N.m", -10.0..=10.0),
    ];
    let mut drawn = Figure::over_samples(figure.samples);
    for (noise, lines, shown) in
        [(EquationError, equation_error, &shown[..]), (Sensor, sensor_noise, &shown[..2])]
    {
        for (which, name, unit, frame) in shown {
            let panel = Panel::new(format!("{}: {name}", noise.text()), *unit);
            drawn = drawn.panel(panel.with_height(130.0).within(frame.clone()));
            for &(label, style, of, method) in lines {
                if let Some(case) = figure.case(noise, of, method) {
                    drawn = drawn.line(label, style, &case.trace[*which].0);
                }
            }
            drawn = drawn.line("set value", Command, &figure.set[*which]);
        }
    }
    drawn = drawn.column("set_tm_s", &figure.set[TM]).column("set_ta_s", &figure.set[TA]);
    for case in &figure.cases {
        let (of, method) = (case.signal_to_noise.of.name(), case.method.name());
        let noise = case.noise.text().replace(' ', "_");
        for (name, trace) in figure_2::COLUMNS.iter().zip(&case.trace.0) {
            drawn = drawn.column(format!("{name}/{noise}/{of}/{method}"), &trace.0);
        }
    }
    drawn
}

/// Amplitude and power as printed; rectangle and trapezoid on the same sensor noise.
fn figure_3_series(figure: &Figure3) -> Figure {
    let mut drawn = Figure::over_samples(figure.samples);
    if let [amplitude, power, _, rectangle, trapezoid, ..] = &figure.cases[..] {
        let (ratios, forms) =
            (["S/N 15 of power", "S/N 15 of amplitude"], ["rectangle (printed)", "trapezoid"]);
        for (noise, labels, cases) in [
            ("equation error", ratios, [power, amplitude]),
            ("sensor noise", forms, [rectangle, trapezoid]),
        ] {
            let inertia = cases.map(|case| &case.inertia_trace.0);
            let load = cases.map(|case| &case.load_torque_trace.0);
            for (name, unit, set, traces) in [
                ("J", "kg.m2", figure.inertia_kg_m2, inertia),
                ("Mc", "N.m", figure.load_torque_n_m, load),
            ] {
                let panel = Panel::new(format!("{noise}: {name}"), unit).with_height(140.0);
                drawn = drawn
                    .panel(panel.within(0.75 * set..=1.25 * set))
                    .line(labels[0], Style::Before, traces[0])
                    .line(labels[1], Style::After, traces[1])
                    .line("set value", Style::Command, &vec![set; figure.samples]);
            }
        }
    }
    for (n, case) in figure.cases.iter().enumerate() {
        drawn = drawn
            .column(format!("inertia_kg_m2/{n}"), &case.inertia_trace.0)
            .column(format!("load_torque_n_m/{n}"), &case.load_torque_trace.0);
    }
    drawn
}

fn figure_4_series(figure: &Figure4) -> Figure {
    let fine = |title: &str, unit: &str, motor: &[f64]| {
        Panel::new(title, unit).sampled("motor", Style::Measured, &figure.fine.time_s, motor)
    };
    Figure::over_time(figure.time_s.clone())
        .panel(fine("current", "A", &figure.fine.current_a))
        .series("current_a", "samples", Style::Before, &figure.current_a)
        .panel(fine("speed", "rad/s", &figure.fine.speed_rad_s))
        .series("speed_rad_s", "samples", Style::Before, &figure.speed_rad_s)
}

/// Errors against a ratio, a panel for each parameter.
fn chart(axis: &str, at: &[f64], curves: &[Curve], decades: (i32, i32)) -> CurveChart {
    let panel = |which: usize| {
        let size = |errors: &Errors| errors.0[which].map_or(f64::NAN, f64::abs);
        let sizes = |curve: &Curve| at.iter().copied().zip(curve.errors.iter().map(size)).collect();
        CurvePanel {
            title: format!("{}: size of the error, %", NAMES[which]),
            curves: curves.iter().map(sizes).collect(),
        }
    };
    CurveChart {
        axis: axis.to_owned(),
        labels: curves.iter().map(|curve| label(curve.scheme)).collect(),
        panels: SHOWN.map(panel).into(),
        decades,
    }
}

/// `scheme 1-iv`, but `output-error`.
fn label(scheme: &str) -> String {
    if scheme.starts_with(|first: char| first.is_ascii_digit()) {
        format!("scheme {scheme}")
    } else {
        scheme.to_owned()
    }
}

/// A grid for each parameter: one row to a ratio, one column to a scheme that gives this parameter at all.
fn errors_grids(
    findings: Findings,
    name: &str,
    against: &'static str,
    ratios: &[String],
    curves: &[Curve],
) -> Findings {
    SHOWN.into_iter().fold(findings, |findings, which| {
        let gives = |curve: &&Curve| curve.errors.iter().any(|errors| errors.0[which].is_some());
        let giving: Vec<&Curve> = curves.iter().filter(gives).collect();
        let rows = ratios.iter().enumerate().map(|(row, ratio)| {
            let errors = giving.iter().map(|curve| or_dash(curve.errors[row].0[which]));
            std::iter::once(ratio.clone()).chain(errors).collect()
        });
        let head = std::iter::once(against).chain(giving.iter().map(|curve| curve.scheme));
        let name = format!("{name}-{}", NAMES[which].to_lowercase());
        findings.grid((name, head.collect(), rows.collect()))
    })
}

fn figure_5_series(figure: &Figure5) -> Figure {
    let (reference, speed) = (of(&figure.trace, REFERENCE), of(&figure.trace, SPEED));
    Figure::over_time(of(&figure.trace, TIME))
        .panel(speed_panel("speed", 150.0).within(FRAME_RAD_S))
        .series("reference_rad_s", "reference", Style::Command, &reference)
        .series("speed_rad_s", "speed", Style::After, &speed)
        .column("estimated_tm_s", &figure.estimate_s)
        .panel(Panel::new("proportional gain", "V per rad/s").with_height(90.0))
        .series("proportional_v_s_per_rad", "Kp", Style::After, &figure.proportional)
}

fn figure_6_series(figure: &Figure6) -> Figure {
    use Style::{After, Command};
    let both = [&figure.fixed, &figure.adaptive];
    let [reference, held] = both.map(|trace| of(trace, REFERENCE));
    let [fixed, adaptive] = both.map(|trace| of(trace, SPEED));
    let [output_fixed, output_adaptive] = both.map(|trace| of(trace, OUTPUT));
    let estimate = &figure.estimate_s;
    let speed = |name: &str| speed_panel(format!("{name}: speed"), 150.0).within(FRAME_RAD_S);
    Figure::over_time(of(both[0], TIME))
        .panel(speed("without adaptation"))
        .series("reference_rad_s", "reference", Command, &reference)
        .series("speed_fixed_rad_s", "speed", After, &fixed)
        .panel(speed("with adaptation"))
        .line("reference", Command, &held)
        .series("speed_adaptive_rad_s", "speed", After, &adaptive)
        .column("output_fixed_v", &output_fixed)
        .column("output_adaptive_v", &output_adaptive)
        .panel(Panel::new("TM", "s").with_height(110.0))
        .series("tm_s", "shaft", Command, &figure.mechanical_s)
        .series("tm_estimated_s", "estimated", After, estimate)
        .column("proportional_fixed_v_s_per_rad", &figure.proportional[0])
        .column("proportional_adaptive_v_s_per_rad", &figure.proportional[1])
}

const SPEEDS: [(&str, Style, Quantity); 2] =
    [("reference", Style::Command, REFERENCE), ("speed", Style::After, SPEED)];

/// Who adapts sooner, as measured.
fn verdict(figure: &Figure7) -> String {
    let [slower, forgetting] = figure.addc_slower;
    let sentence = match slower.by_first_step {
        0 => "not confirmed here",
        all if all == slower.jumps => "confirmed",
        _ => "confirmed in a part of the cases",
    };
    let counts = |slower: Slower| {
        format!(
            "has the larger error over the first step after the jump in {}, is further from where an adapted regulator would have the shaft in {}, and comes back there later in {}",
            slower.by_first_step, slower.by_straying, slower.by_end
        )
    };
    format!(
        "That ADDC adapts more slowly than MRAC, as the paper says, is {sentence}: of {} jumps of TM without saturation, ADDC {}; with an estimate that only forgets, as the paper's, it {}.",
        slower.jumps,
        counts(slower),
        counts(forgetting)
    )
}
