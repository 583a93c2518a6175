//! The physical state of a world and what can be asked of it.

use super::arena::{Arena, ArenaError, Solid};
use super::bodies::{Bodies, Presence};
use super::geometry::{Cone, Pose, Vec2, ray_to_circle, ray_to_segment};
use super::grid::{Cells, Grid};
use super::parameters::Parameters;
use super::physics::{REBUILD_STEPS, Rates, STEP_S};

/// Obstacles count as near a cell from this far beyond it, metres: a robot's radius and what it
/// may be pushed within one step.
const SOLID_MARGIN_M: f32 = 0.15;

/// How far ahead a ranger looks first, metres; it doubles from there.
const FIRST_REACH_M: f32 = 1.0;

/// Robots that may be missing from the grid while more are being added.
const MAX_UNLISTED: usize = 256;

/// Most (cell, obstacle) pairs of a grid.
const MAX_OVERLAPS: u64 = 8_000_000;

/// Bodies in an arena, and the indices that make asking cheap.
#[derive(Debug)]
pub(crate) struct Space {
    pub(crate) arena: Arena,
    pub(crate) parameters: Parameters,
    pub(crate) rates: Rates,
    /// One over the capacity of a pack in ampere seconds.
    pub(crate) per_capacity: f64,
    pub(crate) solids: Vec<Solid>,
    pub(crate) cells: Cells,
    pub(crate) solid_grid: Grid,
    pub(crate) robots: Grid,
    pub(crate) bodies: Bodies,
    pub(crate) steps: u64,
    /// How far a robot may have moved since the grid was rebuilt, metres.
    stale_m: f32,
    /// Robots from this index on were added since the grid was rebuilt.
    listed: usize,
}

/// What a ray of the camera met.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sight {
    pub(crate) distance: f32,
    pub(crate) of: Surface,
    /// Metres along the surface, for a pattern on it.
    pub(crate) along: f32,
    /// Cosine of the angle between the ray and the surface's normal.
    pub(crate) facing: f32,
}

/// What kind of thing a ray met.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Surface {
    Wall,
    Obstacle,
    Robot,
}

impl Space {
    pub(crate) fn new(arena: Arena, parameters: Parameters) -> Result<Self, ArenaError> {
        arena.validate()?;
        let solids: Vec<Solid> = arena.obstacles.iter().map(Solid::new).collect();
        let cells = Cells::new(&arena);
        let overlaps: u64 = solids
            .iter()
            .map(|solid| {
                let half = solid
                    .half_extents()
                    .plus(Vec2::new(SOLID_MARGIN_M, SOLID_MARGIN_M));
                let block = cells.around(solid.centre(), half);
                u64::from(block.columns.1 - block.columns.0 + 1)
                    * u64::from(block.rows.1 - block.rows.0 + 1)
            })
            .sum();
        if overlaps > MAX_OVERLAPS {
            return Err(ArenaError::TooManyObstacles);
        }
        let solid_grid = Grid::of_solids(&cells, &solids, SOLID_MARGIN_M);
        let mut space = Self {
            rates: Rates::new(&parameters),
            per_capacity: 1.0 / (f64::from(parameters.pack.capacity_ah) * 3_600.0),
            arena,
            parameters,
            solids,
            cells,
            solid_grid,
            robots: Grid::default(),
            bodies: Bodies::default(),
            steps: 0,
            stale_m: parameters.top_speed() * STEP_S * REBUILD_STEPS as f32,
            listed: 0,
        };
        space.rebuild_grid();
        Ok(space)
    }

    pub(crate) fn rebuild_grid(&mut self) {
        let (cells, bodies) = (&self.cells, &self.bodies);
        let places = bodies
            .at
            .iter()
            .zip(&bodies.presence)
            .map(|(&at, &presence)| (presence != Presence::Removed).then(|| cells.at(at)));
        self.robots.rebuild(cells, places);
        self.listed = self.bodies.len();
    }

    /// Brings the grid up to date when more than `unlisted` robots are missing from it.
    pub(crate) fn list_robots(&mut self, unlisted: usize) {
        if self.bodies.len() - self.listed > unlisted {
            self.rebuild_grid();
        }
    }

