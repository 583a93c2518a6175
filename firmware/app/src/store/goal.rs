//! A behaviour as it is kept over a restart that was asked for.

use crawler_protocol::MAX_COORDINATE;

use crate::goal::{Goal, Swarm};

/// Numbers of the behaviour that has most of them.
const NUMBERS: usize = 2;

/// Bytes of one: which, and its numbers as `f32`, little-endian. Other programs may keep fewer numbers, or
/// more.
pub(super) const ENCODED: usize = 1 + 4 * NUMBERS;

/// Kept where there is none.
pub(super) const NOTHING: [u8; ENCODED] = [0; ENCODED];

/// A behaviour as bytes; [`NOTHING`] for what has an end and is not taken up again.
pub(super) fn encode(goal: &Goal) -> [u8; ENCODED] {
    let (kind, numbers) = match *goal {
        Goal::Wander { speed } => (1, [speed, 0.0]),
        Goal::Swarm(Swarm::Disperse) => (2, [0.0; NUMBERS]),
        Goal::Swarm(Swarm::Gather { x, y }) => (3, [x, y]),
        Goal::Swarm(Swarm::Flock) => (4, [0.0; NUMBERS]),
        Goal::Swarm(Swarm::Formation) => (5, [0.0; NUMBERS]),
        // Which policy there will be after the restart is not known.
        Goal::Manual { .. } | Goal::Goto { .. } | Goal::Policy { .. } | Goal::Mission { .. } => {
            return NOTHING;
        }
    };
    let mut bytes = NOTHING;
    let all = core::iter::once(kind).chain(numbers.into_iter().flat_map(f32::to_le_bytes));
    for (to, byte) in bytes.iter_mut().zip(all) {
        *to = byte;
    }
    bytes
}

/// What [`encode`] wrote; `None` for nothing, and for what another program wrote that means nothing here or a
/// flash made of it. Numbers that are not there are 0.
pub(super) fn decode(bytes: &[u8]) -> Option<Goal> {
    let (kind, rest) = bytes.split_first()?;
    let (numbers, left) = rest.as_chunks::<4>();
    if numbers.is_empty() || !left.is_empty() {
        return None;
    }
    let number = |index: usize| numbers.get(index).map_or(0.0, |n| f32::from_le_bytes(*n));
    let place = |value: f32| libm::fabsf(value) <= MAX_COORDINATE;
    let [first, second] = [number(0), number(1)];
    Some(match kind {
        1 if (0.0..=1.0).contains(&first) => Goal::Wander { speed: first },
        2 => Goal::Swarm(Swarm::Disperse),
        3 if place(first) && place(second) => Goal::Swarm(Swarm::Gather {
            x: first,
            y: second,
        }),
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
            Swarm::Gather { x: -2.5, y: 7.0 },
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
        assert_eq!(encode(&Goal::Policy { name: 7 }), NOTHING);
        let wander = encode(&Goal::Wander { speed: 0.5 });
        for bytes in [
            &NOTHING[..],
            &[],
            &wander[..4],
            &[1, 0, 0, 0xC0, 0x7F],
            &[1, 0, 0, 0x80, 0xBF],
            &[3, 0, 0, 0xC0, 0x7F],
            &[6, 0, 0, 0, 0],
            &[0xFF; ENCODED],
        ] {
            assert_eq!(decode(bytes), None, "{bytes:?}");
        }
        let origin = Goal::Swarm(Swarm::Gather { x: 0.0, y: 0.0 });
        assert_eq!(
            decode(&[3, 0, 0, 0, 0]),
            Some(origin),
            "as earlier programs"
        );
    }
}
