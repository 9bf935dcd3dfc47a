//! Parameters from data: recursive on line, batch afterwards, with honest uncertainty.
