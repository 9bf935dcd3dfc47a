//! Findings as data: enums whose variants carry numbers, each variant with a code that stays the same from release to release.
//! Sentences about them are made by the program.

/// Defines an enum of findings. The code of each variant is what JSON has of it.
#[macro_export]
macro_rules! findings {
    (
        $(#[$meta:meta])*
        $vis:vis enum $name:ident {
            $(
                $(#[$attribute:meta])*
                $variant:ident $({ $($field:tt)* })? $(($($content:tt)*))? = $code:literal,
            )+
        }
    ) => {
        $(#[$meta])*
        $vis enum $name {
            $($(#[$attribute])* $variant $({ $($field)* })? $(($($content)*))?,)+
        }

        impl $name {
            /// The codes of all variants.
            pub const CODES: &'static [&'static str] = &[$($code),+];

            pub const fn code(&self) -> &'static str {
                match self {
                    $(Self::$variant { .. } => $code,)+
                }
            }
        }

        impl serde::Serialize for $name {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.code())
            }
        }
    };
}