    /// Distance from a point to the nearest surface of anything, negative inside, looking no
    /// further than `limit` for robots and obstacles.
    pub(crate) fn clearance(&mut self, point: Vec2, limit: f32) -> f32 {
        // Rebuilding for each of many robots being added would cost a pass over the grid each.
        self.list_robots(MAX_UNLISTED);
        let walls =
            (self.arena.width * 0.5 - point.x.abs()).min(self.arena.height * 0.5 - point.y.abs());
        let radius = self.parameters.chassis.radius_m;
        let mut nearest = walls;
        self.visit(point, limit + radius, |space, thing| {
            let distance = match thing {
                Thing::Solid(solid) => solid.separation(point).0,
                Thing::Robot(j) => point.minus(space.bodies.at[j]).length() - radius,
            };
            nearest = nearest.min(distance);
        });
        for (&at, &presence) in self.bodies.at[self.listed..]
            .iter()
            .zip(&self.bodies.presence[self.listed..])
        {
            if presence != Presence::Removed {
                nearest = nearest.min(point.minus(at).length() - radius);
            }
        }
        nearest
    }

    /// Calls `each` for everything within `reach` of a point, and some things beyond; an obstacle
    /// may come more than once.
    fn visit(&self, point: Vec2, reach: f32, mut each: impl FnMut(&Self, Thing<'_>)) {
        let half = Vec2::new(reach + self.stale_m, reach + self.stale_m);
        let block = self.cells.around(point, half);
        for row in block.rows.0..=block.rows.1 {
            for column in block.columns.0..=block.columns.1 {
                self.visit_cell(self.cells.index(column, row), &mut each);
            }
        }
    }

    fn visit_cell(&self, cell: usize, each: &mut impl FnMut(&Self, Thing<'_>)) {
        for &solid in self.solid_grid.in_cell(cell) {
            each(self, Thing::Solid(&self.solids[solid as usize]));
        }
        for &robot in self.robots.in_cell(cell) {
            let robot = robot as usize;
            if self.bodies.presence[robot] != Presence::Removed {
                each(self, Thing::Robot(robot));
            }
        }
    }

    /// Calls `each` for everything that may lie within a cone of length `reach`.
    fn visit_cone(&self, cone: &Cone, reach: f32, mut each: impl FnMut(&Self, Thing<'_>)) {
        // The box around the cone: apex, the arc's ends, and its middle.
        let far = |turn: Vec2| cone.apex.plus(turn.out_of_frame(cone.axis).times(reach));
        let corners = [
            cone.apex,
            far(Vec2::new(1.0, 0.0)),
            far(cone.edge),
            far(Vec2::new(cone.edge.x, -cone.edge.y)),
        ];
        let (mut low, mut high) = (cone.apex, cone.apex);
        for corner in corners {
            low = Vec2::new(low.x.min(corner.x), low.y.min(corner.y));
            high = Vec2::new(high.x.max(corner.x), high.y.max(corner.y));
        }
        // The arc bulges beyond its ends by less than the sagitta.
        let margin = reach * (1.0 - cone.edge.x) + self.parameters.chassis.radius_m + self.stale_m;
        let middle = low.plus(high).times(0.5);
        let half = high.minus(low).times(0.5).plus(Vec2::new(margin, margin));
        let block = self.cells.around(middle, half);
        // A cell is skipped when the circle around it lies clear of the cone.
        let around = self.cells.side() * core::f32::consts::FRAC_1_SQRT_2
            + self.parameters.chassis.radius_m
            + self.stale_m;
        for row in block.rows.0..=block.rows.1 {
            for column in block.columns.0..=block.columns.1 {
                let local = self
                    .cells
                    .centre(column, row)
                    .minus(cone.apex)
                    .into_frame(cone.axis);
                let beyond = local.y.abs() * cone.edge.x - local.x * cone.edge.y;
                if beyond <= around {
                    self.visit_cell(self.cells.index(column, row), &mut each);
                }
            }
        }
    }

    /// Distance in metres from robot `i`'s ranger to the nearest echo between `least` and `most`.
    pub(crate) fn range(&self, i: usize, least: f32, most: f32) -> Option<f32> {
        let ranger = &self.parameters.ranger;
        let theta = self.bodies.theta[i];
        let apex = self.bodies.at[i].plus(Vec2::unit(theta).times(ranger.mount_m));
        let cone = Cone::new(apex, theta, ranger.half_angle, ranger.max_incidence);
        let mut nearest = most.next_up();
        for (a, b) in self.walls() {
            if let Some(echo) = cone.echo_of_segment(a, b, nearest)
                && echo >= least
            {
                nearest = echo;
            }
        }
        // Most echoes come from close by: look further only when there is nothing nearer.
        let mut reach = FIRST_REACH_M;
        loop {
            let searched = reach.min(nearest);
            self.visit_cone(&cone, searched, |space, thing| {
                space.hear(&cone, thing, i, least, &mut nearest);
            });
            if searched >= nearest || searched >= most {
                break;
            }
            reach *= 2.0;
        }
        (nearest <= most).then_some(nearest)
    }

    /// Lowers `nearest` to the echo of `thing`, if that is nearer.
    fn hear(&self, cone: &Cone, thing: Thing<'_>, own: usize, least: f32, nearest: &mut f32) {
        let offer = |echo: Option<f32>, nearest: &mut f32| {
            if let Some(echo) = echo
                && echo >= least
                && echo < *nearest
            {
                *nearest = echo;
            }
        };
        match thing {
            Thing::Solid(&Solid::Circle { centre, radius }) => {
                offer(cone.echo_of_circle(centre, radius), nearest);
            }
            Thing::Solid(&Solid::Box { centre, axis, half }) => {
                let corners = Solid::corners(centre, axis, half);
                for (k, &corner) in corners.iter().enumerate() {
                    let next = corners[(k + 1) % 4];
                    offer(cone.echo_of_segment(corner, next, *nearest), nearest);
                }
            }
            Thing::Robot(j) => {
                if j != own {
                    let radius = self.parameters.chassis.radius_m;
                    offer(cone.echo_of_circle(self.bodies.at[j], radius), nearest);
                }
            }
        }
    }

    /// What can be seen from robot `i` within `half_angle` of its heading: candidates for
    /// [`Space::look`].
    pub(crate) fn in_view(&self, i: usize, eye: Pose, half_angle: f32, reach: f32) -> View {
        let cone = Cone::new(eye.position(), eye.theta, half_angle, 1.5);
        let mut view = View::default();
        for (a, b) in self.walls() {
            view.edges.push((a, b, Surface::Wall));
        }
        self.visit_cone(&cone, reach, |space, thing| match thing {
            Thing::Solid(&Solid::Circle { centre, radius }) => {
                view.add_disc((centre, radius, Surface::Obstacle));
            }
            Thing::Solid(&Solid::Box { centre, axis, half }) => {
                let corners = Solid::corners(centre, axis, half);
                for (k, &corner) in corners.iter().enumerate() {
                    view.add_edge((corner, corners[(k + 1) % 4], Surface::Obstacle));
                }
            }
            Thing::Robot(j) => {
                if j != i {
                    let radius = space.parameters.chassis.radius_m;
                    view.add_disc((space.bodies.at[j], radius, Surface::Robot));
                }
            }
        });
        view
    }

    fn walls(&self) -> [(Vec2, Vec2); 4] {
        let (x, y) = (self.arena.width * 0.5, self.arena.height * 0.5);
        let corners = [
            Vec2::new(x, y),
            Vec2::new(-x, y),
            Vec2::new(-x, -y),
            Vec2::new(x, -y),
        ];
        [0, 1, 2, 3].map(|k: usize| (corners[k], corners[(k + 1) % 4]))
    }
}

/// Something near a place.
#[derive(Clone, Copy)]
enum Thing<'a> {
    Solid(&'a Solid),
    Robot(usize),
}

/// The things a camera may see.
#[derive(Debug, Default)]
pub(crate) struct View {
    discs: Vec<(Vec2, f32, Surface)>,
    edges: Vec<(Vec2, Vec2, Surface)>,
}

impl View {
    // An obstacle is offered once for each cell it touches, cell by cell.
    fn add_disc(&mut self, disc: (Vec2, f32, Surface)) {
        if !self.discs.contains(&disc) {
            self.discs.push(disc);
        }
    }

    fn add_edge(&mut self, edge: (Vec2, Vec2, Surface)) {
        if !self.edges.contains(&edge) {
            self.edges.push(edge);
        }
    }

    /// Adds every surface along a ray to `sights`, in no particular order.
    pub(crate) fn look(&self, origin: Vec2, ray: Vec2, sights: &mut Vec<Sight>) {
        for &(centre, radius, of) in &self.discs {
            if let Some(distance) = ray_to_circle(origin, ray, centre, radius) {
                let normal = origin
                    .plus(ray.times(distance))
                    .minus(centre)
                    .times(1.0 / radius);
                sights.push(Sight {
                    distance,
                    of,
                    along: libm::atan2f(normal.y, normal.x) * radius,
                    facing: ray.dot(normal).abs(),
                });
            }
        }
        for &(a, b, of) in &self.edges {
            if let Some((distance, share)) = ray_to_segment(origin, ray, a, b) {
                let along = b.minus(a);
                let length = along.length();
                sights.push(Sight {
                    distance,
                    of,
                    along: share * length,
                    facing: ray.cross(along).abs() / length,
                });
            }
        }
    }
}
