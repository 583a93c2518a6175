//! Environments that everybody knows, from their published equations.

pub(crate) mod acrobot;
pub(crate) mod cartpole;
pub(crate) mod lock;
pub(crate) mod pair;

use crawler_policy::Seed;

/// Numbers from −1 to 1 drawn from a seed (`SplitMix64`).
pub(crate) fn draws<const N: usize>(seed: Seed) -> [f64; N] {
    let mut state = seed.get();
    core::array::from_fn(|_| {
        state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let value = (state ^ (state >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        let value = value ^ (value >> 31);
        (value >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    })
}
