//! `custom`: the user's own expression in the voltage or the torque balance.
//!
//! ```text
//! text --grammar--> Tree ---> Expression (value, second derivatives)
//!                                         |
//! parameters {value, guess, min, max, unit} --roles--> coefficient (linear in it) or shape (not)
//!                                         '--> sgn(w) in a torque: friction level, with true stiction
//! ```
//!
//! In a torque that is linear in `sgn(w)`, the factor of `sgn(w)` joins the Coulomb level: it is always against the motion and
//! holds the shaft at rest. Any other jump at standstill, as of `tanh(1000*w)`, is an explicit torque with which a simulation
//! chatters.

mod expression;
mod parameters;

use expression::{ANGLE, DIRECTION, Expression, MOST_NAMES, PARAMETERS, VARIABLES};
use parameters::Declared;

use super::definition::{
    Defined, DefinitionError, Layout, balance_of, interned, leaked, text_of, unknown_key,
};
use super::grammar::sign;
use super::{
    Balance, Card, Effect, Enters, Formula, Instant, ParameterSpec, Place, Sums, Terms, Tree,
    formula,
};

/// The family's card: what `effects custom` shows.
pub(super) const CARD: Card = Card {
    id: "custom",
    name: "own expression",
    // In one of both, by its settings.
    enters: Enters::Both,
    equation: "T or U = expression in u, i, w, theta, t and named parameters",
    causes: "a property of the machine that the catalogue does not contain",
    looks_like: "as the expression: a parameter in which it is linear is a coefficient, any other is a shape that \
                 needs a guess; sgn(w) in a torque is friction with stiction, any other jump at standstill chatters",
    excite: "over the range of the variables of the expression",
    remedy: "that of the cause",
    ..Card::PLAIN
};

/// Builds the effect from its settings; gives the values that stand in `parameters`, too.
pub(super) fn define(id: &str, settings: &toml::Table) -> Defined {
    let allowed = ["id", "equation", "expression", "parameters"];
    if let Some(key) = settings.keys().find(|key| !allowed.contains(&key.as_str())) {
        return Err(unknown_key(key, &allowed));
    }
    let balance = balance_of(settings)?;
    let text = text_of(settings, "expression", "a*abs(w)*w")?;
    if text.len() > 500 {
        let length = text.len();
        let message = format!("expression has {length} characters, at most 500 are allowed");
        let help = "split it into two effects, custom_one and custom_two";
        return Err(DefinitionError::new("expression", message, help));
    }
    let mut declared = parameters::read(settings.get("parameters"))?;
    let most = MOST_NAMES - PARAMETERS;
    if declared.len() > most {
        let message = format!("{} parameters, at most {most} are allowed", declared.len());
        let help = "a model with as many cannot be identified from one run";
        return Err(DefinitionError::new("parameters", message, help));
    }
    let compile = |declared: &[Declared]| {
        let names: Vec<&str> = declared.iter().map(|one| one.name.as_str()).collect();
        Expression::new(text, &names).map_err(|mistake| DefinitionError {
            offset: Some(mistake.offset),
            ..DefinitionError::new("expression", mistake.message, mistake.help)
        })
    };
    let expression = compile(&declared)?;
    for (index, one) in declared.iter().enumerate() {
        if !expression.has(PARAMETERS + index) {
            let message = format!("parameter `{}` is not in the expression", one.name);
            let help = "take it out, or use it in the expression";
            return Err(DefinitionError::new("parameters", message, help));
        }
    }
    let linear = coefficients(&expression, declared.len());
    for (index, one) in declared.iter_mut().enumerate() {
        one.is_coefficient = linear.contains(&(PARAMETERS + index));
    }
    if linear.is_empty() {
        return Err(DefinitionError::new(
            "expression",
            "the expression is linear in none of its parameters, or has a part without a parameter, so that no \
             coefficient gives its size",
            format!("write size*({text}) with a parameter `size`"),
        ));
    }
    // The first parameter gives the size.
    declared.sort_by_key(|one| !one.is_coefficient);
    let values: Vec<Option<f64>> = declared.iter().map(|one| one.value).collect();
    let mut key = format!("{id}|{balance:?}|{text}");
    for one in &mut declared {
        one.complete()?;
        key.push_str(&one.key());
    }
    let expression = compile(&declared)?;
    let effect = interned(&key, || {
        let splits = balance == Balance::Torque
            && expression.has(DIRECTION)
            && expression.is_affine_in(&[DIRECTION]);
        let specs: Vec<ParameterSpec> = declared.iter().map(Declared::spec).collect();
        Box::new(Custom {
            card: Card {
                id: leaked(id),
                name: leaked(if id == CARD.id { CARD.name } else { id }),
                enters: balance.into(),
                equation: leaked(text),
                needs_angle: expression.has(ANGLE),
                parameters: specs.leak(),
                ..CARD
            },
            body: Box::leak(Box::new(Body { expression, balance, splits })),
            declared,
        })
    });
    Ok((effect, values))
}

