//! Expressions: recursive-descent parser with the position of each mistake, evaluation, and second derivatives by forward-mode
//! automatic differentiation with hyper-dual numbers (AIAA paper 2011-886).
//!
//! ```text
//! sum     = product {("+" | "-") product}
//! product = signed {("*" | "/") signed}
//! signed  = ("+" | "-") signed | power
//! power   = atom ["^" signed]                       so -w^2 = -(w^2) and 2^3^2 = 2^(3^2)
//! atom    = number | name | function "(" sum ")" | "(" sum ")"
//! ```

use std::f64::consts::LN_10;

/// Functions of one argument.
pub(super) const FUNCTIONS: [&str; 17] = [
    "abs", "sgn", "signum", "sqrt", "exp", "ln", "log10", "sin", "cos", "tan", "asin", "acos",
    "atan", "sinh", "cosh", "tanh", "sign",
];
pub(super) const PI: &str = "pi";

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mistake {
    /// Byte at which it was noticed.
    pub offset: usize,
    pub message: String,
    pub help: String,
}

/// A parsed expression; names are indices.
#[derive(Clone, Debug, PartialEq)]
pub enum Tree {
    Number(f64),
    Name(usize),
    /// A function; `signum` and `sign` are read as `sgn`.
    Call(&'static str, Box<Self>),
    /// Left, `+ - * / ^`, right; a sign before a value is a difference from zero.
    Both(Box<Self>, char, Box<Self>),
}

impl Tree {
    pub(super) fn both(self, operator: char, other: Self) -> Self {
        Self::Both(Box::new(self), operator, Box::new(other))
    }

    pub(super) fn call(self, function: &'static str) -> Self {
        Self::Call(function, Box::new(self))
    }

    pub(super) fn is_sign_of(&self, index: usize) -> bool {
        matches!(self, Self::Call("sgn", argument) if **argument == Self::Name(index))
    }

    pub(super) fn has(&self, index: usize) -> bool {
        match self {
            Self::Number(_) => false,
            Self::Name(own) => *own == index,
            Self::Call(_, argument) => argument.has(index),
            Self::Both(left, _, right) => left.has(index) || right.has(index),
        }
    }

    /// The same with some of its parts replaced.
    pub(super) fn replaced(&self, by: &dyn Fn(&Self) -> Option<Self>) -> Self {
        by(self).unwrap_or_else(|| match self {
            Self::Call(function, argument) => Self::Call(function, Box::new(argument.replaced(by))),
            Self::Both(left, operator, right) => {
                left.replaced(by).both(*operator, right.replaced(by))
            }
            Self::Number(_) | Self::Name(_) => self.clone(),
        })
    }

    pub fn value(&self, names: &[f64]) -> f64 {
        match self {
            Self::Number(value) => *value,
            Self::Name(index) => names[*index],
            Self::Call(function, argument) => called(function, argument.value(names)),
            Self::Both(left, operator, right) => {
                let (left, right) = (left.value(names), right.value(names));
                match operator {
                    '+' => left + right,
                    '-' => left - right,
                    '*' => left * right,
                    '/' => left / right,
                    _ => power(left, right),
                }
            }
        }
    }

