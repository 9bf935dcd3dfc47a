//! Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Transactions on Networking 7(2), 1999).

/// Stuffs `plain` into `out` and ends it with 0; returns the bytes used. `out` has room for one code byte per 254
/// bytes and the delimiter.
pub(super) fn encode(plain: &[u8], out: &mut [u8]) -> usize {
    let mut code_at = 0;
    let mut at = 1;
    let mut code = 1_u8;
    for (index, &byte) in plain.iter().enumerate() {
        if byte != 0 {
            out[at] = byte;
            at += 1;
            code += 1;
        }
        let block_full = code == u8::MAX && index + 1 < plain.len();
        if byte == 0 || block_full {
            out[code_at] = code;
            code_at = at;
            at += 1;
            code = 1;
        }
    }
    out[code_at] = code;
    out[at] = 0;
    at + 1
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
            (
                [0x11, 0x22, 0, 0x33].into(),
                [3, 0x11, 0x22, 2, 0x33].into(),
            ),
            ([0x11, 0, 0, 0].into(), [2, 0x11, 1, 1, 1].into()),
            (run(1, 254), [&[255][..], &run(1, 254)].concat()),
            (
                [&[0][..], &run(1, 254)].concat(),
                [&[1, 255][..], &run(1, 254)].concat(),
            ),
            (run(1, 255), [&[255][..], &run(1, 254), &[2, 255]].concat()),
            (
                [&run(2, 255)[..], &[0]].concat(),
                [&[255][..], &run(2, 255), &[1, 1]].concat(),
            ),
        ];
        for (plain, coded) in cases {
            let mut out = [0xAA; 300];
            let length = encode(&plain, &mut out);
            assert_eq!(out[..length - 1], coded);
            assert_eq!(out[length - 1], 0);
            assert_eq!(decode(&mut out[..length - 1]), Some(&plain[..]));
        }
    }

    #[test]
    fn a_code_past_the_end_is_damage() {
        assert_eq!(decode(&mut [3, 1]), None);
        assert_eq!(decode(&mut [2, 1, 255, 1]), None);
    }
}
