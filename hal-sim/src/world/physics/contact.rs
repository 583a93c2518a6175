//! What a robot may not drive into: others, walls, obstacles and movers.
//!
//! Everything here is decided by a robot alone, from what was published at the end of the last
//! step, so that robots can be moved in any order and on any thread.
//!
//! Two robots share the gap between them: each gets a part that both compute alike, and keeps
//! within it. So they cannot meet, whatever else happens to either. Momentum goes from one to the
//! other by an impulse that both compute alike but for its sign. When one touches several others,
//! each contact gets a share of its mass, which is what keeps a crowd from gaining energy.

use super::super::bodies::Presence;
use super::super::geometry::Vec2;
use super::super::space::Space;
use super::SKIN_M;
use super::drive::Stop;

/// Attempts to find a way that keeps within all limits before a robot stays where it is.
const PASSES: u8 = 8;

/// Rounding that a limit may be off by, metres.
const ROUNDING_M: f32 = 1e-6;

/// Closer than this, robots that touched still touch, metres.
const TOUCH_M: f32 = 2e-3;

/// How far a robot may go towards another one: `way · normal` must be at least −`part`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Limit {
    /// The other one.
    robot: u32,
    normal: Vec2,
    part: f32,
}

/// What a robot's neighbours do to it in a step.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Touch {
    /// Change of velocity, metres per second.
    pub(crate) kick: Vec2,
    /// Number of robots it collides with.
    pub(super) hits: u32,
    /// Whether any pushes it.
    pub(super) pushed: bool,
    /// Whether any is as close as touching.
    pub(super) close: bool,
    /// Whether any is close enough to be met within the step.
    pub(super) company: bool,
}

/// A robot and another one near it, as the first sees it.
struct Pair {
    normal: Vec2,
    gap: f32,
    /// Speed of approach.
    closing: f32,
    /// Speed of both together along the normal.
    common: f32,
}

impl Space {
    /// Robots whose centres are further apart cannot meet within a step, metres.
    fn meeting_m(&self) -> f32 {
        2.0 * (self.parameters.chassis.radius_m + self.stride_m) + SKIN_M
    }

    fn pair(&self, i: usize, j: usize) -> Option<Pair> {
        let seen = &self.bodies.published;
        if j == i || seen.presence[j] == Presence::Removed {
            return None;
        }
        let apart = seen.at[i].minus(seen.at[j]);
        let square = apart.dot(apart);
        let reach = self.meeting_m();
        // Also when a position is not a number. Two centres in one point have no direction.
        let near = square < reach * reach && square > 0.0;
        if !near {
            return None;
        }
        let distance = square.sqrt();
        let normal = apart.times(1.0 / distance);
        let (own, other) = (seen.velocity[i], seen.velocity[j]);
        Some(Pair {
            normal,
            gap: distance - 2.0 * self.parameters.chassis.radius_m - SKIN_M,
            closing: other.minus(own).dot(normal),
            common: other.plus(own).dot(normal) * 0.5,
        })
    }

    /// Whether a pair is about to use up more than its gap within the step.
    fn collides(&self, pair: &Pair) -> bool {
        pair.closing * self.dt > pair.gap.max(0.0)
    }

    /// Calls `each` for the robots near robot `i`, in order of their index.
    fn near(&self, i: usize, mut each: impl FnMut(usize)) {
        if self.members.contains(i) {
            for place in self.neighbours.of(i) {
                each(self.neighbours.robot(place));
            }
            return;
        }
        let reach = self.meeting_m();
        let half = Vec2::new(reach + self.stale_m, reach + self.stale_m);
        let block = self.cells.around(self.bodies.published.at[i], half);
        let mut found = [0_u32; 64];
        let mut count = 0;
        for row in block.rows.0..=block.rows.1 {
            let from = self.cells.index(block.columns.0, row);
            let to = self.cells.index(block.columns.1, row);
            for &j in self.robots.in_row(from, to) {
                if self.pair(i, j as usize).is_some() && count < found.len() {
                    found[count] = j;
                    count += 1;
                }
            }
        }
        found[..count].sort_unstable();
        for &j in &found[..count] {
            each(j as usize);
        }
    }

    /// Number of robots that collide with robot `i` in this step.
    fn collisions(&self, i: usize) -> u32 {
        let mut count = 0;
        self.near(i, |j| {
            count += u32::from(self.pair(i, j).is_some_and(|pair| self.collides(&pair)));
        });
        count
    }

