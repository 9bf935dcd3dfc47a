//! Block bootstrap of a hold-out: how often a candidate would rank first if the run were another of its kind.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const DRAWS: usize = 1000;
const SEED: u64 = 1;

/// Share of seeded block bootstraps in which each candidate has the smallest error. `blocks` are the squared errors of each
/// candidate, block by block; those that not all of them have are left out.
pub(super) fn first_rank_shares(blocks: &[Vec<f64>]) -> Vec<f64> {
    let n = blocks.iter().map(Vec::len).min().unwrap_or(0);
    let mut wins = vec![0_usize; blocks.len()];
    if n == 0 {
        return vec![0.0; blocks.len()];
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    for _ in 0..DRAWS {
        let drawn: Vec<usize> = (0..n).map(|_| rng.random_range(0..n)).collect();
        let error = |index: usize| drawn.iter().map(|block| blocks[index][*block]).sum::<f64>();
        if let Some(first) = (0..blocks.len()).min_by(|a, b| error(*a).total_cmp(&error(*b))) {
            wins[first] += 1;
        }
    }
    wins.iter()
        .map(|wins| *wins as f64 / DRAWS as f64)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_better_ranks_first_and_equals_share_it() {
        let good = vec![1.0; 40];
        let bad = vec![2.0; 40];
        let shares = first_rank_shares(&[bad.clone(), good.clone()]);
        assert!(
            shares[0].abs() < 1e-12 && (shares[1] - 1.0).abs() < 1e-12,
            "{shares:?}"
        );
        // Better in one half of the run, worse in the other: nobody knows.
        let (mut left, mut right) = (good.clone(), bad.clone());
        left[20..].copy_from_slice(&bad[20..]);
        right[20..].copy_from_slice(&good[20..]);
        let shares = first_rank_shares(&[left, right]);
        assert!(
            shares.iter().all(|share| (0.4..0.6).contains(share)),
            "{shares:?}"
        );
        assert_eq!(first_rank_shares(&[good, Vec::new()]), [0.0, 0.0]);
    }
}