/// The parameters that give the expression its size: the most in which it is linear together, of those sets that come
/// up when the parameters are taken in turn from each of them.
fn coefficients(expression: &Expression, parameters: usize) -> Vec<usize> {
    let mut most = Vec::new();
    for first in 0..parameters {
        let mut set: Vec<usize> = Vec::new();
        for step in 0..parameters {
            set.push(PARAMETERS + (first + step) % parameters);
            if !expression.is_affine_in(&set) {
                set.pop();
            }
        }
        if set.len() > most.len() && expression.is_linear_in(&set) {
            most = set;
        }
    }
    most
}

struct Custom {
    card: Card,
    body: &'static Body,
    declared: Vec<Declared>,
}

struct Body {
    expression: Expression,
    balance: Balance,
    /// Whether the factor of `sgn(w)` is a friction level.
    splits: bool,
}

impl Effect for Custom {
    fn card(&self) -> &Card {
        &self.card
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        let mut all = [0.0; MOST_NAMES];
        all[PARAMETERS..PARAMETERS + values.len()].copy_from_slice(values);
        Box::new(Evaluated { body: self.body, all })
    }

    fn formula(&self) -> Option<Vec<Formula>> {
        let keys: Vec<&str> = self.card.parameters.iter().map(|spec| spec.key).collect();
        let whole = formula::read(self.card.equation, &keys)?;
        let one = |place, tree| Formula { place, tree };
        if self.body.balance == Balance::Voltage {
            return Some(vec![one(Place::Voltage, whole)]);
        }
        if !self.body.splits {
            return Some(vec![one(Place::Torque, whole)]);
        }
        // As in `split`: the factor of sgn(w) at rest, where it is positive, is the level of a friction.
        let at_rest = |direction: f64| {
            whole.replaced(&|part: &Tree| match part {
                Tree::Name(formula::SPEED) => Some(Tree::Number(0.0)),
                sign if sign.is_sign_of(formula::SPEED) => Some(Tree::Number(direction)),
                _ => None,
            })
        };
        let jump = at_rest(1.0).both('-', at_rest(0.0));
        let level = jump.clone().both('+', jump.call("abs"));
        let level = Tree::Number(0.5).both('*', level);
        let direction = Tree::Name(formula::SPEED).call("sgn");
        let torque = whole.both('-', direction.both('*', level.clone()));
        Some(vec![one(Place::Torque, torque), one(Place::Friction, level)])
    }

    fn settings(&self) -> Vec<(&'static str, toml::Value)> {
        vec![
            ("equation", self.body.balance.key().into()),
            ("expression", self.card.equation.into()),
        ]
    }

    fn layout(&self) -> Layout {
        Layout::Table("parameters")
    }

    fn written(&self, parameter: usize, value: Option<f64>) -> Option<toml::Value> {
        Some(self.declared[parameter].written(value))
    }
}

struct Evaluated {
    body: &'static Body,
    /// Variables, `sgn(w)`, parameters.
    all: [f64; MOST_NAMES],
}

impl Evaluated {
    fn value(&self, at: &Instant, direction: f64) -> f64 {
        let mut all = self.all;
        all[..VARIABLES.len()].copy_from_slice(&[
            at.voltage_v,
            at.current_a,
            at.speed_rad_s,
            at.angle.rad(),
            at.time_s,
        ]);
        all[DIRECTION] = direction;
        self.body.expression.value(&all)
    }

    /// `(torque, friction level)`. A friction level holds the shaft and is never below zero, so the factor of `sgn(w)` is one
    /// only as far as it is positive at rest; the remainder is a torque, as `a*w` in `(b + a*w)*sgn(w)`.
    fn split(&self, at: &Instant) -> (f64, f64) {
        let direction = sign(at.speed_rad_s);
        if !self.body.splits {
            return (self.value(at, direction), 0.0);
        }
        let at_rest = Instant { speed_rad_s: 0.0, ..*at };
        let level = (self.value(&at_rest, 1.0) - self.value(&at_rest, 0.0)).max(0.0);
        let level = if level.is_finite() { level } else { 0.0 };
        (self.value(at, direction) - direction * level, level)
    }
}

impl Terms for Evaluated {
    fn voltage_v(&self, at: &Instant, own: &[f64]) -> f64 {
        self.sums(at, own).voltage_v
    }

    fn torque_n_m(&self, at: &Instant, own: &[f64]) -> f64 {
        self.sums(at, own).torque_n_m
    }

    fn friction_n_m(&self, at: &Instant) -> f64 {
        self.sums(at, &[]).friction_n_m
    }

    fn add_to(&self, sums: &mut Sums, at: &Instant, _own: &[f64]) {
        if self.body.balance == Balance::Voltage {
            sums.voltage_v += self.value(at, sign(at.speed_rad_s));
            return;
        }
        let (torque_n_m, friction_n_m) = self.split(at);
        sums.torque_n_m += torque_n_m;
        sums.friction_n_m += friction_n_m;
    }
}

#[cfg(test)]
mod tests;
