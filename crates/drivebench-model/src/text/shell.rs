//! Words of a command that a person can copy into a shell.

use std::path::Path;

/// A path as a shell takes it.
pub fn quoted(path: &Path) -> String {
    quoted_word(&path.display().to_string())
}

/// A word of a command as a shell takes it.
pub fn quoted_word(word: &str) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./:=,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}
