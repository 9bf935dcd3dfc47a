//! The points of the lines of a picture, in the page for zooming in: a second level of decimation, finer than the picture, or
//! all points where they are few.

use super::decimate::{Pieces, decimate};

/// Points of all lines of a picture together: about 11 bytes each in the page, so that one of many millions of samples stays
/// below 5 MB.
pub const MOST_POINTS: usize = 360_000;

/// One line of text for each line of the picture: base64 of pairs of 32-bit floats, least byte first: place along the axis and
/// value. A value that is not a number is a gap. With it the width of the columns to which a line was thinned, if any was.
pub(super) fn encode(
    lines: &[&Pieces],
    from: f64,
    to: f64,
    most_points: usize,
) -> (String, Option<f64>) {
    let share = most_points / lines.len().max(1);
    let columns = (share / 4).max(1);
    let (mut text, mut width) = (String::new(), None);
    for pieces in lines {
        let points: usize = pieces.iter().map(Vec::len).sum();
        let thinned = (points > share).then(|| decimate(pieces, from, to, columns));
        if thinned.is_some() {
            width = Some((to - from) / columns as f64);
        }
        let mut bytes = Vec::with_capacity(8 * points.min(share + share / 2));
        let mut push = |place: f64, value: f64| {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "seven digits are more than a picture shows"
            )]
            for number in [place as f32, value as f32] {
                bytes.extend_from_slice(&number.to_le_bytes());
            }
        };
        for (index, piece) in thinned.as_ref().unwrap_or(pieces).iter().enumerate() {
            if let Some(first) = piece.first().filter(|_| index > 0) {
                push(first.0, f64::NAN);
            }
            for (place, value) in piece {
                push(*place, *value);
            }
        }
        base64(&mut text, &bytes);
        text.push('\n');
    }
    (text, width)
}

/// RFC 4648, which browsers decode themselves.
fn base64(text: &mut String, bytes: &[u8]) {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    text.reserve(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let byte = |index: usize| u32::from(group.get(index).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for index in 0..4 {
            let digit = (bits >> (18 - 6 * index)) & 63;
            let is_digit = index <= group.len();
            text.push(if is_digit { char::from(DIGITS[digit as usize]) } else { '=' });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_the_standard() {
        for (bytes, expected) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            let mut text = String::new();
            base64(&mut text, bytes.as_bytes());
            assert_eq!(text, expected);
        }
    }

    #[test]
    fn a_short_line_is_whole_and_a_long_one_is_bounded() {
        let short = vec![vec![(0.0, 1.0), (1.0, 2.0)], vec![(3.0, 4.0)]];
        // Four pairs, the gap among them, of eight bytes each.
        let (text, width) = encode(&[&short], 0.0, 3.0, MOST_POINTS);
        assert_eq!(width, None);
        assert_eq!(text.len(), 32_usize.div_ceil(3) * 4 + 1);
        let long = vec![(0..100_000).map(|k| (f64::from(k), f64::from(k % 7))).collect()];
        let (text, width) = encode(&[&long], 0.0, 1e5, 4_000);
        assert_eq!(width, Some(100.0));
        assert!(text.len() < 8 * 4_100 * 4 / 3, "{}", text.len());
    }
}
