//! A user's expression, compiled: its value and how its parameters enter.

use std::fmt::Debug;

use exmex::{BinOp, Differentiate, Express, FlatEx, FloatOpsFactory, MakeOperators, Operator};

use crate::config_text::help_for_unknown;
use crate::plant::effect::grammar::{self, Mistake, Written, sign};

/// Variables of every expression, before the parameters.
pub(super) const VARIABLES: [&str; 5] = ["u", "i", "w", "theta", "t"];
const SPEED: usize = 2;
pub(super) const ANGLE: usize = 3;
/// Index under which `sgn(w)` is handed to the expression.
pub(super) const DIRECTION: usize = VARIABLES.len();
/// Index of the first parameter.
pub(super) const PARAMETERS: usize = DIRECTION + 1;

/// The operators of the library, but a sign that is zero at zero and a power that is fast where it is a square.
#[derive(Clone, Debug)]
struct Operators;

impl MakeOperators<f64> for Operators {
    fn make<'a>() -> Vec<Operator<'a, f64>> {
        let mut all = FloatOpsFactory::<f64>::make();
        all.retain(|operator| operator.repr() != "^");
        all.push(Operator::make_bin(
            "^",
            BinOp {
                apply: power,
                prio: 4,
                is_commutative: false,
            },
        ));
        all.push(Operator::make_unary("sgn", sign));
        all
    }
}

#[expect(clippy::float_cmp, reason = "an exponent that is written as 2 is 2")]
fn power(base: f64, exponent: f64) -> f64 {
    if exponent == 2.0 {
        base * base
    } else {
        base.powf(exponent)
    }
}

type Compiled = FlatEx<f64, Operators>;

pub(super) struct Expression {
    compiled: Compiled,
    /// Where the values of the compiled expression's variables stand among all.
    takes: Vec<usize>,
    written: Written,
    /// Number of variables, `sgn(w)` and parameters together.
    all: usize,
}

impl Expression {
    /// Parses and compiles `text` with these parameters.
    pub(super) fn new(text: &str, parameters: &[&str]) -> Result<Self, Mistake> {
        let names = |name: &str| {
            let variable = VARIABLES.iter().position(|known| *known == name);
            let parameter = || {
                let found = parameters.iter().position(|known| *known == name)?;
                Some(PARAMETERS + found)
            };
            variable.or_else(parameter).ok_or_else(|| {
                let known: Vec<&str> = VARIABLES.iter().chain(parameters).copied().collect();
                let functions = grammar::FUNCTIONS.iter().copied();
                let all: Vec<&str> = known.iter().copied().chain(functions).collect();
                match crate::config_text::nearest(name, all.iter().copied()) {
                    Some(_) if name.len() > 1 => help_for_unknown(name, all.iter().copied()),
                    _ => format!("variables and parameters: {}", known.join(", ")),
                }
            })
        };
        let written = Written::of(&grammar::read(text, &names)?, SPEED, DIRECTION);
        let compiled = Compiled::parse(&written.value).map_err(|error| Mistake {
            offset: 0,
            message: format!("the expression cannot be compiled: {error}"),
            help: "simplify it".to_owned(),
        })?;
        let all = PARAMETERS + parameters.len();
        let index = |name: &String| (0..all).find(|index| grammar::variable(*index) == *name);
        let takes = compiled.var_names().iter().filter_map(index).collect();
        Ok(Self {
            compiled,
            takes,
            written,
            all,
        })
    }

    /// Whether the variable or parameter with this index stands in it.
    pub(super) fn has(&self, index: usize) -> bool {
        self.takes.contains(&index)
    }

    /// Value for the values of all variables and parameters.
    #[inline]
    pub(super) fn value(&self, all: &[f64]) -> f64 {
        let mut taken = [0.0; MOST_NAMES];
        for (to, from) in taken.iter_mut().zip(&self.takes) {
            *to = all[*from];
        }
        self.compiled
            .eval(&taken[..self.takes.len()])
            .unwrap_or(f64::NAN)
    }

    /// Whether the expression is proportional to all of `indices` together: straight in them, and nothing is left where
    /// they are zero.
    pub(super) fn is_linear_in(&self, indices: &[usize]) -> bool {
        self.is_affine_in(indices) && self.is_scaled_by(indices)
    }

    /// Whether the expression is straight in all of `indices` together: every second derivative among them vanishes.
    /// The derivatives are symbolic; whether one is zero is seen from its values at some points. What a derivative
    /// cannot see, a corner at zero as in `abs(a)`, is excluded by comparing both sides of zero.
    pub(super) fn is_affine_in(&self, indices: &[usize]) -> bool {
        indices.iter().enumerate().all(|(place, one)| {
            let mut others = indices[place..].iter();
            others.all(|other| self.second_derivative_vanishes(*one, *other))
                && self.is_straight_through_zero(*one)
        })
    }

    /// Whether the value is zero, twofold or opposite where all of `indices` are.
    fn is_scaled_by(&self, indices: &[usize]) -> bool {
        let mut seen = false;
        points(self.all).all(|point| {
            let at = |factor: f64| {
                let mut scaled = point.clone();
                for index in indices {
                    scaled[*index] *= factor;
                }
                self.value(&scaled)
            };
            let (one, near) = (at(1.0), 1e-9 * at(1.0).abs());
            let errors = [at(0.0), at(2.0) - 2.0 * one, at(-1.0) + one];
            // Where the expression has no value it shows nothing.
            let is_known = one.is_finite() && errors.iter().all(|error| error.is_finite());
            seen |= is_known;
            !is_known || errors.iter().all(|error| error.abs() <= near)
        }) && seen
    }

