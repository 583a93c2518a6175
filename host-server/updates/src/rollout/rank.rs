//! In which order robots of a phase are chosen: by chance, but the same in every run.

use crawler_protocol::RobotId;

use super::names::RolloutId;

/// The place of a robot in the order of a rollout; the lowest is first.
///
/// It follows from both names alone: each rollout begins with other robots, and a server that takes a rollout
/// over goes on in the same order. FNV-1a over the names, then the finaliser of `MurmurHash3`, since FNV leaves
/// names that end alike close together.
pub(super) fn rank(rollout: &RolloutId, robot: &RobotId) -> u64 {
    let names = [rollout.as_str(), "/", robot.as_str()];
    let bytes = names.iter().flat_map(|name| name.bytes());
    let mut hash = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    for factor in [0xff51_afd7_ed55_8ccd, 0xc4ce_b9fe_1a85_ec53] {
        hash = (hash ^ (hash >> 33)).wrapping_mul(factor);
    }
    hash ^ (hash >> 33)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranks(rollout: &str) -> Vec<u64> {
        let rollout = RolloutId::new(rollout).unwrap();
        let robots = (0..1_000).map(|n| RobotId::new(&format!("sim-{n:04}")).unwrap());
        robots.map(|robot| rank(&rollout, &robot)).collect()
    }

    #[test]
    fn the_order_is_fixed_for_good() {
        assert_eq!(
            ranks("spring")[..2],
            [3_976_370_744_924_207_421, 11_461_716_712_649_309_585]
        );
    }

    #[test]
    fn neighbours_are_far_apart_and_rollouts_differ() {
        let (a, b) = (ranks("a"), ranks("b"));
        let distinct: std::collections::BTreeSet<_> = a.iter().chain(&b).collect();
        assert_eq!(distinct.len(), 2_000);
        // Each tenth of the order has about a tenth of the first hundred robots, and of all.
        for ranks in [&a[..], &b[..], &a[..100]] {
            let low = ranks.iter().filter(|rank| **rank < u64::MAX / 10).count();
            assert!(
                (ranks.len() / 20..ranks.len() / 5).contains(&low),
                "{low} of {}",
                ranks.len()
            );
        }
    }
}
