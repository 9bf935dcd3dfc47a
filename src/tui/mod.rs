//! The live screens.
