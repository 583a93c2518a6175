//! Randomness with a name: every stream belongs to one device of one robot of one world.

use rand_core::Rng;
use rand_pcg::Pcg32;

/// What a stream of random numbers is for. Two purposes never share a stream, so that a
/// measurement more of one device does not change what another one draws.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Purpose {
    Build = 1,
    Program = 2,
    Ranger = 3,
    Battery = 4,
    Camera = 5,
    Flash = 6,
    Serial = 7,
    Tracker = 8,
    Radio = 9,
    Senses = 10,
    Start = 11,
    Hostile = 12,
    Defects = 13,
}

/// The stream of `purpose` for one robot of the world with this seed.
pub(crate) fn stream(seed: u64, robot: u32, purpose: Purpose) -> Pcg32 {
    let place = u64::from(robot) << 8 | purpose as u64;
    // Mixed, so that neighbouring seeds and robots begin far apart; the stream selector differs
    // for each place, so that no two ever run on the same sequence.
    Pcg32::new(mix(seed ^ mix(place)), place)
}

/// The finaliser of `SplitMix64` (Steele, Lea, Flood: Fast Splittable Pseudorandom Number
/// Generators, OOPSLA 2014).
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

/// A normally distributed number (Box and Muller 1958).
pub(crate) fn normal(rng: &mut impl Rng) -> f32 {
    // 1 − u is never zero.
    let radius = (-2.0 * libm::logf(1.0 - uniform(rng))).sqrt();
    radius * libm::cosf(core::f32::consts::TAU * uniform(rng))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_seed_robot_and_purpose() {
        let mut first: Vec<u64> = Vec::new();
        for seed in 0..4 {
            for robot in 0..4 {
                for purpose in [Purpose::Build, Purpose::Program, Purpose::Ranger] {
                    first.push(stream(seed, robot, purpose).next_u64());
                }
            }
        }
        let all = first.len();
        first.sort_unstable();
        first.dedup();
        assert_eq!(first.len(), all);
    }

    #[test]
    fn numbers_have_the_moments_they_should() {
        let mut rng = stream(7, 0, Purpose::Ranger);
        let n = 20_000_u16;
        let draws: Vec<f32> = (0..n).map(|_| normal(&mut rng)).collect();
        let mean = draws.iter().sum::<f32>() / f32::from(n);
        let variance = draws.iter().map(|d| (d - mean) * (d - mean)).sum::<f32>() / f32::from(n);
        assert!(mean.abs() < 0.03, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.05, "variance {variance}");
        assert!((0..n).all(|_| (0.0..1.0).contains(&uniform(&mut rng))));
    }
}
