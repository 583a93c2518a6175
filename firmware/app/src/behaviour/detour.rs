//! Which way round an obstacle, on the way to a target.

use crawler_hal::Duration;

use crate::state::Side;

/// What `goto` drives straight for after turning aside, before it heads for its target again.
const STRAIGHT: Duration = Duration::from_millis(1_200);
/// Longest straight, as a multiple of that.
const LONGEST: u32 = 3;
/// Coming nearer to the target by less than this is coming no nearer, in metres.
const NEARER_M: f32 = 0.15;
/// Turns to one side before the other one is tried. Each later try has twice as many: wherever the
/// way round is, it is found at a small multiple of its length.
const FIRST_TRY: u8 = 4;
/// Most turns of a try.
const LONGEST_TRY: u8 = 64;

/// The way round whatever keeps the robot from its target.
///
/// Choosing a side anew at every turn would be a random walk along a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Detour {
    side: Side,
    /// Least distance to the target when blocked, in metres.
    nearest: f32,
    turns: u8,
    limit: u8,
}

impl Detour {
    /// The detour of a robot that is blocked `distance` metres from its target, after `before`. It
    /// keeps to its side as long as it comes no nearer; `drawn` is the side of a new one.
    pub fn next(before: Option<Self>, distance: f32, drawn: Side) -> Self {
        let fresh = Self {
            side: drawn,
            nearest: distance,
            turns: 1,
            limit: FIRST_TRY,
        };
        let Some(before) = before else { return fresh };
        if distance < before.nearest - NEARER_M {
            return fresh;
        }
        if before.turns < before.limit {
            return Self {
                turns: before.turns + 1,
                ..before
            };
        }
        Self {
            side: before.side.other(),
            turns: 1,
            limit: before.limit.saturating_mul(2).min(LONGEST_TRY),
            ..before
        }
    }

    /// The side to turn to.
    pub const fn side(&self) -> Side {
        self.side
    }

    /// How long to drive straight after turning aside: longer, the longer the way round turns out
    /// to be.
    pub fn straight(before: Option<&Self>) -> Duration {
        let turns = before.map_or(0, |detour| u32::from(detour.turns));
        STRAIGHT * (1 + turns / 4).min(LONGEST)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_side_is_kept_until_it_leads_nearer_or_has_had_its_turns() {
        let mut detour = Detour::next(None, 1.2, Side::Left);
        let mut sides = std::vec![detour.side()];
        for _ in 0..30 {
            // Along a wall the target is never nearer than in front of it.
            detour = Detour::next(Some(detour), 1.3, Side::Right);
            sides.push(detour.side());
        }
        let runs: std::vec::Vec<usize> = sides.chunk_by(|a, b| a == b).map(<[_]>::len).collect();
        assert_eq!(runs, [4, 8, 16, 3]);
        assert_eq!(
            sides[..5],
            [Side::Left, Side::Left, Side::Left, Side::Left, Side::Right]
        );
        // Past the wall it is another obstacle, with a side of its own.
        let beyond = Detour::next(Some(detour), 0.9, Side::Right);
        assert_eq!(beyond, Detour::next(None, 0.9, Side::Right));
    }

    #[test]
    fn tries_and_straights_grow_and_have_an_end() {
        let mut detour = Detour::next(None, 1.0, Side::Left);
        assert_eq!(Detour::straight(None), STRAIGHT);
        assert_eq!(Detour::straight(Some(&detour)), STRAIGHT);
        let mut longest = 0;
        let mut run = 0;
        for _ in 0..2_000 {
            let next = Detour::next(Some(detour), f32::NAN, Side::Left);
            run = if next.side() == detour.side() {
                run + 1
            } else {
                1
            };
            longest = longest.max(run);
            detour = next;
            assert!(Detour::straight(Some(&detour)) <= STRAIGHT * LONGEST);
        }
        assert_eq!(longest, u32::from(LONGEST_TRY));
    }
}
