//! Options of `add` that define an effect: an own expression, or a curve whose knots come from the axis map.

use super::failure::{Failure, USAGE};
use super::output;
use crate::diagnosis::{AxisMap, Evidence, axis_map};
use crate::identification::output_error;
use crate::plant::effect::{Axis, DefinitionError};
use crate::plant::{Effect, Model, effect};
use crate::workflow::curve;

/// What defines an effect that is not in the catalogue.
#[derive(clap::Args, Clone, Debug, Default)]
pub(super) struct DefinitionArguments {
    /// Of custom and table: torque or voltage; a table's default is torque, over the current voltage
    #[arg(long, value_name = "torque|voltage")]
    equation: Option<String>,
    /// Of custom: expression in u, i, w, theta, t and the parameters, as 'a*abs(w)*w'
    #[arg(long, allow_hyphen_values = true)]
    expression: Option<String>,
    /// Of custom: a parameter, to be fitted; where the expression is not linear in it with a guess: ws=10 or
    /// 'ws={ guess = 10, min = 1, max = 40 }'
    #[arg(long = "parameter", value_name = "NAME[=GUESS]")]
    parameters: Vec<String>,
    /// Of table: what the curve runs over
    #[arg(long, value_name = "speed_rad_s|current_a|angle_rad|time_s|voltage_v")]
    axis: Option<String>,
    /// Of table: own knots instead of those of the axis map, as --knots=-100,0,100
    #[arg(long, value_delimiter = ',', allow_hyphen_values = true)]
    knots: Vec<f64>,
}

impl DefinitionArguments {
    /// Refuses the options for an effect that they do not define.
    pub(super) fn refuse_for(&self, id: &str) -> Result<(), Failure> {
        refuse(
            id,
            &[
                ("--equation", self.equation.is_some()),
                ("--expression", self.expression.is_some()),
                ("--parameter", !self.parameters.is_empty()),
                ("--axis", self.axis.is_some()),
                ("--knots", !self.knots.is_empty()),
            ],
        )
    }
}

fn refuse(id: &str, options: &[(&str, bool)]) -> Result<(), Failure> {
    match options.iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(Failure::with_help(
            USAGE,
            format!("{option} does not belong to effect {id:?}"),
            "see `drivebench add --help`",
        )),
        None => Ok(()),
    }
}

/// The effect that the options define. A table takes from `model` the parameter that its curve would hold as well.
pub(super) fn effect(
    id: &str,
    arguments: &DefinitionArguments,
    model: &mut Model,
    evidence: &Evidence,
) -> Result<&'static dyn Effect, Failure> {
    if effect::family(id).is_some_and(|family| family.id == "custom") {
        custom(id, arguments)
    } else {
        table(id, arguments, model, evidence)
    }
}

fn custom(id: &str, arguments: &DefinitionArguments) -> Result<&'static dyn Effect, Failure> {
    refuse(
        id,
        &[
            ("--axis", arguments.axis.is_some()),
            ("--knots", !arguments.knots.is_empty()),
        ],
    )?;
    let mut settings = toml::Table::new();
    for (key, value) in [
        ("equation", &arguments.equation),
        ("expression", &arguments.expression),
    ] {
        let Some(value) = value else {
            return Err(Failure::with_help(
                USAGE,
                format!("effect {id:?} needs --{key}"),
                "as --equation torque --expression 'a*abs(w)*w' --parameter a",
            ));
        };
        settings.insert(key.to_owned(), value.as_str().into());
    }
    let mut parameters = toml::Table::new();
    for text in &arguments.parameters {
        let (name, value) = parameter(text)?;
        if parameters.insert(name.clone(), value).is_some() {
            return Err(Failure::with_help(
                USAGE,
                format!("parameter `{name}` stands twice"),
                "each name once",
            ));
        }
    }
    settings.insert("parameters".to_owned(), parameters.into());
    let (effect, _) = effect::define(id, &settings)
        .map_err(|error| failure(&error, arguments.expression.as_deref()))?;
    Ok(effect)
}

