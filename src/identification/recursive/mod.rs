//! Recursive identification: one sample in, parameters with their uncertainty out.
//!
//! ```text
//! samples, voltage as applied -> blocks of about 10 ms -> scheme 3: R, L, Ke (current predicted over the block)
//!                                                      -> mechanical balance: J, Mc (scheme 3 with its own Ke)
//! samples (i, w) ----------------------------------------> scheme 2: J, Mc (Kt known), as paper A
//! ```

mod direction;
mod mechanical;
mod scheme_2;
mod scheme_3;
mod track;
mod winding;

pub(in crate::identification) use direction::{Direction, steady_period};
pub use scheme_2::{CurrentIntegral, Scheme2};
pub use scheme_3::{Memory, Scheme3, StartValues};
