//! A comparison on the screen: what `compare --screen` and `view` show, before anything is searched.

use std::io::IsTerminal as _;

use super::by_hand::{self, Left, Shown};
use super::evidence::{Place, Prepared};
use super::failure::Failure;
use super::pages;
use crate::tui::Opens;
use crate::workflow::Discovery;
use drivebench_diagnose::ErrorOf;

/// A screen needs a terminal; `help` says what does without one.
pub(crate) fn needs_terminal(what: &str, help: &str) -> Result<(), Failure> {
    if std::io::stdout().is_terminal() {
        return Ok(());
    }
    let headline = format!("{what}: standard output is not a terminal");
    Err(Failure::usage(headline, help))
}

/// Shows the complete model beside its runs until the screen is left; from there a person may search what it misses.
pub(crate) fn show(prepared: &Prepared, error_of: ErrorOf) -> Result<Left, Failure> {
    let model = prepared.model.file.model.clone();
    let place = Place::of(None, prepared)?;
    let discovery = Discovery::new(model, prepared.evidence.clone())
        .with_recorded(prepared.recorded.clone())
        .with_limits(place.limits());
    let shown = Shown {
        title: format!("{}; model: {}", prepared.about.title, prepared.model.from),
        opens: Opens::Comparison(error_of),
        stopped_at: pages::stopped_at(prepared),
        fitted_on: prepared.run.run.name.clone(),
        history: prepared.model.file.history.clone(),
        output: None,
    };
    let left = by_hand::show(discovery, shown)?;
    if left.is_interrupted() {
        return Err(Failure::interrupted("interrupted"));
    }
    Ok(left)
}
