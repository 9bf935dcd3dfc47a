//! Paper B on the page: its figures.

use super::{cells, comparison, csv, named, of, paper_b_beyond, paper_b_design, seconds, times};
use crate::control::TrialPoint;
use crate::report::plot::{Panel, PanelPlot, Series, Style};
use crate::report::reproduce::{Picture, Reproduction, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::PaperB;
use crate::workflow::reproduce::paper_b::{Disturbance, Figure4, Figure5, Followed};

impl PaperB {
    /// The page with its pictures and tables.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: "Paper B, computed again".to_owned(),
            subtitle: self.title.to_owned(),
            lead: ("In short".to_owned(), self.in_short()),
            sections: vec![
                Section {
                    heading: "What the paper leaves open, and what was chosen".to_owned(),
                    paragraphs: self.chosen.clone(),
                    ..Section::default()
                },
                figure_4(&self.figure_4),
                figure_5(&self.figure_5),
                paper_b_design::convergence(&self.design),
                paper_b_design::ratio(&self.design),
                paper_b_design::radii(&self.design),
                paper_b_beyond::noise(&self.noise),
                paper_b_beyond::hall(&self.hall),
                paper_b_beyond::back_emf(&self.back_emf),
                comparison::section(&self.comparison),
            ],
        }
    }

    fn in_short(&self) -> String {
        let [without, with] = &self.figure_4.courses;
        let [bare, compensated] = &self.figure_5.courses;
        let stop = self.design.stops.iter().find(|stop| stop.tolerance < 1e-5);
        let counts = stop.map_or((0, 0), |stop| {
            (stop.filter_iterations, stop.feedback_iterations)
        });
        let variance = |of| {
            let found = self
                .noise
                .of(of)
                .map_or([f64::NAN; 2], |v| v.speed_variance);
            fixed(found[1] / found[0], 2)
        };
        format!(
            "The compensation does what the paper's Figures 4 and 5 show: under friction the mean error on the flat parts goes from {} to {} rad/s, and a load of {} N.m that leaves {} rad/s for good is recovered from in {} s. K and gamma stop after {} and {} iterations. What the paper does not say: white noise of the sensor is not compensated, the variance of the speed is {} times as large with it; of a load that wanders {} is left.",
            fixed(without.flat_mean_rad_s, 2),
            fixed(with.flat_mean_rad_s, 2),
            self.figure_5.load_n_m,
            fixed(bare.applied.lasting_rad_s, 2),
            seconds(compensated.applied.recovery_s),
            counts.0,
            counts.1,
            variance(Disturbance::Sensor),
            variance(Disturbance::Load),
        )
    }
}

fn figure_4(figure: &Figure4) -> Section {
    let [without, with] = &figure.courses;
    let t = times(&without.trace);
    let speed = |course: &Followed| of(&course.trace, |p| p.speed_rad_s);
    let error = |course: &Followed| of(&course.trace, |p| p.reference_rad_s - p.speed_rad_s);
    let reference = of(&with.trace, |p| p.reference_rad_s);
    let response = Panel::new("(a) speed", "rad/s")
        .with_height(220.0)
        .with(Series::sampled("reference", Style::Command, &t, &reference))
        .with(Series::sampled(
            "without compensation",
            Style::Before,
            &t,
            &speed(without),
        ))
        .with(Series::sampled("with", Style::After, &t, &speed(with)));
    let errors = Panel::new("(b) error", "rad/s")
        .with_height(180.0)
        .with(Series::sampled(
            "without compensation",
            Style::Before,
            &t,
            &error(without),
        ))
        .with(Series::sampled("with", Style::After, &t, &error(with)));
    let rows = figure.courses.iter().map(|course| {
        cells([
            yes(course.compensated),
            significant(course.absolute_error_rad, 3),
            fixed(course.largest_error_rad_s, 2),
            fixed(course.slope_error_rad_s, 3),
            fixed(course.flat_error_rad_s, 3),
            fixed(course.flat_mean_rad_s, 3),
            fixed(course.overshoot_rad_s, 2),
            significant(course.effort_v, 3),
        ])
    });
    let columns = [
        ("reference_rad_s", reference.clone()),
        ("speed_without_rad_s", speed(without)),
        ("speed_with_rad_s", speed(with)),
        ("output_without_v", of(&without.trace, |p| p.output_v)),
        ("output_with_v", of(&with.trace, |p| p.output_v)),
    ];
    let columns: Vec<(String, &[f64])> = columns
        .iter()
        .map(|(name, values)| ((*name).to_owned(), &values[..]))
        .collect();
    Section {
        heading: "Figure 4: polyline reference, with and without adaptive compensation".to_owned(),
        paragraphs: vec!["The paper's plant with friction and noise. On a slope both lag: the feedback needs an error to accelerate, and the compensation answers what the model does not foresee, not what it does. Friction is not in the model: without compensation it leaves an error on the flat parts, with it none stays. On the way down friction brakes along, and there the bare regulator has the smaller error.".to_owned()],
        pictures: vec![Picture {
            name: "figure-4",
            svg: PanelPlot::default().with(response).with(errors).svg("speed and error to a polyline reference with and without compensation"),
            caption: "(a) response, (b) error.".to_owned(),
        }],
        tables: vec![(
            "Errors over the whole course; slope and flat: root mean square, the flat parts from 0.2 s after their corner on.".to_owned(),
            named(
                "figure-4",
                vec![
                    "compensation", "IAE, rad", "largest, rad/s", "slope, rad/s", "flat, rad/s",
                    "flat mean, rad/s", "overshoot, rad/s", "effort, V",
                ],
                rows.collect(),
            ),
        )],
        data: vec![("figure-4-series.csv".to_owned(), csv("time_s", &t, &columns))],
    }
}

