//! Figure 3 on the page.

use super::{cells, csv, inside, percent, range, samples};
use crate::report::page::Table;
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{NamedTable, Picture, Section};
use crate::text::number::significant;
use crate::workflow::reproduce::{Figure3, Trace};

pub(super) fn section(figure: &Figure3) -> Section {
    let k = samples(figure.samples);
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
            svg: plot(figure).svg("estimates of scheme 2 over the samples"),
            caption: "One seed. Equation error: as printed (rectangle). Sensor noise: S/N 15 of power on the speed, the current exact.".to_owned(),
        }],
        tables: vec![(
            format!("Median [5 % to 95 %] over the samples from k = {} on and {} seeds.", figure.settled_from, figure.seeds),
            NamedTable { name: "figure-3".to_owned(), table: table(figure) },
        )],
        data: vec![("figure-3-series.csv".to_owned(), csv("k", &k, &columns))],
    }
}

fn table(figure: &Figure3) -> Table {
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
    Table {
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
    }
}

fn plot(figure: &Figure3) -> PanelPlot {
    let k = samples(figure.samples);
    let truth = |value: f64| vec![value; figure.samples];
    let panel = |title: &str, unit: &str, set: f64, lines: [(&str, Style, &Trace); 2]| {
        let mut panel = Panel::new(title, unit).with_height(140.0);
        for (label, style, trace) in lines {
            panel = panel.with(Series::sampled(
                label,
                style,
                &k,
                &inside(&trace.0, 0.75 * set..=1.25 * set),
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
    plot
}
