//! The ground of a scenario: its size, and what stands in it.

use rand_core::Rng;
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::generate::Generate;
use super::passable::Passable;
use super::spawn::{Nearby, TRIES};
use super::{Scenario, ScenarioError};
use crate::world::{Arena, ArenaError, Colour, MAX_OBSTACLES, Mover, Object, Obstacle, Patch};

/// Drawn arenas that are thrown away at most, because not every place in them can be reached.
const ATTEMPTS: u64 = 40;
/// What a robot keeps from walls where it is to find its way, metres.
const WAY_MARGIN_M: f32 = 0.03;

/// Size of the arena and what stands in it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ground {
    /// Length along x, metres. Without it the arena is a square of `area_per_robot` for each
    /// robot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub width: Option<f32>,
    /// Length along y, metres; goes with `width`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<f32>,
    /// Square metres for each robot.
    pub area_per_robot: f32,
    /// Shortest side of a square arena, metres.
    pub least_side: f32,
    /// Obstacles at given places.
    pub obstacles: Vec<Obstacle>,
    /// Obstacles that move by themselves.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub movers: Vec<Mover>,
    /// Parts of the floor that grip differently.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub patches: Vec<Patch>,
    /// Colour of obstacles and movers; bare where there is none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paint: Option<Colour>,
    /// Coloured things, as solid as obstacles.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<Object>,
    /// Obstacles at places drawn from the seed.
    pub scatter: Scatter,
    /// Walls drawn from the seed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub generate: Option<Generate>,
}

impl Default for Ground {
    fn default() -> Self {
        Self {
            width: None,
            height: None,
            area_per_robot: 2.0,
            least_side: 3.0,
            obstacles: Vec::new(),
            movers: Vec::new(),
            patches: Vec::new(),
            paint: None,
            objects: Vec::new(),
            scatter: Scatter::default(),
            generate: None,
        }
    }
}

/// Obstacles drawn from the seed: half of them circles, half boxes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scatter {
    /// Number for each square metre of the arena.
    pub per_square_metre: f32,
    /// Smallest and largest radius of circles, metres.
    pub radius: [f32; 2],
    /// Shortest and longest side of boxes, metres.
    pub side: [f32; 2],
    /// Free space around each, metres: a robot has to get through.
    pub clearance: f32,
}

impl Default for Scatter {
    fn default() -> Self {
        Self {
            per_square_metre: 0.0,
            radius: [0.08, 0.25],
            side: [0.15, 0.6],
            clearance: 0.45,
        }
    }
}

impl Scenario {
    pub(super) fn sides(&self) -> (f32, f32) {
        if let (Some(width), Some(height)) = (self.arena.width, self.arena.height) {
            return (width, height);
        }
        let area = self.arena.area_per_robot * self.robots.max(1) as f32;
        let side = area.sqrt().max(self.arena.least_side);
        (side, side)
    }

    /// The arena without what is drawn.
    pub(super) fn fixed_arena(&self) -> Arena {
        let (width, height) = self.sides();
        Arena {
            width,
            height,
            obstacles: self.arena.obstacles.clone(),
            movers: self.arena.movers.clone(),
            patches: self.arena.patches.clone(),
            paint: self.arena.paint,
            objects: self.arena.objects.clone(),
        }
    }

    /// The arena of a run, with the walls and obstacles that `seed` puts into it.
    ///
    /// Where a robot might not get from everywhere to everywhere, because walls are drawn or
    /// obstacles may stand close together, that is checked, and another arena drawn if need be.
    ///
    /// # Errors
    /// [`ScenarioError::NoRoom`] when an obstacle finds no place, or no arena is found in which
    /// every place can be reached.
    pub fn arena(&self, seed: u64) -> Result<Arena, ScenarioError> {
        let fixed = self.fixed_arena();
        fixed.validate()?;
        let radius = self.parameters.chassis.radius_m;
        // Obstacles with room between them for a robot cannot close a way off.
        let scattered = self.arena.scatter.per_square_metre > 0.0;
        let close = scattered && self.arena.scatter.clearance < 2.0 * (radius + WAY_MARGIN_M);
        if self.arena.generate.is_none() && !close {
            return self.attempt(&fixed, seed);
        }
        let mut last = None;
        for attempt in 0..ATTEMPTS {
            // Far from the seeds that people give.
            let seed = seed.wrapping_add(attempt.wrapping_mul(0x9E37_79B9_7F4A_7C15));
            match self.attempt(&fixed, seed) {
                Ok(arena) if Passable::new(&arena, radius + WAY_MARGIN_M).is_connected() => {
                    return Ok(arena);
                }
                Ok(_) => {}
                Err(error @ ScenarioError::NoRoom(_)) => last = Some(error),
                Err(error) => return Err(error),
            }
        }
        Err(last.unwrap_or_else(|| {
            ScenarioError::NoRoom(format!(
                "an arena in which a robot can reach every place; {ATTEMPTS} were drawn"
            ))
        }))
    }

    fn attempt(&self, fixed: &Arena, seed: u64) -> Result<Arena, ScenarioError> {
        let mut arena = fixed.clone();
        let (width, height) = (arena.width, arena.height);
        if let Some(generate) = &self.arena.generate {
            let mut rng = Pcg32::new(seed, 0x7761_6C6C);
            arena
                .obstacles
                .extend(generate.walls(width, height, &mut rng));
        }
        let scatter = &self.arena.scatter;
        let wanted = (scatter.per_square_metre * width * height) as usize;
        if arena.obstacles.len() + wanted > MAX_OBSTACLES {
            return Err(ArenaError::TooManyObstacles.into());
        }
        let mut rng = Pcg32::new(seed, 0x6F62_7374);
        let mut draw = |low: f32, high: f32| {
            low + (high - low) * ((rng.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0))
        };
        // Only what lies near can be in the way: with thousands of obstacles, looking at all of
        // them for each draw would take minutes.
        let mut near = Nearby::new(&arena, scatter.side[1].max(scatter.radius[1]) * 2.0);
        for number in 0..wanted {
            let mut placed = false;
            for _ in 0..TRIES {
                let (x, y) = (
                    draw(-width * 0.5, width * 0.5),
                    draw(-height * 0.5, height * 0.5),
                );
                let (obstacle, reach) = if number % 2 == 0 {
                    let r = draw(scatter.radius[0], scatter.radius[1]);
                    (Obstacle::Circle { x, y, r }, r)
                } else {
                    let w = draw(scatter.side[0], scatter.side[1]);
                    let h = draw(scatter.side[0], scatter.side[1]);
                    let theta = draw(0.0, core::f32::consts::PI);
                    let reach = (w * w + h * h).sqrt() * 0.5;
                    (Obstacle::Box { x, y, w, h, theta }, reach)
                };
                if near.clearance(&arena, x, y, reach + scatter.clearance)
                    >= reach + scatter.clearance
                {
                    near.add(arena.obstacles.len() as u32, x, y);
                    arena.obstacles.push(obstacle);
                    placed = true;
                    break;
                }
            }
            if !placed {
                return Err(ScenarioError::NoRoom(format!(
                    "obstacle {} of {wanted} in an arena of {width} m by {height} m",
                    number + 1
                )));
            }
        }
        arena.validate()?;
        Ok(arena)
    }
}
