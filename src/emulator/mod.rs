//! The software drive: plant, state machine, registers, watchdog, line pacing.

pub mod truth;
