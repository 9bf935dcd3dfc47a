//! A record with the estimates of its lost voltages as rows of their own, for schemes that take it row by row.

use crate::plant::Scenario;
use crate::sample::{Channel, Run, RunError};

/// `None` where the rows do not fit between the others.
pub(super) fn estimated(run: &Run, scenario: &Scenario) -> Option<Run> {
    with_rows(run, scenario).ok()
}

fn with_rows(run: &Run, scenario: &Scenario) -> Result<Run, RunError> {
    let (times, holes) = (run.time_s(), &scenario.unknown_input);
    let is_new =
        |time_s: f64| !times[times.partition_point(|time| *time < time_s)..].starts_with(&[time_s]);
    let mut rows: Vec<(f64, Option<usize>)> = times.iter().copied().zip((0..).map(Some)).collect();
    rows.extend(
        holes
            .iter()
            .filter(|hole| is_new(hole.from_s))
            .map(|hole| (hole.from_s, None)),
    );
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let place = |time_s: f64| rows.partition_point(|row| row.0 < time_s);
    let mut whole = Run::new(run.name.clone(), rows.iter().map(|row| row.0).collect())?;
    (whole.rows_dropped, whole.notes) = (run.rows_dropped, run.notes.clone());
    for channel in Channel::ALL {
        let Some(column) = run.column(channel) else {
            continue;
        };
        let mut cells: Vec<f64> = (rows.iter())
            .map(|(_, row)| row.map_or(f64::NAN, |row| column[row]))
            .collect();
        if channel == scenario.input_channel {
            for hole in holes {
                cells[place(hole.from_s)] = hole.mean;
            }
        }
        whole.set_column(channel, cells, run.origin(channel))?;
        if let Some(side) = run.side(channel) {
            whole.set_side(channel, side);
        }
    }
    let mut limited: Vec<usize> = (run.limited_rows().iter().map(|row| place(times[*row])))
        .chain(
            holes
                .iter()
                .filter(|hole| hole.restart.is_some())
                .map(|hole| place(hole.to_s)),
        )
        .collect();
    limited.sort_unstable();
    limited.dedup();
    whole.set_limited_rows(limited);
    Ok(whole)
}
