//! Figure 7 of paper A on the page: ADDC and MRAC, in saturation and out of it.

use super::{cells, named, seconds, speed_panel};
use crate::report::page::Cell;
use crate::report::plot::PanelPlot;
use crate::report::reproduce::{Picture, Section};
use crate::text::number::{fixed, significant};
use crate::workflow::reproduce::adaptive::{Adaptation, Cycle, Figure7, Slower};

/// Who adapts sooner, as measured.
pub(super) fn verdict(figure: &Figure7) -> String {
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

/// The half of Figure 7 that is in saturation.
pub(super) fn saturation(figure: &Figure7) -> Section {
    let mut plot = PanelPlot::default();
    for run in &figure.saturated {
        let title = format!("{}: speed", run.controller.name());
        plot = plot.with(speed_panel(title, &run.trace).with_height(110.0));
    }
    let cycles = figure.saturated.first().map_or(0, |run| run.cycles.len());
    let rows = (0..cycles).map(|n| {
        let of_all = |show: &dyn Fn(&Cycle) -> String| -> Vec<String> {
            figure
                .saturated
                .iter()
                .map(|run| show(&run.cycles[n]))
                .collect()
        };
        let mut row = vec![(n + 1).to_string()];
        row.extend(
            of_all(&|cycle| fixed(cycle.to_rad_s, 0))
                .into_iter()
                .take(1),
        );
        row.extend(of_all(&|cycle| fixed(cycle.error_rad_s, 2)));
        row.extend(of_all(&|cycle| fixed(cycle.limited_percent, 0)));
        row.into_iter().map(Cell::text).collect()
    });
    Section {
        heading: "Figure 7: ADDC and MRAC in saturation".to_owned(),
        paragraphs: vec![format!(
            "Figure 7 of the paper is a block diagram. Its text says that MRAC takes wrong action in saturation, because its reference model is linear, and must be disconnected there, and that ADDC goes on working. Start and brake between standstill and {} rad/s at a current limit of 10 A. MRAC: `u = kr r - kw w - ki i + k1` with proportional-integral adaptation (Landau) against a reference model of second order.",
            figure.full_rad_s
        )],
        pictures: vec![Picture {
            name: "figure-7-saturation",
            svg: plot.svg("start and brake with ADDC, with MRAC disconnected in saturation and with MRAC always connected"),
            caption: "The connected MRAC takes the limit for a wrong gain.".to_owned(),
        }],
        tables: vec![(
            "Root mean square error over the last 2 s of each start and brake; share of its cycles in a limit.".to_owned(),
            named(
                "figure-7-saturation",
                vec![
                    "cycle", "to, rad/s", "error: addc, rad/s", "mrac disconnected", "mrac connected",
                    "limited: addc, %", "mrac disconnected", "mrac connected",
                ],
                rows.collect(),
            ),
        )],
        ..Section::default()
    }
}

/// The half of Figure 7 that stays out of saturation.
pub(super) fn adaptation(figure: &Figure7) -> Section {
    let row = |found: &Adaptation| -> Vec<Cell> {
        cells([
            found.mechanical_s.to_string(),
            fixed(found.height_rad_s, 0),
            if found.noise { "yes" } else { "no" }.to_owned(),
            found.controller.name().to_owned(),
            significant(found.error_s, 3),
            significant(found.adapted_error_s, 3),
            significant(found.first_deviation_s, 3),
            significant(found.last_deviation_s, 3),
            seconds(found.adapted_after_s),
            fixed(found.limited_percent, 0),
        ])
    };
    let mut plot = PanelPlot::default();
    for run in &figure.shown {
        let title = format!("{}: speed", run.name);
        plot = plot.with(speed_panel(title, &run.trace));
    }
    Section {
        heading: "Figure 7: who adapts sooner".to_owned(),
        paragraphs: vec![
            verdict(figure),
            "TM jumps from 0.2 s together with a step of the reference, and each rival is held against itself: the same regulator made for the new TM, on a shaft that always had it. Error: integral of the absolute error over the first step after the jump, over the height of the step; `adapted error`: that of the regulator that was told. Strays: integral of the absolute difference of the two speeds over the height, of the first step and of the last (the twelfth). Back after: from then on the two speeds are within 10 % of the height. Only cases in which nobody was limited compare the adaptation alone. `addc` drops its memory when its predictions miss; `forgetting alone` is the paper's way, beta and nothing else.".to_owned(),
            "Where the inertia falls, MRAC has the smaller first step, as the paper says and for its reason: its gains answer the first error, while ADDC makes this step with gains that are too high until the estimate is believed; with an estimate that only forgets that takes longest. But once it is believed ADDC is adapted, in less than half a step, while MRAC moves its gains in proportion to the error between model and shaft: in steps this small it has not adapted when the twelve steps are over. Where the inertia rises, ADDC is the sooner one by every measure: old gains are only too slow there, and the shaft tells its inertia all the while. Larger steps adapt MRAC within some of them (the rows in which a limit was met); under noise its gains may drift instead.".to_owned(),
        ],
        pictures: vec![Picture {
            name: "figure-7-adaptation",
            svg: plot.svg("ADDC, ADDC by forgetting alone and MRAC over a jump of TM, unsaturated"),
            caption: format!("TM falls to 0.05 s in the middle of what is shown, at the third step; height {} rad/s, without noise.", figure.shown_height_rad_s),
        }],
        tables: vec![(
            "Jumps from TM = 0.2 s.".to_owned(),
            named(
                "figure-7-adaptation",
                vec![
                    "TM after, s", "height, rad/s", "noise", "controller", "error, s", "adapted error, s",
                    "strays first, s", "strays last, s", "back after, s", "limited, %",
                ],
                figure.adaptation.iter().map(row).collect(),
            ),
        )],
        ..Section::default()
    }
}
