//! What a robot remembers of its surroundings, from a ranger that sees one direction at a time.
//!
//! An echo comes from anywhere in the cone of the ranger, so it is kept as three points across the cone. They stay until
//! they are old, or the ranger has looked through the place with the middle of its cone: what leaves the cone as the
//! robot comes nearer is beside it, and not gone. For each of 24 directions it is known when the robot looked there last,
//! and how far it has driven since: what was not looked at is not free, and is in the way. Where somebody known to be
//! near stands, an echo is theirs and is not kept.

use crawler_hal::Millimeters;
use heapless::Vec;

use super::sector::{SECTORS, sector};
use super::shield::Around;
use crate::motion::angle::{Angle, ONE_BITS, turned};
use crate::perception::Sight;

/// Echoes that are kept.
const POINTS: usize = 64;
/// Directions of looks.
const DIRECTIONS: u16 = 24;

/// Radius of the body, in millimetres.
const RADIUS: i32 = 85;
/// From the middle of the robot to its ranger, in millimetres.
const MOUNT: i32 = 60;
/// Farther echoes are not kept, in millimetres from the ranger: what they come from is not known well enough.
const FARTHEST: i32 = 1_300;
/// Echoes within this of each other along both axes are of one thing, in millimetres.
const SAME: i32 = 90;
/// Points of an echo: in the middle of the cone, and 8° to both sides.
const ACROSS: [Angle; 3] = [
    Angle::from_units(0),
    Angle::from_units(1_456),
    Angle::from_units(-1_456),
];
/// 7.5°.
const HALFWAY: Angle = Angle::from_units(1_365);
/// An echo so near to somebody along both axes is theirs, in millimetres.
const THEIRS: i32 = 250;
/// What stands nearer than the echo by more than this is not there any more, in millimetres.
const THROUGH: i32 = 150;
/// Part of the way along the beam that it is free to both sides: less than the cone of the ranger.
const BEAM: i32 = 10;
/// An echo is kept for so many decisions: 20 s.
const KEPT: u16 = 200;
/// A look counts for nothing after so many decisions: 10 s.
const LOOKED: u16 = 100;
/// Nor after so many centimetres.
const DRIVEN: u16 = 70;
/// Long ago, in decisions.
const LONG: u16 = 1_000;
/// So far from where memory begins, in millimetres, it begins anew: coordinates of points have 16 bits.
const REACH: i32 = 20_000;
/// From the rim a thing counts from here on, in millimetres.
const NEAR: i32 = 1_500;
/// A corridor is so much wider than what drives in it, to each side, in millimetres.
const ASIDE: i32 = 55;
/// What is less than this ahead or behind is beside, in millimetres.
const BESIDE: i32 = 20;

/// Where a robot is and heads, in whole numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Place {
    /// Millimetres along both axes.
    pub(super) at: [i32; 2],
    /// Heading.
    pub(super) heading: Angle,
}

/// Somebody near, relative to the robot.
#[derive(Debug, Clone, Copy, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Other {
    /// Millimetres along both axes of the world.
    pub(super) at: [i16; 2],
    /// Their distance.
    pub(super) distance: i16,
    /// Millimetres per second along both axes of the world.
    pub(super) velocity: [i16; 2],
}

/// Where an echo came from.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Point {
    /// Millimetres from where memory begins.
    at: [i16; 2],
    /// At which decision.
    seen: u16,
}

/// The last look in a direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Look {
    /// At which decision.
    at: u16,
    /// After how many centimetres.
    way: u16,
}

/// See the [module](self).
#[derive(Debug, Clone)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Memory {
    points: Vec<Point, POINTS>,
    looks: [Look; DIRECTIONS as usize],
    /// Where it begins, in millimetres.
    origin: [i32; 2],
    /// Driven so far, in millimetres.
    way: u32,
    /// Counts decisions.
    decision: u16,
}

/// What is around a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Survey {
    /// How near the nearest thing is in each sector: 127 at the rim, 0 from 1.5 m on.
    pub(super) things: [i8; SECTORS],
    /// How well it is known what is in each sector: 127 was looked at just now, 0 is not known.
    pub(super) looks: [i8; SECTORS],
    /// What is in the way.
    pub(super) around: Around,
}

impl Survey {
    /// Nothing is there.
    pub(super) const EMPTY: Self = Self {
        things: [0; SECTORS],
        looks: [0; SECTORS],
        around: Around::CLEAR,
    };
}

