//! Enumerations whose values travel as numbers: each value once, with its meaning and its code.

/// Declares an enumeration with its codes on the wire.
macro_rules! coded {
    ($(#[$about:meta])* $name:ident: $code:ty { $($(#[$doc:meta])* $variant:ident = $value:literal,)* }) => {
        $(#[$about])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name { $($(#[$doc])* $variant,)* }

        impl $name {
            /// Every value, by rising code.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Code on the wire.
            pub const fn code(self) -> $code {
                match self { $(Self::$variant => $value),* }
            }

            /// The value of a code, if there is one.
            pub const fn from_code(code: $code) -> Option<Self> {
                match code { $($value => Some(Self::$variant),)* _ => None }
            }
        }
    };
}

pub(crate) use coded;
