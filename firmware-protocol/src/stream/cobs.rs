//! Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999).

use crate::bytes::Bytes;

/// Stuffs `plain` and ends it with 0; `N` has room for one code byte per 254 bytes and the delimiter.
pub(super) fn encode<const N: usize>(plain: &[u8]) -> Bytes<N> {
    let mut out = Bytes::of(&[0]);
    let (mut code_at, mut code) = (0, 1_u8);
    for (index, &byte) in plain.iter().enumerate() {
        if byte != 0 {
            out.extend(&[byte]);
            code += 1;
        }
        let block_full = code == u8::MAX && index + 1 < plain.len();
        if byte == 0 || block_full {
            out[code_at] = code;
            code_at = out.len();
            out.extend(&[0]);
            code = 1;
        }
    }
    out[code_at] = code;
    out.extend(&[0]);
    out
}

/// Restores the bytes in place; `None` if a code byte points past the end.
pub(super) fn decode(coded: &mut [u8]) -> Option<&[u8]> {
    let (mut read, mut write) = (0, 0);
    while let Some(&code) = coded.get(read) {
        let block = usize::from(code).checked_sub(1)?;
        let next = read + 1 + block;
        if next > coded.len() {
            return None;
        }
        coded.copy_within(read + 1..next, write);
        write += block;
        read = next;
        // A full block carries no zero, and the zero after the last block is the delimiter.
        if code != u8::MAX && read < coded.len() {
            coded[write] = 0;
            write += 1;
        }
    }
    Some(&coded[..write])
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// The example encodings of the paper's usual summary, with the edges of a full block.
    #[test]
    fn known_encodings_both_ways() {
        let run = |from: u8, to: u8| (from..=to).collect::<Vec<u8>>();
        let cases: [(Vec<u8>, Vec<u8>); 9] = [
            ([].into(), [1].into()),
            ([0].into(), [1, 1].into()),
            ([0, 0].into(), [1, 1, 1].into()),
            ([0x11, 0x22, 0, 0x33].into(), [3, 0x11, 0x22, 2, 0x33].into()),
            ([0x11, 0, 0, 0].into(), [2, 0x11, 1, 1, 1].into()),
            (run(1, 254), [&[255][..], &run(1, 254)].concat()),
            ([&[0][..], &run(1, 254)].concat(), [&[1, 255][..], &run(1, 254)].concat()),
            (run(1, 255), [&[255][..], &run(1, 254), &[2, 255]].concat()),
            ([&run(2, 255)[..], &[0]].concat(), [&[255][..], &run(2, 255), &[1, 1]].concat()),
        ];
        for (plain, coded) in cases {
            let mut out = encode::<300>(&plain);
            let (delimiter, stuffed) = out.split_last_mut().unwrap();
            assert_eq!((&*stuffed, *delimiter), (&coded[..], 0));
            assert_eq!(decode(stuffed), Some(&plain[..]));
        }
    }

    #[test]
    fn a_code_past_the_end_is_damage() {
        assert_eq!(decode(&mut [3, 1]), None);
        assert_eq!(decode(&mut [2, 1, 255, 1]), None);
    }
}
