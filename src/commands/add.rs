//! `add` and `remove`: a refit with one effect more or less, compared before and after.
//!
//! `custom` and `table` are not in the catalogue: an expression of the user, or a curve whose knots come from the axis map. The
//! options of `add` define them.

use std::path::PathBuf;

use crate::commands::arguments::{EvidenceArguments, run_path};
use crate::commands::effects::unknown_effect;
use crate::commands::evidence::Judging;
use crate::report::Document;
use crate::report::comparison::change_document;
use crate::report::wording::location::axis_map as axis_map_words;
use crate::report::wording::{change as words, json};
use crate::runtime::{Failure, Form, REFUSED, Terminal, model_file, output, speed_command};
use crate::workflow::{curve_table, four_digits, hold_collinear_parameter};
use drivebench_diagnose::{AddResult, AxisMap, Evidence, add, axis_map, remove};
use drivebench_identify::output_error;
use drivebench_model::plant::effect::{Axis, DefinitionError};
use drivebench_model::plant::{Effect, FileHistory, Model, ModelError, effect};

/// Refit a model without one of its effects and show the held-out error before and after
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench remove stribeck_friction --model model.toml --run runs/a --holdout runs/b --output model2.toml"
)]
pub(super) struct Arguments {
    /// Id of the effect, as listed by `drivebench effects`; or custom or table, also with a name, as `custom_fan`
    effect: String,
    /// Model file; without it the run folder's, else a fitted baseline
    #[arg(long)]
    model: Option<PathBuf>,
    /// Run folder, samples.csv, or any CSV with --map
    #[arg(long, value_parser = run_path())]
    run: PathBuf,
    /// Where to write the new model; without it the model is printed
    #[arg(long, value_name = "MODEL2.toml")]
    output: Option<PathBuf>,
    #[command(flatten)]
    evidence: EvidenceArguments,
    #[command(flatten)]
    form: Form,
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
    /// Add the effect although these runs do not need it; the result is marked as forced
    #[arg(long)]
    force: bool,
}

/// What defines an effect that is not in the catalogue.
#[derive(clap::Args, Clone, Debug, Default)]
struct DefinitionArguments {
    /// Of custom and table: torque or voltage; a table's default is torque, over the current voltage
    #[arg(long, value_name = "torque|voltage")]
    equation: Option<String>,
    /// Of custom: expression in u, i, w, theta, t and the parameters, as 'a*abs(w)*w'
    #[arg(long, allow_hyphen_values = true)]
    expression: Option<String>,
    /// Of custom: a parameter to fit; with a first guess where the expression is not linear in it: ws=10 or
    /// 'ws={ guess = 10, min = 1, max = 40 }'
    #[arg(long = "parameter", value_name = "NAME[=GUESS]")]
    parameters: Vec<String>,
    /// Of table: the abscissa of the curve
    #[arg(long, value_name = "speed_rad_s|current_a|angle_rad|time_s|voltage_v")]
    axis: Option<String>,
    /// Of table: knots, instead of those of the axis map, as --knots=-100,0,100
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    knots: Vec<f64>,
}

/// Refuses options that are given for an effect that they do not define.
fn refuse(id: &str, options: &[(&str, bool)]) -> Result<(), Failure> {
    options.iter().find(|(_, given)| *given).map_or(Ok(()), |(option, _)| {
        let headline = format!("{option} does not belong to effect {id:?}");
        Err(Failure::usage(headline, "see `drivebench add --help`"))
    })
}

impl DefinitionArguments {
    /// Every option and whether it is given: one of both, two of `custom`, two of `table`.
    fn given(&self) -> [(&'static str, bool); 5] {
        [
            ("--equation", self.equation.is_some()),
            ("--expression", self.expression.is_some()),
            ("--parameter", !self.parameters.is_empty()),
            ("--axis", self.axis.is_some()),
            ("--knots", !self.knots.is_empty()),
        ]
    }
}

pub(super) fn execute_add(arguments: &AddArguments, terminal: &Terminal) -> Result<(), Failure> {
    let id = arguments.common.effect.as_str();
    if effect::family(id).is_none() {
        refuse(id, &arguments.definition.given())?;
        known(id)?;
    }
    run(&arguments.common, Some(arguments), terminal)
}

pub(super) fn execute_remove(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    if effect::family(&arguments.effect).is_none() {
        known(&arguments.effect)?;
    }
    run(arguments, None, terminal)
}

fn known(id: &str) -> Result<&'static dyn Effect, Failure> {
    effect::find(id).ok_or_else(|| unknown_effect(id))
}

fn of_model(model: &Model, id: &str) -> Result<&'static dyn Effect, Failure> {
    let active = model.effects.iter().find(|active| active.id() == id);
    active.map_or_else(|| known(id), |active| Ok(active.effect))
}