impl Memory {
    /// Nothing is known.
    pub(super) const fn new() -> Self {
        Self {
            points: Vec::new(),
            looks: [Look {
                at: 0u16.wrapping_sub(LONG),
                way: 0,
            }; DIRECTIONS as usize],
            origin: [0; 2],
            way: 0,
            decision: 0,
        }
    }

    /// Another decision, after `way` millimetres.
    pub(super) fn pass(&mut self, place: &Place, way: u16) {
        self.way = self.way.wrapping_add(u32::from(way));
        self.decision = self.decision.wrapping_add(1);
        let now = self.decision;
        self.points
            .retain(|point| now.wrapping_sub(point.seen) <= KEPT);
        // What is old stays old when numbers come round.
        let way = self.centimetres();
        for look in &mut self.looks {
            if now.wrapping_sub(look.at) > LONG || way.wrapping_sub(look.way) > LONG {
                look.at = now.wrapping_sub(LONG);
                look.way = way;
            }
        }
        let far = |(at, origin): (&i32, &i32)| at.abs_diff(*origin) > REACH.unsigned_abs() / 2;
        if place.at.iter().zip(&self.origin).any(far) {
            self.points.clear();
            self.origin = place.at;
        }
    }

    fn centimetres(&self) -> u16 {
        (self.way / 10) as u16
    }

    /// Takes in what the ranger saw from `place`.
    pub(super) fn see(&mut self, place: &Place, sight: Sight, others: &[Other]) {
        let towards = place.heading.direction();
        let distance = match sight {
            Sight::Range(Millimeters(mm)) => i32::from(mm),
            Sight::Touching => 0,
            Sight::Clear => i32::MAX / 2,
        };
        let way = self.centimetres();
        if let Some(look) = self.looks.get_mut(place.heading.part(DIRECTIONS)) {
            *look = Look {
                at: self.decision,
                way,
            };
        }
        let [x, y] = self.own(place);
        let free = distance.min(FARTHEST) + MOUNT - THROUGH;
        self.points.retain(|point| {
            let [px, py] = point.at.map(i32::from);
            let [along, across] = turned([px - x, py - y], towards);
            !(along > RADIUS && along < free && across.abs() * BEAM < along)
        });
        if distance > FARTHEST {
            return;
        }
        let along =
            |towards: [i32; 2], distance: i32| towards.map(|part| (distance * part) >> ONE_BITS);
        let echo = along(towards, distance + MOUNT);
        let theirs = |other: &Other| {
            let [x, y] = other.at.map(i32::from);
            (x - echo[0]).abs() < THEIRS && (y - echo[1]).abs() < THEIRS
        };
        if others.iter().any(theirs) {
            return;
        }
        let mount = along(towards, MOUNT);
        for off in ACROSS {
            let across = place.heading.plus(off).direction();
            let [ex, ey] = along(across, distance);
            self.keep([x + mount[0] + ex, y + mount[1] + ey]);
        }
    }

    /// Keeps a point.
    fn keep(&mut self, [x, y]: [i32; 2]) {
        let at = [x, y].map(|along| along.clamp(-REACH, REACH) as i16);
        let new = Point {
            at,
            seen: self.decision,
        };
        let same = |point: &&mut Point| {
            let [px, py] = point.at.map(i32::from);
            (px - x).abs() < SAME && (py - y).abs() < SAME
        };
        if let Some(known) = self.points.iter_mut().find(same) {
            *known = new;
        } else if let Err(new) = self.points.push(new) {
            let now = self.decision;
            let age = |point: &&mut Point| now.wrapping_sub(point.seen);
            if let Some(oldest) = self.points.iter_mut().max_by_key(age) {
                *oldest = new;
            }
        }
    }

    /// The robot as points are.
    fn own(&self, place: &Place) -> [i32; 2] {
        let along =
            |axis: usize| (place.at[axis].saturating_sub(self.origin[axis])).clamp(-REACH, REACH);
        [along(0), along(1)]
    }

    /// The things around `place`: the first half of a survey.
    pub(super) fn things(&self, place: &Place) -> Survey {
        let towards = place.heading.direction();
        let [x, y] = self.own(place);
        let mut survey = Survey::EMPTY;
        for point in &self.points {
            let [px, py] = point.at.map(i32::from);
            let there = turned([px - x, py - y], towards);
            if let Some(thing) = survey.things.get_mut(sector(there)) {
                *thing = (*thing).max(nearness(distance(there)));
            }
            block(&mut survey.around, there, RADIUS);
        }
        survey
    }

