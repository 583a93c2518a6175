//! The physical state of a world and what can be asked of it.

use super::arena::{Arena, ArenaError, Solid};
use super::bodies::{Bodies, Presence};
use super::dropped::Items;
use super::geometry::{Beam, Cone, Vec2};
use super::grid::{Cells, Grid};
use super::members::Members;
use super::movers::Movers;
use super::neighbours::Neighbours;
use super::parameters::Parameters;
use super::patches::Patches;
use super::physics::{Limit, MAX_SPEED_FACTOR, REBUILD_STEPS, SKIN_M, STEP_S, Stop, Train};

/// Obstacles count as near a cell from this far beyond it, metres: a robot's radius and what it
/// may be pushed within one step.
const SOLID_MARGIN_M: f32 = 0.15;

/// Robots that may be missing from the grid while more are being added.
const MAX_UNLISTED: usize = 256;

/// Most (cell, obstacle) pairs of a grid.
const MAX_OVERLAPS: u64 = 8_000_000;

/// Bodies in an arena, and the indices that make asking cheap.
#[derive(Debug, Clone)]
pub(crate) struct Space {
    pub(crate) arena: Arena,
    pub(crate) parameters: Parameters,
    pub(crate) train: Train,
    /// The step, seconds.
    pub(crate) dt: f32,
    /// No robot moves further in a step, metres.
    pub(crate) stride_m: f32,
    /// The robots that this replica moves.
    pub(crate) members: Members,
    pub(crate) neighbours: Neighbours,
    /// Whether a robot may meet something fixed until the grid is rebuilt.
    pub(crate) walled: Vec<bool>,
    pub(crate) movers: Movers,
    pub(crate) patches: Patches,
    /// Memory of the solver, empty between robots.
    pub(crate) limits: Vec<Limit>,
    pub(crate) stops: Vec<Stop>,
    /// One over the capacity of a pack in ampere seconds.
    pub(crate) per_capacity: f64,
    /// Of every ranger.
    pub(crate) beam: Beam,
    pub(crate) solids: Vec<Solid>,
    pub(crate) cells: Cells,
    pub(crate) solid_grid: Grid,
    pub(crate) robots: Grid,
    pub(crate) bodies: Bodies,
    pub(crate) steps: u64,
    /// How far a robot may have moved since the grid was rebuilt, metres.
    pub(crate) stale_m: f32,
    /// Robots from this index on were added since the grid was rebuilt.
    pub(super) listed: usize,
    /// What was dropped into the arena and lies there now, at the end of its lists.
    pub(crate) items: Items,
}

/// Whether a grid of these cells can hold all of them.
pub(super) fn fits_grid(cells: &Cells, solids: impl Iterator<Item = Solid>) -> bool {
    let overlaps = |solid: Solid| {
        let half = solid
            .half_extents()
            .plus(Vec2::new(SOLID_MARGIN_M, SOLID_MARGIN_M));
        let block = cells.around(solid.centre(), half);
        u64::from(block.columns.1 - block.columns.0 + 1)
            * u64::from(block.rows.1 - block.rows.0 + 1)
    };
    solids.map(overlaps).sum::<u64>() <= MAX_OVERLAPS
}

impl Space {
    pub(crate) fn new(arena: Arena, parameters: Parameters) -> Result<Self, ArenaError> {
        Self::with_step(arena, parameters, STEP_S)
    }

    /// With steps of another length than [`STEP_S`], in seconds: to see what the step changes.
    pub(crate) fn with_step(
        arena: Arena,
        parameters: Parameters,
        dt: f32,
    ) -> Result<Self, ArenaError> {
        arena.validate()?;
        let solids: Vec<Solid> = arena.solids().collect();
        let cells = Cells::new(&arena);
        if !fits_grid(&cells, solids.iter().copied()) {
            return Err(ArenaError::TooManyObstacles);
        }
        let grounds = arena.patches.iter();
        if !fits_grid(&cells, grounds.map(|patch| Solid::new(&patch.ground()))) {
            return Err(ArenaError::TooManyPatches);
        }
        let solid_grid = Grid::of_solids(&cells, &solids, SOLID_MARGIN_M);
        let movers = Movers::new(&arena);
        let stride_m = parameters.top_speed().max(movers.top_speed()) * MAX_SPEED_FACTOR * dt;
        let mut space = Self {
            train: Train::new(&parameters, dt),
            dt,
            stride_m,
            members: Members::ALL,
            neighbours: Neighbours::default(),
            walled: Vec::new(),
            patches: Patches::new(&arena, &cells),
            movers,
            limits: Vec::new(),
            stops: Vec::new(),
            beam: Beam::new(
                parameters.ranger.half_angle,
                parameters.ranger.max_incidence,
            ),
            per_capacity: 1.0 / (f64::from(parameters.pack.capacity_ah) * 3_600.0),
            arena,
            parameters,
            solids,
            cells,
            solid_grid,
            robots: Grid::default(),
            bodies: Bodies::default(),
            steps: 0,
            stale_m: 0.0,
            listed: 0,
            items: Items::default(),
        };
        space.stride(stride_m);
        space.rebuild_grid();
        Ok(space)
    }

