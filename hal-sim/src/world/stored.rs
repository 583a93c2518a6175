//! The physical state as it is stored.

use serde::{Deserialize, Serialize};

use super::MAX_ROBOTS;
use super::bodies::Bodies;
use super::space::Space;

/// What of a [`Space`] its arena and its parameters do not say.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct SpaceState {
    bodies: Bodies,
    steps: u64,
    /// Cell of each robot when the grid was built last: the order in which neighbours are met
    /// depends on it.
    places: Vec<u32>,
    listed: u32,
    /// How far each mover has gone on its path, metres.
    pub(super) movers: Vec<f64>,
}

impl SpaceState {
    pub(crate) fn robots(&self) -> usize {
        self.bodies.len()
    }
}

impl Space {
    pub(crate) fn state(&self) -> SpaceState {
        SpaceState {
            bodies: self.bodies.clone(),
            steps: self.steps,
            places: self.robots.places().to_vec(),
            listed: self.listed as u32,
            movers: (0..self.movers.len()).map(|k| self.movers.way(k)).collect(),
        }
    }

    /// Goes on from a stored state.
    ///
    /// # Errors
    /// What of it cannot be; the space is then worth nothing.
    pub(crate) fn restore(&mut self, state: SpaceState) -> Result<(), &'static str> {
        let SpaceState {
            bodies,
            steps,
            places,
            listed,
            movers,
        } = state;
        if bodies.len() > MAX_ROBOTS || !bodies.is_whole() {
            return Err("number of robots");
        }
        self.check_bodies(&bodies)?;
        if steps > u64::MAX / 2 {
            return Err("time");
        }
        let listed = listed as usize;
        if listed != places.len() || listed > bodies.len() {
            return Err("grid");
        }
        // A robot is found as long as it is at most one cell from where it was listed.
        let near = bodies
            .published
            .at
            .iter()
            .zip(&places)
            .all(|(&at, &place)| self.cells.finds(place, self.cells.at(at)));
        if !near {
            return Err("grid");
        }
        self.movers.restore(&movers).ok_or("movers")?;
        self.robots.restore(&self.cells, &places);
        self.bodies = bodies;
        self.steps = steps;
        self.listed = listed;
        // Not from where robots were when the grid was built, but as much as is needed from here.
        self.look_around(self.stale_m);
        Ok(())
    }

    fn check_bodies(&self, bodies: &Bodies) -> Result<(), &'static str> {
        /// Metres per second that no wheel of this world reaches.
        const FASTEST: f32 = 20.0;
        /// Radians per second.
        const FASTEST_TURN: f32 = 2_000.0;
        let (x, y) = (self.arena.width * 0.5, self.arena.height * 0.5);
        let most_as = 2.0 / self.per_capacity;
        for i in 0..bodies.len() {
            let seen = &bodies.published;
            let (at, velocity) = (seen.at[i], seen.velocity[i]);
            let build = &bodies.build[i];
            // Not-a-number fails each of them.
            let placed = at.x.abs() <= x
                && at.y.abs() <= y
                && (seen.heading[i].length() - 1.0).abs() <= 1e-3;
            let moving = velocity.length() <= FASTEST
                && seen.spin[i].abs() <= FASTEST_TURN
                && (0.0..=10.0).contains(&seen.push[i].1)
                && bodies.left[i].abs() <= FASTEST
                && bodies.right[i].abs() <= FASTEST
                && (0.0..=f64::MAX).contains(&bodies.energy_j[i]);
            let supplied = (0.0..=100.0).contains(&bodies.supply_v[i])
                && (0.0..=most_as).contains(&bodies.charge_as[i]);
            let built = (0.0..=2.0).contains(&build.left)
                && (0.0..=2.0).contains(&build.right)
                && build
                    .friction
                    .iter()
                    .all(|share| (0.0..=2.0).contains(share))
                && (0.01..=10.0).contains(&build.mass_kg)
                && (1e-4..=1_000.0).contains(&build.turn_kg)
                && (0.005..=1.0).contains(&build.track_m)
                && (build.per_half_track * build.track_m - 2.0).abs() <= 1e-3
                && (0.0..=2_000.0).contains(&build.internal_ohm);
            if !(placed && moving && supplied && built) {
                return Err("body");
            }
        }
        Ok(())
    }
}