    /// Who is around `place`, and how well it is known what is: the other half.
    pub(super) fn complete(&self, survey: &mut Survey, place: &Place, others: &[Other]) {
        let towards = place.heading.direction();
        for other in others {
            let there = turned(other.at.map(i32::from), towards);
            block(&mut survey.around, there, 2 * RADIUS);
        }
        for (number, look) in survey.looks.iter_mut().enumerate() {
            // The middle of the sector, and 7.5° to both sides.
            let middle = (number * 65_536 / SECTORS) as u16;
            let middle = place.heading.plus(Angle::from_units(middle.cast_signed()));
            let [right, left] = [middle.minus(HALFWAY), middle.plus(HALFWAY)];
            *look = self.freshness(right).min(self.freshness(left));
        }
        let known = |sectors: [usize; 3]| {
            let looks = sectors
                .iter()
                .filter_map(|sector| survey.looks.get(*sector));
            looks.min().is_some_and(|least| *least > 0)
        };
        if !known([SECTORS - 1, 0, 1]) {
            survey.around.ahead = 0;
        }
        if !known([5, 6, 7]) {
            survey.around.behind = 0;
        }
    }

    /// How well it is known what is in this direction.
    fn freshness(&self, towards: Angle) -> i8 {
        let Some(look) = self.looks.get(towards.part(DIRECTIONS)) else {
            return 0;
        };
        let age = i32::from(self.decision.wrapping_sub(look.at).min(LOOKED));
        let way = i32::from(self.centimetres().wrapping_sub(look.way).min(DRIVEN));
        let left = 127 - age * 127 / i32::from(LOOKED) - way * 127 / i32::from(DRIVEN);
        left.max(0) as i8
    }
}

/// A distance without a root: too long by at most a fifteenth.
pub(super) fn distance([x, y]: [i32; 2]) -> i32 {
    let (x, y) = (x.abs(), y.abs());
    x.max(y) + x.min(y) * 3 / 8
}

/// 127 at the rim, 0 from [`NEAR`] on.
fn nearness(distance: i32) -> i8 {
    (127 - (distance - RADIUS).clamp(0, NEAR) * 127 / NEAR) as i8
}

