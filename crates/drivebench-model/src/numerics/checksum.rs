//! FNV-1a of 64 bits: a checksum of bytes that is the same on every machine and in every version.

/// The checksum of an empty text (the offset basis).
pub const EMPTY: u64 = 0xcbf2_9ce4_8422_2325;

/// Continues the checksum `before` with these bytes.
pub fn fnv_1a(before: u64, bytes: impl IntoIterator<Item = u8>) -> u64 {
    bytes
        .into_iter()
        .fold(before, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_its_authors() {
        for (text, expected) in
            [("", EMPTY), ("a", 0xaf63_dc4c_8601_ec8c), ("foobar", 0x8594_4171_f739_67e8)]
        {
            assert_eq!(fnv_1a(EMPTY, text.bytes()), expected, "{text}");
        }
        let parts = fnv_1a(fnv_1a(EMPTY, "foo".bytes()), "bar".bytes());
        assert_eq!(parts, fnv_1a(EMPTY, "foobar".bytes()));
    }
}
