//! Session, guard, runner: one bench run from standstill to standstill.
