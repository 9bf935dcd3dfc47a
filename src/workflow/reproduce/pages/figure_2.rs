//! Figure 2 on the page.

use super::{cells, csv, inside, percent, range, samples};
use crate::report::page::Table;
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{NamedTable, Picture, Section};
use crate::text::number::fixed;
use crate::workflow::reproduce::figure_2::{ByParameter, Case, Figure2, Method};
use crate::workflow::reproduce::{NoiseModel, RatioOf, Spread, Trace};

pub(super) fn section(figure: &Figure2) -> Section {
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
            svg: plot(figure).svg("estimates of scheme 1 over the samples, TM doubled at k = 900"),
            caption: "One seed. Upper half: noise as equation error. Lower half: the same ratio (power) as noise of the speed sensor. A line is cut where it leaves the frame or where the scheme finds no motor.".to_owned(),
        }],
        tables: vec![
            (follow.to_owned(), NamedTable { name: "figure-2-tm".to_owned(), table: tm_table(figure) }),
            (
                "Median error of the others, before / after the jump; in how many of the estimates there is a motor at all.".to_owned(),
                NamedTable { name: "figure-2-others".to_owned(), table: others_table(figure) },
            ),
        ],
        data: vec![("figure-2-series.csv".to_owned(), series(figure))],
    }
}

fn tm_table(figure: &Figure2) -> Table {
    let row = |case: &Case| {
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

fn others_table(figure: &Figure2) -> Table {
    let row = |case: &Case| {
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

fn plot(figure: &Figure2) -> PanelPlot {
    use NoiseModel::{EquationError, Sensor};
    use RatioOf::{Amplitude, Power};
    type Pick = for<'a> fn(&'a ByParameter<Trace>) -> &'a Trace;
    let k = samples(figure.samples);
    let tm: Pick = |all| &all.mechanical_time_constant_s;
    let ta: Pick = |all| &all.electrical_time_constant_s;
    let ke: Pick = |all| &all.back_emf_v_s_per_rad;
    let mc: Pick = |all| &all.load_torque_n_m;
    let set = &figure.set;
    let equation_error = [
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
    let by_instruments = Method::InstrumentalVariables;
    let sensor_noise = [
        (
            "instrumental variables",
            Style::Measured,
            Sensor,
            Power,
            by_instruments,
        ),
        ("printed", Style::Before, Sensor, Power, Method::Printed),
        ("exact", Style::After, Sensor, Power, Method::Exact),
    ];
    // Each parameter with its set value and the range of its frame.
    let tm = ("TM", "s", tm, &set.mechanical_time_constant_s, 0.0..=1.0);
    let ta = ("Ta", "s", ta, &set.electrical_time_constant_s, 0.0..=0.2);
    let ke = ("Ke", "V.s/rad", ke, &set.back_emf_v_s_per_rad, 0.0..=0.8);
    let mc = ("Mc", "N.m", mc, &set.load_torque_n_m, -10.0..=10.0);
    let panels: [(&str, &[Line], _); 6] = [
        ("equation error", &equation_error, &tm),
        ("equation error", &equation_error, &ta),
        ("equation error", &equation_error, &ke),
        ("equation error", &equation_error, &mc),
        ("sensor noise", &sensor_noise, &tm),
        ("sensor noise", &sensor_noise, &ta),
    ];
    let mut plot = PanelPlot::default().with_axis("sample k", "");
    for (noise, lines, (name, unit, pick, truth, frame)) in panels {
        let mut panel = Panel::new(format!("{noise}: {name}"), *unit).with_height(130.0);
        for (label, style, noise, of, method) in lines {
            if let Some(case) = figure.case(*noise, *of, *method) {
                let shown = inside(&pick(&case.trace).0, frame.clone());
                panel = panel.with(Series::sampled(*label, *style, &k, &shown));
            }
        }
        plot = plot.with(panel.with(Series::sampled("set value", Style::Command, &k, truth)));
    }
    plot
}

/// Label, style and the case it shows.
type Line = (&'static str, Style, NoiseModel, RatioOf, Method);

fn series(figure: &Figure2) -> String {
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
