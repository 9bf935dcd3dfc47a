//! Paper B on the page: its figures, its design (where the iterations stop, what Q/R does, what K3 and mu do), and what it
//! does not show (variance by kind of noise, speed from Hall edges, the back-EMF that it leaves out).

use super::{
    OUTPUT, Quantity, REFERENCE, SPEED, TIME, choices, comparison, of, seconds, speed_panel,
    trials, yes,
};
use crate::control::TrialPoint;
use crate::report::plot::{CurveChart, CurvePanel, Panel, Style};
use crate::report::reproduce::{Figure, Reproduction, Section, csv};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::PaperB;
use crate::workflow::reproduce::data_sheet::DataSheet;
use crate::workflow::reproduce::paper_b::{
    BackEmf, Design, Disturbance, Figure4, Figure5, Hall, Noise,
};

impl PaperB {
    /// The page with its pictures and tables.
    pub fn report(&self) -> Reproduction {
        Reproduction {
            title: "Paper B, computed again".to_owned(),
            subtitle: self.title.to_owned(),
            lead: ("In short".to_owned(), self.in_short()),
            sections: vec![
                choices(&self.chosen),
                data_sheet(&self.data_sheet),
                figure_4(&self.figure_4, &self.design),
                figure_5(&self.figure_5),
                convergence(&self.design),
                ratio(&self.design),
                radii(&self.design),
                noise(&self.noise),
                hall(&self.hall),
                back_emf(&self.back_emf),
                comparison(&self.comparison),
            ],
        }
    }

