//! A user's expression: its value, and in which parameters it is linear.

use crate::config_text::help_for_unknown;
use crate::plant::effect::grammar::{self, FUNCTIONS, Mistake, Tree};

/// Variables of every expression, before the parameters.
pub(super) const VARIABLES: [&str; 5] = ["u", "i", "w", "theta", "t"];
pub(super) const ANGLE: usize = 3;
/// Index of `sgn(w)`, which is a variable of its own.
pub(super) const DIRECTION: usize = VARIABLES.len();
pub(super) const PARAMETERS: usize = DIRECTION + 1;
/// Names that an expression may hold.
pub(super) const MOST_NAMES: usize = 24;

pub(super) struct Expression {
    tree: Tree,
    /// Number of variables, `sgn(w)` and parameters together.
    all: usize,
}

impl Expression {
    pub(super) fn new(text: &str, parameters: &[&str]) -> Result<Self, Mistake> {
        let names = |name: &str| {
            let variable = VARIABLES.iter().position(|known| *known == name);
            let parameter = parameters.iter().position(|known| *known == name);
            variable.or(parameter.map(|parameter| PARAMETERS + parameter)).ok_or_else(|| {
                let known = [&VARIABLES[..], parameters].concat();
                let all = [&known[..], &FUNCTIONS].concat();
                match crate::config_text::nearest(name, all.iter().copied()) {
                    Some(_) if name.len() > 1 => help_for_unknown(name, all.iter().copied()),
                    _ => format!("variables and parameters: {}", known.join(", ")),
                }
            })
        };
        let direction = |part: &Tree| part.is_sign_of(2).then_some(Tree::Name(DIRECTION));
        Ok(Self {
            tree: grammar::read(text, &names)?.replaced(&direction),
            all: PARAMETERS + parameters.len(),
        })
    }

    pub(super) fn has(&self, index: usize) -> bool {
        self.tree.has(index)
    }

    pub(super) fn value(&self, all: &[f64]) -> f64 {
        self.tree.value(all)
    }

    /// Whether the expression is proportional to all of `indices` together: affine in them, and zero where they are zero.
    pub(super) fn is_linear_in(&self, indices: &[usize]) -> bool {
        self.is_affine_in(indices) && self.is_scaled_by(indices)
    }

    /// Whether every second derivative among `indices` vanishes at some points. A corner at zero, as in `abs(a)`, has no second
    /// derivative and is excluded by comparing both sides of zero.
    pub(super) fn is_affine_in(&self, indices: &[usize]) -> bool {
        indices.iter().enumerate().all(|(first, one)| {
            let mut others = indices[first..].iter();
            others.all(|other| self.second_derivative_vanishes(*one, *other))
                && self.is_straight_through_zero(*one)
        })
    }

    /// Homogeneity of degree one: whether the value is zero, twofold or opposite where all of `indices` are.
    fn is_scaled_by(&self, indices: &[usize]) -> bool {
        let mut is_defined = false;
        points(self.all).all(|point| {
            let at = |factor: f64| {
                let mut scaled = point.clone();
                for index in indices {
                    scaled[*index] *= factor;
                }
                self.value(&scaled)
            };
            let (one, tolerance) = (at(1.0), 1e-9 * at(1.0).abs());
            let errors = [at(0.0), at(2.0) - 2.0 * one, at(-1.0) + one];
            // Points without a value are left out.
            let is_finite = one.is_finite() && errors.iter().all(|error| error.is_finite());
            is_defined |= is_finite;
            !is_finite || errors.iter().all(|error| error.abs() <= tolerance)
        }) && is_defined
    }

    fn second_derivative_vanishes(&self, one: usize, other: usize) -> bool {
        if !self.has(one) || !self.has(other) {
            return true;
        }
        // Relative to the first derivative.
        let derivatives = points(self.all).map(|at| self.tree.second_derivative(&at, one, other));
        let mut finite = derivatives.filter(|of| of[1].is_finite() && of[3].is_finite()).peekable();
        finite.peek().is_some() && finite.all(|of| of[3].abs() <= 1e-9 * of[1].abs())
    }

    fn is_straight_through_zero(&self, index: usize) -> bool {
        points(self.all).all(|mut point| {
            let size = point[index];
            let mut at = |value: f64| {
                point[index] = value;
                self.value(&point)
            };
            let (left, middle, right) = (at(-size), at(0.0), at(size));
            let second_difference = (left + right - 2.0 * middle).abs();
            // Points without a value are left out.
            second_difference.is_nan()
                || second_difference <= 1e-9 * (left.abs() + middle.abs() + right.abs())
        })
    }
}

/// Seven points of a Kronecker sequence with coordinates between 0.2 and 1.8: steps by the golden ratio, and by 0.137 more for
/// each dimension.
fn points(dimensions: usize) -> impl Iterator<Item = Vec<f64>> {
    let step = |axis: usize| 0.618_033_988_749_895 + 0.137 * axis as f64;
    let coordinate = move |point: i32, axis| 0.2 + 1.6 * (f64::from(point) * step(axis)).fract();
    (1..=7).map(move |point| (0..dimensions).map(|axis| coordinate(point, axis)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let expression = Expression::new(text, &["a"]).unwrap();
            let value = expression.value(&[10.0, 2.0, 3.0, 0.5, 3.0, 1.0, 2.0]);
            assert!((value - expected).abs() < 1e-12, "{text}");
        }
    }

    #[test]
    fn linearity_is_detected_through_functions_and_products() {
        for (text, names, expected) in [
            ("a*abs(w)*w + b*sin(3*theta)", "ab", true),
            ("a*exp(-(w/b)^2)*sgn(w)", "a", true),
            ("a*exp(-(w/b)^2)*sgn(w)", "b", false),
            ("a*(w + b*w^2)", "ab", false),
            // Affine in b, but not zero at b = 0.
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
            let expression = Expression::new(text, &["a", "b"]).unwrap();
            let index = |name: char| PARAMETERS + usize::from(name == 'b');
            let indices: Vec<usize> = names.chars().map(index).collect();
            assert_eq!(expression.is_linear_in(&indices), expected, "{text} in {names}");
        }
    }
}