/// Takes in something at a place ahead and to the left whose rim and the robot's are `reach` from its middle.
fn block(around: &mut Around, [along, across]: [i32; 2], reach: i32) {
    let inside = reach + ASIDE - across.abs();
    if inside <= 0 || along.abs() < BESIDE {
        return;
    }
    // Round bodies: what is off to one side is met later.
    let free = (along.abs() - inside.min(reach)).clamp(0, i32::from(u16::MAX)) as u16;
    let way = if along > 0 {
        &mut around.ahead
    } else {
        &mut around.behind
    };
    *way = (*way).min(free);
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const fn at(x: i32, y: i32, heading: u16) -> Place {
        Place {
            at: [x, y],
            heading: Angle::from_units(heading.cast_signed()),
        }
    }

    fn range(mm: u16) -> Sight {
        Sight::Range(Millimeters(mm))
    }

    impl Memory {
        fn survey(&self, place: &Place, others: &[Other]) -> Survey {
            let mut survey = self.things(place);
            self.complete(&mut survey, place, others);
            survey
        }
    }

    /// Looks everywhere but to the left.
    fn look_around(memory: &mut Memory, place: &Place) {
        for bin in (0..24_u16).filter(|bin| !(5..=6).contains(bin)) {
            memory.see(
                &at(place.at[0], place.at[1], bin * 2_731 + 1_000),
                Sight::Clear,
                &[],
            );
        }
        for bin in 5..=6 {
            let look = Look {
                at: memory.decision,
                way: memory.centimetres(),
            };
            memory.looks[bin] = look;
        }
    }

    #[test]
    fn what_was_seen_is_remembered_where_it_is() {
        let mut memory = Memory::new();
        // 1 m from the middle, along the y axis.
        memory.see(&at(0, 0, 0x4000), range(940), &[]);
        let survey = memory.survey(&at(0, 0, 0), &[]);
        let [near] = [127 - (1_000 - 85) * 127 / 1_500].map(|near| near as i8);
        let mut things = [0; SECTORS];
        things[3] = near;
        assert_eq!(survey.things, things, "to the left");
        assert_eq!(survey.looks, [0; SECTORS], "a sector takes two looks");
        let unknown = Around {
            ahead: 0,
            behind: 0,
        };
        assert_eq!(survey.around, unknown);
        look_around(&mut memory, &at(0, 0, 0));
        assert_eq!(memory.survey(&at(0, 0, 0), &[]).around, Around::CLEAR);
        // From half way, facing it, with the back to it, and beside it.
        let ahead = memory.survey(&at(0, 500, 0x4000), &[]).around;
        assert_eq!(
            (ahead.ahead, ahead.behind),
            (415, u16::MAX),
            "the middle one of three"
        );
        let behind = memory.survey(&at(0, 500, 0xC000), &[]).around;
        assert_eq!((behind.ahead, behind.behind), (u16::MAX, 416));
        let beside = memory.survey(&at(400, 500, 0x4000), &[]).around;
        assert_eq!(beside, Around::CLEAR);
    }

    #[test]
    fn what_is_looked_through_is_forgotten_and_so_is_what_is_old() {
        let mut memory = Memory::new();
        memory.see(&at(0, 0, 0), range(600), &[]);
        memory.see(&at(0, 0, 0x4000), range(600), &[]);
        assert!(memory.points.len() > 2);
        // Nearer by less than what a ranger errs by.
        memory.see(&at(0, 0, 0), range(700), &[]);
        let all = memory.points.len();
        assert!(
            (5..=8).contains(&all),
            "three more, as far as they are others: {all}"
        );
        memory.see(&at(0, 0, 0), Sight::Clear, &[]);
        let left = memory.points.len();
        assert!(left < all, "in the middle of the cone nothing is left");
        for _ in 0..KEPT {
            memory.pass(&at(0, 0, 0), 0);
        }
        assert_eq!(memory.points.len(), left);
        memory.pass(&at(0, 0, 0), 0);
        assert_eq!(memory.points.len(), 0);
    }

    #[test]
    fn an_echo_of_somebody_known_is_not_kept() {
        let mut memory = Memory::new();
        let other = Other {
            at: [0, 650],
            distance: 650,
            velocity: [0; 2],
        };
        memory.see(&at(0, 0, 0x4000), range(500), &[other]);
        assert_eq!(memory.points.len(), 0);
        look_around(&mut memory, &at(0, 0, 0));
        let around = memory.survey(&at(0, 0, 0x4000), &[other]).around;
        assert_eq!((around.ahead, around.behind), (480, u16::MAX));
        memory.see(&at(0, 0, 0), range(500), &[other]);
        assert!(!memory.points.is_empty());
    }

    #[test]
    fn looks_fade_with_time_and_way() {
        let mut memory = Memory::new();
        let place = at(0, 0, 0);
        for heading in 0..24_u16 {
            memory.see(&at(0, 0, heading * 2_731 + 1_000), Sight::Clear, &[]);
        }
        assert_eq!(memory.survey(&place, &[]).looks, [127; SECTORS]);
        for _ in 0..50 {
            memory.pass(&place, 0);
        }
        let half = memory.survey(&place, &[]).looks;
        assert!(half.iter().all(|look| (63..=64).contains(look)), "{half:?}");
        memory.pass(&place, 350);
        let less = memory.survey(&place, &[]).looks;
        assert!(less.iter().all(|look| *look < 3), "{less:?}");
        // Nothing is young again when counters come round.
        for _ in 0..70_000 {
            memory.pass(&place, 0);
            assert!(
                memory
                    .survey(&place, &[])
                    .looks
                    .iter()
                    .all(|look| *look < 3)
            );
        }
    }

    proptest! {
        #[test]
        fn no_place_and_no_echo_is_too_much(
            steps in prop::collection::vec(
                (any::<[i32; 2]>(), any::<u16>(), any::<u16>(), any::<u16>(), -8_000..8_000_i32, -8_000..8_000_i32), 1..200,
            ),
        ) {
            let mut memory = Memory::new();
            for (near, (there, heading, mm, way, x, y)) in steps.into_iter().enumerate() {
                let place = at(there[0] >> (near % 31), there[1] >> (near % 29), heading);
                let other = Other { at: [x, y].map(|along| along as i16), distance: distance([x, y]) as i16, velocity: [0; 2] };
                let sight = if mm < 100 { Sight::Clear } else { range(mm) };
                memory.pass(&place, way);
                memory.see(&place, sight, &[other]);
                let survey = memory.survey(&place, &[other]);
                prop_assert!(survey.things.iter().chain(&survey.looks).all(|value| *value >= 0));
            }
        }
    }
}
