//! A formula in the notation of another language, with no more parentheses than it needs.

use super::Target;
use drivebench_model::plant::REFERENCE_SUPPLY_V;
use drivebench_model::plant::effect::{SYMBOLS, Tree};

/// What the names of a formula mean where it is written.
pub(super) struct Names<'a> {
    /// The program's own prefix, where a language has no other way to keep names apart.
    pub(super) program: &'a str,
    pub(super) effect: &'a str,
    pub(super) keys: &'a [&'static str],
    /// Number of the effect's state among all.
    pub(super) state: usize,
}

/// A tree in the symbols of the equations.
pub(super) fn plain(tree: &Tree, keys: &[&'static str]) -> String {
    let language = Language { target: None, instant: [""; 5], parameter: "" };
    let names = Names { program: "", effect: "", keys, state: 0 };
    language.bare(tree, &names).0
}

pub(super) struct Language {
    /// `None`: the symbols of the equations themselves.
    target: Option<Target>,
    /// Names of voltage, current, speed, angle and time.
    instant: [&'static str; 5],
    /// Before the name of a parameter.
    parameter: &'static str,
}

use Precedence::{Atom, Power, Product, Sign, Sum};

/// Operator precedence, the loosest first; the right side of an operator that is not associative must bind tighter.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Precedence {
    Sum,
    Product,
    Sign,
    Power,
    Atom,
}

impl Language {
    pub(super) const fn of(target: Target) -> Self {
        let (instant, parameter) = match target {
            Target::C => (
                ["voltage_v", "s->current_a", "s->speed_rad_s", "s->angle_rad", "s->time_s"],
                "p->",
            ),
            Target::Python => (["voltage_v", "s[0]", "s[1]", "s[2]", "s[3]"], "self."),
            Target::Matlab => (["voltage_v", "s(1)", "s(2)", "s(3)", "s(4)"], "p."),
            Target::Modelica => (["voltage_v", "i", "w", "angle_rad", "time"], ""),
        };
        Self { target: Some(target), instant, parameter }
    }

    /// The state of an effect, which is the `number`th of all.
    pub(super) fn state(&self, effect: &str, number: usize) -> String {
        match self.target {
            Some(Target::C) => format!("s->{effect}"),
            Some(Target::Python) => format!("s[{}]", 4 + number),
            Some(Target::Matlab) => format!("s({})", 5 + number),
            Some(Target::Modelica) => format!("{effect}_state"),
            None => "x".to_owned(),
        }
    }

    /// The tree as a term of a sum.
    pub(super) fn written(&self, tree: &Tree, names: &Names<'_>) -> String {
        let text = self.bound(tree, names, Product);
        // A sign does not follow an operator.
        if text.starts_with('-') { format!("({text})") } else { text }
    }

    /// The tree as the operand of an operator of this precedence.
    fn bound(&self, tree: &Tree, names: &Names<'_>, least: Precedence) -> String {
        let (text, strength) = self.bare(tree, names);
        if strength < least { format!("({text})") } else { text }
    }

    fn bare(&self, tree: &Tree, names: &Names<'_>) -> (String, Precedence) {
        match tree {
            Tree::Number(value) if *value < 0.0 => (format!("{value:?}"), Sign),
            Tree::Number(value) => (format!("{value:?}"), Atom),
            Tree::Name(index) => (self.name(*index, names), Atom),
            Tree::Call(function, argument) => {
                let (argument, _) = self.bare(argument, names);
                let function = self.function(function, names);
                (format!("{function}({argument})"), Atom)
            }
            Tree::Both(zero, '-', value) if **zero == Tree::Number(0.0) => {
                (format!("-{}", self.bound(value, names, Power)), Sign)
            }
            Tree::Both(base, '^', exponent) if self.target == Some(Target::C) => {
                let (base, _) = self.bare(base, names);
                let (exponent, _) = self.bare(exponent, names);
                (format!("pow({base}, {exponent})"), Atom)
            }
            Tree::Both(left, operator, right) => {
                let (sign, strength, least) = match operator {
                    '+' => (" + ", Sum, (Sum, Sum)),
                    '-' => (" - ", Sum, (Sum, Product)),
                    '*' => (" * ", Product, (Product, Sign)),
                    '/' => (" / ", Product, (Product, Sign)),
                    _ if self.target == Some(Target::Python) => ("**", Power, (Atom, Atom)),
                    _ => ("^", Power, (Atom, Atom)),
                };
                let left = self.bound(left, names, least.0);
                let right = self.bound(right, names, least.1.max(strength));
                // A sign does not follow an operator.
                let right = if right.starts_with('-') { format!("({right})") } else { right };
                (format!("{left}{sign}{right}"), strength)
            }
        }
    }

    fn name(&self, index: usize, names: &Names<'_>) -> String {
        let parameter = |key: &str| format!("{}{key}", self.parameter);
        match SYMBOLS.get(index) {
            Some(symbol) if self.target.is_none() => (*symbol).to_owned(),
            None if self.target.is_none() => parameter(names.keys[index - SYMBOLS.len()]),
            None => parameter(&format!("{}_{}", names.effect, names.keys[index - SYMBOLS.len()])),
            Some(&"R") => parameter("resistance_ohm"),
            Some(&"Ke") => parameter("back_emf_v_s_per_rad"),
            Some(&"Kt") => parameter("torque_n_m_per_a"),
            Some(&"U") => format!("{REFERENCE_SUPPLY_V:?}"),
            Some(&"x") => self.state(names.effect, names.state),
            Some(_) => self.instant[index].to_owned(),
        }
    }

    fn function(&self, function: &str, names: &Names<'_>) -> String {
        let name = match (self.target, function) {
            (None, _) | (Some(Target::Python), "abs" | "sgn") => return function.to_owned(),
            (Some(Target::C), "sgn") => return format!("{}_sgn", names.program),
            (Some(Target::C), "abs") => "fabs",
            (_, "sgn") => "sign",
            (_, "ln") => "log",
            (_, other) => other,
        };
        match self.target {
            Some(Target::Python) => format!("math.{name}"),
            _ => name.to_owned(),
        }
    }
}