    fn in_short(&self) -> String {
        let [without, with, _] = &self.figure_4.courses;
        let [bare, compensated, _] = &self.figure_5.courses;
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

fn data_sheet(sheet: &DataSheet) -> Section {
    let percent = |share: f64| fixed(100.0 * share, 1);
    let [as_printed, in_series] = sheet.rated_v;
    Section::new("The data sheet against itself, and what the average model leaves out")
        .say(format!(
            "P = T n, T1 = L/R (without M) and 0.827 check. The rest does not fit: ke n I is less than half of the rated power, T/I is 2.4 times ke, Tm belongs to another inertia. ke and R per phase with two phases in series would explain most of it. The 380 V supply rectified gives {} V in the mean; rated speed and current take {} V with ke and R as printed, {} V with two phases in series: voltage is not what limits this drive, and Figures 4 and 5 are limited by current alone.",
            fixed(sheet.rectified_v, 0), fixed(as_printed, 0), fixed(in_series, 0)
        ))
        .table(
            "data-sheet",
            "What the paper prints beside what its other data make of it.",
            &sheet.checks,
            &[
                ("value", &|check| check.what.to_owned()),
                ("unit", &|check| check.unit.to_owned()),
                ("printed", &|check| significant(check.printed, 3)),
                ("computed", &|check| significant(check.computed, 3)),
                ("computed/printed", &|check| fixed(check.computed / check.printed, 2)),
            ],
        )
        .say(format!(
            "Eq. (1) has a drop of the switches, and the paper sets it aside; it gives no value, {} V are chosen for two of them. On the paper's plant that is {} N.m of friction more, which the compensation takes with the rest. 0.827 is the mean of sinusoidal phases that conduct for 120 degrees: within each of twelve steps a turn the torque swings by {} % of its mean, {} % to either side in the first harmonic. That is in proportion to the current, so no cogging, and the inertia hides it but at low speed.",
            sheet.switches_v, fixed(sheet.drop_as_friction_n_m, 2), percent(sheet.ripple_peak_to_peak), percent(sheet.ripple_ratio)
        ))
        .table(
            "switches-and-ripple",
            "The motor with its back-EMF under a constant voltage and the rated current; ripple from its lowest to its highest.",
            &sheet.switched,
            &[
                ("model", &|row| row.model.to_owned()),
                ("voltage, V", &|row| fixed(row.voltage_v, 1)),
                ("speed, rad/s", &|row| fixed(row.speed_rad_s, 2)),
                ("speed ripple, rad/s", &|row| fixed(row.ripple_rad_s, 4)),
                ("current, A", &|row| fixed(row.current_a, 2)),
            ],
        )
}

/// How a regulator is called that acts with a share of K3.
fn share(share_of_k3: f64) -> String {
    match share_of_k3 {
        none if none <= 0.0 => "none".to_owned(),
        whole if whole >= 1.0 => "K3 as printed".to_owned(),
        part => format!("{part} K3"),
    }
}

type Traces<'a> = [&'a [TrialPoint]; 3];

/// The same quantity without compensation and with it, in a panel of their own or behind what is in the latest one.
fn both(figure: Figure, [without, with, _]: Traces<'_>, quantity: Quantity) -> Figure {
    figure
        .line(
            "without compensation",
            Style::Before,
            &of(without, quantity),
        )
        .line("with", Style::After, &of(with, quantity))
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

fn figure_4(figure: &Figure4, design: &Design) -> Section {
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
    let [_, with, printed] = &figure.courses;
    Section::new("Figure 4: polyline reference, with and without adaptive compensation")
        .say("The paper's plant with friction and noise. On a slope both lag: the feedback needs an error to accelerate, and the compensation answers what the model does not foresee, not what it does. Friction is not in the model: without compensation it leaves an error on the flat parts, with it none stays. On the way down friction brakes along, and there the bare regulator has the smaller error.")
        .figure(
            "figure-4",
            "speed and error to a polyline reference with and without compensation",
            "(a) response, (b) error, (c) error with the K3 that is printed and with the share of it that is usable.",
            &columns(series, traces),
        )
        .say(format!(
            "The printed K3 = 1/(A+B) takes the filtered error of one cycle for the whole of a disturbance that has acted for one cycle, and corrects all of it again in each cycle until it has gone. With mu = 0.2 that is a loop with a damping ratio of {} (see the table of K3 and mu): it is stable, and it swings. The voltage works {} times as hard ({} against {} V from cycle to cycle), and the flat parts have {} rad/s of error instead of {}. Figure 5 has what a load does with each.",
            fixed(design.radii.damping[0][3], 2),
            fixed(printed.effort_v / with.effort_v, 0),
            significant(printed.effort_v, 3),
            significant(with.effort_v, 2),
            fixed(printed.flat_error_rad_s, 2),
            fixed(with.flat_error_rad_s, 2),
        ))
        .table(
            "figure-4",
            "Errors over the whole course; slope and flat: root mean square, the flat parts from 0.2 s after their corner on.",
            &figure.courses,
            &[
                ("compensation", &|course| share(course.share_of_k3)),
                ("IAE, rad", &|course| significant(course.absolute_error_rad, 3)),
                ("largest, rad/s", &|course| fixed(course.largest_error_rad_s, 2)),
                ("slope, rad/s", &|course| fixed(course.slope_error_rad_s, 3)),
                ("flat, rad/s", &|course| fixed(course.flat_error_rad_s, 3)),
                ("flat mean, rad/s", &|course| fixed(course.flat_mean_rad_s, 3)),
                ("overshoot, rad/s", &|course| fixed(course.overshoot_rad_s, 2)),
                ("effort, V", &|course| significant(course.effort_v, 3)),
            ],
        )
}

fn figure_5(figure: &Figure5) -> Section {
    let traces = figure.courses.each_ref().map(|course| {
        let begin = course.trace.partition_point(|point| point.time_s < 0.6);
        &course.trace[begin..]
    });
    let series = Figure::over_time(of(traces[0], TIME))
        .panel(speed_panel("speed", 200.0))
        .line("reference", Style::Command, &of(traces[0], REFERENCE));
    let voltage = Panel::new("voltage", "V").with_height(110.0);
    let series = both(both(series, traces, SPEED).panel(voltage), traces, OUTPUT)
        .panel(speed_panel("speed with K3 as printed", 140.0))
        .line("K3 as printed", Style::Measured, &of(traces[2], SPEED))
        .line("usable share", Style::After, &of(traces[1], SPEED));
    let rows = figure.courses.iter().flat_map(|course| {
        [
            ("applied", course, &course.applied),
            ("removed", course, &course.removed),
        ]
    });
    Section::new("Figure 5: a load applied and removed")
        .say(format!(
            "{} N.m at {} rad/s. Friction is there all the time, so that the bare feedback stands below its reference before the load comes.",
            figure.load_n_m, figure.speed_rad_s
        ))
        .figure(
            "figure-5",
            "speed and voltage while a load comes on and goes off",
            "The load is on from 0.8 to 1.4 s.",
            &columns(series, traces),
        )
        .table(
            "figure-5",
            "Dip: largest error; recovery: to 0.5 % of the speed; lasting: mean error at the end.",
            rows,
            &[
                ("compensation", &|(_, course, _)| share(course.share_of_k3)),
                ("load", &|(what, _, _)| (*what).to_owned()),
                ("dip, rad/s", &|(_, _, change)| fixed(change.dip_rad_s, 2)),
                ("recovery, s", &|(_, _, change)| seconds(change.recovery_s)),
                ("lasting, rad/s", &|(_, _, change)| fixed(change.lasting_rad_s, 3)),
                ("effort, V", &|(_, course, _)| significant(course.effort_v, 3)),
            ],
        )
}

fn convergence(design: &Design) -> Section {
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
    let chart = CurveChart {
        axis: "iteration".to_owned(),
        labels: ["K (Kalman filter)", "gamma (feedback)"]
            .map(str::to_owned)
            .into(),
        panels: vec![panel],
        decades: (-9, 0),
    };
    let [filter, feedback] = changes.map(Vec::clone);
    let columns = [("filter_change", filter), ("feedback_change", feedback)];
    Section::new("Where the iterations of K and gamma stop")
        .say(format!(
            "Steady gains: K = {}, {}; gamma G = {}, {} V per rad/s. The loop's largest eigenvalue with them and the compensation is {}.",
            significant(design.filter_gain[0], 4),
            significant(design.filter_gain[1], 4),
            significant(design.feedback_gain[0], 4),
            significant(design.feedback_gain[1], 4),
            fixed(design.radius, 4)
        ))
        .picture(
            "convergence",
            chart.svg("relative change of both gains over the iterations"),
            "From P(0) = 1 and V alone.",
        )
        .table(
            "convergence",
            "Iterations until the relative change is below the set value.",
            &design.stops,
            &[
                ("set value", &|stop| format!("{:.0e}", stop.tolerance)),
                ("K", &|stop| stop.filter_iterations.to_string()),
                ("gamma", &|stop| stop.feedback_iterations.to_string()),
            ],
        )
        .series("convergence", csv("iteration", &iterations, &columns))
}

fn ratio(design: &Design) -> Section {
    Section::new("What Q/R does")
        .say("Q is changed, R stays what the sensor has; without compensation. A small Q trusts the model: the voltage is quiet, and what the model does not know (friction) is hardly believed, so that it leaves a larger error. A large Q believes the sensor, and its noise goes to the motor. A step without noise and friction does not depend on Q: the filter knows the model exactly there, and the gains of filter and feedback are designed apart.")
        .table(
            "q-over-r",
            "Factor 1 is what was chosen. Overshoot and settling: a step from 50 to 51 rad/s without noise; deviation and effort: 100 rad/s with both noises and friction.",
            &design.ratios,
            &[
                ("factor", &|row| significant(row.factor, 1)),
                ("Q, V^2", &|row| significant(row.process_noise, 2)),
                ("K1", &|row| significant(row.filter_gain[0], 3)),
                ("K2", &|row| significant(row.filter_gain[1], 3)),
                ("iterations", &|row| row.iterations.to_string()),
                ("overshoot, %", &|row| fixed(row.overshoot_percent, 1)),
                ("settling, s", &|row| seconds(row.settling_s)),
                ("speed deviation, rad/s", &|row| significant(row.speed_std_rad_s, 3)),
                ("effort, V", &|row| significant(row.effort_v, 3)),
                ("lasting error, rad/s", &|row| fixed(row.lasting_rad_s, 2)),
            ],
        )
}

fn radii(design: &Design) -> Section {
    let head = || vec!["share of K3", "mu = 0.02", "0.05", "0.1", "0.2", "1"];
    let rows = |values: &[Vec<f64>], decimals| -> Vec<Vec<String>> {
        let row = |(share, values): (&f64, &Vec<f64>)| {
            let values = values.iter().map(|value| fixed(*value, decimals));
            std::iter::once(share.to_string()).chain(values).collect()
        };
        design.radii.shares.iter().zip(values).map(row).collect()
    };
    Section::new("K3 and mu")
        .say("The predictor works on measured speeds and is fed u*: so the compensation is a loop of its own beside filter and feedback, an integrator behind the smoothing. The slower the smoothing, the less of K3 it bears before it swings: with the whole K3 and mu = 0.1 its damping is a tenth.")
        .grid(
            "k3-and-mu-damping",
            "Damping ratio of the compensation. Rows: share of K3 = 1/(A+B); columns: mu. 1: it does not swing.",
            head(),
            rows(&design.radii.damping, 2),
        )
        .grid(
            "k3-and-mu-radius",
            "Largest eigenvalue of the whole loop on its own plant: below 1 it is stable.",
            head(),
            rows(&design.radii.radius, 4),
        )
}

fn noise(noise: &Noise) -> Section {
    Section::new("Variance of the speed, with and without compensation")
        .say(format!(
            "True speed at 100 rad/s on the paper's plant without friction, from 0.5 s to 4 s, mean of {} seeds. The paper calls its compensation one of white noise. White noise has no past that tells its future: what takes a slow load must answer to noise as well. The measured ratio says what each costs.",
            noise.seeds
        ))
        .table(
            "variance",
            "Below a ratio of 1 the compensation helps.",
            &noise.variances,
            &[
                ("disturbance", &|row| row.disturbance.text().to_owned()),
                ("variance without, (rad/s)^2", &|row| significant(row.speed_variance[0], 3)),
                ("with", &|row| significant(row.speed_variance[1], 3)),
                ("ratio", &|row| fixed(row.speed_variance[1] / row.speed_variance[0], 2)),
                ("effort without, V", &|row| significant(row.effort_v[0], 3)),
                ("with", &|row| significant(row.effort_v[1], 3)),
            ],
        )
}

fn hall(hall: &Hall) -> Section {
    let shown = hall.shown.iter();
    let shown = shown.map(|run| (&run.name[..], &run.trace[..]));
    let lines: [(&str, Style, Quantity); 3] = [
        ("reference", Style::Command, REFERENCE),
        ("seen", Style::Before, |point| point.seen_rad_s),
        ("true", Style::After, SPEED),
    ];
    let ways = ["true speed", "Hall edges", "Hall edges, slower design"];
    let rows = hall
        .speeds
        .iter()
        .flat_map(|at| [0, 1, 2].map(|way: usize| (at, way)));
    let [exact, edges, slower] = hall.polyline_error_rad_s;
    Section::new("Speed from Hall edges")
        .say(format!(
            "{} edges per turn at p = 2. The speed is the angle between two edges over the time between them, held until the next one; where that is late, the reading falls as one edge in the time waited. It is a mean over the last interval, old by half an interval at the edge and by one and a half before the next: a dead time that grows as the shaft slows down. No other noise; friction is there. On a slope a reading that is late is too low while the shaft accelerates, and the regulator pushes more: the lag to the reference gets smaller by it, not larger. What suffers is slow speed.",
            hall.edges_per_turn
        ))
        .say(format!(
            "Root mean square error over the polyline of Figure 4: {} rad/s on the true speed, {} rad/s on Hall edges, {} rad/s on Hall edges with a slower design (W = {}).",
            fixed(exact, 2), fixed(edges, 2), fixed(slower, 2), hall.slower_voltage_cost
        ))
        .figure(
            "hall",
            "speed seen through Hall edges and true speed over the polyline",
            "The same regulator on the true speed, on Hall edges, and a slower design on Hall edges.",
            &trials(shown, 120.0, &lines),
        )
        .table(
            "hall",
            "Constant speeds: deviation of the true speed, mean error, effort.",
            rows,
            &[
                ("speed, rad/s", &|(at, _)| fixed(at.speed_rad_s, 0)),
                ("periods per edge", &|(at, _)| fixed(at.interval_periods, 1)),
                ("seen", &|(_, way)| ways[*way].to_owned()),
                ("deviation, rad/s", &|(at, way)| fixed(at.std_rad_s[*way], 3)),
                ("mean error, rad/s", &|(at, way)| fixed(at.mean_error_rad_s[*way], 3)),
                ("effort, V", &|(at, way)| fixed(at.effort_v[*way], 3)),
            ],
        )
}

fn back_emf(found: &BackEmf) -> Section {
    let [paper, full] = found.open_end_rad_s;
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
    let closed = drawn(title, &on_motor.collect::<Vec<_>>());
    Section::new("Worked example: the back-EMF that the model leaves out")
        .say(format!(
            "Eq. (6) to (9) are an open-loop transfer function: the back-EMF does not feed back. At a constant {} V the paper's plant accelerates without end ({} rad/s after 0.3 s), the motor comes to rest at a speed ({} rad/s there); they are 5 % apart after {} s.",
            found.open_voltage_v, fixed(paper, 1), fixed(full, 1), seconds(found.apart_after_s)
        ))
        .say("Closed over the motor, the same feedback leaves an error that stays: the missing effect is a load that grows with the speed. The compensation takes it as it takes a load, but only after it has shown; the back-EMF of the reference, fed forward, takes it before. To name what is missing is worth more than to adapt to it.")
        .figure(
            "back-emf",
            "speed under a constant voltage with and without back-EMF",
            "Without friction, load and noise.",
            &open,
        )
        .figure(
            "back-emf-closed",
            "closed loop over the motor with back-EMF: bare, with compensation, with the back-EMF fed forward",
            "From standstill to 100 rad/s, paper B's feedback on the motor with its back-EMF.",
            &closed,
        )
        .table(
            "back-emf",
            "From standstill to 100 rad/s in the current limit; lasting: mean error from 1.2 to 1.5 s.",
            &found.closed,
            &[
                ("plant", &|row| if row.full_motor { "with back-EMF" } else { "paper B" }.to_owned()),
                ("compensation", &|row| yes(row.compensated)),
                ("fed forward", &|row| yes(row.fed_forward)),
                ("overshoot, %", &|row| fixed(row.overshoot_percent, 1)),
                ("settling, s", &|row| seconds(row.settling_s)),
                ("lasting, rad/s", &|row| fixed(row.lasting_rad_s, 3)),
            ],
        )
}
