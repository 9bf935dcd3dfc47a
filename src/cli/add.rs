//! `add` and `remove`: one effect more or less, before and after; never overwrites the model.
//!
//! `custom` and `table` are not in the catalogue: what they are comes with the options of `add` (see `defined`).

use std::fmt::Write as _;
use std::path::PathBuf;

use super::data::{EvidenceArguments, prepare};
use super::defined::{self, DefinitionArguments};
use super::diagnose::parameter_text;
use super::failure::{Failure, REFUSED, USAGE};
use super::sanity_report::Judging;
use super::{compare, model_output, output, progress, signals};
use crate::config_text::help_for_unknown;
use crate::diagnosis::{AddResult, add, remove};
use crate::plant::{Effect, FileHistory, Model, ModelError, ModelFile, effect};

/// Refit a model without one of its effects and show the held-out error before and after
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench remove stribeck_friction --model model.toml --run runs/a --holdout runs/b --output model2.toml"
)]
pub(super) struct Arguments {
    /// Id of the effect, as `drivebench effects` lists them; or custom and table, with an own name as `custom_fan`
    effect: String,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(long)]
    run: PathBuf,
    /// Where to write the new model; without it the model is printed
    #[arg(long, value_name = "MODEL2.toml")]
    output: Option<PathBuf>,
    #[command(flatten)]
    evidence: EvidenceArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Refit a model with an effect added and show the held-out error before and after
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench add stribeck_friction --model model.toml --run runs/a --holdout runs/b --output model2.toml\n  drivebench add custom --equation torque --expression 'a*abs(w)*w + b*sgn(w)' --parameter a --parameter b --run runs/a\n  drivebench add table --axis speed_rad_s --run runs/a --holdout runs/b"
)]
pub(super) struct AddArguments {
    #[command(flatten)]
    common: Arguments,
    #[command(flatten)]
    definition: DefinitionArguments,
}

pub(super) fn execute_add(arguments: &AddArguments) -> Result<(), Failure> {
    let id = arguments.common.effect.as_str();
    if effect::family(id).is_none() {
        arguments.definition.refuse_for(id)?;
        known(id)?;
    }
    run(&arguments.common, Some(&arguments.definition))
}

pub(super) fn execute_remove(arguments: &Arguments) -> Result<(), Failure> {
    if effect::family(&arguments.effect).is_none() {
        known(&arguments.effect)?;
    }
    run(arguments, None)
}

/// The effect of the catalogue with this id.
fn known(id: &str) -> Result<&'static dyn Effect, Failure> {
    effect::find(id).ok_or_else(|| {
        let families = effect::FAMILIES.iter().map(|card| card.id);
        let known: Vec<&str> = effect::CATALOGUE
            .iter()
            .map(|effect| effect.card().id)
            .chain(families)
            .collect();
        let help = help_for_unknown(id, known.iter().copied());
        Failure::with_help(
            USAGE,
            format!("effect {id:?} is not in the catalogue"),
            help,
        )
    })
}

/// The effect with this id as the model has it.
fn of_model(model: &Model, id: &str) -> Result<&'static dyn Effect, Failure> {
    match model.effects.iter().find(|active| active.id() == id) {
        Some(active) => Ok(active.effect),
        None => known(id),
    }
}

fn run(arguments: &Arguments, adding: Option<&DefinitionArguments>) -> Result<(), Failure> {
    let id = arguments.effect.as_str();
    if let Some(path) = &arguments.output {
        output::refuse_existing(path, "--output")?;
    }
    let _endable = signals::endable()?;
    let shown = progress::begin(if adding.is_some() { "add" } else { "remove" });
    let prepared = prepare(
        &arguments.run,
        arguments.model.as_ref(),
        &arguments.evidence,
        Judging::Refits,
    )?;
    let mut model = prepared.model.file.model.clone();
    let result = if let Some(definition) = adding {
        progress::stage("refits with the effect and without it", 0);
        // Refused here with a clear word rather than as a failed fit.
        if model.has(id) {
            return Err(ModelError::Duplicate { id: id.to_owned() }.into());
        }
        let chosen = if effect::family(id).is_some() {
            defined::effect(id, definition, &mut model, &prepared.evidence)?
        } else {
            known(id)?
        };
        add(chosen, &model, prepared.evidence)?
    } else {
        progress::stage("refits with the effect and without it", 0);
        model.without_effect(id)?;
        remove(of_model(&model, id)?, &model, prepared.evidence)?
    };
    drop(shown);
    let file = model_file(
        &result,
        &prepared.model.file.history,
        &prepared.run.run.name,
    );
    if let Some(path) = arguments.output.as_ref().filter(|_| result.accepted) {
        output::file(path, &file.to_toml())?;
        output::message(&format!("model written to {}", path.display()));
    }
    let mut value = serde_json::to_value(&result).unwrap_or_default();
    value["limits"] = value["after"]["limits"].take();
    // The contract shows the signals of `compare` under before and after.
    for side in ["before", "after"] {
        value[side] = value[side]["signals"].take();
    }
    value["rows_dropped"] = prepared.run.run.rows_dropped.into();
    value["notes"] = prepared.run.run.notes.clone().into();
    // A refused model is not handed out.
    value["model"] = result.accepted.then(|| file.to_toml()).into();
    let print_model = arguments.output.is_none() && result.accepted;
    output::result(&value, arguments.json, |_| {
        text(&result, print_model.then(|| file.to_toml()))
    })?;
    if result.accepted {
        Ok(())
    } else {
        Err(Failure::new(REFUSED, format!("refused: {}", result.reason)))
    }
}

/// The new model with its history.
fn model_file(result: &AddResult, before: &FileHistory, run: &str) -> ModelFile {
    let mut history = FileHistory {
        fitted: model_output::fitted(&result.fit.parameters),
        ..before.clone()
    };
    history.fitted_on = vec![run.to_owned()];
    for rung in &result.ladder {
        let line = model_output::rung(rung, result.before.noise_floor_from);
        if history.ladder.last() != Some(&line) {
            history.ladder.push(line);
        }
    }
    ModelFile {
        model: result.fit.model.clone(),
        history,
    }
}

fn text(result: &AddResult, model: Option<String>) -> String {
    let mut text = format!(
        "{}: {}\n",
        if result.accepted {
            "accepted"
        } else {
            "refused"
        },
        result.reason
    );
    let _ = write!(
        text,
        "\nbefore\n{}\nafter\n{}",
        compare::text(&result.before),
        compare::text(&result.after)
    );
    for parameter in &result.parameters {
        let _ = writeln!(text, "{}", parameter_text(parameter));
    }
    if let Some([before, after]) = &result.confirm {
        let _ = writeln!(
            text,
            "on the confirming run: {:.2} -> {:.2} {}",
            before.holdout_rmse,
            after.holdout_rmse,
            result.before.noise_floor_from.times()
        );
    }
    if let Some(model) = model {
        let _ = write!(text, "\n{model}");
    }
    text
}
