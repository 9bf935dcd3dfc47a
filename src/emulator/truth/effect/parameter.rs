//! Parameters of the truth: their keys, units and what they may be.

/// One parameter of the truth: key as in the model file, value, unit.
pub type TrueParameter = (&'static str, f64, &'static str);

/// A value that a parameter cannot have: key, value, what is allowed.
pub type Refused = (&'static str, f64, &'static str);

/// What a parameter may be.
#[derive(Clone, Copy, Debug)]
pub(super) enum Allowed {
    /// Any number.
    Signed,
    NotNegative,
    Positive,
    /// 0 to 1.
    Fraction,
    /// Between 0 and 1, without them.
    Share,
    /// 0 to 0.5: a loss that leaves something over.
    Loss,
    /// Whole numbers, 1 to 400.
    Order,
    /// 0 to 1 s.
    Delay,
}

impl Allowed {
    pub(super) fn refuses(self, value: f64) -> Option<&'static str> {
        let (ok, text) = match self {
            Self::Signed => (true, "a number"),
            Self::NotNegative => (value >= 0.0, "0 or more"),
            Self::Positive => (value > 0.0, "above 0"),
            Self::Fraction => ((0.0..=1.0).contains(&value), "0 to 1"),
            Self::Share => (value > 0.0 && value < 1.0, "between 0 and 1"),
            Self::Loss => ((0.0..=0.5).contains(&value), "0 to 0.5"),
            Self::Order => (
                value.fract() == 0.0 && (1.0..=400.0).contains(&value),
                "a whole number, 1 to 400",
            ),
            Self::Delay => ((0.0..=1.0).contains(&value), "0 to 1 s"),
        };
        (!(value.is_finite() && ok)).then_some(text)
    }
}

/// The configuration of one hidden effect: `key: what it may be in "unit"` per parameter.
macro_rules! hidden_effect {
    ($(#[$doc:meta])* $name:ident { $($(#[$of_key:meta])* $key:ident: $allowed:ident in $unit:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[$of_key])* pub $key: f64,)+
        }

        impl $name {
            pub(in crate::emulator::truth::effect) fn parameters(
                &self,
            ) -> Vec<$crate::emulator::truth::effect::TrueParameter> {
                vec![$((stringify!($key), self.$key, $unit)),+]
            }

            pub(in crate::emulator::truth::effect) fn refused(
                &self,
            ) -> Option<$crate::emulator::truth::effect::Refused> {
                use $crate::emulator::truth::effect::parameter::Allowed;
                [$((stringify!($key), self.$key, Allowed::$allowed)),+]
                    .into_iter()
                    .find_map(|(key, value, allowed)| Some((key, value, allowed.refuses(value)?)))
            }
        }
    };
}
pub(super) use hidden_effect;