    /// The value, its derivatives by the names `one` and `other`, and the mixed second derivative.
    pub(super) fn second_derivative(&self, names: &[f64], one: usize, other: usize) -> HyperDual {
        let part = |tree: &Self| tree.second_derivative(names, one, other);
        match self {
            Self::Number(value) => [*value, 0.0, 0.0, 0.0],
            Self::Name(index) => {
                let unit = |name: usize| f64::from(u8::from(*index == name));
                [names[*index], unit(one), unit(other), 0.0]
            }
            Self::Call(function, argument) => {
                let x = part(argument);
                let [first, second] = derivatives(function, x[0]);
                chain([called(function, x[0]), first, second], x)
            }
            Self::Both(left, operator, right) => {
                let (u, v) = (part(left), part(right));
                match operator {
                    '+' => [0, 1, 2, 3].map(|n| u[n] + v[n]),
                    '-' => [0, 1, 2, 3].map(|n| u[n] - v[n]),
                    '*' => product(u, v),
                    '/' => product(u, chain([1.0 / v[0], -v[0].powi(-2), 2.0 * v[0].powi(-3)], v)),
                    _ if v[1..].iter().all(|part| *part == 0.0) => {
                        let (x, n) = (u[0], v[0]);
                        let first = n * x.powf(n - 1.0);
                        chain([power(x, n), first, n * (n - 1.0) * x.powf(n - 2.0)], u)
                    }
                    _ => {
                        let logarithm = chain([u[0].ln(), 1.0 / u[0], -u[0].powi(-2)], u);
                        let exponent = product(v, logarithm);
                        chain([exponent[0].exp(); 3], exponent)
                    }
                }
            }
        }
    }
}

fn called(function: &str, x: f64) -> f64 {
    match function {
        "abs" => x.abs(),
        "sqrt" => x.sqrt(),
        "exp" => x.exp(),
        "ln" => x.ln(),
        "log10" => x.log10(),
        "sin" => x.sin(),
        "cos" => x.cos(),
        "tan" => x.tan(),
        "asin" => x.asin(),
        "acos" => x.acos(),
        "atan" => x.atan(),
        "sinh" => x.sinh(),
        "cosh" => x.cosh(),
        "tanh" => x.tanh(),
        _ => sign(x),
    }
}

/// First and second derivative of a function; the sign has none at zero and zero elsewhere.
fn derivatives(function: &str, x: f64) -> [f64; 2] {
    let value = called(function, x);
    let (under_root, of_atan) = (1.0 - x * x, 1.0 / (1.0 + x * x));
    let of_asin = under_root.powf(-0.5);
    match function {
        "abs" => [sign(x), 0.0],
        "sqrt" => [0.5 / value, -0.25 / (x * value)],
        "exp" => [value; 2],
        "ln" => [1.0 / x, -1.0 / (x * x)],
        "log10" => [1.0 / (x * LN_10), -1.0 / (x * x * LN_10)],
        "sin" => [x.cos(), -value],
        "cos" => [-x.sin(), -value],
        "tan" => [1.0 + value * value, 2.0 * value * (1.0 + value * value)],
        "asin" => [of_asin, x * of_asin / under_root],
        "acos" => [-of_asin, -x * of_asin / under_root],
        "atan" => [of_atan, -2.0 * x * of_atan * of_atan],
        "sinh" => [x.cosh(), value],
        "cosh" => [x.sinh(), value],
        "tanh" => [1.0 - value * value, -2.0 * value * (1.0 - value * value)],
        _ => [0.0; 2],
    }
}

/// Value, two first derivatives and their mixed second one.
type HyperDual = [f64; 4];

/// Chain rule for a function with this value, first and second derivative.
fn chain([value, first, second]: [f64; 3], x: HyperDual) -> HyperDual {
    [value, first * x[1], first * x[2], second * x[1] * x[2] + first * x[3]]
}

fn product(u: HyperDual, v: HyperDual) -> HyperDual {
    [
        u[0] * v[0],
        u[1] * v[0] + u[0] * v[1],
        u[2] * v[0] + u[0] * v[2],
        u[3] * v[0] + u[1] * v[2] + u[2] * v[1] + u[0] * v[3],
    ]
}

#[expect(clippy::float_cmp, reason = "an exponent that is written as 2 is 2")]
fn power(base: f64, exponent: f64) -> f64 {
    if exponent == 2.0 { base * base } else { base.powf(exponent) }
}

pub(super) fn sign(value: f64) -> f64 {
    f64::from(u8::from(value > 0.0)) - f64::from(u8::from(value < 0.0))
}

/// Reads `text`. `names` gives the index of a variable, or the help for an unknown one.
pub fn read(text: &str, names: &dyn Fn(&str) -> Result<usize, String>) -> Result<Tree, Mistake> {
    let mut reader = Reader { text, at: 0, depth: 0, names };
    let tree = reader.sum()?;
    match reader.peek() {
        None => Ok(tree),
        Some(')') => {
            let help = "take it out, or open a parenthesis before it";
            reader.mistake("`)` has no opening parenthesis", help)
        }
        Some(other) => reader.no_operator(other),
    }
}

struct Reader<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    names: &'a dyn Fn(&str) -> Result<usize, String>,
}

