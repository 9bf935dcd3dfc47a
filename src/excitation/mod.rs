//! Excitation programs: pure, seekable, seeded functions of time.
