//! Patterns of names, as those of files and of columns.

/// Whether a text fits a pattern, in which a star stands for any text and a question mark for one letter.
pub fn fits_pattern(pattern: &str, text: &str) -> bool {
    let [pattern, text] = [pattern, text].map(|letters| letters.chars().collect::<Vec<_>>());
    // Position of the last star, and the end of the text that it stands for.
    let (mut at, mut in_pattern, mut star) = (0, 0, None);
    while at < text.len() {
        match pattern.get(in_pattern) {
            Some('*') => {
                star = Some((in_pattern, at));
                in_pattern += 1;
            }
            Some(letter) if *letter == '?' || *letter == text[at] => {
                at += 1;
                in_pattern += 1;
            }
            _ => {
                let Some((star_at, end)) = star else { return false };
                (at, in_pattern, star) = (end + 1, star_at + 1, Some((star_at, end + 1)));
            }
        }
    }
    pattern[in_pattern..].iter().all(|letter| *letter == '*')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_have_stars_and_question_marks() {
        for (pattern, fitting, others) in [
            ("2026-*", &["2026-a", "2026-"][..], &["2025-a"][..]),
            ("*abx", &["abcabx"], &["abcab"]),
            ("a*b*c", &["axbxc"], &["axbxcx"]),
            ("*", &["", "x"], &[]),
            ("ch?", &["ch1", "ch\u{e9}"], &["ch", "ch12"]),
            ("*vel_estimate", &["axis0.encoder.vel_estimate"], &["vel_estimates"]),
            ("a", &["a"], &["ab", ""]),
        ] {
            assert!(fitting.iter().all(|text| fits_pattern(pattern, text)), "{pattern}");
            assert!(!others.iter().any(|text| fits_pattern(pattern, text)), "{pattern}");
        }
    }
}
