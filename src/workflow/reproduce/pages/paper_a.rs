//! Paper A on the page: identification (Figures 2 to 4, Table 1, errors against period and noise) and adaptive control
//! (Figures 5 to 7).

use super::{
    OUTPUT, REFERENCE, SPEED, TIME, choices, comparison, of, or_dash, seconds, speed_panel, trials,
    yes,
};
use crate::report::plot::{CurveChart, CurvePanel, Panel, Style};
use crate::report::reproduce::{Figure, Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::adaptive::{
    Figure5, Figure6, Figure7, MECHANICAL_S, Saturated, Slower, SteppedBy,
};
use crate::workflow::reproduce::figure_2::{self, Case, KE, MC, TA, TM};
use crate::workflow::reproduce::loops::{Kind, Step};
use crate::workflow::reproduce::{
    Curve, Errors, Figure2, Figure3, Figure4, Method, NAMES, NoiseModel, NoiseSweep, PaperA,
    RatioOf, Sampling, Spread, Table1,
};

/// Speeds that Figures 5 and 6 show: without the start.
const FRAME_RAD_S: std::ops::RangeInclusive<f64> = 70.0..=130.0;
/// Which errors are drawn and tabled: Ta, TM, Ke, J (Mc is in the JSON).
const SHOWN: [usize; 4] = [0, 1, 2, 3];

impl PaperA {
    /// The page with its pictures and tables.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: "Paper A, computed again".to_owned(),
            subtitle: self.title.to_owned(),
            lead: (
                "In short".to_owned(),
                format!("{} {}", self.identification(), self.adaptation()),
            ),
            sections: vec![
                choices(&self.chosen),
                figure_2(&self.figure_2),
                figure_3(&self.figure_3),
                figure_4(&self.figure_4),
                table_1(&self.table_1),
                sampling(&self.sampling),
                noise(&self.noise),
                figure_5(&self.adaptive.figure_5),
                figure_6(&self.adaptive.figure_6),
                saturation(&self.adaptive.figure_7),
                adaptation(&self.adaptive.figure_7),
                comparison(&self.adaptive.comparison),
                Section::new("Time per iteration").say(format!(
                    "The paper's own figures on its {}: less than {} ms for scheme 1, less than {} ms for scheme 2. Ours are measured by the benchmarks of the repository (cargo bench, in benches/), not here.",
                    self.paper_iteration_time.computer,
                    self.paper_iteration_time.scheme_1_ms,
                    self.paper_iteration_time.scheme_2_ms
                )),
            ],
        }
    }

    fn identification(&self) -> String {
        let error = |noise, of, method| {
            let found = self.figure_2.case(noise, of, method);
            let error = |case: &Case| case.before[TA].error_percent;
            percent(found.map_or(f64::NAN, error))
        };
        let (equation, sensor) = (NoiseModel::EquationError, NoiseModel::Sensor);
        let (last, truth) = (self.table_1.rows.last(), self.table_1.truth.inertia_kg_m2);
        format!(
            "Figure 2 can be met with noise as equation error (S/N 10 in power: Ta {}, TM follows its doubling), not with the same noise on the speed sensor (Ta {}); instrumental variables over all samples take that bias away (Ta {}). Table 1: with the trapezoid J lies {} from the truth at N = 50 without noise, {} in the mean with it.",
            error(equation, RatioOf::Power, Method::Printed),
            error(sensor, RatioOf::Power, Method::Printed),
            error(sensor, RatioOf::Power, Method::InstrumentalVariables),
            off(
                last.map_or(f64::NAN, |row| row.trapezoid.inertia_kg_m2),
                truth
            ),
            percent(last.map_or(f64::NAN, |row| row.inertia_with_noise.error_percent)),
        )
    }

    fn adaptation(&self) -> String {
        let (figure_6, figure_7) = (&self.adaptive.figure_6, &self.adaptive.figure_7);
        let overshoots = figure_6
            .adapted(1)
            .map(|row| row.fixed.response.overshoot_percent);
        let [least, most] = span(overshoots);
        let adapted = figure_6.adapted(1).chain(figure_6.adapted(2));
        let [_, adapted] = span(adapted.map(|row| row.adaptive.response.overshoot_percent));
        let error = |kind| {
            let run = figure_7.saturated_of(kind);
            fixed(run.map_or(f64::NAN, Saturated::end_error_rad_s), 1)
        };
        format!(
            "Figure 6: at TM = {} s the fixed PI overshoots by {} to {} %, the adaptive one by at most {} % from the second step after a jump. {} In saturation MRAC ends with an error of {} rad/s where it stays connected, {} rad/s where it is disconnected, ADDC with {} rad/s.",
            MECHANICAL_S[1],
            fixed(least, 0),
            fixed(most, 0),
            fixed(adapted, 1),
            verdict(figure_7),
            error(Kind::MracConnected),
            error(Kind::MracDisconnected),
            error(Kind::Addc),
        )
    }
}