fn run(
    arguments: &Arguments,
    adding: Option<&AddArguments>,
    terminal: &Terminal,
) -> Result<(), Failure> {
    let id = arguments.effect.as_str();
    output::refuse_existing(&arguments.output, "--output")?;
    let _endable = terminal.endable()?;
    let shown = terminal.progress(if adding.is_some() { "add" } else { "remove" });
    let model = arguments.model.as_deref();
    let prepared =
        arguments.evidence.prepare(&arguments.run, model, Judging::Refits, false, terminal)?;
    let (mut model, evidence) = (prepared.model.file.model.clone(), &prepared.evidence);
    terminal.stage("refits with the effect and without it", 0);
    let mut result = if let Some(AddArguments { definition, .. }) = adding {
        if model.has(id) {
            return Err(ModelError::Duplicate { id: id.to_owned() }.into());
        }
        let chosen = match effect::family(id) {
            Some(family) if family.id == "custom" => custom(id, definition)?,
            Some(_) => table(id, definition, &mut model, evidence, terminal)?,
            None => known(id)?,
        };
        add(chosen, &model, evidence.clone())?
    } else {
        model.without_effect(id)?;
        remove(of_model(&model, id)?, &model, evidence.clone())?
    };
    drop(shown);
    if adding.is_some_and(|adding| adding.force) && !result.accepted && result.can_be_forced() {
        result.force();
        terminal.warn(&[format!("{}: {}", result.effect, words::change(&result))]);
    }
    let before = &prepared.model.file.history;
    let run = Some(prepared.run.run.name.clone());
    let file = model_file(&result.fit, before, run, &result.ladder, result.before.noise_floor_from);
    if let Some(path) = arguments.output.as_ref().filter(|_| result.accepted) {
        terminal.file(path, &file.to_toml())?;
        terminal.message(&format!("model written to {}", path.display()));
    }
    let mut value = prepared.result(&json::change(&result));
    for key in ["limits", "limit_codes"] {
        value[key] = value["after"][key].take();
    }
    // In JSON, before and after hold the signals of `compare`.
    for side in ["before", "after"] {
        value[side] = value[side]["signals"].take();
    }
    // A refused model is not printed.
    let model = result.accepted.then(|| file.to_toml());
    value["model"] = model.clone().into();
    if let Some(model) = model.filter(|_| arguments.output.is_none() && !arguments.form.json) {
        terminal.line(&model)?;
    }
    let document = document(&result, arguments);
    terminal.document(&value, arguments.form, &document)?;
    if result.accepted {
        return Ok(());
    }
    let (done, help) = match adding {
        Some(_) if result.can_be_forced() => {
            ("added", "the reason is on stdout; --force adds it nevertheless")
        }
        Some(_) => (
            "added",
            "the reason is on stdout: it cannot be fitted to these runs, so that --force cannot add it either",
        ),
        None => ("removed", "the reason is on stdout: these runs need it"),
    };
    Err(Failure::with_help(REFUSED, format!("{} was not {done}", result.effect), help))
}

/// The result, and the commands that follow; where no file was named, the new model above it.
fn document(result: &AddResult, arguments: &Arguments) -> Document {
    let mut document = change_document(result);
    let written = arguments.output.as_ref().filter(|_| result.accepted);
    let model = written.or(arguments.model.as_ref()).map(PathBuf::as_path);
    document.go_on(arguments.evidence.diagnose(&arguments.run, model));
    if let Some(model) = written {
        let runs = FileHistory {
            fitted_on: vec![arguments.run.display().to_string()],
            ..FileHistory::default()
        };
        document.go_on(speed_command(&runs, model, " --feed-forward compare"));
    }
    document
}

fn custom(id: &str, arguments: &DefinitionArguments) -> Result<&'static dyn Effect, Failure> {
    refuse(id, &arguments.given()[3..])?;
    let mut settings = toml::Table::new();
    for (key, value) in [("equation", &arguments.equation), ("expression", &arguments.expression)] {
        let Some(value) = value else {
            let headline = format!("effect {id:?} needs --{key}");
            let help = "as --equation torque --expression 'a*abs(w)*w' --parameter a";
            return Err(Failure::usage(headline, help));
        };
        settings.insert(key.to_owned(), value.as_str().into());
    }
    let mut parameters = toml::Table::new();
    for text in &arguments.parameters {
        let (name, value) = parameter(text)?;
        if parameters.insert(name.clone(), value).is_some() {
            let headline = format!("parameter `{name}` is given twice");
            return Err(Failure::usage(headline, "each name once"));
        }
    }
    settings.insert("parameters".to_owned(), parameters.into());
    let expression = arguments.expression.as_deref();
    let (effect, _) = effect::define(id, &settings).map_err(|error| failure(&error, expression))?;
    Ok(effect)
}

