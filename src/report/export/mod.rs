//! A model, the gains of its regulator, and a measured torque map, as source text of other languages.
//!
//! ```text
//! Model --(formula of each effect, as a tree)--> terms of the equations --.
//! PiGains, what holds a speed --------------------------------------------+--> template of the language --> one file
//! TorqueMap ----------------------------------------------------------------> C with its interpolation
//! ```
//!
//! Every target integrates the same equations: the classical Runge-Kutta method in steps that follow the fastest motion,
//! cut where the speed comes to zero; Modelica leaves that to its tool. What has no formula is refused by its name.

mod map;
mod notation;

pub use map::map_as_c;

use notation::{Language, Names};
use thiserror::Error;

use drivebench_control::{Holding, PiGains};
use drivebench_model::plant::effect::Place;
use drivebench_model::plant::{
    ActiveEffect, Enters, Input, Model, ModelError, MotorKey, Path, Plant,
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    C,
    Python,
    Matlab,
    Modelica,
}

#[derive(Clone, Debug, Error, PartialEq)]
pub enum ExportError {
    #[error("effect {id:?} cannot be exported: {reason}")]
    Effect { id: String, reason: String },
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error("gains cannot be exported to modelica")]
    Gains,
    #[error("gains with a notch cannot be exported")]
    Notch,
}

