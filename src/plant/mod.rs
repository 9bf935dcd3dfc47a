//! Motor, load and effects as equations; a model and its simulation.
