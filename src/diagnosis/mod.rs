//! Compare the model with the measurement, see where it fails, name the missing effect, add it.
