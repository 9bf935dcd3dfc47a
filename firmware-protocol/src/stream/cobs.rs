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