    fn second_derivative_vanishes(&self, one: usize, other: usize) -> bool {
        if !self.has(one) || !self.has(other) {
            return true;
        }
        let Ok(smooth) = Compiled::parse(&self.written.smooth) else {
            return false;
        };
        // Differentiated twice, the expression is of a size with its first derivative where it is not linear.
        let names = smooth.var_names();
        let place = |index: usize| {
            let name = grammar::variable(index);
            names.iter().position(|known| *known == name)
        };
        // What stands within signs only has no derivative there.
        let (Some(one), Some(other)) = (place(one), place(other)) else {
            return true;
        };
        let taken = names.len();
        let first = smooth.partial(one);
        let second = first.clone().and_then(|first| first.partial(other));
        let (Ok(first), Ok(second)) = (first, second) else {
            return false;
        };
        let values: Vec<[f64; 2]> = points(taken)
            .filter_map(|point| Some([first.eval(&point).ok()?, second.eval(&point).ok()?]))
            .filter(|pair| pair.iter().all(|value| value.is_finite()))
            .collect();
        let vanishes = |[first, second]: &[f64; 2]| second.abs() <= 1e-9 * first.abs();
        !values.is_empty() && values.iter().all(vanishes)
    }

    fn is_straight_through_zero(&self, index: usize) -> bool {
        points(self.all).all(|mut point| {
            let size = point[index];
            let mut at = |value: f64| {
                point[index] = value;
                self.value(&point)
            };
            let (left, middle, right) = (at(-size), at(0.0), at(size));
            let bend = (left + right - 2.0 * middle).abs();
            // Where the expression has no value it shows no bend either.
            bend.is_nan() || bend <= 1e-9 * (left.abs() + middle.abs() + right.abs())
        })
    }
}

/// Names that an expression may hold.
pub(super) const MOST_NAMES: usize = 24;

/// Points with coordinates between 0.2 and 1.8, spread by the golden ratio and its powers.
fn points(dimensions: usize) -> impl Iterator<Item = Vec<f64>> {
    (1..=7).map(move |point| {
        (0..dimensions)
            .map(|axis| {
                let step = 0.618_033_988_749_895 + 0.137 * axis as f64;
                0.2 + 1.6 * (f64::from(point) * step).fract()
            })
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str, w: f64, a: f64) -> f64 {
        let expression = Expression::new(text, &["a"]).unwrap();
        expression.value(&[10.0, 2.0, w, 0.5, 3.0, sign(w), a])
    }

    #[test]
    fn the_usual_rules_of_precedence_hold() {
        for (text, expected) in [
            ("-w^2", -9.0),
            ("exp(-(w/3)^2)", (-1.0_f64).exp()),
            ("2^3^2", 512.0),
            ("12/2*3", 18.0),
            ("2*12/4/3", 2.0),
            ("10-4-3", 3.0),
            ("10-4+3", 9.0),
            ("a*-w", -6.0),
            ("2^-1", 0.5),
            ("1e-3*w + 1.5E2", 150.003),
            ("--w", 3.0),
            ("cos(pi)*u", -10.0),
            ("abs(-w)*sgn(w)*i*theta*t", 9.0),
            ("sgn(0)", 0.0),
            ("sign(0-w)", -1.0),
            ("tanh(0)+sqrt(w^2)", 3.0),
        ] {
            assert!((value(text, 3.0, 2.0) - expected).abs() < 1e-12, "{text}");
        }
    }

    #[test]
    fn linearity_is_seen_through_functions_and_products() {
        let linear = |text: &str, names: &str| {
            let expression = Expression::new(text, &["a", "b"]).unwrap();
            let index = |name: char| PARAMETERS + usize::from(name == 'b');
            let indices: Vec<usize> = names.chars().map(index).collect();
            expression.is_linear_in(&indices)
        };
        for (text, names, expected) in [
            ("a*abs(w)*w + b*sin(3*theta)", "ab", true),
            ("a*exp(-(w/b)^2)*sgn(w)", "a", true),
            ("a*exp(-(w/b)^2)*sgn(w)", "b", false),
            ("a*(w + b*w^2)", "ab", false),
            // Straight in b, but at b = 0 a part is left: b is no size of it.
            ("a*(w + b*w^2)", "b", false),
            ("a + b*w", "b", false),
            ("a + b*w", "ab", true),
            ("0.1 + a*w", "a", false),
            ("w*sgn(a)", "a", false),
            ("a*sgn(w - sgn(i)*sgn(b - w))", "a", true),
            ("abs(a)*w", "a", false),
            ("abs(a*w)", "a", false),
            ("a^2*w", "a", false),
            ("w*sqrt(a)", "a", false),
            ("tanh(a*w)", "a", false),
            ("a/(1+b*abs(w))", "a", true),
        ] {
            assert_eq!(linear(text, names), expected, "{text} in {names}");
        }
    }
}
