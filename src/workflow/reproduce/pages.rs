//! The reproduction as pictures, tables and sentences.

use std::fmt::Write as _;

use super::figure_2::{self, ByParameter};
use super::schemes::NAMES;
use super::{Curve, Figure2, Figure3, Figure4, Method, NoiseModel, NoiseSweep, PaperA, RatioOf};
use super::{Sampling, Spread, Sweep, Table1, Trace};
use crate::report::number::{fixed, significant};
use crate::report::page::{Cell, Table};
use crate::report::plot::{CurveChart, CurvePanel, Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{NamedTable, Picture, Reproduction, Section};

impl PaperA {
    /// The page with its pictures and tables.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: "Paper A, computed again".to_owned(),
            subtitle: self.title.to_owned(),
            lead: ("In short".to_owned(), self.in_short()),
            sections: vec![
                Section {
                    heading: "What the paper leaves open, and what was chosen".to_owned(),
                    paragraphs: self.chosen.clone(),
                    ..Section::default()
                },
                figure_2(&self.figure_2),
                figure_3(&self.figure_3),
                figure_4(&self.figure_4),
                table_1(&self.table_1),
                sampling(&self.sampling),
                noise(&self.noise),
                Section {
                    heading: "Time per iteration".to_owned(),
                    paragraphs: vec![format!(
                        "The paper's own figures on its {}: less than {} ms for scheme 1, less than {} ms for scheme 2. Ours are measured by the benchmarks of the repository (cargo bench), not here.",
                        self.paper_iteration_time.computer,
                        self.paper_iteration_time.scheme_1_ms,
                        self.paper_iteration_time.scheme_2_ms
                    )],
                    ..Section::default()
                },
            ],
        }
    }

    fn in_short(&self) -> String {
        let error = |noise, of, method| {
            let found = self.figure_2.case(noise, of, method);
            found.map_or(f64::NAN, |case| {
                case.before.electrical_time_constant_s.error_percent
            })
        };
        let (equation, sensor) = (NoiseModel::EquationError, NoiseModel::Sensor);
        let last = self.table_1.rows.last();
        format!(
            "Figure 2 can be met with noise as equation error (S/N 10 in power: Ta {}, TM follows its doubling), not with the same noise on the speed sensor (Ta {}); instrumental variables over all samples take that bias away (Ta {}). Table 1: with the trapezoid J lies {} from the truth at N = 50 without noise, {} in the mean with it.",
            percent(error(equation, RatioOf::Power, Method::Printed)),
            percent(error(sensor, RatioOf::Power, Method::Printed)),
            percent(error(sensor, RatioOf::Power, Method::InstrumentalVariables)),
            percent(last.map_or(f64::NAN, |row| 100.0
                * (row.trapezoid.inertia_kg_m2 / self.table_1.truth.inertia_kg_m2 - 1.0))),
            percent(last.map_or(f64::NAN, |row| row.inertia_with_noise.error_percent)),
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

fn cells<const N: usize>(texts: [String; N]) -> Vec<Cell> {
    texts.into_iter().map(Cell::text).collect()
}

/// `0.221 [0.170 to 0.301]`.
fn range(spread: &Spread) -> String {
    if spread.median.is_finite() {
        let [low, median, high] =
            [spread.low, spread.median, spread.high].map(|value| significant(value, 3));
        format!("{median} [{low} to {high}]")
    } else {
        "none".to_owned()
    }
}

fn milli(value: f64) -> String {
    fixed(1e6 * value, 0)
}

// Figure 2

fn figure_2(figure: &Figure2) -> Section {
    let follow = "TM [5 % to 95 % of time and seeds]: set value 0.2 s before the jump and 0.4 s after it. `follows` counts the samples until the median over the seeds has made nine tenths of the step.";
    Section {
        heading: "Figure 2: scheme 1, beta = 0.97, TM doubled at k = 900".to_owned(),
        paragraphs: vec![
            format!(
                "T = {:.0} ms, {} samples. As an equation error the noise enters eq. (13) itself; S/N compares the speed with what that noise makes of it. As sensor noise it is added to the speed that the scheme sees; S/N compares the speed with that noise.",
                1e3 * figure.period_s,
                figure.samples
            ),
            "The printed form's own error at T/Ta = 0.2 is in the figures too: TM 10 % high at 0.2 s. The exact form does not have it. Under sensor noise both forms are biased, whatever the number of samples; the instrumental variables are not, but they are a batch: drawn over all samples since the start or the jump, of which they are told. Over a memory of 33 samples they would scatter too much to be of use.".to_owned(),
        ],
        pictures: vec![Picture {
            name: "figure-2",
            svg: figure_2_plot(figure).svg("estimates of scheme 1 over the samples, TM doubled at k = 900"),
            caption: "One seed. Upper half: noise as equation error. Lower half: the same ratio (power) as noise of the speed sensor. A line is cut where it leaves the frame or where the scheme finds no motor.".to_owned(),
        }],
        tables: vec![
            (follow.to_owned(), NamedTable { name: "figure-2-tm".to_owned(), table: figure_2_tm(figure) }),
            (
                "Median error of the others, before / after the jump; in how many of the estimates there is a motor at all.".to_owned(),
                NamedTable { name: "figure-2-others".to_owned(), table: figure_2_others(figure) },
            ),
        ],
        data: vec![("figure-2-series.csv".to_owned(), figure_2_series(figure))],
    }
}

fn figure_2_tm(figure: &Figure2) -> Table {
    let row = |case: &figure_2::Case| {
        let (before, after) = (
            case.before.mechanical_time_constant_s,
            case.after.mechanical_time_constant_s,
        );
        cells([
            case.noise.text().to_owned(),
            case.signal_to_noise.text(),
            case.method.text().to_owned(),
            range(&before),
            percent(before.error_percent),
            range(&after),
            percent(after.error_percent),
            match case.samples_to_follow {
                Some(samples) => samples.to_string(),
                None if case.method.is_batch() => "told".to_owned(),
                None => "never".to_owned(),
            },
        ])
    };
    Table {
        head: vec![
            "noise",
            "S/N",
            "method",
            "TM before, s",
            "error",
            "TM after, s",
            "error",
            "follows",
        ],
        rows: figure.cases.iter().map(row).collect(),
    }
}

fn figure_2_others(figure: &Figure2) -> Table {
    let row = |case: &figure_2::Case| {
        let both = |of: &dyn Fn(&ByParameter<Spread>) -> Spread,
                    show: &dyn Fn(Spread) -> String| {
            format!("{} / {}", show(of(&case.before)), show(of(&case.after)))
        };
        let error = |spread: Spread| percent(spread.error_percent);
        cells([
            case.noise.text().to_owned(),
            case.signal_to_noise.text(),
            case.method.text().to_owned(),
            both(&|all| all.electrical_time_constant_s, &error),
            both(&|all| all.back_emf_v_s_per_rad, &error),
            both(&|all| all.inertia_kg_m2, &error),
            both(&|all| all.load_torque_n_m, &error),
            both(&|all| all.mechanical_time_constant_s, &|spread| {
                format!("{} %", fixed(spread.told_percent, 0))
            }),
        ])
    };
    Table {
        head: vec!["noise", "S/N", "method", "Ta", "Ke", "J", "Mc", "told"],
        rows: figure.cases.iter().map(row).collect(),
    }
}

/// The samples as the axis of a picture.
fn samples(count: usize) -> Vec<f64> {
    (0..count).map(|k| k as f64).collect()
}

/// Values inside the frame; the line is cut elsewhere.
fn inside(values: &[f64], low: f64, high: f64) -> Vec<f64> {
    let keep = |value: &f64| {
        if (low..=high).contains(value) {
            *value
        } else {
            f64::NAN
        }
    };
    values.iter().map(keep).collect()
}

fn figure_2_plot(figure: &Figure2) -> PanelPlot {
    use NoiseModel::{EquationError, Sensor};
    use RatioOf::{Amplitude, Power};
    type Pick = for<'a> fn(&'a ByParameter<Trace>) -> &'a Trace;
    let k = samples(figure.samples);
    let tm: Pick = |all| &all.mechanical_time_constant_s;
    let ta: Pick = |all| &all.electrical_time_constant_s;
    let ke: Pick = |all| &all.back_emf_v_s_per_rad;
    let mc: Pick = |all| &all.load_torque_n_m;
    let set = &figure.set;
    let under_equation_error = [
        (
            "S/N 10 of power",
            Style::Before,
            EquationError,
            Power,
            Method::Printed,
        ),
        (
            "S/N 10 of amplitude",
            Style::After,
            EquationError,
            Amplitude,
            Method::Printed,
        ),
    ];
    let under_sensor_noise = [
        (
            "instrumental variables",
            Style::Measured,
            Sensor,
            Power,
            Method::InstrumentalVariables,
        ),
        ("printed", Style::Before, Sensor, Power, Method::Printed),
        ("exact", Style::After, Sensor, Power, Method::Exact),
    ];
    let panel = |title: &str,
                 unit: &str,
                 truth: &[f64],
                 pick: Pick,
                 low: f64,
                 high: f64,
                 lines: &[(&str, Style, NoiseModel, RatioOf, Method)]| {
        let mut panel = Panel::new(title, unit).with_height(130.0);
        for (label, style, noise, of, method) in lines {
            if let Some(case) = figure.case(*noise, *of, *method) {
                let shown = inside(&pick(&case.trace).0, low, high);
                panel = panel.with(Series::sampled(*label, *style, &k, &shown));
            }
        }
        panel.with(Series::sampled("set value", Style::Command, &k, truth))
    };
    PanelPlot::default()
        .with_axis("sample k", "")
        .with(panel(
            "equation error: TM",
            "s",
            &set.mechanical_time_constant_s,
            tm,
            0.0,
            1.0,
            &under_equation_error,
        ))
        .with(panel(
            "equation error: Ta",
            "s",
            &set.electrical_time_constant_s,
            ta,
            0.0,
            0.2,
            &under_equation_error,
        ))
        .with(panel(
            "equation error: Ke",
            "V.s/rad",
            &set.back_emf_v_s_per_rad,
            ke,
            0.0,
            0.8,
            &under_equation_error,
        ))
        .with(panel(
            "equation error: Mc",
            "N.m",
            &set.load_torque_n_m,
            mc,
            -10.0,
            10.0,
            &under_equation_error,
        ))
        .with(panel(
            "sensor noise: TM",
            "s",
            &set.mechanical_time_constant_s,
            tm,
            0.0,
            1.0,
            &under_sensor_noise,
        ))
        .with(panel(
            "sensor noise: Ta",
            "s",
            &set.electrical_time_constant_s,
            ta,
            0.0,
            0.2,
            &under_sensor_noise,
        ))
}

fn figure_2_series(figure: &Figure2) -> String {
    let mut columns: Vec<(String, &[f64])> = vec![
        (
            "set_tm_s".to_owned(),
            &figure.set.mechanical_time_constant_s,
        ),
        (
            "set_ta_s".to_owned(),
            &figure.set.electrical_time_constant_s,
        ),
    ];
    for case in &figure.cases {
        let of = match case.signal_to_noise.of {
            RatioOf::Power => "power",
            RatioOf::Amplitude => "amplitude",
        };
        let noise = case.noise.text().replace(' ', "_");
        let method = case.method.name();
        for (name, trace) in [
            ("tm_s", &case.trace.mechanical_time_constant_s),
            ("ta_s", &case.trace.electrical_time_constant_s),
            ("back_emf_v_s_per_rad", &case.trace.back_emf_v_s_per_rad),
            ("inertia_kg_m2", &case.trace.inertia_kg_m2),
            ("load_torque_n_m", &case.trace.load_torque_n_m),
        ] {
            columns.push((format!("{name}/{noise}/{of}/{method}"), &trace.0));
        }
    }
    csv("k", &samples(figure.samples), &columns)
}

/// Columns beside an axis; what is not there is an empty cell.
fn csv(axis: &str, at: &[f64], columns: &[(String, &[f64])]) -> String {
    let mut out = axis.to_owned();
    for (name, _) in columns {
        let _ = write!(out, ",{name}");
    }
    for (row, at) in at.iter().enumerate() {
        let _ = write!(out, "\n{at}");
        for (_, values) in columns {
            out.push(',');
            if let Some(value) = values.get(row).filter(|value| value.is_finite()) {
                let _ = write!(out, "{value}");
            }
        }
    }
    out.push('\n');
    out
}

// Figure 3

fn figure_3(figure: &Figure3) -> Section {
    let k = samples(figure.samples);
    let truth = |value: f64| vec![value; figure.samples];
    let panel = |title: &str, unit: &str, set: f64, lines: [(&str, Style, &Trace); 2]| {
        let mut panel = Panel::new(title, unit).with_height(140.0);
        for (label, style, trace) in lines {
            panel = panel.with(Series::sampled(
                label,
                style,
                &k,
                &inside(&trace.0, 0.75 * set, 1.25 * set),
            ));
        }
        panel.with(Series::sampled(
            "set value",
            Style::Command,
            &k,
            &truth(set),
        ))
    };
    // Amplitude and power as printed; rectangle and trapezoid on the same sensor noise.
    let mut plot = PanelPlot::default().with_axis("sample k", "");
    if let [amplitude, power, _, rectangle, trapezoid, ..] = figure.cases.as_slice() {
        let (j, mc) = (figure.inertia_kg_m2, figure.load_torque_n_m);
        let ratios = ["S/N 15 of power", "S/N 15 of amplitude"];
        let forms = ["rectangle (printed)", "trapezoid"];
        plot = plot
            .with(panel(
                "equation error: J",
                "kg.m2",
                j,
                [
                    (ratios[0], Style::Before, &power.inertia_trace),
                    (ratios[1], Style::After, &amplitude.inertia_trace),
                ],
            ))
            .with(panel(
                "equation error: Mc",
                "N.m",
                mc,
                [
                    (ratios[0], Style::Before, &power.load_torque_trace),
                    (ratios[1], Style::After, &amplitude.load_torque_trace),
                ],
            ))
            .with(panel(
                "sensor noise: J",
                "kg.m2",
                j,
                [
                    (forms[0], Style::Before, &rectangle.inertia_trace),
                    (forms[1], Style::After, &trapezoid.inertia_trace),
                ],
            ))
            .with(panel(
                "sensor noise: Mc",
                "N.m",
                mc,
                [
                    (forms[0], Style::Before, &rectangle.load_torque_trace),
                    (forms[1], Style::After, &trapezoid.load_torque_trace),
                ],
            ));
    }
    let rows = figure.cases.iter().map(|case| {
        cells([
            case.noise.text().to_owned(),
            case.signal_to_noise.text(),
            case.of_signal.to_owned(),
            case.integral.to_owned(),
            range(&case.inertia_kg_m2),
            percent(case.inertia_kg_m2.error_percent),
            range(&case.load_torque_n_m),
            percent(case.load_torque_n_m.error_percent),
        ])
    });
    let table = Table {
        head: vec![
            "noise",
            "S/N",
            "S/N compares",
            "integral of i",
            "J, kg.m2",
            "error",
            "Mc, N.m",
            "error",
        ],
        rows: rows.collect(),
    };
    let mut columns: Vec<(String, &[f64])> = Vec::new();
    for (index, case) in figure.cases.iter().enumerate() {
        columns.push((format!("inertia_kg_m2/{index}"), &case.inertia_trace.0));
        columns.push((
            format!("load_torque_n_m/{index}"),
            &case.load_torque_trace.0,
        ));
    }
    Section {
        heading: "Figure 3: scheme 2, beta = 0.98".to_owned(),
        paragraphs: vec![format!(
            "T = {:.0} ms; set values J = {} kg.m2, Mc = {} N.m. Scheme 2 has the current in its regressor and not the speed, so noise of the speed sensor scatters it without bias; noise of the current sensor would bias it. Its own error here is the rectangle's: the current moves within a period.",
            1e3 * figure.period_s,
            significant(figure.inertia_kg_m2, 4),
            significant(figure.load_torque_n_m, 3)
        )],
        pictures: vec![Picture {
            name: "figure-3",
            svg: plot.svg("estimates of scheme 2 over the samples"),
            caption: "One seed. Equation error: as printed (rectangle). Sensor noise: S/N 15 of power on the speed, the current exact.".to_owned(),
        }],
        tables: vec![(
            format!("Median [5 % to 95 %] over the samples from k = {} on and {} seeds.", figure.settled_from, figure.seeds),
            NamedTable { name: "figure-3".to_owned(), table },
        )],
        data: vec![("figure-3-series.csv".to_owned(), csv("k", &k, &columns))],
    }
}

// Figure 4 and Table 1

fn figure_4(figure: &Figure4) -> Section {
    let panel = |title: &str, unit: &str, fine: &[f64], sampled: &[f64]| {
        Panel::new(title, unit)
            .with(Series::sampled(
                "motor",
                Style::Measured,
                &figure.fine.time_s,
                fine,
            ))
            .with(Series::sampled(
                "samples",
                Style::Before,
                &figure.time_s,
                sampled,
            ))
    };
    let plot = PanelPlot::default()
        .with(panel(
            "current",
            "A",
            &figure.fine.current_a,
            &figure.current_a,
        ))
        .with(panel(
            "speed",
            "rad/s",
            &figure.fine.speed_rad_s,
            &figure.speed_rad_s,
        ));
    let columns = [
        ("current_a".to_owned(), figure.current_a.as_slice()),
        ("speed_rad_s".to_owned(), figure.speed_rad_s.as_slice()),
    ];
    Section {
        heading: "Figure 4: the transient, emulated".to_owned(),
        paragraphs: vec![format!(
            "{} from rest at {:.0} V, sampled every {:.0} ms; noise of the sensors {} rad/s and {} A (standard deviations).",
            figure.motor,
            figure.voltage_v,
            1e3 * figure.period_s,
            figure.speed_noise_rad_s,
            figure.current_noise_a
        )],
        pictures: vec![Picture {
            name: "figure-4",
            svg: plot.svg("current and speed of the start"),
            caption: "The paper's Figure 4 is a measured curve without numbers; this is the start that takes its place.".to_owned(),
        }],
        tables: Vec::new(),
        data: vec![("figure-4-series.csv".to_owned(), csv("time_s", &figure.time_s, &columns))],
    }
}

fn table_1(table: &Table1) -> Section {
    let truth = table.truth;
    let error = |value: f64| percent(100.0 * (value / truth.inertia_kg_m2 - 1.0));
    let rows = table.rows.iter().map(|row| {
        let (j, mc) = (row.inertia_with_noise, row.load_torque_with_noise);
        cells([
            row.n.to_string(),
            milli(row.paper.inertia_kg_m2),
            fixed(row.paper.load_torque_n_m, 4),
            format!(
                "{} ({})",
                milli(row.rectangle.inertia_kg_m2),
                error(row.rectangle.inertia_kg_m2)
            ),
            format!(
                "{} ({})",
                milli(row.trapezoid.inertia_kg_m2),
                error(row.trapezoid.inertia_kg_m2)
            ),
            fixed(row.trapezoid.load_torque_n_m, 4),
            format!(
                "{} ± {} ({})",
                milli(j.mean),
                milli(j.std),
                percent(j.error_percent)
            ),
            format!("{} %", fixed(j.coverage_percent, 0)),
            if mc.told_percent < 50.0 {
                format!("told by {} %", fixed(mc.told_percent, 0))
            } else {
                format!("{} ± {}", fixed(mc.mean, 3), fixed(mc.std, 3))
            },
        ])
    });
    let by_n = Table {
        head: vec![
            "N",
            "paper J",
            "paper Mc",
            "rectangle J",
            "trapezoid J",
            "trapezoid Mc",
            "with noise J",
            "95 % covers",
            "with noise Mc",
        ],
        rows: rows.collect(),
    };
    let rows = table.by_period.iter().map(|row| {
        let j = row.inertia_with_noise;
        cells([
            format!("{} ms", significant(1e3 * row.period_s, 2)),
            significant(row.period_s / table.electrical_time_constant_s, 2),
            row.n.to_string(),
            error(row.rectangle.inertia_kg_m2),
            error(row.trapezoid.inertia_kg_m2),
            percent(j.error_percent),
            format!("{} %", significant(100.0 * j.std / truth.inertia_kg_m2, 2)),
            format!("{} %", fixed(j.coverage_percent, 0)),
        ])
    });
    let by_period = Table {
        head: vec![
            "T",
            "T/Ta",
            "N",
            "rectangle",
            "trapezoid",
            "mean with noise",
            "spread",
            "95 % covers",
        ],
        rows: rows.collect(),
    };
    Section {
        heading: "Table 1: scheme 2 after N samples".to_owned(),
        paragraphs: vec![
            format!(
                "J in 1e-6 kg.m2, Mc in N.m. The paper's columns come from its measured transient, ours from the emulated one, whose truth is J = {} and Mc = {}; the paper's catalogue says J = {}, and its settled values lie 6 % above that. T = {:.0} ms = {} Ta, beta = {}, Ke known.",
                milli(truth.inertia_kg_m2),
                fixed(truth.load_torque_n_m, 3),
                milli(table.catalogue_inertia_kg_m2),
                1e3 * table.period_s,
                significant(table.period_s / table.electrical_time_constant_s, 2),
                table.forgetting
            ),
            format!(
                "The left rectangle is what the paper prints. While the current still rises it makes J too large, at T = 1 ms by {} after 20 samples: the sign and about the size of the paper's excess over the catalogue.",
                error(table.by_period.first().map_or(f64::NAN, |row| row.rectangle.inertia_kg_m2))
            ),
        ],
        tables: vec![
            (
                format!("Rectangle and trapezoid without noise; with noise: trapezoid, mean and standard deviation over {} seeds, error of the mean, and how many of the 95 % intervals of J hold the truth.", table.seeds),
                NamedTable { name: "table-1".to_owned(), table: by_n },
            ),
            (
                "Error of J by the period. Sampled fast, twenty samples end before the current has peaked and the noise weighs more; sampled at half of Ta, the trapezoid's own half per cent is larger than the noise, which is all that the interval knows.".to_owned(),
                NamedTable { name: "table-1-by-period".to_owned(), table: by_period },
            ),
        ],
        ..Section::default()
    }
}

// What the paper does not show

/// Which errors are drawn and tabled: Ta, TM, Ke, J (Mc is in the JSON).
const SHOWN: [usize; 4] = [0, 1, 2, 3];

fn sampling(sampling: &Sampling) -> Section {
    let mut section = Section {
        heading: "Not in the paper: how slowly each scheme may sample".to_owned(),
        paragraphs: vec!["Noise-free. One motor is sampled with ever longer periods; schemes 1 know the resistance, schemes 2 the torque constant, the others nothing. A dash: not given by this scheme, or not carried by the data.".to_owned()],
        ..Section::default()
    };
    for (sweep, name) in sampling.sweeps.iter().zip(["sampling-ta", "sampling-tm"]) {
        section.pictures.push(Picture {
            name,
            svg: chart(sweep.against, &sweep.ratios, &sweep.curves, (-4, 3)).svg("errors of each scheme against the period"),
            caption: format!(
                "Size of the error against {}; TM/Ta = {}, Ta = {} ms. Below 1e-4 % it is drawn at the lower edge.",
                sweep.against,
                sweep.tm_over_ta,
                significant(1e3 * sweep.electrical_time_constant_s, 2)
            ),
        });
        for which in SHOWN {
            section.tables.push((
                format!(
                    "Error of {} against {} at TM/Ta = {}.",
                    NAMES[which], sweep.against, sweep.tm_over_ta
                ),
                NamedTable {
                    name: format!("{name}-{}", NAMES[which].to_lowercase()),
                    table: errors_table(sweep.against, &ratios(sweep), &sweep.curves, which),
                },
            ));
        }
    }
    let rows = sampling.at_ta.iter().map(|row| {
        let [ta, tm, ke, ..] = row.printed.to_array();
        let largest = row
            .exact
            .to_array()
            .into_iter()
            .map(|error| error.map_or(f64::NAN, f64::abs));
        let show = |error: Option<f64>| percent(error.unwrap_or(f64::NAN));
        cells([
            row.tm_over_ta.to_string(),
            show(ta),
            show(tm),
            show(ke),
            format!("{:.0e} %", largest.fold(0.0, f64::max)),
        ])
    });
    section.tables.push((
        "Scheme 1 at T = Ta: the printed form, and the largest error of any parameter of the exact one.".to_owned(),
        NamedTable {
            name: "scheme-1-at-ta".to_owned(),
            table: Table {
                head: vec!["TM/Ta", "printed Ta", "printed TM", "printed Ke", "exact"],
                rows: rows.collect(),
            },
        },
    ));
    section
}

fn ratios(sweep: &Sweep) -> Vec<String> {
    sweep
        .ratios
        .iter()
        .map(|ratio| format!("{ratio}"))
        .collect()
}

fn noise(sweep: &NoiseSweep) -> Section {
    let labels: Vec<String> = sweep
        .signal_to_noise
        .iter()
        .map(|ratio| format!("{ratio:e}"))
        .collect();
    let tables = SHOWN.map(|which| {
        (
            format!("Error of {} against S/N (power).", NAMES[which]),
            NamedTable {
                name: format!("noise-{}", NAMES[which].to_lowercase()),
                table: errors_table("S/N", &labels, &sweep.curves, which),
            },
        )
    });
    let long = sweep.long.curves.iter().map(|curve| {
        let errors = curve.errors.first().copied().unwrap_or_default().to_array();
        let shown = errors.map(|error| error.map_or_else(|| "-".to_owned(), percent));
        std::iter::once(Cell::text(label(curve.scheme)))
            .chain(shown.map(Cell::text))
            .collect()
    });
    let long = (
        format!(
            "Schemes 1 on {} samples at S/N {} (power), median of {} seeds: more samples do not mend the bias of least squares. A dash: fewer than half of the seeds give a motor at all.",
            sweep.long.samples, sweep.long.signal_to_noise, sweep.long.seeds
        ),
        NamedTable {
            name: "noise-long-record".to_owned(),
            table: Table {
                head: std::iter::once("scheme").chain(NAMES).collect(),
                rows: long.collect(),
            },
        },
    );
    Section {
        heading: "Not in the paper: error against signal-to-noise".to_owned(),
        paragraphs: vec![format!(
            "White noise on the sensors of speed and current, S/N of power. Ta = {} s, TM = {} s, T = {:.0} ms, {} samples, median of {} seeds, no forgetting beyond each scheme's own.",
            sweep.electrical_time_constant_s,
            sweep.mechanical_time_constant_s,
            1e3 * sweep.period_s,
            sweep.samples,
            sweep.seeds
        )],
        pictures: vec![Picture {
            name: "noise",
            svg: chart(
                "S/N of power",
                &sweep.signal_to_noise,
                &sweep.curves,
                (-3, 3),
            )
            .svg("errors of each scheme against signal-to-noise"),
            caption: "Size of the median error against the signal-to-noise ratio of the sensors."
                .to_owned(),
        }],
        tables: tables.into_iter().chain([long]).collect(),
        data: Vec::new(),
    }
}

fn chart(axis: &str, at: &[f64], curves: &[Curve], decades: (i32, i32)) -> CurveChart {
    let panels = SHOWN.map(|which| CurvePanel {
        title: format!("{}: size of the error, %", NAMES[which]),
        curves: curves
            .iter()
            .map(|curve| {
                let errors = curve.errors.iter().map(|errors| errors.to_array()[which]);
                at.iter()
                    .zip(errors)
                    .map(|(at, error)| (*at, error.map_or(f64::NAN, f64::abs)))
                    .collect()
            })
            .collect(),
    });
    CurveChart {
        axis: axis.to_owned(),
        labels: curves.iter().map(|curve| label(curve.scheme)).collect(),
        panels: panels.into(),
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

/// One row to a ratio, one column to a scheme that gives this parameter at all.
fn errors_table(against: &'static str, ratios: &[String], curves: &[Curve], which: usize) -> Table {
    let giving: Vec<&Curve> = curves
        .iter()
        .filter(|curve| {
            curve
                .errors
                .iter()
                .any(|errors| errors.to_array()[which].is_some())
        })
        .collect();
    let rows = ratios.iter().enumerate().map(|(row, ratio)| {
        let errors = giving.iter().map(|curve| {
            let error = curve.errors[row].to_array()[which];
            Cell::text(error.map_or_else(|| "-".to_owned(), percent))
        });
        std::iter::once(Cell::text(ratio)).chain(errors).collect()
    });
    Table {
        head: std::iter::once(against)
            .chain(giving.iter().map(|curve| curve.scheme))
            .collect(),
        rows: rows.collect(),
    }
}