/// A signed error in per cent with as many digits as are of interest.
fn percent(value: f64) -> String {
    let decimals = match value.abs() {
        size if size.is_nan() => return "-".to_owned(),
        size if size >= 1000.0 => {
            let (sign, than) = if value > 0.0 { ("+", '>') } else { ("-", '<') };
            return format!("{than} {sign}1000 %");
        }
        size if size >= 20.0 => 0,
        size if size >= 0.095 => 1,
        size if size >= 0.000_95 => 3,
        _ => return "< 0.001 %".to_owned(),
    };
    let sign = if value > 0.0 { "+" } else { "" };
    format!("{sign}{} %", fixed(value, decimals))
}

/// How far a value lies from its truth.
fn off(value: f64, truth: f64) -> String {
    percent(100.0 * (value / truth - 1.0))
}

/// Least, and largest above zero.
fn span(values: impl Iterator<Item = f64>) -> [f64; 2] {
    values.fold([f64::INFINITY, 0.0], |[least, most], value| {
        [least.min(value), most.max(value)]
    })
}

/// `0.221 [0.170 to 0.301]`.
fn range(spread: &Spread) -> String {
    if !spread.median.is_finite() {
        return "none".to_owned();
    }
    let values = [spread.median, spread.low, spread.high];
    let [median, low, high] = values.map(|value| significant(value, 3));
    format!("{median} [{low} to {high}]")
}

fn milli(value: f64) -> String {
    fixed(1e6 * value, 0)
}

