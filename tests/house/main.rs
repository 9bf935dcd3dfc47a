//! The repository's own rules: the plan of its rooms, and files of the user that are read or refused with words.

mod architecture;
mod budgets;
mod citations;
mod codes;
mod effects;
mod faults;
mod text_files;