    /// Gathers how far robot `i` may go towards others.
    pub(super) fn limits(&self, i: usize, limits: &mut Vec<Limit>) {
        limits.clear();
        self.near(i, |j| {
            if let Some(pair) = self.pair(i, j) {
                // Half of the gap each, shifted in favour of the one that follows.
                let half = pair.gap * 0.5;
                let shift = (pair.common * self.dt).clamp(-half.abs(), half.abs());
                limits.push(Limit {
                    robot: j as u32,
                    normal: pair.normal,
                    part: if half > 0.0 { half - shift } else { half },
                });
            }
        });
    }

    /// What the robots around robot `i` do to it.
    pub(crate) fn touch(&self, i: usize) -> Touch {
        let mut touch = Touch::default();
        let masses = &self.bodies.build;
        let pushes = &self.bodies.published.push;
        self.near(i, |j| {
            let Some(pair) = self.pair(i, j) else { return };
            touch.company = true;
            touch.close |= pair.gap < TOUCH_M;
            touch.hits += u32::from(self.collides(&pair));
            let (whom, impulse) = pushes[j];
            if whom as usize == i {
                touch.pushed = true;
                let change = pair.normal.times(impulse / masses[i].mass_kg);
                touch.kick = touch.kick.plus(change);
            }
        });
        if touch.hits == 0 {
            return touch;
        }
        let count = touch.hits;
        self.near(i, |j| {
            let Some(pair) = self.pair(i, j) else { return };
            if !self.collides(&pair) {
                return;
            }
            let excess = pair.closing - pair.gap.max(0.0) / self.dt;
            // A sum of two does not depend on who computes it.
            let share = |robot: usize, count: u32| count as f32 / masses[robot].mass_kg;
            let (own, other) = (share(i, count), share(j, self.collisions(j)));
            let impulse = excess / (own + other);
            touch.kick = touch
                .kick
                .plus(pair.normal.times(impulse / masses[i].mass_kg));
        });
        touch
    }

    /// Gathers the fixed surfaces near a robot at `at`, in its frame, and how fast it may approach
    /// each.
    pub(super) fn stops(&self, at: Vec2, heading: Vec2, stops: &mut Vec<Stop>) {
        let radius = self.parameters.chassis.radius_m;
        let per_step = 1.0 / self.dt;
        let mut add = |normal: Vec2, gap: f32, own: f32| {
            // What comes towards the robot meets it from further away than the robot alone can go.
            if gap < self.stride_m + own.max(0.0) * self.dt {
                stops.push(Stop {
                    normal: normal.into_frame(heading),
                    least: own - gap.max(0.0) * per_step,
                    taken: 0.0,
                });
            }
        };
        let (x, y) = (
            self.arena.width * 0.5 - radius,
            self.arena.height * 0.5 - radius,
        );
        add(Vec2::new(-1.0, 0.0), x - at.x, 0.0);
        add(Vec2::new(1.0, 0.0), x + at.x, 0.0);
        add(Vec2::new(0.0, -1.0), y - at.y, 0.0);
        add(Vec2::new(0.0, 1.0), y + at.y, 0.0);
        for &solid in self.solid_grid.in_cell(self.cells.at(at)) {
            let (distance, normal) = self.solids[solid as usize].separation(at);
            add(normal, distance - radius - SKIN_M, 0.0);
        }
        for k in 0..self.movers.len() {
            if self.is_near_mover(at, k) {
                let (distance, normal) = self.movers.now(k).separation(at);
                let own = self.movers.velocity(k, self.dt).dot(normal);
                add(normal, distance - radius - SKIN_M, own);
            }
        }
    }

    /// Whether a robot at `at` may meet mover `k` in this step.
    pub(super) fn is_near_mover(&self, at: Vec2, k: usize) -> bool {
        let apart = at.minus(self.movers.now(k).centre());
        let reach = self.movers.around(k) + self.parameters.chassis.radius_m + 2.0 * self.stride_m;
        apart.dot(apart) < reach * reach
    }

