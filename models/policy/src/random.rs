//! Randomness with a name. A stream belongs to one purpose at one place of one run, and begins anew there, so
//! nothing of a generator has to be kept for a run to go on.

use rand_core::Rng;
use rand_pcg::Pcg32;

/// What a stream of random numbers is for.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    Weights = 1,
    Actions = 2,
    Order = 3,
    Replay = 4,
    Resample = 5,
    Decisions = 6,
}

/// The stream of `purpose` at a place, which is two numbers: a round and an environment, say.
pub(crate) fn stream(seed: u64, purpose: Purpose, place: (u64, u64)) -> Pcg32 {
    let start = mix(seed ^ mix(place.0 ^ mix(place.1 ^ mix(purpose as u64))));
    Pcg32::new(start, (place.1 << 8) | purpose as u64)
}

/// The finaliser of `SplitMix64` (Steele, Lea, Flood: Fast Splittable Pseudorandom Number Generators,
/// OOPSLA 2014).
pub(crate) const fn mix(value: u64) -> u64 {
    let value = value.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let value = (value ^ (value >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    value ^ (value >> 31)
}

/// A number from 0 to 1, 1 excluded, in steps that a float holds exactly.
pub(crate) fn uniform(rng: &mut impl Rng) -> f32 {
    (rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// A number below `end`, by multiplication: no number is likelier than another by more than `end` / 2³².
pub(crate) fn below(rng: &mut impl Rng, end: u32) -> u32 {
    ((u64::from(rng.next_u32()) * u64::from(end)) >> 32) as u32
}

/// A normally distributed number (Box and Muller 1958).
pub(crate) fn normal(rng: &mut impl Rng) -> f64 {
    // 1 − u is never zero.
    let radius = (-2.0 * libm::log(1.0 - f64::from(uniform(rng)))).sqrt();
    radius * libm::cos(core::f64::consts::TAU * f64::from(uniform(rng)))
}

/// The numbers below `end` in a random order (Fisher and Yates).
pub(crate) fn permutation(rng: &mut impl Rng, end: u32) -> Vec<u32> {
    let mut order: Vec<u32> = (0..end).collect();
    for last in (1..end).rev() {
        order.swap(last as usize, below(rng, last + 1) as usize);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_seed_purpose_and_place() {
        let mut first = Vec::new();
        for seed in 0..4 {
            for purpose in [Purpose::Weights, Purpose::Actions, Purpose::Order] {
                for place in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    first.push(stream(seed, purpose, place).next_u64());
                }
            }
        }
        let all = first.len();
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), all);
    }

    #[test]
    fn a_permutation_has_every_number_once() {
        let mut rng = stream(3, Purpose::Order, (0, 0));
        let mut order = permutation(&mut rng, 1_000);
        assert_ne!(order, (0..1_000).collect::<Vec<_>>());
        order.sort_unstable();
        assert_eq!(order, (0..1_000).collect::<Vec<_>>());
    }

    #[test]
    fn normal_numbers_have_their_moments() {
        let mut rng = stream(7, Purpose::Weights, (0, 0));
        let draws: Vec<f64> = (0..20_000).map(|_| normal(&mut rng)).collect();
        let mean = draws.iter().sum::<f64>() / 20_000.0;
        let variance = draws.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / 20_000.0;
        assert!(
            mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05,
            "{mean} {variance}"
        );
    }
}
