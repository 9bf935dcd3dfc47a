//! Text for people: a value and a sentence look the same on the screen, on the page, in the terminal and in notes.
//!
//! ```text
//! value, standard deviation, unit --> number --> "12.35 ± 0.10 V"   digits as the uncertainty carries them
//! sentence, width ------------------> lines ---> rows that fit      screen, card in the terminal, row of a table
//! rows of cells --------------------> columns -> cells of one width  table in the terminal and in Markdown
//! word ----------------------------> shell --> as a command takes it
//! ```
//!
//! What a program reads back (CSV, JSON numbers, model files) is written to the last bit by the room that owns the file.

pub mod columns;
pub mod lines;
pub mod number;
pub mod shell;