    /// Nobody gets farther in a step.
    fn stride(&mut self, stride_m: f32) {
        self.stride_m = stride_m;
        self.stale_m = stride_m * REBUILD_STEPS as f32;
    }

    /// There is a robot with motors that may be stronger than any that is drawn.
    pub(super) fn allow_for(&mut self, motors: [f32; 2]) {
        let fastest = self.parameters.top_speed_of(motors[0].max(motors[1]));
        let stride_m = fastest * MAX_SPEED_FACTOR * self.dt;
        if stride_m > self.stride_m {
            self.stride(stride_m);
            self.rebuild_grid();
        }
    }

    /// Lists what stands in the arena anew, because that has changed.
    pub(super) fn rebuild_solids(&mut self) {
        self.solids = self.arena.solids().collect();
        self.solid_grid = Grid::of_solids(&self.cells, &self.solids, SOLID_MARGIN_M);
        // Also who may meet something fixed.
        self.rebuild_grid();
    }

    pub(crate) fn rebuild_grid(&mut self) {
        let (cells, bodies) = (&self.cells, &self.bodies);
        let seen = &bodies.published;
        let places = seen
            .at
            .iter()
            .zip(&seen.presence)
            .map(|(&at, &presence)| (presence != Presence::Removed).then(|| cells.at(at)));
        self.robots.rebuild(cells, places);
        self.listed = self.bodies.len();
        self.look_around(0.0);
    }

    /// Finds out who may meet whom until the grid is rebuilt. The grid may be off by `stale`,
    /// metres.
    pub(crate) fn look_around(&mut self, stale: f32) {
        let radius = self.parameters.chassis.radius_m;
        let own = self.stale_m + self.stride_m;
        self.neighbours.rebuild(
            &self.cells,
            &self.robots,
            &self.bodies,
            self.members,
            2.0 * (radius + own) + SKIN_M,
            stale,
        );
        let mut walled = core::mem::take(&mut self.walled);
        walled.clear();
        walled.extend((0..self.bodies.len()).map(|i| {
            let at = self.bodies.published.at[i];
            self.members.contains(i) && self.is_walled(at, radius + own + SKIN_M)
        }));
        self.walled = walled;
    }

    /// Whether a wall or an obstacle is within `reach` of a point.
    fn is_walled(&self, at: Vec2, reach: f32) -> bool {
        let walls = (self.arena.width * 0.5 - at.x.abs()).min(self.arena.height * 0.5 - at.y.abs());
        if walls < reach {
            return true;
        }
        if self.solids.is_empty() {
            return false;
        }
        let block = self.cells.around(at, Vec2::new(reach, reach));
        (block.rows.0..=block.rows.1).any(|row| {
            (block.columns.0..=block.columns.1).any(|column| {
                let solids = self.solid_grid.in_cell(self.cells.index(column, row));
                solids
                    .iter()
                    .any(|&solid| self.solids[solid as usize].separation(at).0 < reach)
            })
        })
    }

    /// Brings the grid up to date when more than `unlisted` robots are missing from it.
    pub(crate) fn list_robots(&mut self, unlisted: usize) {
        if self.bodies.len() - self.listed > unlisted {
            self.rebuild_grid();
        }
    }

    /// See [`World::clearance`](super::World::clearance).
    pub(crate) fn clear_of(&mut self, x: f32, y: f32, limit: f32) -> f32 {
        self.clearance(Vec2::new(x, y), limit.clamp(0.0, 1_000.0))
    }

    /// Distance from a point to the nearest surface of anything, negative inside, looking no
    /// further than `limit` for robots and obstacles.
    pub(crate) fn clearance(&mut self, point: Vec2, limit: f32) -> f32 {
        self.clearance_but(point, limit, None)
    }

