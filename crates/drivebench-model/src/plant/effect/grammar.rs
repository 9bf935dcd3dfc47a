//! Reads an expression as a person means it, names the place of a mistake, and writes it for the evaluator.
//!
//! The evaluator binds a sign tighter than a power (`-w^2` is `(-w)^2` there), a division tighter than a product, knows
//! no `1e-6`, and tells of a mistake without its place. So the usual rules are kept here, and what is handed on (to the
//! evaluator, or to other programs) carries its order in a tree:
//!
//! ```text
//! sum     = product {("+" | "-") product}
//! product = signed {("*" | "/") signed}
//! signed  = ("+" | "-") signed | power
//! power   = atom ["^" signed]                       so -w^2 = -(w^2) and 2^3^2 = 2^(3^2)
//! atom    = number | name | function "(" sum ")" | "(" sum ")"
//! ```

/// Functions of one argument.
pub(super) const FUNCTIONS: [&str; 17] = [
    "abs", "sgn", "signum", "sqrt", "exp", "ln", "log10", "sin", "cos", "tan", "asin", "acos",
    "atan", "sinh", "cosh", "tanh", "sign",
];
/// The only constant.
pub(super) const PI: &str = "pi";

/// A mistake in an expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Mistake {
    /// Byte at which it was noticed.
    pub(super) offset: usize,
    pub(super) message: String,
    pub(super) help: String,
}

/// An expression as it was read; names stand by the index that the reader was told.
#[derive(Clone, Debug, PartialEq)]
pub enum Tree {
    Number(f64),
    Name(usize),
    /// A function by the name that it is known by first: `sgn` for `sign` and `signum`.
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

    /// Value for the values of the names.
    pub fn value(&self, of: &dyn Fn(usize) -> f64) -> f64 {
        match self {
            Self::Number(value) => *value,
            Self::Name(index) => of(*index),
            Self::Call(function, argument) => called(function, argument.value(of)),
            Self::Both(left, operator, right) => {
                let (left, right) = (left.value(of), right.value(of));
                match operator {
                    '+' => left + right,
                    '-' => left - right,
                    '*' => left * right,
                    '/' => left / right,
                    _ => left.powf(right),
                }
            }
        }
    }
}

fn called(function: &str, value: f64) -> f64 {
    match function {
        "abs" => value.abs(),
        "sqrt" => value.sqrt(),
        "exp" => value.exp(),
        "ln" => value.ln(),
        "log10" => value.log10(),
        "sin" => value.sin(),
        "cos" => value.cos(),
        "tan" => value.tan(),
        "asin" => value.asin(),
        "acos" => value.acos(),
        "atan" => value.atan(),
        "sinh" => value.sinh(),
        "cosh" => value.cosh(),
        "tanh" => value.tanh(),
        _ => sign(value),
    }
}

/// Zero at zero.
pub(super) fn sign(value: f64) -> f64 {
    if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    }
}

/// An expression in the evaluator's notation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Written {
    pub(super) value: String,
    /// The same for derivatives: `abs` as a root, whose derivative the evaluator knows, and each `sgn` as a number of its
    /// own, because its derivative is zero wherever it has one.
    pub(super) smooth: String,
}

impl Written {
    /// `direction` is the index under which the sign of the name `speed`, written `sgn(w)`, is handed on as a variable of
    /// its own.
    pub(super) fn of(tree: &Tree, speed: usize, direction: usize) -> Self {
        let mut signs = 0;
        Self::within(tree, (speed, direction), &mut signs)
    }

    fn within(tree: &Tree, speed: (usize, usize), signs: &mut usize) -> Self {
        match tree {
            // Without an exponent, which the evaluator would not read.
            Tree::Number(value) => Self::plain(format!("{value}")),
            Tree::Name(index) => Self::named(*index),
            Tree::Call("sgn", argument) if **argument == Tree::Name(speed.0) => {
                Self::named(speed.1)
            }
            Tree::Call(function, argument) => {
                let Self { value, smooth } = Self::within(argument, speed, signs);
                let smooth = match *function {
                    "abs" => format!("sqrt(({smooth})^2)"),
                    "sgn" => {
                        *signs += 1;
                        Self::named(SIGNS + *signs).smooth
                    }
                    other => format!("{other}({smooth})"),
                };
                let value = format!("{function}({value})");
                Self { value, smooth }
            }
            Tree::Both(left, operator, right) => {
                let left = Self::within(left, speed, signs);
                let right = Self::within(right, speed, signs);
                Self {
                    value: format!("({}{operator}{})", left.value, right.value),
                    smooth: format!("({}{operator}{})", left.smooth, right.smooth),
                }
            }
        }
    }

    fn named(index: usize) -> Self {
        Self::plain(format!("{{{}}}", variable(index)))
    }

    fn plain(text: String) -> Self {
        Self {
            smooth: text.clone(),
            value: text,
        }
    }
}

/// The name under which the evaluator knows the variable with this index; they sort as the indices do.
pub(super) fn variable(index: usize) -> String {
    format!("v{index:04}")
}

/// Index of the variable that stands for the first sign in [`Written::smooth`]: behind all others.
const SIGNS: usize = 1000;

