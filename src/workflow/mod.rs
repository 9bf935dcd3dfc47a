//! The order of the loop, as a pure state machine.
