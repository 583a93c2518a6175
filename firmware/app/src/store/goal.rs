//! A behaviour as it is kept over a restart that was asked for.

use crate::goal::{Goal, Swarm};

/// Bytes of one: which, and its speed as `f32`, little-endian.
pub(super) const ENCODED: usize = 5;

/// Kept where there is none.
pub(super) const NOTHING: [u8; ENCODED] = [0; ENCODED];

/// A behaviour as bytes; [`NOTHING`] for what has an end and is not taken up again.
pub(super) const fn encode(goal: &Goal) -> [u8; ENCODED] {
    let (kind, speed) = match goal {
        Goal::Wander { speed } => (1, *speed),
        Goal::Swarm(Swarm::Disperse) => (2, 0.0),
        Goal::Swarm(Swarm::Gather) => (3, 0.0),
        Goal::Swarm(Swarm::Flock) => (4, 0.0),
        Goal::Swarm(Swarm::Formation) => (5, 0.0),
        Goal::Manual { .. } | Goal::Goto { .. } => return NOTHING,
    };
    let [a, b, c, d] = speed.to_le_bytes();
    [kind, a, b, c, d]
}

/// What [`encode`] wrote; `None` for nothing, and for what another program wrote or a flash made of it.
pub(super) fn decode(bytes: &[u8]) -> Option<Goal> {
    let [kind, a, b, c, d] = *<&[u8; ENCODED]>::try_from(bytes).ok()?;
    let speed = f32::from_le_bytes([a, b, c, d]);
    Some(match kind {
        1 if (0.0..=1.0).contains(&speed) => Goal::Wander { speed },
        2 => Goal::Swarm(Swarm::Disperse),
        3 => Goal::Swarm(Swarm::Gather),
        4 => Goal::Swarm(Swarm::Flock),
        5 => Goal::Swarm(Swarm::Formation),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use crawler_hal::Instant;

    use super::*;

    #[test]
    fn behaviours_are_read_as_they_were_written_and_nothing_else_is() {
        let swarm = [
            Swarm::Disperse,
            Swarm::Gather,
            Swarm::Flock,
            Swarm::Formation,
        ];
        let all = [0.0, 0.35, 1.0].map(|speed| Goal::Wander { speed });
        for goal in all.into_iter().chain(swarm.map(Goal::Swarm)) {
            assert_eq!(decode(&encode(&goal)), Some(goal));
        }
        let goto = Goal::Goto {
            x: 1.0,
            y: 2.0,
            deadline: Instant::BOOT,
        };
        assert_eq!(encode(&goto), NOTHING);
        let wander = encode(&Goal::Wander { speed: 0.5 });
        for bytes in [
            &NOTHING[..],
            &[],
            &wander[..4],
            &[1, 0, 0, 0xC0, 0x7F],
            &[1, 0, 0, 0x80, 0xBF],
            &[6, 0, 0, 0, 0],
            &[0xFF; ENCODED],
        ] {
            assert_eq!(decode(bytes), None, "{bytes:?}");
        }
    }
}