fn figure_2(figure: &Figure2) -> Section {
    let both = |case: &Case, which: usize, show: fn(Spread) -> String| {
        format!("{} / {}", show(case.before[which]), show(case.after[which]))
    };
    let error = |spread: Spread| percent(spread.error_percent);
    Section::new("Figure 2: scheme 1, beta = 0.97, TM doubled at k = 900")
        .say(format!(
            "T = {:.0} ms, {} samples. As an equation error the noise enters eq. (13) itself; S/N compares the speed with what that noise makes of it. As sensor noise it is added to the speed that the scheme sees; S/N compares the speed with that noise.",
            1e3 * figure.period_s, figure.samples
        ))
        .say("The printed form's own error at T/Ta = 0.2 is in the figures too: TM 10 % high at 0.2 s. The exact form does not have it. Under sensor noise both forms are biased, whatever the number of samples; the instrumental variables are not, but they are a batch: drawn over all samples since the start or the jump, of which they are told. Over a memory of 33 samples they would scatter too much to be of use.")
        .figure(
            "figure-2",
            "estimates of scheme 1 over the samples, TM doubled at k = 900",
            "One seed. Upper half: noise as equation error. Lower half: the same ratio (power) as noise of the speed sensor. A line is cut where it leaves the frame or where the scheme finds no motor.",
            &figure_2_series(figure),
        )
        .table(
            "figure-2-tm",
            "TM [5 % to 95 % of time and seeds]: set value 0.2 s before the jump and 0.4 s after it. `follows` counts the samples until the median over the seeds has made nine tenths of the step.",
            &figure.cases,
            &[
                ("noise", &|case| case.noise.text().to_owned()),
                ("S/N", &|case| case.signal_to_noise.text()),
                ("method", &|case| case.method.text().to_owned()),
                ("TM before, s", &|case| range(&case.before[TM])),
                ("error", &|case| error(case.before[TM])),
                ("TM after, s", &|case| range(&case.after[TM])),
                ("error", &|case| error(case.after[TM])),
                ("follows", &|case| match case.samples_to_follow {
                    Some(samples) => samples.to_string(),
                    None if case.method.is_batch() => "told".to_owned(),
                    None => "never".to_owned(),
                }),
            ],
        )
        .table(
            "figure-2-others",
            "Median error of the others, before / after the jump; in how many of the estimates there is a motor at all.",
            &figure.cases,
            &[
                ("noise", &|case| case.noise.text().to_owned()),
                ("S/N", &|case| case.signal_to_noise.text()),
                ("method", &|case| case.method.text().to_owned()),
                ("Ta", &|case| both(case, TA, error)),
                ("Ke", &|case| both(case, KE, error)),
                ("J", &|case| both(case, figure_2::J, error)),
                ("Mc", &|case| both(case, MC, error)),
                ("told", &|case| both(case, TM, |spread| format!("{} %", fixed(spread.told_percent, 0)))),
            ],
        )
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
        (
            "instrumental variables",
            Measured,
            Power,
            InstrumentalVariables,
        ),
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
    for (noise, lines, shown) in [
        (EquationError, equation_error, &shown[..]),
        (Sensor, sensor_noise, &shown[..2]),
    ] {
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
    drawn = drawn
        .column("set_tm_s", &figure.set[TM])
        .column("set_ta_s", &figure.set[TA]);
    for case in &figure.cases {
        let (of, method) = (case.signal_to_noise.of.name(), case.method.name());
        let noise = case.noise.text().replace(' ', "_");
        for (name, trace) in figure_2::COLUMNS.iter().zip(&case.trace.0) {
            drawn = drawn.column(format!("{name}/{noise}/{of}/{method}"), &trace.0);
        }
    }
    drawn
}

fn figure_3(figure: &Figure3) -> Section {
    Section::new("Figure 3: scheme 2, beta = 0.98")
        .say(format!(
            "T = {:.0} ms; set values J = {} kg.m2, Mc = {} N.m. Scheme 2 has the current in its regressor and not the speed, so noise of the speed sensor scatters it without bias; noise of the current sensor would bias it. Its own error here is the rectangle's: the current moves within a period.",
            1e3 * figure.period_s,
            significant(figure.inertia_kg_m2, 4),
            significant(figure.load_torque_n_m, 3)
        ))
        .figure(
            "figure-3",
            "estimates of scheme 2 over the samples",
            "One seed. Equation error: as printed (rectangle). Sensor noise: S/N 15 of power on the speed, the current exact.",
            &figure_3_series(figure),
        )
        .table(
            "figure-3",
            format!("Median [5 % to 95 %] over the samples from k = {} on and {} seeds.", figure.settled_from, figure.seeds),
            &figure.cases,
            &[
                ("noise", &|case| case.noise.text().to_owned()),
                ("S/N", &|case| case.signal_to_noise.text()),
                ("S/N compares", &|case| case.of_signal.to_owned()),
                ("integral of i", &|case| case.integral.to_owned()),
                ("J, kg.m2", &|case| range(&case.inertia_kg_m2)),
                ("error", &|case| percent(case.inertia_kg_m2.error_percent)),
                ("Mc, N.m", &|case| range(&case.load_torque_n_m)),
                ("error", &|case| percent(case.load_torque_n_m.error_percent)),
            ],
        )
}

/// Amplitude and power as printed; rectangle and trapezoid on the same sensor noise.
fn figure_3_series(figure: &Figure3) -> Figure {
    let mut drawn = Figure::over_samples(figure.samples);
    if let [amplitude, power, _, rectangle, trapezoid, ..] = &figure.cases[..] {
        let (ratios, forms) = (
            ["S/N 15 of power", "S/N 15 of amplitude"],
            ["rectangle (printed)", "trapezoid"],
        );
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

fn figure_4(figure: &Figure4) -> Section {
    let fine = |title: &str, unit: &str, motor: &[f64]| {
        Panel::new(title, unit).sampled("motor", Style::Measured, &figure.fine.time_s, motor)
    };
    let series = Figure::over_time(figure.time_s.clone())
        .panel(fine("current", "A", &figure.fine.current_a))
        .series("current_a", "samples", Style::Before, &figure.current_a)
        .panel(fine("speed", "rad/s", &figure.fine.speed_rad_s))
        .series("speed_rad_s", "samples", Style::Before, &figure.speed_rad_s);
    Section::new("Figure 4: the transient, emulated")
        .say(format!(
            "{} from rest at {:.0} V, sampled every {:.0} ms; noise of the sensors {} rad/s and {} A (standard deviations).",
            figure.motor, figure.voltage_v, 1e3 * figure.period_s, figure.speed_noise_rad_s, figure.current_noise_a
        ))
        .figure(
            "figure-4",
            "current and speed of the start",
            "The paper's Figure 4 is a measured curve without numbers; this is the start that takes its place.",
            &series,
        )
}

fn table_1(table: &Table1) -> Section {
    let truth = table.truth;
    let error = |value: f64| off(value, truth.inertia_kg_m2);
    let with_error = |j: f64| format!("{} ({})", milli(j), error(j));
    let covers = |percent: f64| format!("{} %", fixed(percent, 0));
    let relative = |period_s: f64| significant(period_s / table.electrical_time_constant_s, 2);
    Section::new("Table 1: scheme 2 after N samples")
        .say(format!(
            "J in 1e-6 kg.m2, Mc in N.m. The paper's columns come from its measured transient, ours from the emulated one, whose truth is J = {} and Mc = {}; the paper's catalogue says J = {}, and its settled values lie 6 % above that. T = {:.0} ms = {} Ta, beta = {}, Ke known.",
            milli(truth.inertia_kg_m2),
            fixed(truth.load_torque_n_m, 3),
            milli(table.catalogue_inertia_kg_m2),
            1e3 * table.period_s,
            relative(table.period_s),
            table.forgetting
        ))
        .say(format!(
            "The left rectangle is what the paper prints. While the current still rises it makes J too large, at T = 1 ms by {} after 20 samples: the sign and about the size of the paper's excess over the catalogue.",
            error(table.by_period.first().map_or(f64::NAN, |row| row.rectangle.inertia_kg_m2))
        ))
        .table(
            "table-1",
            format!("Rectangle and trapezoid without noise; with noise: trapezoid, mean and standard deviation over {} seeds, error of the mean, and how many of the 95 % intervals of J hold the truth.", table.seeds),
            &table.rows,
            &[
                ("N", &|row| row.n.to_string()),
                ("paper J", &|row| milli(row.paper.inertia_kg_m2)),
                ("paper Mc", &|row| fixed(row.paper.load_torque_n_m, 4)),
                ("rectangle J", &|row| with_error(row.rectangle.inertia_kg_m2)),
                ("trapezoid J", &|row| with_error(row.trapezoid.inertia_kg_m2)),
                ("trapezoid Mc", &|row| fixed(row.trapezoid.load_torque_n_m, 4)),
                ("with noise J", &|row| {
                    let j = row.inertia_with_noise;
                    format!("{} ± {} ({})", milli(j.mean), milli(j.std), percent(j.error_percent))
                }),
                ("95 % covers", &|row| covers(row.inertia_with_noise.coverage_percent)),
                ("with noise Mc", &|row| match row.load_torque_with_noise {
                    mc if mc.told_percent < 50.0 => format!("told by {} %", fixed(mc.told_percent, 0)),
                    mc => format!("{} ± {}", fixed(mc.mean, 3), fixed(mc.std, 3)),
                }),
            ],
        )
        .table(
            "table-1-by-period",
            "Error of J by the period. Sampled fast, twenty samples end before the current has peaked and the noise weighs more; sampled at half of Ta, the trapezoid's own half per cent is larger than the noise; the interval has it from a second estimate on every second sample.",
            &table.by_period,
            &[
                ("T", &|row| format!("{} ms", significant(1e3 * row.period_s, 2))),
                ("T/Ta", &|row| relative(row.period_s)),
                ("N", &|row| row.n.to_string()),
                ("rectangle", &|row| error(row.rectangle.inertia_kg_m2)),
                ("trapezoid", &|row| error(row.trapezoid.inertia_kg_m2)),
                ("mean with noise", &|row| percent(row.inertia_with_noise.error_percent)),
                ("spread", &|row| {
                    format!("{} %", significant(100.0 * row.inertia_with_noise.std / truth.inertia_kg_m2, 2))
                }),
                ("95 % covers", &|row| covers(row.inertia_with_noise.coverage_percent)),
            ],
        )
}

fn sampling(sampling: &Sampling) -> Section {
    let mut section = Section::new("Not in the paper: how slowly each scheme may sample")
        .say("Noise-free. One motor is sampled with ever longer periods; schemes 1 know the resistance, schemes 2 the torque constant, the others nothing. A dash: not given by this scheme, or not carried by the data.");
    for (sweep, name) in sampling.sweeps.iter().zip(["sampling-ta", "sampling-tm"]) {
        let (against, tm_over_ta) = (sweep.against, sweep.tm_over_ta);
        let drawn = chart(against, &sweep.ratios, &sweep.curves, (-4, 3));
        section = section.picture(
            name,
            drawn.svg("errors of each scheme against the period"),
            format!(
                "Size of the error against {against}; TM/Ta = {tm_over_ta}, Ta = {} ms. Below 1e-4 % it is drawn at the lower edge.",
                significant(1e3 * sweep.electrical_time_constant_s, 2)
            ),
        );
        let ratios: Vec<String> = sweep.ratios.iter().map(f64::to_string).collect();
        section = errors_tables(
            section,
            name,
            against,
            &ratios,
            &sweep.curves,
            |parameter| format!("Error of {parameter} against {against} at TM/Ta = {tm_over_ta}."),
        );
    }
    let show = |error: Option<f64>| percent(error.unwrap_or(f64::NAN));
    section.table(
        "scheme-1-at-ta",
        "Scheme 1 at T = Ta: the printed form, and the largest error of any parameter of the exact one.",
        &sampling.at_ta,
        &[
            ("TM/Ta", &|row| row.tm_over_ta.to_string()),
            ("printed Ta", &|row| show(row.printed.0[0])),
            ("printed TM", &|row| show(row.printed.0[1])),
            ("printed Ke", &|row| show(row.printed.0[2])),
            ("exact", &|row| {
                let sizes = row.exact.0.map(|error| error.map_or(f64::NAN, f64::abs));
                format!("{:.0e} %", sizes.into_iter().fold(0.0, f64::max))
            }),
        ],
    )
}

fn noise(sweep: &NoiseSweep) -> Section {
    let axis = &sweep.signal_to_noise;
    let drawn = chart("S/N of power", axis, &sweep.curves, (-3, 3));
    let section = Section::new("Not in the paper: error against signal-to-noise")
        .say(format!(
            "White noise on the sensors of speed and current, S/N of power. Ta = {} s, TM = {} s, T = {:.0} ms, {} samples, median of {} seeds, no forgetting beyond each scheme's own.",
            sweep.electrical_time_constant_s,
            sweep.mechanical_time_constant_s,
            1e3 * sweep.period_s,
            sweep.samples,
            sweep.seeds
        ))
        .picture(
            "noise",
            drawn.svg("errors of each scheme against signal-to-noise"),
            "Size of the median error against the signal-to-noise ratio of the sensors.",
        );
    let ratios: Vec<String> = axis.iter().map(|ratio| format!("{ratio:e}")).collect();
    let sentence = |parameter: &str| format!("Error of {parameter} against S/N (power).");
    let long = sweep.long.curves.iter().map(|curve| {
        let errors = curve.errors.first().copied().unwrap_or_default();
        let errors = errors.0.map(|error| or_dash(error, percent));
        std::iter::once(label(curve.scheme)).chain(errors).collect()
    });
    errors_tables(section, "noise", "S/N", &ratios, &sweep.curves, sentence).grid(
        "noise-long-record",
        format!(
            "Schemes 1 on {} samples at S/N {} (power), median of {} seeds: more samples do not mend the bias of least squares. A dash: fewer than half of the seeds give a motor at all.",
            sweep.long.samples, sweep.long.signal_to_noise, sweep.long.seeds
        ),
        std::iter::once("scheme").chain(NAMES).collect(),
        long,
    )
}

/// Errors against a ratio, a panel for each parameter.
fn chart(axis: &str, at: &[f64], curves: &[Curve], decades: (i32, i32)) -> CurveChart {
    let panel = |which: usize| {
        let size = |errors: &Errors| errors.0[which].map_or(f64::NAN, f64::abs);
        let sizes = |curve: &Curve| {
            at.iter()
                .copied()
                .zip(curve.errors.iter().map(size))
                .collect()
        };
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

/// A table for each parameter: one row to a ratio, one column to a scheme that gives this parameter at all.
fn errors_tables(
    section: Section,
    name: &str,
    against: &'static str,
    ratios: &[String],
    curves: &[Curve],
    sentence: impl Fn(&str) -> String,
) -> Section {
    SHOWN.into_iter().fold(section, |section, which| {
        let gives = |curve: &&Curve| curve.errors.iter().any(|errors| errors.0[which].is_some());
        let giving: Vec<&Curve> = curves.iter().filter(gives).collect();
        let rows = ratios.iter().enumerate().map(|(row, ratio)| {
            let errors = giving.iter().map(|curve| curve.errors[row].0[which]);
            let errors = errors.map(|error| or_dash(error, percent));
            std::iter::once(ratio.clone()).chain(errors).collect()
        });
        let head = std::iter::once(against).chain(giving.iter().map(|curve| curve.scheme));
        let name = format!("{name}-{}", NAMES[which].to_lowercase());
        section.grid(name, sentence(NAMES[which]), head.collect(), rows)
    })
}

fn figure_5(figure: &Figure5) -> Section {
    let (reference, speed) = (of(&figure.trace, REFERENCE), of(&figure.trace, SPEED));
    let gain = &figure.proportional;
    let series = Figure::over_time(of(&figure.trace, TIME))
        .panel(speed_panel("speed", 150.0).within(FRAME_RAD_S))
        .series("reference_rad_s", "reference", Style::Command, &reference)
        .series("speed_rad_s", "speed", Style::After, &speed)
        .column("estimated_tm_s", &figure.estimate_s)
        .panel(Panel::new("proportional gain", "V per rad/s").with_height(90.0))
        .series("proportional_v_s_per_rad", "Kp", Style::After, gain);
    let before = figure.before.iter().map(|step| ("no", step));
    let after = figure.after.iter().map(|step| ("yes", step));
    Section::new("Figure 5: the adaptation joins")
        .say(format!(
            "Chosen by us, the text has no data: the regulator is tuned for TM = {} s, the shaft has {} s; at {} s the adaptation joins without a bump. It is told nothing of the shaft: the first step that it sees tells it.",
            figure.tuned_for_s, figure.mechanical_s, figure.joins_at_s
        ))
        .figure(
            "figure-5",
            "speed and gain; the adaptation joins in the middle",
            format!("Fixed gains until {} s, adaptive from there on; the start from standstill is cut off.", figure.joins_at_s),
            &series,
        )
        .table(
            "figure-5",
            "Every step of the reference but the start.",
            before.chain(after),
            &[
                ("at, s", &|(_, step)| fixed(step.at_s, 0)),
                ("adaptive", &|(adapts, _)| (*adapts).to_owned()),
                ("overshoot, %", &|(_, step)| fixed(step.response.overshoot_percent, 1)),
                ("settling, s", &|(_, step)| seconds(step.response.settling_s)),
                ("IAE, rad", &|(_, step)| significant(step.response.absolute_error_rad, 3)),
                ("effort, V", &|(_, step)| significant(step.effort_v, 3)),
            ],
        )
}

fn figure_6(figure: &Figure6) -> Section {
    let overshoots = figure
        .adapted(1)
        .map(|row| row.fixed.overshoot_of_reference_percent);
    let [least, most] = span(overshoots);
    let overshoot = |step: &Step| fixed(step.response.overshoot_percent, 1);
    let settling = |step: &Step| seconds(step.response.settling_s);
    let iae = |step: &Step| significant(step.response.absolute_error_rad, 3);
    let effort = |step: &Step| significant(step.effort_v, 3);
    Section::new(format!("Figure 6: TM 0.2, 0.05, 1 s with and without adaptation, beta = {}", figure.forgetting))
        .say(format!(
            "Overshoot counts from the speed at the instant of the step: a loop that swings does not begin at the old reference. Of the reference's own step the fixed regulator overshoots by {} to {} % at TM = 0.05 s. It does not settle there.",
            fixed(least, 0), fixed(most, 0)
        ))
        .say(format!(
            "Both regulators are tuned for TM = 0.2 s at T = {:.0} ms with {:.0} ms of delay. TM jumps together with a step of the reference: this first step is run with the old gains, and it is what tells the new inertia. A constant reference would tell nothing; there the estimate stands still. The settling time that an adapted step may take is 1.3 times the acceleration at the current limit and five small time constants.",
            1e3 * figure.period_s, 1e3 * figure.delay_s
        ))
        .figure(
            "figure-6",
            "speed with fixed and with adaptive gains while TM jumps",
            "Upper panel: fixed gains. Middle: adaptive. Lower: the shaft's TM and the one that is estimated, where the estimate is settled. The start from standstill is cut off.",
            &figure_6_series(figure),
        )
        .table(
            "figure-6",
            "Every step: with fixed gains / with adaptation.",
            &figure.steps,
            &[
                ("TM, s", &|row: &&SteppedBy| row.mechanical_s.to_string()),
                ("step", &|row| row.step.to_string()),
                ("overshoot fixed, %", &|row| overshoot(&row.fixed)),
                ("adaptive, %", &|row| overshoot(&row.adaptive)),
                ("settling fixed, s", &|row| settling(&row.fixed)),
                ("adaptive, s", &|row| settling(&row.adaptive)),
                ("allowed, s", &|row| fixed(row.allowed_settling_s, 3)),
                ("IAE fixed, rad", &|row| iae(&row.fixed)),
                ("adaptive, rad", &|row| iae(&row.adaptive)),
                ("effort fixed, V", &|row| effort(&row.fixed)),
                ("adaptive, V", &|row| effort(&row.adaptive)),
                ("TM estimated, s", &|row| fixed(row.estimate_s, 3)),
            ],
        )
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
        "That ADDC adapts more slowly than MRAC, as the paper says, is {sentence}: of {} jumps of TM that saturate nobody, ADDC {}; with an estimate that only forgets, as the paper's, it {}.",
        slower.jumps,
        counts(slower),
        counts(forgetting)
    )
}

const SPEEDS: [(&str, Style, super::Quantity); 2] = [
    ("reference", Style::Command, REFERENCE),
    ("speed", Style::After, SPEED),
];

/// The half of Figure 7 that is in saturation.
fn saturation(figure: &Figure7) -> Section {
    let runs = figure.saturated.iter();
    let runs = runs.map(|run| (run.controller.name(), &run.trace[..]));
    let cycles = figure.saturated.first().map_or(0, |run| run.cycles.len());
    let cycle = |which: usize, n: &usize| figure.saturated[which].cycles[*n];
    let error = |which, n: &usize| fixed(cycle(which, n).error_rad_s, 2);
    let limited = |which, n: &usize| fixed(cycle(which, n).limited_percent, 0);
    Section::new("Figure 7: ADDC and MRAC in saturation")
        .say(format!(
            "Figure 7 of the paper is a block diagram. Its text says that MRAC takes wrong action in saturation, because its reference model is linear, and must be disconnected there, and that ADDC goes on working. Start and brake between standstill and {} rad/s at a current limit of 10 A. MRAC: `u = kr r - kw w - ki i + k1` with proportional-integral adaptation (Landau) against a reference model of second order.",
            figure.full_rad_s
        ))
        .figure(
            "figure-7-saturation",
            "start and brake with ADDC, with MRAC disconnected in saturation and with MRAC always connected",
            "The connected MRAC takes the limit for a wrong gain.",
            &trials(runs, 110.0, &SPEEDS),
        )
        .table(
            "figure-7-saturation",
            "Root mean square error over the last 2 s of each start and brake; share of its cycles in a limit.",
            0..cycles,
            &[
                ("cycle", &|n| (n + 1).to_string()),
                ("to, rad/s", &|n| fixed(cycle(0, n).to_rad_s, 0)),
                ("error: addc, rad/s", &|n| error(0, n)),
                ("mrac disconnected", &|n| error(1, n)),
                ("mrac connected", &|n| error(2, n)),
                ("limited: addc, %", &|n| limited(0, n)),
                ("mrac disconnected", &|n| limited(1, n)),
                ("mrac connected", &|n| limited(2, n)),
            ],
        )
}

/// The half of Figure 7 that stays out of saturation.
fn adaptation(figure: &Figure7) -> Section {
    let shown = figure.shown.iter();
    let shown = shown.map(|run| (&run.name[..], &run.trace[..]));
    Section::new("Figure 7: who adapts sooner")
        .say(verdict(figure))
        .say("TM jumps from 0.2 s together with a step of the reference, and each rival is held against itself: the same regulator made for the new TM, on a shaft that always had it. Error: integral of the absolute error over the first step after the jump, over the height of the step; `adapted error`: that of the regulator that was told. Strays: integral of the absolute difference of the two speeds over the height, of the first step and of the last (the twelfth). Back after: from then on the two speeds are within 10 % of the height. Only cases in which nobody was limited compare the adaptation alone. `addc` drops its memory when its predictions miss; `forgetting alone` is the paper's way, beta and nothing else.")
        .say("Where the inertia falls, MRAC has the smaller first step, as the paper says and for its reason: its gains answer the first error, while ADDC makes this step with gains that are too high until the estimate is believed; with an estimate that only forgets that takes longest. But once it is believed ADDC is adapted, in less than half a step, while MRAC moves its gains in proportion to the error between model and shaft: in steps this small it has not adapted when the twelve steps are over. Where the inertia rises, ADDC is the sooner one by every measure: old gains are only too slow there, and the shaft tells its inertia all the while. Larger steps adapt MRAC within some of them (the rows in which a limit was met); under noise its gains may drift instead.")
        .figure(
            "figure-7-adaptation",
            "ADDC, ADDC by forgetting alone and MRAC over a jump of TM, unsaturated",
            format!("TM falls to 0.05 s in the middle of what is shown, at the third step; height {} rad/s, without noise.", figure.shown_height_rad_s),
            &trials(shown, 150.0, &SPEEDS),
        )
        .table(
            "figure-7-adaptation",
            "Jumps from TM = 0.2 s.",
            &figure.adaptation,
            &[
                ("TM after, s", &|found| found.mechanical_s.to_string()),
                ("height, rad/s", &|found| fixed(found.height_rad_s, 0)),
                ("noise", &|found| yes(found.noise)),
                ("controller", &|found| found.controller.name().to_owned()),
                ("error, s", &|found| significant(found.error_s, 3)),
                ("adapted error, s", &|found| significant(found.adapted_error_s, 3)),
                ("strays first, s", &|found| significant(found.first_deviation_s, 3)),
                ("strays last, s", &|found| significant(found.last_deviation_s, 3)),
                ("back after, s", &|found| seconds(found.adapted_after_s)),
                ("limited, %", &|found| fixed(found.limited_percent, 0)),
            ],
        )
}
