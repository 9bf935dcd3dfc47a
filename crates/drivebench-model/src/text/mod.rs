//! Text for people, the same on the screen, on the page, in the terminal and in notes.
//!
//! ```text
//! value, standard deviation, unit --> number --> "12.35 ± 0.10 V"   digits as the uncertainty carries them
//! sentence, width ------------------> lines ---> rows that fit      screen, card in the terminal, row of a table
//! rows of cells --------------------> columns -> cells of one width  table in the terminal and in Markdown
//! word ----------------------------> shell --> as a command takes it
//! finding -------------------------> codes --> its code in JSON
//! variant -------------------------> tabulated -> its name, in one table with all variants
//! ```
//!
//! Files for programs (CSV, JSON, model files) have all digits and are written by other modules.

pub mod codes;
pub mod columns;
pub mod lines;
pub mod number;
pub mod shell;
mod tabulated;
