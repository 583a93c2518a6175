//! Which point of the way is next.

use super::map::CELL_MM;
use super::{BODY_MM, Destination, Navigator, STANDING_MM};

/// Cells of the way that are tried as the next point, nearest first.
const TRIED: [u8; 6] = [2, 3, 5, 8, 13, 20];
/// Cells to what is blocked that a point of the way and the line to it should have, where there are as many: what is marked
/// may be a cell off.
const ROOM: u8 = 2;
/// Somebody nearer ahead than this wants part of that room, in millimetres, and half as far to either side.
const BESIDE_MM: i32 = 700;
/// Nearer than this somebody who comes head-on is met, in millimetres, and with so much between the middles
/// of both they pass each other. In a corridor each has to be beside its wall before that, and what is told of others is
/// half a second old.
const MEET_MM: i32 = 3_000;
pub(super) const PASS_MM: i32 = 240;

impl Navigator {
    /// The farthest point of the way that the robot can drive to in a straight line with [`ROOM`] to either side, or with
    /// as much as the plan keeps where that is nowhere.
    ///
    /// A plan takes the shortest way, along whatever it goes round, and the line to a far point of it cuts each corner.
    pub(super) fn next_point(&mut self, going: Destination) -> Option<[i32; 2]> {
        let here = self.map.cell(self.here.at);
        let goal = self.map.cell(going.at);
        self.wave.set_start(here);
        let mut cell = self.wave.nearest(here)?;
        let has_room = self.nobody_is_ahead();
        let (mut roomy, mut straight) = (None, None);
        let mut tried = TRIED.iter();
        let mut try_at = *tried.next()?;
        for step in 1..=TRIED[TRIED.len() - 1] {
            let next = self.wave.nearer(cell, goal);
            cell = next.unwrap_or(cell);
            if step < try_at && next.is_some() {
                continue;
            }
            let point = if cell == goal {
                going.at
            } else if has_room {
                self.map.middle(self.wave.roomiest(&self.map, cell, ROOM))
            } else {
                self.map.middle(cell)
            };
            if self.is_straight(point, ROOM) {
                roomy = Some(point);
            } else if straight.is_some() && !self.is_straight(point, 0) {
                break;
            }
            straight = Some(point);
            if next.is_none() {
                break;
            }
            try_at = tried.next().copied().unwrap_or(u8::MAX);
        }
        roomy.or(straight)
    }

    /// Whether nobody is so near ahead that the middle of a way is not the robot's own.
    fn nobody_is_ahead(&self) -> bool {
        !self.others.iter().any(|other| {
            let [ahead, left] = self.here.seen_from(other.at);
            (0..BESIDE_MM).contains(&ahead) && left.abs() < BESIDE_MM / 2
        })
    }

    /// The next point, further to the right where somebody comes head-on: so much that both pass each other if
    /// both do so, as far as there is room.
    pub(super) fn keep_right(&self, point: [i32; 2]) -> [i32; 2] {
        let meets = self.others.iter().find_map(|other| {
            let [ahead, left] = self.here.seen_from(other.at);
            let [c, s] = self.here.heading;
            let along = (other.velocity[0] * c + other.velocity[1] * s) >> 12;
            let is_met = (BODY_MM..MEET_MM).contains(&ahead)
                && (-MEET_MM / 4..PASS_MM).contains(&left)
                && along < -STANDING_MM;
            is_met.then_some([ahead, left])
        });
        let Some([ahead, left]) = meets else {
            return point;
        };
        let [along, beside] = self.here.seen_from(point);
        let along = along.min(ahead / 2);
        // It turns elsewhere, or there already.
        if along < BODY_MM || beside.abs() > along {
            return point;
        }
        let tries = [ROOM, 1, 0]
            .into_iter()
            .flat_map(|room| [4, 3, 2, 1].map(|quarters| (room, quarters)));
        for (room, quarters) in tries {
            let aside = (left - PASS_MM) * quarters / 8;
            let to = self.here.point(along, aside);
            if aside < beside && self.wave.passes(&self.map, self.map.cell(to), room) {
                return to;
            }
        }
        point
    }

    /// Whether the straight way to `point` is passable with so many cells to what is blocked, and no fewer than the plan
    /// keeps.
    fn is_straight(&self, point: [i32; 2], room: u8) -> bool {
        let from = self.here.at;
        let [dx, dy] = [0, 1].map(|axis| point[axis] - from[axis]);
        let steps = (dx.abs().max(dy.abs()) / (CELL_MM / 2)).max(1);
        // In 256ths of a millimetre; the way is at most some metres long.
        let [step_x, step_y] = [dx, dy].map(|along| (along << 8) / steps);
        let mut last = self.map.cell(from);
        for step in 1..=steps {
            let at = [
                from[0] + ((step_x * step) >> 8),
                from[1] + ((step_y * step) >> 8),
            ];
            let cell = self.map.cell(at);
            if cell != last {
                last = cell;
                if !self.wave.passes(&self.map, cell, room) {
                    return false;
                }
            }
        }
        true
    }
}
