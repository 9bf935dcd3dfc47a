//! The report of `compare`: how good a model is as it stands, and where it fails.

use super::compared;
use super::page::{Page, Tone};
use super::{Context, tables};
use crate::diagnosis::{Comparison, HoldoutFrom};
use crate::identification::noise::FloorSource;
use crate::sample::ParameterEstimate;

/// Everything that the page of a comparison is made of.
#[derive(Clone, Debug)]
pub struct ComparisonReport<'a> {
    pub title: &'a str,
    pub context: &'a Context,
    pub comparison: &'a Comparison,
    /// Whether something speaks against the hold-out; the notes of the context say what.
    pub holdout_objected: bool,
    /// Of the model that is compared; may be empty.
    pub parameters: &'a [ParameterEstimate],
}

impl ComparisonReport<'_> {
    pub fn html(&self) -> String {
        self.page().html()
    }

    pub fn page(&self) -> Page {
        let found = self.comparison;
        let mut page = Page::new(self.title, "Comparison of a model with a run");
        let from = match found.holdout_from {
            HoldoutFrom::Run if self.holdout_objected => {
                "the run that was named to judge by, against which something speaks (see below),"
            }
            HoldoutFrom::Run => "a run that the fit has not seen",
            HoldoutFrom::Split => "the last part of the run",
        };
        let fails = found.balances.iter().any(|balance| balance.fails);
        let error = found.holdout_rmse;
        let (tone, word, sentence) = if found.noise_floor_from == FloorSource::None {
            (
                Tone::Attention,
                "No noise floor",
                format!(
                    "On {from} the error is {error:.2} times its scale; without a noise floor nobody can say how good that is."
                ),
            )
        } else if found.is_at_the_floor() && !fails {
            (
                Tone::Good,
                "At the noise floor",
                format!(
                    "On {from} the error is {error:.2} times the noise floor: the model explains the run."
                ),
            )
        } else {
            (
                Tone::Attention,
                "Above the noise floor",
                format!(
                    "On {from} the error is {error:.2} times the noise floor: the model misses something."
                ),
            )
        };
        page.lead(tone, word, sentence);
        tables::data_notes(&mut page, self.context);
        let models = [("model", Some(found))];
        page.section("Model beside measurement");
        compared::figures(&mut page, &models);
        compared::places(&mut page, &models);
        if !self.parameters.is_empty() {
            tables::parameter_section(&mut page, None, &[], self.parameters);
        }
        tables::conditions(&mut page, self.context);
        page
    }
}