/// `a`, `a=1e-6` or `a={ guess = 10, min = 1 }`.
fn parameter(text: &str) -> Result<(String, toml::Value), Failure> {
    let Some((name, value)) = text.split_once('=') else {
        return Ok((text.trim().to_owned(), toml::Table::new().into()));
    };
    let line = format!("value = {}", value.trim());
    let mut table: toml::Table = line.parse().map_err(|_| {
        Failure::with_help(
            USAGE,
            format!("--parameter {text:?} cannot be read"),
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
            let column = expression[..offset.min(expression.len())].chars().count();
            format!(
                "expression, column {}: {}\n  {expression}\n  {}^",
                column + 1,
                error.message,
                " ".repeat(column)
            )
        }
        _ => error.message.clone(),
    };
    Failure::with_help(USAGE, headline, error.help.clone())
}

fn table(
    id: &str,
    arguments: &DefinitionArguments,
    model: &mut Model,
    evidence: &Evidence,
) -> Result<&'static dyn Effect, Failure> {
    refuse(
        id,
        &[
            ("--expression", arguments.expression.is_some()),
            ("--parameter", !arguments.parameters.is_empty()),
        ],
    )?;
    let known = || {
        let keys: Vec<&str> = Axis::ALL.into_iter().map(Axis::key).collect();
        keys.join(", ")
    };
    let Some(axis) = arguments.axis.as_deref() else {
        return Err(Failure::with_help(
            USAGE,
            format!("effect {id:?} needs --axis"),
            format!("one of {}", known()),
        ));
    };
    let axis = Axis::from_key(axis)
        .ok_or_else(|| Failure::with_help(USAGE, format!("axis {axis:?} is not known"), known()))?;
    let default = if axis == Axis::Current {
        "voltage"
    } else {
        "torque"
    };
    let equation = arguments.equation.as_deref().unwrap_or(default);
    let fit = output_error::fit(
        std::slice::from_ref(model),
        &evidence.training,
        &evidence.noise,
    )?;
    let knots = if arguments.knots.is_empty() {
        let found = chosen(
            axis_map(&fit.model, &evidence.training, &evidence.noise)?,
            equation,
            axis,
        )?;
        output::message(&found.sentence);
        found.knots.into_iter().map(curve::four_digits).collect()
    } else {
        arguments.knots.clone()
    };
    let effect = curve::table(id, equation, axis, &knots).map_err(|error| failure(&error, None))?;
    if let Some(held) = curve::hold_what_the_curve_holds(model, &fit.model, id, equation, axis) {
        output::message(&format!(
            "{held} is held: the curve would explain it as well"
        ));
    }
    output::message("provisional: the curve holds what the data show, not why; look for its cause");
    Ok(effect)
}

fn chosen(maps: Vec<AxisMap>, equation: &str, axis: Axis) -> Result<AxisMap, Failure> {
    let axes: Vec<String> = maps
        .iter()
        .filter(|map| Axis::from_key(map.axis).is_some())
        .map(|map| {
            format!(
                "{} over {} ({:.0} %)",
                map.equation,
                map.axis,
                100.0 * map.r2.max(0.0)
            )
        })
        .collect();
    maps.into_iter()
        .find(|map| map.equation == equation && map.axis == axis.key())
        .ok_or_else(|| {
            Failure::with_help(
                USAGE,
                format!(
                    "the run gives no curve of the {equation} error over {}",
                    axis.key()
                ),
                format!("it gives {}; or give --knots", axes.join(", ")),
            )
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_is_a_name_with_or_without_what_is_known() {
        let empty = toml::Value::Table(toml::Table::new());
        assert_eq!(parameter("a").unwrap(), ("a".to_owned(), empty));
        assert_eq!(
            parameter("ws = 1e1").unwrap(),
            ("ws".to_owned(), 10.0.into())
        );
        let (name, value) = parameter("c={ guess = 10, min = 1 }").unwrap();
        assert_eq!(
            (name.as_str(), value["guess"].as_integer()),
            ("c", Some(10))
        );
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
        assert!(
            error.contains("column 3: unknown name `ww`\n  a*ww\n    ^"),
            "{error}"
        );
        assert!(arguments.refuse_for("viscous_friction").is_err());
        assert!(
            DefinitionArguments::default()
                .refuse_for("viscous_friction")
                .is_ok()
        );
    }
}