fn yes(is_so: bool) -> String {
    if is_so { "yes" } else { "no" }.to_owned()
}

fn figure_5(figure: &Figure5) -> Section {
    let [without, with] = &figure.courses;
    let from = |trace: &[TrialPoint]| {
        let begin = trace.partition_point(|point| point.time_s < 0.6);
        trace[begin..].to_vec()
    };
    let (bare, compensated) = (from(&without.trace), from(&with.trace));
    let t = times(&bare);
    let speed = Panel::new("speed", "rad/s")
        .with_height(200.0)
        .with(Series::sampled(
            "reference",
            Style::Command,
            &t,
            &of(&bare, |p| p.reference_rad_s),
        ))
        .with(Series::sampled(
            "without compensation",
            Style::Before,
            &t,
            &of(&bare, |p| p.speed_rad_s),
        ))
        .with(Series::sampled(
            "with",
            Style::After,
            &t,
            &of(&compensated, |p| p.speed_rad_s),
        ));
    let output = Panel::new("voltage", "V")
        .with_height(110.0)
        .with(Series::sampled(
            "without compensation",
            Style::Before,
            &t,
            &of(&bare, |p| p.output_v),
        ))
        .with(Series::sampled(
            "with",
            Style::After,
            &t,
            &of(&compensated, |p| p.output_v),
        ));
    let rows = figure.courses.iter().flat_map(|course| {
        [("applied", &course.applied), ("removed", &course.removed)].map(|(what, change)| {
            cells([
                yes(course.compensated),
                what.to_owned(),
                fixed(change.dip_rad_s, 2),
                seconds(change.recovery_s),
                fixed(change.lasting_rad_s, 3),
                significant(course.effort_v, 3),
            ])
        })
    });
    let columns = [
        ("speed_without_rad_s", of(&bare, |p| p.speed_rad_s)),
        ("speed_with_rad_s", of(&compensated, |p| p.speed_rad_s)),
        ("output_without_v", of(&bare, |p| p.output_v)),
        ("output_with_v", of(&compensated, |p| p.output_v)),
    ];
    let columns: Vec<(String, &[f64])> = columns
        .iter()
        .map(|(name, values)| ((*name).to_owned(), &values[..]))
        .collect();
    Section {
        heading: "Figure 5: a load applied and removed".to_owned(),
        paragraphs: vec![format!(
            "{} N.m at {} rad/s. Friction is there all the time, so that the bare feedback stands below its reference before the load comes.",
            figure.load_n_m, figure.speed_rad_s
        )],
        pictures: vec![Picture {
            name: "figure-5",
            svg: PanelPlot::default()
                .with(speed)
                .with(output)
                .svg("speed and voltage while a load comes on and goes off"),
            caption: "The load is on from 0.8 to 1.4 s.".to_owned(),
        }],
        tables: vec![(
            "Dip: largest error; recovery: to 0.5 % of the speed; lasting: mean error at the end."
                .to_owned(),
            named(
                "figure-5",
                vec![
                    "compensation",
                    "load",
                    "dip, rad/s",
                    "recovery, s",
                    "lasting, rad/s",
                    "effort, V",
                ],
                rows.collect(),
            ),
        )],
        data: vec![(
            "figure-5-series.csv".to_owned(),
            csv("time_s", &t, &columns),
        )],
    }
}