    /// The same, leaving out one robot.
    pub(super) fn clearance_but(&mut self, point: Vec2, limit: f32, but: Option<usize>) -> f32 {
        // Rebuilding for each of many robots being added would cost a pass over the grid each.
        self.list_robots(MAX_UNLISTED);
        let walls =
            (self.arena.width * 0.5 - point.x.abs()).min(self.arena.height * 0.5 - point.y.abs());
        let radius = self.parameters.chassis.radius_m;
        let mut nearest = walls;
        self.visit(point, limit + radius, |space, thing| {
            if but.is_none_or(|but| thing != Thing::Robot(but)) {
                nearest = nearest.min(space.body_of(thing).separation(point).0);
            }
        });
        let seen = &self.bodies.published;
        for i in self.listed..seen.at.len() {
            if seen.presence[i] != Presence::Removed && but != Some(i) {
                nearest = nearest.min(point.minus(seen.at[i]).length() - radius);
            }
        }
        nearest
    }

    /// Calls `each` for everything within `reach` of a point, and some things beyond; an obstacle
    /// may come more than once.
    fn visit(&self, point: Vec2, reach: f32, each: impl FnMut(&Self, Thing)) {
        self.visit_around(point, Vec2::new(reach, reach), each);
    }

    /// The same for a rectangle around a point.
    pub(super) fn visit_around(&self, point: Vec2, half: Vec2, mut each: impl FnMut(&Self, Thing)) {
        for k in 0..self.movers.len() {
            each(self, Thing::Mover(k as u32));
        }
        let half = half.plus(Vec2::new(self.stale_m, self.stale_m));
        let block = self.cells.around(point, half);
        for row in block.rows.0..=block.rows.1 {
            for column in block.columns.0..=block.columns.1 {
                self.visit_cell(self.cells.index(column, row), &mut each);
            }
        }
    }

    fn visit_cell(&self, cell: usize, each: &mut impl FnMut(&Self, Thing)) {
        for &solid in self.solid_grid.in_cell(cell) {
            each(self, Thing::Solid(solid));
        }
        for &robot in self.robots.in_cell(cell) {
            let robot = robot as usize;
            if self.bodies.published.presence[robot] != Presence::Removed {
                each(self, Thing::Robot(robot));
            }
        }
    }

    /// Calls `each` for everything that may lie in a cone between two distances from its apex, and
    /// some things beyond; an obstacle may come more than once.
    pub(crate) fn visit_cone(
        &self,
        cone: &Cone,
        from: f32,
        to: f32,
        mut each: impl FnMut(&Self, Thing),
    ) {
        for k in 0..self.movers.len() {
            let apart = self.movers.now(k).centre().minus(cone.apex);
            if apart.length() < to + self.movers.around(k) {
                each(self, Thing::Mover(k as u32));
            }
        }
        // Most obstacles reach into several cells.
        let mut recent = [u32::MAX; 4];
        let mut place = 0;
        for (first, last) in self.rows_of_cone(cone, from, to) {
            for &solid in self.solid_grid.in_row(first, last) {
                if !recent.contains(&solid) {
                    recent[place % recent.len()] = solid;
                    place += 1;
                    each(self, Thing::Solid(solid));
                }
            }
            for &robot in self.robots.in_row(first, last) {
                if self.bodies.published.presence[robot as usize] != Presence::Removed {
                    each(self, Thing::Robot(robot as usize));
                }
            }
        }
    }

    /// The first and the last cell, in every row of cells, of a rectangle that has in it all that
    /// lies in a cone between two distances from its apex.
    pub(super) fn rows_of_cone(
        &self,
        cone: &Cone,
        from: f32,
        to: f32,
    ) -> impl Iterator<Item = (usize, usize)> + use<> {
        let (low, high) = cone.bounds(from, to);
        let margin = self.parameters.chassis.radius_m + self.stale_m;
        let margin = Vec2::new(margin, margin);
        self.cells
            .block(low.minus(margin), high.plus(margin))
            .rows_of(self.cells)
    }

    /// The ground that something covers.
    pub(super) fn body_of(&self, thing: Thing) -> Solid {
        match thing {
            Thing::Solid(solid) => self.solids[solid as usize],
            Thing::Mover(mover) => *self.movers.now(mover as usize),
            Thing::Robot(j) => Solid::Circle {
                centre: self.bodies.published.at[j],
                radius: self.parameters.chassis.radius_m,
            },
        }
    }
}

/// Something near a place: its index among those of its kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Thing {
    Solid(u32),
    Mover(u32),
    Robot(usize),
}