/// `a`, `a=1e-6` or `a={ guess = 10, min = 1 }`.
fn parameter(text: &str) -> Result<(String, toml::Value), Failure> {
    let Some((name, value)) = text.split_once('=') else {
        return Ok((text.trim().to_owned(), toml::Table::new().into()));
    };
    let mut table: toml::Table = format!("value = {}", value.trim()).parse().map_err(|_| {
        Failure::usage(format!("--parameter {text:?} cannot be read"),
            "as --parameter a, --parameter ws=10 or --parameter 'ws={ guess = 10, min = 1, max = 40 }'",
        )
    })?;
    let value = table.remove("value").unwrap_or(toml::Value::Boolean(false));
    Ok((name.trim().to_owned(), value))
}

/// An error in a definition, with a mark below the place in the expression.
fn failure(error: &DefinitionError, expression: Option<&str>) -> Failure {
    let headline = match (error.offset, expression) {
        (Some(offset), Some(expression)) => {
            let before = expression[..offset.min(expression.len())].chars().count();
            let (column, message) = (before + 1, &error.message);
            format!("expression, column {column}: {message}\n  {expression}\n  {:before$}^", "")
        }
        _ => error.message.clone(),
    };
    Failure::usage(headline, error.help.clone())
}

fn table(
    id: &str,
    arguments: &DefinitionArguments,
    model: &mut Model,
    evidence: &Evidence,
    terminal: &Terminal,
) -> Result<&'static dyn Effect, Failure> {
    refuse(id, &arguments.given()[1..3])?;
    let keys: Vec<&str> = Axis::ALL.into_iter().map(Axis::key).collect();
    let known = keys.join(", ");
    let Some(axis) = arguments.axis.as_deref() else {
        let headline = format!("effect {id:?} needs --axis");
        return Err(Failure::usage(headline, format!("one of {known}")));
    };
    let axis = Axis::from_key(axis)
        .ok_or_else(|| Failure::usage(format!("axis {axis:?} is not known"), known))?;
    let default = if axis == Axis::Current { "voltage" } else { "torque" };
    let equation = arguments.equation.as_deref().unwrap_or(default);
    let (training, noise) = (&evidence.training, &evidence.noise);
    let fit = output_error::fit(std::slice::from_ref(model), training, noise)?;
    let knots = if arguments.knots.is_empty() {
        let maps = axis_map(&fit.model, training, noise)?;
        let found = chosen(maps, equation, axis)?;
        terminal.message(&axis_map_words(&found));
        found.knots.into_iter().map(four_digits).collect()
    } else {
        arguments.knots.clone()
    };
    let effect = curve_table(id, equation, axis, &knots).map_err(|error| failure(&error, None))?;
    if let Some(held) = hold_collinear_parameter(model, &fit.model, id, equation, axis) {
        terminal.message(&format!(
            "{held} is held constant: the data cannot separate it from the curve"
        ));
    }
    terminal
        .message("provisional: the curve describes the error, not its cause; look for the cause");
    Ok(effect)
}

fn chosen(maps: Vec<AxisMap>, equation: &str, axis: Axis) -> Result<AxisMap, Failure> {
    let known = maps.iter().filter(|map| Axis::from_key(map.axis).is_some());
    let axes: Vec<_> = known
        .map(|map| {
            let percent = 100.0 * map.r2.max(0.0);
            format!("{} over {} ({percent:.0} %)", map.equation, map.axis)
        })
        .collect();
    let (axes, axis) = (axes.join(", "), axis.key());
    let wanted = |map: &AxisMap| map.equation == equation && map.axis == axis;
    maps.into_iter().find(wanted).ok_or_else(|| {
        let headline = format!("the run gives no curve of the {equation} error over {axis}");
        Failure::usage(headline, format!("curves of this run: {axes}; or give --knots"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_is_a_name_with_or_without_a_guess() {
        let empty = toml::Value::Table(toml::Table::new());
        assert_eq!(parameter("a").unwrap(), ("a".to_owned(), empty));
        assert_eq!(parameter("ws = 1e1").unwrap(), ("ws".to_owned(), 10.0.into()));
        let (name, value) = parameter("c={ guess = 10, min = 1 }").unwrap();
        assert_eq!((name.as_str(), value["guess"].as_integer()), ("c", Some(10)));
        assert!(parameter("a=b c").is_err());
    }

    #[test]
    fn a_mistake_is_marked_below_the_expression() {
        let arguments = DefinitionArguments {
            equation: Some("torque".to_owned()),
            expression: Some("a*ww".to_owned()),
            parameters: vec!["a".to_owned()],
            ..DefinitionArguments::default()
        };
        let error = custom("custom", &arguments).err().unwrap();
        let error = error.headline();
        assert!(error.contains("column 3: unknown name `ww`\n  a*ww\n    ^"), "{error}");
        assert!(refuse("viscous_friction", &arguments.given()).is_err());
        let none = DefinitionArguments::default();
        assert!(refuse("viscous_friction", &none.given()).is_ok());
    }
}