    /// Brings the way a robot wants to go from `at` within its limits and out of everything solid.
    /// `None` when that is not found.
    pub(super) fn fit(&self, at: Vec2, want: Vec2, limits: &[Limit]) -> Option<Vec2> {
        let mut way = want;
        for _ in 0..PASSES {
            let mut moved = false;
            for limit in limits {
                let over = -limit.part - way.dot(limit.normal);
                if over > ROUNDING_M {
                    way = way.plus(limit.normal.times(over));
                    moved = true;
                }
            }
            let place = at.plus(way);
            let free = self.push_out(place);
            if free != place {
                way = free.minus(at);
                moved = true;
            }
            if !moved {
                let length = way.dot(way);
                let most = self.stride_m + ROUNDING_M;
                return (length <= most * most).then_some(way);
            }
        }
        None
    }

    /// The one of `limits` that kept a robot back most when it wanted to go `want` and went `way`:
    /// its number, the direction from it, and by how much, in metres.
    pub(super) fn held_back(limits: &[Limit], want: Vec2, way: Vec2) -> Option<(u32, Vec2, f32)> {
        let lost = way.minus(want);
        let mut most = None;
        let mut least = ROUNDING_M;
        for limit in limits {
            let by = lost.dot(limit.normal);
            let met = way.dot(limit.normal) <= ROUNDING_M - limit.part;
            if met && by > least {
                least = by;
                most = Some((limit.robot, limit.normal, by));
            }
        }
        most
    }

    /// Pushes a disc out of everything fixed that it overlaps, one thing after the other.
    fn push_out(&self, mut place: Vec2) -> Vec2 {
        let radius = self.parameters.chassis.radius_m;
        let clear = |solid: &super::super::arena::Solid, place: Vec2| {
            let (distance, direction) = solid.separation(place);
            if distance < radius {
                place.plus(direction.times(radius + SKIN_M - distance))
            } else {
                place
            }
        };
        for &solid in self.solid_grid.in_cell(self.cells.at(place)) {
            place = clear(&self.solids[solid as usize], place);
        }
        for k in 0..self.movers.len() {
            if self.is_near_mover(place, k) {
                place = clear(self.movers.next(k), place);
            }
        }
        let limit = Vec2::new(
            self.arena.width * 0.5 - radius,
            self.arena.height * 0.5 - radius,
        );
        if place.x.abs() > limit.x || place.y.abs() > limit.y {
            place = Vec2::new(
                place.x.clamp(-limit.x, limit.x),
                place.y.clamp(-limit.y, limit.y),
            );
        }
        place
    }

    /// Lets every mover go on for whom all robots in its way can make room, and makes the others
    /// wait.
    pub(super) fn move_movers(&mut self) {
        if self.movers.is_empty() {
            return;
        }
        self.movers.intend(self.dt);
        let mut limits = core::mem::take(&mut self.limits);
        for k in 0..self.movers.len() {
            let noted = self.movers.ways.len();
            if !self.finds_room(k, &mut limits) {
                self.movers.ways.truncate(noted);
                self.movers.wait(k);
            }
        }
        self.limits = limits;
    }

    /// Whether all robots in the way of mover `k` can make room; notes how.
    fn finds_room(&mut self, k: usize, limits: &mut Vec<Limit>) -> bool {
        let radius = self.parameters.chassis.radius_m;
        let next = *self.movers.next(k);
        let around = self.movers.around(k) + radius + SKIN_M + self.stale_m;
        let block = self.cells.around(next.centre(), Vec2::new(around, around));
        for row in block.rows.0..=block.rows.1 {
            let from = self.cells.index(block.columns.0, row);
            let to = self.cells.index(block.columns.1, row);
            for place in self.robots.row_range(from, to) {
                let i = self.robots.item(place) as usize;
                let at = self.bodies.published.at[i];
                if self.bodies.published.presence[i] == Presence::Removed
                    || next.separation(at).0 >= radius
                {
                    continue;
                }
                self.limits(i, limits);
                let Some(way) = self.fit_around(at, k, limits) else {
                    return false;
                };
                self.movers.ways.push((i as u32, way));
            }
        }
        true
    }

    /// Where a robot at `at` goes when mover `own` goes on. The movers after it have not decided
    /// yet, so it keeps out of where they are as well as of where they want to go.
    fn fit_around(&self, at: Vec2, own: usize, limits: &[Limit]) -> Option<Vec2> {
        let way = self.fit(at, Vec2::default(), limits)?;
        let place = at.plus(way);
        let radius = self.parameters.chassis.radius_m;
        let free = (0..self.movers.len()).all(|k| {
            k <= own
                || !self.is_near_mover(place, k)
                || self.movers.now(k).separation(place).0 >= radius
        });
        free.then_some(way)
    }
}