impl ExportError {
    pub fn help(&self) -> String {
        match self {
            Self::Effect { id, .. } => format!(
                "nothing is left out silently: `drivebench remove {id}` makes a model without it, and --to json has every effect"
            ),
            Self::Model(error) => error.help().to_owned(),
            Self::Notch => {
                "nothing is left out silently: --to json has the notch, its frequency, damping and depth".to_owned()
            }
            Self::Gains => {
                "leave --gains out and take Modelica.Blocks.Continuous.LimPID with them, or export to c, python or matlab"
                    .to_owned()
            }
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Regulator {
    pub gains: PiGains,
    pub holding: Holding,
    pub period_s: f64,
    /// Age of the measurement relative to the limited output, s.
    pub leaving_s: f64,
    pub limit_v: f64,
}

impl Regulator {
    pub fn values(&self) -> [(&'static str, f64); 8] {
        [
            ("proportional_v_s_per_rad", self.gains.proportional),
            ("integral_time_s", self.gains.integral_time_s),
            ("reference_filter_s", self.gains.reference_filter_s),
            ("period_s", self.period_s),
            ("limit_v", self.limit_v),
            ("holding_v_s_per_rad", self.holding.per_speed),
            ("holding_v", self.holding.against),
            ("leaving_s", self.leaving_s),
        ]
    }
}

pub struct Export {
    /// Its name in the exported language.
    name: String,
    title: String,
    parameters: Vec<(String, f64, &'static str)>,
    terms: Vec<Term>,
    /// Effects with a state, in the order of their states.
    states: Vec<&'static str>,
    longest_step_s: f64,
    regulator: Option<Regulator>,
}

/// A formula of an effect, which names its parameters and its state.
struct Term {
    effect: &'static str,
    keys: Vec<&'static str>,
    formula: drivebench_model::plant::effect::Formula,
}

impl Export {
    /// `title`: what it is and where it comes from.
    pub fn new(
        model: &Model,
        regulator: Option<Regulator>,
        name: &str,
        title: &str,
    ) -> Result<Self, ExportError> {
        model.require_complete()?;
        if regulator.is_some_and(|regulator| regulator.gains.notch.is_some()) {
            return Err(ExportError::Notch);
        }
        let longest_step_s = Plant::new(model, Input::Voltage)?.runge_kutta_step_s();
        let mut parameters = Vec::new();
        for key in MotorKey::ALL {
            let value = match key {
                MotorKey::TorqueConstant => model.motor.torque_constant(),
                other => model.motor.get(other),
            };
            let unset = || ModelError::Unset { key: key.key().to_owned() };
            parameters.push((key.key().to_owned(), value.ok_or_else(unset)?, key.unit()));
        }
        let (mut terms, mut states) = (Vec::new(), Vec::new());
        for active in &model.effects {
            let id = active.id();
            if is_zero_path(active) {
                continue;
            }
            let formulas = active.effect.formula().ok_or_else(|| ExportError::Effect {
                id: id.to_owned(),
                reason: why_no_formula(active),
            })?;
            let specs = active.effect.parameters().iter();
            for (spec, value) in specs.clone().zip(active.values_or_guess()) {
                parameters.push((format!("{id}_{}", spec.key), value, spec.unit));
            }
            for formula in formulas {
                if formula.place == Place::StateRate {
                    states.push(id);
                }
                terms.push(Term {
                    effect: id,
                    keys: specs.clone().map(|spec| spec.key).collect(),
                    formula,
                });
            }
        }
        Ok(Self {
            name: identifier(name),
            title: title.replace("*/", "* /").replace('"', "'"),
            parameters,
            terms,
            states,
            longest_step_s,
            regulator,
        })
    }

    pub fn written(&self, target: Target) -> Result<String, ExportError> {
        if target == Target::Modelica && self.regulator.is_some() {
            return Err(ExportError::Gains);
        }
        let language = Language::of(target);
        let (template, regulator) = match target {
            Target::C => (include_str!("model.h"), include_str!("regulator.h")),
            Target::Python => (include_str!("model.py"), include_str!("regulator.py")),
            Target::Matlab => (include_str!("model.m"), include_str!("regulator.m")),
            Target::Modelica => (include_str!("model.mo"), ""),
        };
        let regulator = self.regulator.map_or("", |_| regulator);
        let mut text = template.replace("{{regulator}}", regulator);
        text = repeated(&text, ["key", "value", "unit"], &self.parameter_rows(target));
        text = repeated(&text, ["effect", "state", "index", "rate"], &self.state_rows(&language));
        let gains = self.regulator.map_or(Vec::new(), |regulator| {
            regulator.values().map(|(key, value)| [key.to_owned(), format!("{value:?}")]).into()
        });
        text = repeated(&text, ["gain_key", "gain"], &gains);
        let regulate = self.regulator.map(|_| ["regulate".to_owned()]);
        text = repeated(&text, ["regulate"], regulate.as_slice());
        let mut fill = |key: &str, value: &str| text = text.replace(&mark(key), value);
        for (key, place) in [
            ("voltage", Place::Voltage),
            ("torque", Place::Torque),
            ("friction", Place::Friction),
            ("current_rate", Place::CurrentRate),
            ("inertia", Place::Inertia),
            ("current_reading", Place::CurrentReading),
            ("speed_reading", Place::SpeedReading),
        ] {
            fill(key, &self.sum(place, &language));
        }
        let names: Vec<String> =
            self.states.iter().map(|effect| format!(", state of {effect}")).collect();
        fill("state_names", &names.concat());
        fill("state_count", &(4 + self.states.len()).to_string());
        let gains: Vec<&str> = gains.iter().map(|[_, value]| value.as_str()).collect();
        fill("gains", &gains.join(", "));
        fill("longest_s", &format!("{:?}", self.longest_step_s));
        fill("title", &self.title);
        fill("name", &self.name);
        fill("Name", &camel(&self.name));
        fill("NAME", &self.name.to_uppercase());
        Ok(text)
    }

    fn parameter_rows(&self, target: Target) -> Vec<[String; 3]> {
        let row = |(key, value, unit): &(String, f64, &str)| {
            // The unit of a number without a unit, in the grammar of Modelica.
            let unit = if target == Target::Modelica && *unit == "-" { "1" } else { *unit };
            [key.clone(), format!("{value:?}"), unit.to_owned()]
        };
        self.parameters.iter().map(row).collect()
    }

    /// Effect, name, index in Matlab and rate of each state.
    fn state_rows(&self, language: &Language) -> Vec<[String; 4]> {
        let rates = self.terms.iter().filter(|term| term.formula.place == Place::StateRate);
        let row = |(number, term): (usize, &Term)| {
            let rate = language.written(&term.formula.tree, &self.names(term));
            let index = (5 + number).to_string();
            [term.effect.to_owned(), language.state(term.effect, number), index, rate]
        };
        rates.enumerate().map(row).collect()
    }

    /// All formulas of a place, zero where there is none.
    fn sum(&self, place: Place, language: &Language) -> String {
        let terms = self.terms.iter().filter(|term| term.formula.place == place);
        let texts: Vec<String> =
            terms.map(|term| language.written(&term.formula.tree, &self.names(term))).collect();
        match &texts[..] {
            [] => "0.0".to_owned(),
            [one] => one.clone(),
            several => several.join(" + "),
        }
    }

    fn names<'a>(&'a self, term: &'a Term) -> Names<'a> {
        Names {
            program: &self.name,
            effect: term.effect,
            keys: &term.keys,
            state: self.states.iter().position(|effect| *effect == term.effect).unwrap_or(0),
        }
    }
}

fn mark(key: &str) -> String {
    format!("{{{{{key}}}}}")
}

/// The template with each of its lines that has one of the marks once for each row of their values.
fn repeated<const N: usize>(text: &str, keys: [&str; N], rows: &[[String; N]]) -> String {
    let marks = keys.map(mark);
    let mut filled = String::new();
    for line in text.split_inclusive('\n') {
        if !marks.iter().any(|mark| line.contains(mark)) {
            filled.push_str(line);
            continue;
        }
        for row in rows {
            let pairs = marks.iter().zip(row);
            filled += &pairs.fold(line.to_owned(), |line, (mark, value)| line.replace(mark, value));
        }
    }
    filled
}

/// The terms of an effect as text in the symbols of the equations and its own parameters, each with what it adds to; `None`
/// where it has no formula.
pub fn formulas(active: &ActiveEffect) -> Option<Vec<(&'static str, String)>> {
    let keys: Vec<&str> = active.effect.parameters().iter().map(|spec| spec.key).collect();
    let written = active.effect.formula()?.into_iter().map(|term| {
        let text = notation::plain(&term.tree, &keys);
        let place = match term.place {
            Place::Voltage => "voltage drop, V",
            Place::Torque => "torque against positive motion, N.m",
            Place::Friction => "friction level, N.m",
            Place::CurrentRate => "relative rate of the current",
            Place::Inertia => "relative inertia",
            Place::StateRate => "rate of the state x",
            Place::CurrentReading => "reading of the current, A",
            Place::SpeedReading => "reading of the speed, rad/s",
        };
        (place, text)
    });
    Some(written.collect())
}

/// Whether it is a delay or filter of zero time in the path of the command or the measurement.
fn is_zero_path(active: &ActiveEffect) -> bool {
    let terms = active.effect.terms(&active.values_or_guess());
    active.effect.card().enters == Enters::Path && terms.path() == Path::default()
}

fn why_no_formula(active: &ActiveEffect) -> String {
    let reason = match active.effect.card().enters {
        Enters::Path => "it delays the command or the measurement, which needs earlier samples",
        _ if active.effect.terms(&active.values_or_guess()).coupling().is_some() => {
            "it is a second inertia with play and friction, and the exported step function has one inertia"
        }
        _ => "its curve closes over a turn of the shaft",
    };
    reason.to_owned()
}

/// A name that every language takes: letters, digits and underscores, a letter first.
pub fn identifier(text: &str) -> String {
    let mut name = String::new();
    for letter in text.trim().chars() {
        match letter {
            _ if letter.is_ascii_alphanumeric() => name.push(letter.to_ascii_lowercase()),
            _ if name.ends_with('_') || name.is_empty() => {}
            _ => name.push('_'),
        }
    }
    let name = name.trim_end_matches('_');
    match name.chars().next() {
        Some(first) if first.is_ascii_alphabetic() => name.to_owned(),
        Some(_) => format!("motor_{name}"),
        None => "motor".to_owned(),
    }
}

/// `zk_22fc` as `Zk22fc`.
fn camel(name: &str) -> String {
    let words = name.split('_').map(|word| {
        let (first, rest) = word.split_at(word.len().min(1));
        first.to_uppercase() + rest
    });
    words.collect()
}

#[cfg(test)]
mod tests;