impl Reader<'_> {
    fn mistake<T>(&self, message: &str, help: &str) -> Result<T, Mistake> {
        Err(Mistake { offset: self.at, message: message.to_owned(), help: help.to_owned() })
    }

    fn no_operator<T>(&self, before: char) -> Result<T, Mistake> {
        let message = format!("an operator is missing before {before:?}");
        self.mistake(&message, "a product needs its sign: a*w")
    }

    /// The next character that is not a space.
    fn peek(&mut self) -> Option<char> {
        let rest = &self.text[self.at..];
        self.at += rest.len() - rest.trim_start().len();
        self.text[self.at..].chars().next()
    }

    fn take(&mut self, wanted: &[char]) -> Option<char> {
        let next = self.peek().filter(|next| wanted.contains(next))?;
        self.at += next.len_utf8();
        Some(next)
    }

    /// One level deeper, at most 64: each needs stack.
    fn deeper(&mut self, message: &str) -> Result<(), Mistake> {
        self.depth += 1;
        if self.depth > 64 { self.mistake(message, "simplify it") } else { Ok(()) }
    }

    fn sum(&mut self) -> Result<Tree, Mistake> {
        self.deeper("too many parentheses within each other")?;
        let mut left = self.product()?;
        while let Some(operator) = self.take(&['+', '-']) {
            left = left.both(operator, self.product()?);
        }
        self.depth -= 1;
        Ok(left)
    }

    fn product(&mut self) -> Result<Tree, Mistake> {
        let mut left = self.signed()?;
        while let Some(operator) = self.take(&['*', '/']) {
            left = left.both(operator, self.signed()?);
        }
        Ok(left)
    }

    fn signed(&mut self) -> Result<Tree, Mistake> {
        let mut negative = false;
        while let Some(sign) = self.take(&['+', '-']) {
            negative ^= sign == '-';
        }
        let power = self.power()?;
        Ok(if negative { Tree::Number(0.0).both('-', power) } else { power })
    }

    fn power(&mut self) -> Result<Tree, Mistake> {
        let base = self.atom()?;
        if self.take(&['^']).is_none() {
            return Ok(base);
        }
        self.deeper("too many powers of powers")?;
        let exponent = self.signed()?;
        self.depth -= 1;
        Ok(base.both('^', exponent))
    }

    fn atom(&mut self) -> Result<Tree, Mistake> {
        match self.peek() {
            None => self.mistake(
                "the expression ends where a value is expected",
                "a value is a number, a variable, a parameter or a function of one",
            ),
            Some('(') => self.parenthesis(),
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_alphabetic() || c == '_' => self.name(),
            Some(other) => self.mistake(
                &format!("{other:?} stands where a value is expected"),
                "allowed: numbers, names, + - * / ^ and parentheses",
            ),
        }
    }

    fn parenthesis(&mut self) -> Result<Tree, Mistake> {
        let open = self.at;
        self.at += 1;
        let inside = self.sum()?;
        if self.take(&[')']).is_some() {
            return Ok(inside);
        }
        match self.peek() {
            None => {
                self.at = open;
                self.mistake("`(` is never closed", "add `)`")
            }
            Some(',') => self.mistake(
                "a function of two arguments is not known",
                &format!("functions of one argument: {}", FUNCTIONS.join(", ")),
            ),
            Some(other) => self.no_operator(other),
        }
    }

    fn number(&mut self) -> Result<Tree, Mistake> {
        let rest = &self.text.as_bytes()[self.at..];
        let is_digit = |byte: &&u8| byte.is_ascii_digit() || **byte == b'.';
        let digits = |from: usize| from + rest[from..].iter().take_while(is_digit).count();
        let mut end = digits(0);
        if matches!(rest.get(end), Some(b'e' | b'E')) {
            let sign = usize::from(matches!(rest.get(end + 1), Some(b'+' | b'-')));
            if rest.get(end + 1 + sign).is_some_and(u8::is_ascii_digit) {
                end = digits(end + 1 + sign);
            }
        }
        let number = &self.text[self.at..self.at + end];
        match number.parse::<f64>() {
            Ok(value) if value.is_finite() => {
                self.at += end;
                Ok(Tree::Number(value))
            }
            _ => self.mistake(&format!("{number:?} is not a number"), "as 12, 0.5 or 1e-6"),
        }
    }

    fn name(&mut self) -> Result<Tree, Mistake> {
        let begin = self.at;
        let rest = &self.text[begin..];
        let end = rest.find(|c: char| !(c.is_alphanumeric() || c == '_'));
        let name = &rest[..end.unwrap_or(rest.len())];
        if let Some(function) = FUNCTIONS.into_iter().find(|known| *known == name) {
            self.at += name.len();
            if self.peek() != Some('(') {
                let message = format!("the function `{name}` needs its argument in parentheses");
                return self.mistake(&message, &format!("as {name}(w)"));
            }
            let is_sign = matches!(function, "sign" | "signum");
            let function = if is_sign { "sgn" } else { function };
            return Ok(self.parenthesis()?.call(function));
        }
        let tree = match (self.names)(name) {
            _ if name == PI => Tree::Number(std::f64::consts::PI),
            Ok(index) => Tree::Name(index),
            Err(help) => return self.mistake(&format!("unknown name `{name}`"), &help),
        };
        self.at += name.len();
        if name != PI && self.peek() == Some('(') {
            self.at = begin;
            let help = format!("functions: {}", FUNCTIONS.join(", "));
            return self.mistake(&format!("`{name}` is not a function"), &help);
        }
        Ok(tree)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn names(name: &str) -> Result<usize, String> {
        ["w", "a"].iter().position(|known| *known == name).ok_or_else(|| "w or a".to_owned())
    }

    #[test]
    fn mistakes_are_found_at_their_position() {
        for (text, offset, part) in [
            ("a*ww", 2, "unknown name `ww`"),
            ("a*(w+1", 2, "never closed"),
            ("a*w)", 3, "no opening parenthesis"),
            ("a*", 2, "ends"),
            ("", 0, "ends"),
            ("2 w", 2, "operator is missing"),
            ("a w", 2, "operator is missing"),
            ("(a w)", 3, "operator is missing"),
            ("a*/w", 2, "'/'"),
            ("abs w", 4, "parentheses"),
            ("a*max(w, 2)", 2, "unknown name `max`"),
            ("abs(w, 2)", 5, "two arguments"),
            ("w(2)", 0, "not a function"),
            ("1.2.3*w", 0, "not a number"),
            ("a*1e999", 2, "not a number"),
            ("a*w\u{b2}", 2, "unknown name"),
            ("{a}", 0, "'{'"),
        ] {
            let mistake = read(text, &names).unwrap_err();
            assert_eq!(mistake.offset, offset, "{text}: {mistake:?}");
            assert!(mistake.message.contains(part), "{text}: {mistake:?}");
        }
    }

    #[test]
    fn derivatives_are_those_of_small_differences() {
        let functions = FUNCTIONS.map(|name| format!("{name}(0.3*w*a) + w*a"));
        let others = ["w^a", "(w*a)^3", "w/(1 + a*w)", "-a^2*w + 2^w"].map(str::to_owned);
        for text in functions.into_iter().chain(others) {
            let tree = read(&text, &names).unwrap();
            let h = 1e-4;
            let at = |dw: f64, da: f64| tree.value(&[0.9 + dw * h, 1.3 + da * h]);
            let mixed = at(1.0, 1.0) - at(1.0, -1.0) - at(-1.0, 1.0) + at(-1.0, -1.0);
            let by_w = (at(1.0, 0.0) - at(-1.0, 0.0)) / (2.0 * h);
            let by_a = (at(0.0, 1.0) - at(0.0, -1.0)) / (2.0 * h);
            let expected = [at(0.0, 0.0), by_w, by_a, mixed / (4.0 * h * h)];
            let found = tree.second_derivative(&[0.9, 1.3], 0, 1);
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-5, "{text}: {found} {expected}");
            }
        }
    }

    #[test]
    fn no_text_makes_the_parser_panic() {
        proptest!(|(text in "[a-w0-9.e+*/^() -]{0,40}|\\PC{0,20}")| {
            let _ = read(&text, &names);
        });
        for text in ["(", "w^", "-"] {
            assert!(read(&text.repeat(10_000), &names).is_err());
        }
    }
}
