//! Closed lists as one table: an enum with a value for each variant.

/// Defines an enum whose variants have a constant each, such as a name, and the function that gives it; `ALL` has the variants in
/// their order.
#[macro_export]
macro_rules! tabulated {
    (
        $(#[$meta:meta])*
        pub enum $type:ident {
            $($(#[$attribute:meta])* $variant:ident = $value:expr,)+
        }
        $(#[$doc:meta])*
        $vis:vis const fn $get:ident(self) -> $of:ty;
    ) => {
        $(#[$meta])*
        pub enum $type {
            $($(#[$attribute])* $variant,)+
        }

        impl $type {
            pub const ALL: [Self; [$($value),+].len()] = [$(Self::$variant),+];

            $(#[$doc])*
            $vis const fn $get(self) -> $of {
                match self {
                    $(Self::$variant => $value,)+
                }
            }
        }
    };
}
