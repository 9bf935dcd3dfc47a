//! Word wrap, and text that is cut to a width; every character counts as one column.

/// The rows of a text that is broken between words; a word longer than a row is broken where the row ends. What fits stays
/// as it is, and rows of what is broken keep the indentation of their line.
pub fn wrapped(text: &str, width: usize) -> Vec<String> {
    if text.is_empty() {
        return vec![String::new()];
    }
    text.lines().flat_map(|line| broken(line, width)).collect()
}

fn broken(line: &str, width: usize) -> Vec<String> {
    if line.chars().count() <= width {
        return vec![line.to_owned()];
    }
    let spaces = line.chars().take_while(|c| c.is_whitespace()).count();
    let indent = spaces.min(width.saturating_sub(1));
    let room = width.saturating_sub(indent).max(1);
    let mut rows = Vec::new();
    let (mut row, mut length) = (String::new(), 0);
    for word in line.split_whitespace() {
        let mut word: Vec<char> = word.chars().collect();
        if length > 0 && length + 1 + word.len() > room {
            rows.push(std::mem::take(&mut row));
            length = 0;
        }
        if length > 0 {
            row.push(' ');
            length += 1;
        }
        while word.len() > room {
            let rest = word.split_off(room);
            rows.push(word.into_iter().collect());
            word = rest;
        }
        length += word.len();
        row.extend(word);
    }
    rows.push(row);
    for row in &mut rows {
        row.insert_str(0, &" ".repeat(indent));
    }
    rows
}

/// The lines of a text in rows of `width` columns of a terminal: continued beneath the last column of a table's row, else indented
/// by two. Not broken are texts to be copied: a command in backquotes, any word (as a path, which may be longer than a row),
/// and a row of a table with bars.
pub fn folded(text: &str, width: usize) -> Vec<String> {
    text.lines().flat_map(|line| folded_line(line, width)).collect()
}

fn folded_line(line: &str, width: usize) -> Vec<String> {
    let text = line.trim_start();
    if line.chars().count() <= width || text.starts_with('|') {
        return vec![line.to_owned()];
    }
    let own = &line[..line.len() - text.len()];
    let gap = text.rfind("  ").map(|at| own.len() + at + 2);
    let head = &line[..gap.unwrap_or(own.len())];
    let column = head.chars().count();
    let (mut row, text, indent) = match gap {
        // Beyond two thirds of the width the last column is too narrow.
        Some(at) if column <= width * 2 / 3 => (head.to_owned(), &line[at..], column),
        _ => (own.to_owned(), text, own.chars().count() + 2),
    };
    let mut rows = Vec::new();
    let mut is_begun = false;
    for word in unbroken(text, width.saturating_sub(indent)) {
        if is_begun && row.chars().count() + 1 + word.chars().count() > width {
            rows.push(std::mem::replace(&mut row, " ".repeat(indent)));
        } else if is_begun {
            row.push(' ');
        }
        row.push_str(&word);
        is_begun = true;
    }
    rows.push(row);
    rows
}

/// The words of a text, with a command in backquotes as one where it is no longer than `most`.
fn unbroken(text: &str, most: usize) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    for word in text.split_whitespace() {
        let length = 1 + word.chars().count();
        let begun =
            words.last_mut().filter(|begun| is_open && begun.chars().count() + length <= most);
        match begun {
            Some(begun) => {
                begun.push(' ');
                begun.push_str(word);
            }
            None => words.push(word.to_owned()),
        }
        is_open ^= word.matches('`').count() % 2 == 1;
    }
    words
}

/// A text cut to `width`, with a mark where something is left out.
pub fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_owned();
    }
    let mut short: String = text.chars().take(width.saturating_sub(1)).collect();
    short.push('…');
    short
}

/// A sentence with a capital first letter.
pub fn capitalised(sentence: &str) -> String {
    let mut letters = sentence.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn no_word_is_lost_between_rows_and_no_row_is_too_long() {
        let text = "  held-out error 2.82 -> 2.74 times the noise aaaaaaaaaaaaaaaaaaaaaaaaa";
        for width in 1..80 {
            let rows = wrapped(text, width);
            assert!(rows.iter().all(|row| row.chars().count() <= width), "{rows:?}");
            let joined: String = rows.concat().split_whitespace().collect();
            assert_eq!(joined, text.split_whitespace().collect::<String>());
        }
        assert_eq!(wrapped("", 10), [""]);
        assert_eq!(wrapped("  a  b\n c", 6), ["  a  b", " c"]);
        assert_eq!(wrapped("  one two", 6), ["  one", "  two"]);
        assert_eq!(cut("diagnosis", 4), "dia…");
    }

    #[test]
    fn folding_keeps_columns_commands_and_paths() {
        for (text, folded_text) in [
            ("short\n\n  as it is", "short\n\n  as it is"),
            ("error: one two three four five", "error: one two three\n  four five"),
            ("key  kind  a reason of words", "key  kind  a reason\n           of words"),
            ("  /a/path/that/is/long is", "  /a/path/that/is/long\n    is"),
            ("help: so and `do this now` or", "help: so and\n  `do this now` or"),
            ("| a row of a table | with bars |", "| a row of a table | with bars |"),
            (
                "x `a command that is longer than a row`",
                "x `a command that is\n  longer than a row`",
            ),
        ] {
            assert_eq!(folded(text, 20).join("\n"), folded_text, "{text}");
        }
    }
}