/// Reads `text`. `names` gives the index of a variable, or which there are.
pub(super) fn read(
    text: &str,
    names: &dyn Fn(&str) -> Result<usize, String>,
) -> Result<Tree, Mistake> {
    let mut reader = Reader {
        text,
        at: 0,
        depth: 0,
        names,
    };
    let tree = reader.sum()?;
    match reader.peek() {
        None => Ok(tree),
        Some(')') => Err(reader.mistake(
            "`)` closes nothing",
            "take it out, or open a parenthesis before it",
        )),
        Some(other) => Err(reader.no_operator(other)),
    }
}

/// Parentheses within parentheses that are read: none is written by hand as deep, and each costs stack.
const DEEPEST: usize = 64;

struct Reader<'a> {
    text: &'a str,
    at: usize,
    depth: usize,
    names: &'a dyn Fn(&str) -> Result<usize, String>,
}

impl Reader<'_> {
    fn mistake(&self, message: &str, help: &str) -> Mistake {
        Mistake {
            offset: self.at,
            message: message.to_owned(),
            help: help.to_owned(),
        }
    }

    fn no_operator(&self, before: char) -> Mistake {
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

    fn sum(&mut self) -> Result<Tree, Mistake> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.mistake("too many parentheses within each other", "simplify it"));
        }
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
        Ok(if negative {
            Tree::Number(0.0).both('-', power)
        } else {
            power
        })
    }

    fn power(&mut self) -> Result<Tree, Mistake> {
        let base = self.atom()?;
        if self.take(&['^']).is_none() {
            return Ok(base);
        }
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.mistake("too many powers of powers", "simplify it"));
        }
        let exponent = self.signed()?;
        self.depth -= 1;
        Ok(base.both('^', exponent))
    }

    fn atom(&mut self) -> Result<Tree, Mistake> {
        match self.peek() {
            None => Err(self.mistake(
                "the expression ends where a value is expected",
                "a value is a number, a variable, a parameter or a function of one",
            )),
            Some('(') => self.parenthesis(),
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_alphabetic() || c == '_' => self.name(),
            Some(other) => Err(self.mistake(
                &format!("{other:?} stands where a value is expected"),
                "allowed: numbers, names, + - * / ^ and parentheses",
            )),
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
            None => Err(Mistake {
                offset: open,
                message: "`(` is never closed".to_owned(),
                help: "add `)`".to_owned(),
            }),
            Some(',') => Err(self.mistake(
                "a function of two arguments is not known",
                &format!("functions of one argument: {}", FUNCTIONS.join(", ")),
            )),
            Some(other) => Err(self.no_operator(other)),
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
            _ => Err(self.mistake(&format!("{number:?} is not a number"), "as 12, 0.5 or 1e-6")),
        }
    }

    fn name(&mut self) -> Result<Tree, Mistake> {
        let begin = self.at;
        let rest = &self.text[begin..];
        let length = rest
            .find(|c: char| !(c.is_alphanumeric() || c == '_'))
            .unwrap_or(rest.len());
        let name = &rest[..length];
        if let Some(function) = FUNCTIONS.into_iter().find(|known| *known == name) {
            self.at += length;
            if self.peek() != Some('(') {
                let message = format!("the function `{name}` needs its argument in parentheses");
                return Err(self.mistake(&message, &format!("as {name}(w)")));
            }
            let argument = self.parenthesis()?;
            let is_sign = matches!(function, "sgn" | "sign" | "signum");
            return Ok(argument.call(if is_sign { "sgn" } else { function }));
        }
        if name == PI {
            self.at += length;
            return Ok(Tree::Number(std::f64::consts::PI));
        }
        match (self.names)(name) {
            Ok(index) => {
                self.at += length;
                if self.peek() == Some('(') {
                    self.at = begin;
                    let help = format!("functions: {}", FUNCTIONS.join(", "));
                    return Err(self.mistake(&format!("`{name}` is not a function"), &help));
                }
                Ok(Tree::Name(index))
            }
            Err(help) => Err(self.mistake(&format!("unknown name `{name}`"), &help)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(name: &str) -> Result<usize, String> {
        ["w", "a"]
            .iter()
            .position(|known| *known == name)
            .ok_or_else(|| "w or a".to_owned())
    }

    #[test]
    fn mistakes_are_found_at_their_place() {
        for (text, offset, part) in [
            ("a*ww", 2, "unknown name `ww`"),
            ("a*(w+1", 2, "never closed"),
            ("a*w)", 3, "closes nothing"),
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
    fn what_is_handed_on_grows_with_the_text_alone() {
        for function in FUNCTIONS {
            let text = format!("{}a{}", format!("{function}(").repeat(60), ")".repeat(60));
            let written = Written::of(&read(&text, &names).unwrap(), 0, 9);
            let length = written.value.len().max(written.smooth.len());
            assert!(length < 16 * text.len(), "{function}: {length}");
        }
    }

    #[test]
    fn any_text_is_answered_without_a_panic() {
        use proptest::prelude::*;
        proptest!(|(text in "[a-w0-9.e+*/^() -]{0,40}|\\PC{0,20}")| {
            let _ = read(&text, &names);
        });
        assert!(read(&"(".repeat(10_000), &names).is_err());
        assert!(read(&"w^".repeat(10_000), &names).is_err());
        assert!(read(&"-".repeat(10_000), &names).is_err());
    }
}
