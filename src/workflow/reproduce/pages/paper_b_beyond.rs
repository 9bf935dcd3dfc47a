//! What paper B does not show: variance by kind of noise, speed from Hall edges, the back-EMF that it leaves out.

use super::{cells, named, of, seconds, times};
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::paper_b::{BackEmf, Hall, Noise};

pub(super) fn noise(noise: &Noise) -> Section {
    let rows = noise.variances.iter().map(|row| {
        let [without, with] = row.speed_variance;
        cells([
            row.disturbance.text().to_owned(),
            significant(without, 3),
            significant(with, 3),
            fixed(with / without, 2),
            significant(row.effort_v[0], 3),
            significant(row.effort_v[1], 3),
        ])
    });
    Section {
        heading: "Variance of the speed, with and without compensation".to_owned(),
        paragraphs: vec![format!(
            "True speed at 100 rad/s on the paper's plant without friction, from 0.5 s to 4 s, mean of {} seeds. The paper calls its compensation one of white noise. White noise has no past that tells its future: what takes a slow load must answer to noise as well. The measured ratio says what each costs.",
            noise.seeds
        )],
        tables: vec![(
            "Below a ratio of 1 the compensation helps.".to_owned(),
            named(
                "variance",
                vec![
                    "disturbance",
                    "variance without, (rad/s)^2",
                    "with",
                    "ratio",
                    "effort without, V",
                    "with",
                ],
                rows.collect(),
            ),
        )],
        ..Section::default()
    }
}

pub(super) fn hall(hall: &Hall) -> Section {
    let rows = hall.speeds.iter().flat_map(|at| {
        let ways = ["true speed", "Hall edges", "Hall edges, slower design"];
        ways.into_iter().enumerate().map(|(way, name)| {
            cells([
                fixed(at.speed_rad_s, 0),
                fixed(at.interval_periods, 1),
                name.to_owned(),
                fixed(at.std_rad_s[way], 3),
                fixed(at.mean_error_rad_s[way], 3),
                fixed(at.effort_v[way], 3),
            ])
        })
    });
    let mut plot = PanelPlot::default();
    for run in &hall.shown {
        let t = times(&run.trace);
        plot = plot.with(
            Panel::new(format!("{}: speed", run.name), "rad/s")
                .with_height(120.0)
                .with(Series::sampled(
                    "reference",
                    Style::Command,
                    &t,
                    &run.column(|p| p.reference_rad_s),
                ))
                .with(Series::sampled(
                    "seen",
                    Style::Before,
                    &t,
                    &run.column(|p| p.seen_rad_s),
                ))
                .with(Series::sampled(
                    "true",
                    Style::After,
                    &t,
                    &run.column(|p| p.speed_rad_s),
                )),
        );
    }
    let [exact, edges, slower] = hall.polyline_error_rad_s;
    Section {
        heading: "Speed from Hall edges".to_owned(),
        paragraphs: vec![
            format!(
                "{} edges per turn at p = 2. The speed is the angle between two edges over the time between them, held until the next one; where that is late, the reading falls as one edge in the time waited. It is a mean over the last interval, old by half an interval at the edge and by one and a half before the next: a dead time that grows as the shaft slows down. No other noise; friction is there. On a slope a reading that is late is too low while the shaft accelerates, and the regulator pushes more: the lag to the reference gets smaller by it, not larger. What suffers is slow speed.",
                hall.edges_per_turn
            ),
            format!(
                "Root mean square error over the polyline of Figure 4: {} rad/s on the true speed, {} rad/s on Hall edges, {} rad/s on Hall edges with a slower design (W = {}).",
                fixed(exact, 2),
                fixed(edges, 2),
                fixed(slower, 2),
                hall.slower_voltage_cost
            ),
        ],
        pictures: vec![Picture {
            name: "hall",
            svg: plot.svg("speed seen through Hall edges and true speed over the polyline"),
            caption: "The same regulator on the true speed, on Hall edges, and a slower design on Hall edges.".to_owned(),
        }],
        tables: vec![(
            "Constant speeds: deviation of the true speed, mean error, effort.".to_owned(),
            named(
                "hall",
                vec![
                    "speed, rad/s", "periods per edge", "seen", "deviation, rad/s",
                    "mean error, rad/s", "effort, V",
                ],
                rows.collect(),
            ),
        )],
        ..Section::default()
    }
}

pub(super) fn back_emf(found: &BackEmf) -> Section {
    let [paper, full] = found.open_end_rad_s;
    let mut open = Panel::new(
        format!("open loop at {} V: speed", found.open_voltage_v),
        "rad/s",
    );
    for (run, style) in found.open.iter().zip([Style::Before, Style::After]) {
        let speeds = run.column(|p| p.speed_rad_s);
        open = open.with(Series::sampled(
            run.name.clone(),
            style,
            &times(&run.trace),
            &speeds,
        ));
    }
    let mut closed = Panel::new("closed over the motor with back-EMF: speed", "rad/s");
    let on_motor = found.closed.iter().filter(|row| row.full_motor);
    for (row, (name, style)) in on_motor.zip([
        ("without compensation", Style::Before),
        ("with", Style::After),
        ("fed forward", Style::Measured),
    ]) {
        let speeds = of(&row.trace, |p| p.speed_rad_s);
        closed = closed.with(Series::sampled(name, style, &times(&row.trace), &speeds));
    }
    let plant = |full: bool| if full { "with back-EMF" } else { "paper B" };
    let yes = |is_so: bool| if is_so { "yes" } else { "no" };
    let rows = found.closed.iter().map(|row| {
        cells([
            plant(row.full_motor).to_owned(),
            yes(row.compensated).to_owned(),
            yes(row.fed_forward).to_owned(),
            fixed(row.overshoot_percent, 1),
            seconds(row.settling_s),
            fixed(row.lasting_rad_s, 3),
        ])
    });
    Section {
        heading: "Worked example: the back-EMF that the model leaves out".to_owned(),
        paragraphs: vec![
            format!(
                "Eq. (6) to (9) are an open-loop transfer function: the back-EMF does not feed back. At a constant {} V the paper's plant accelerates without end ({} rad/s after 0.3 s), the motor comes to rest at a speed ({} rad/s there); they are 5 % apart after {} s.",
                found.open_voltage_v,
                fixed(paper, 1),
                fixed(full, 1),
                seconds(found.apart_after_s)
            ),
            "Closed over the motor, the same feedback leaves an error that stays: the missing effect is a load that grows with the speed. The compensation takes it as it takes a load, but only after it has shown; the back-EMF of the reference, fed forward, takes it before. To name what is missing is worth more than to adapt to it.".to_owned(),
        ],
        pictures: vec![Picture {
            name: "back-emf",
            svg: PanelPlot::default().with(open).svg("speed under a constant voltage with and without back-EMF"),
            caption: "Without friction, load and noise.".to_owned(),
        }, Picture {
            name: "back-emf-closed",
            svg: PanelPlot::default().with(closed).svg("closed loop over the motor with back-EMF: bare, with compensation, with the back-EMF fed forward"),
            caption: "From standstill to 100 rad/s, paper B's feedback on the motor with its back-EMF.".to_owned(),
        }],
        tables: vec![(
            "From standstill to 100 rad/s in the current limit; lasting: mean error from 1.2 to 1.5 s.".to_owned(),
            named(
                "back-emf",
                vec![
                    "plant", "compensation", "fed forward", "overshoot, %", "settling, s",
                    "lasting, rad/s",
                ],
                rows.collect(),
            ),
        )],
        ..Section::default()
    }
}
