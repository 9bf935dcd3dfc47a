//! Maximal-length linear-feedback shift register for pseudo-random sequences (Golomb, *Shift Register Sequences*, 1967).

/// A Fibonacci register of 16 bits with taps 16, 15, 13 and 4: x^16 + x^15 + x^13 + x^4 + 1 is primitive, so every state
/// but zero comes up once in 65,535 steps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Lfsr {
    state: u16,
}

impl Lfsr {
    /// Any seed gives a state that is not zero; neighbouring seeds start far apart in the sequence.
    pub(super) fn new(seed: u64) -> Self {
        // The finaliser of SplitMix64 (Steele, Lea, Flood 2014) spreads small seeds over the states.
        let mut mixed = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^= mixed >> 31;
        let state = u16::try_from(mixed % 65_535 + 1).expect("1 to 65535 fits into 16 bits");
        Self { state }
    }

    pub(super) fn next_bit(&mut self) -> bool {
        let state = self.state;
        let bit = (state ^ (state >> 1) ^ (state >> 3) ^ (state >> 12)) & 1;
        self.state = (state >> 1) | (bit << 15);
        bit == 1
    }

    /// One of `0..count`, equally often but for one part in 65,535 per level; `count` of at least 2.
    pub(super) fn next_level(&mut self, count: u16) -> u16 {
        let bits = u16::BITS - (count - 1).leading_zeros();
        for _ in 0..bits {
            self.next_bit();
        }
        // The newest bits are the highest: the state as a fraction of its range picks the level.
        let scaled = u32::from(self.state - 1) * u32::from(count) / 65_535;
        u16::try_from(scaled).expect("below count, which is 16 bits wide")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn the_sequence_has_the_full_length_and_is_balanced() {
        let start = Lfsr::new(1);
        let mut register = start.clone();
        let (mut ones, mut steps) = (0, 0);
        while steps == 0 || register != start {
            ones += u32::from(register.next_bit());
            steps += 1;
        }
        assert_eq!((steps, ones), (65_535, 32_768));
    }

    #[test]
    fn levels_come_up_equally_often_and_seeds_differ() {
        for count in [2, 3, 5, 8] {
            let mut register = Lfsr::new(7);
            let mut hits = vec![0_u32; usize::from(count)];
            for _ in 0..60_000 {
                hits[usize::from(register.next_level(count))] += 1;
            }
            let fair = 60_000 / u32::from(count);
            let is_fair = |hit: &u32| hit.abs_diff(fair) < fair / 10;
            assert!(hits.iter().all(is_fair), "{count}: {hits:?}");
        }
        let bits = |seed| {
            let mut register = Lfsr::new(seed);
            (0..64).map(|_| register.next_bit()).collect::<Vec<_>>()
        };
        assert_eq!(bits(3), bits(3));
        assert_ne!(bits(3), bits(4));
        assert_ne!(bits(0), bits(u64::MAX));
    }
}
