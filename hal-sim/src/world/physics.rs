//! One step of the world.

use crawler_hal::Duration;

use super::battery::open_circuit_v;
use super::bodies::{Bridge, Drive, Inputs, Presence};
use super::geometry::{Vec2, wrap};
use super::parameters::Parameters;
use super::space::Space;

/// The physics step.
pub const PHYSICS_STEP: Duration = Duration::from_millis(10);

/// The physics step in seconds.
pub(crate) const STEP_S: f32 = 0.01;

/// Steps from one rebuild of the grid to the next.
pub(crate) const REBUILD_STEPS: u64 = 10;

/// Slower than this an undriven wheel stands, metres per second.
const STANDSTILL: f32 = 2e-3;

/// A supply that comes back this far above the brown-out voltage starts the robot again.
const BROWN_OUT_HYSTERESIS_V: f32 = 0.5;

/// Gap the solver leaves between things that touch, metres. It must exceed the resolution of a
/// coordinate, which is 0.03 mm at the edge of the largest arena.
pub(crate) const SKIN_M: f32 = 1e-4;

/// Steps after a contact during which another touch is the same contact.
const CONTACT_HOLD: u8 = 20;

/// Attempts to find a free place before a robot stays where it was.
const SOLVER_PASSES: u8 = 4;

/// Share of a wheel's speed that goes on as slip when the body is held back.
const SLIP_KEPT: f32 = 0.5;

/// Factors of the motor model that do not change from step to step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    driven: f32,
    brake: f32,
    coast: f32,
}

impl Rates {
    pub(crate) fn new(parameters: &Parameters) -> Self {
        // Share of the way to the final speed made in one step by a first-order lag.
        let share = |tau: f32| 1.0 - libm::expf(-STEP_S / tau);
        let chassis = &parameters.chassis;
        Self {
            driven: share(chassis.driven_tau_s),
            brake: share(chassis.brake_tau_s),
            coast: share(chassis.coast_tau_s),
        }
    }
}

/// Moves one wheel on by a step. Returns its new rim speed and the current it drew, in amperes.
pub(crate) fn turn_wheel(
    parameters: &Parameters,
    rates: &Rates,
    bridge: Bridge,
    strength: f32,
    supply_v: f32,
    speed: f32,
) -> (f32, f32) {
    let chassis = &parameters.chassis;
    let duty = f32::from(bridge.duty) * (1.0 / 255.0);
    let sign = match bridge.drive() {
        Drive::Forward => 1.0,
        Drive::Backward => -1.0,
        Drive::Brake => {
            let rate = rates.coast + (rates.brake - rates.coast) * duty;
            return (settle(speed - speed * rate), 0.0);
        }
    };
    let motor_v = duty * (supply_v - chassis.bridge_drop_v).max(0.0);
    // A standing wheel needs the breakaway voltage, a turning one only what friction takes.
    let threshold = if speed == 0.0 {
        chassis.breakaway_v
    } else {
        chassis.running_v
    };
    if motor_v <= threshold {
        // Too little to turn: with the enable input low most of the time it coasts to a halt.
        let current = motor_v / chassis.winding_ohm * duty;
        return (settle(speed - speed * rates.coast), current);
    }
    let per_volt = chassis.speed_per_volt * strength;
    let goal = sign * (motor_v - chassis.running_v) * per_volt;
    let next = speed + (goal - speed) * rates.driven;
    // The back voltage of the turning motor opposes the drive; a motor driven against its turn
    // draws more than one that stands. Nothing flows back into the pack.
    let back_v = sign * speed / per_volt.max(1e-6);
    let current = ((motor_v - back_v) / chassis.winding_ohm).max(0.0) * duty;
    (next, current)
}

fn settle(speed: f32) -> f32 {
    if speed.abs() < STANDSTILL { 0.0 } else { speed }
}

/// What a step found out about a robot's supply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Power {
    /// It fell below the brown-out voltage.
    Lost,
    /// It came back.
    Restored,
}

impl Space {
    /// Moves the world on by one [`PHYSICS_STEP`]; `power` hears of every brown-out and recovery.
    ///
    /// Robots move in order of their index, each against where the others are at that moment, and
    /// never into anything: a place that is not free after the solver's passes is not taken. So
    /// no overlap can arise from a state without overlap.
    pub(crate) fn step(&mut self, mut power: impl FnMut(usize, Power)) {
        if self.steps.is_multiple_of(REBUILD_STEPS) {
            self.rebuild_grid();
        } else {
            self.list_robots(0);
        }
        self.steps += 1;
        for i in 0..self.bodies.len() {
            if self.bodies.presence[i] == Presence::Removed {
                continue;
            }
            let hold = &mut self.bodies.hold[i];
            *hold = hold.saturating_sub(1);
            self.drive(i, &mut power);
            self.travel(i);
        }
    }

    fn drive(&mut self, i: usize, power: &mut impl FnMut(usize, Power)) {
        let bodies = &mut self.bodies;
        let parameters = &self.parameters;
        let build = bodies.build[i];
        let supply_v = bodies.supply_v[i];
        let Inputs { left, right, .. } = bodies.inputs[i];
        let (left, left_a) = turn_wheel(
            parameters,
            &self.rates,
            left,
            build.left,
            supply_v,
            bodies.left[i],
        );
        let (right, right_a) = turn_wheel(
            parameters,
            &self.rates,
            right,
            build.right,
            supply_v,
            bodies.right[i],
        );
        bodies.left[i] = left;
        bodies.right[i] = right;

        let pack = &parameters.pack;
        let powered = bodies.presence[i] == Presence::Present;
        let current = if powered {
            pack.quiescent_a + left_a + right_a
        } else {
            0.0
        };
        let charge = &mut bodies.charge_as[i];
        *charge = (*charge - f64::from(current * STEP_S)).max(0.0);
        let share = (*charge * self.per_capacity) as f32;
        let volts = (open_circuit_v(share) - build.internal_ohm * current).max(0.0);
        bodies.supply_v[i] = volts;
        if powered && volts < pack.brown_out_v {
            bodies.presence[i] = Presence::Unpowered;
            // The outputs of a dead microcontroller float, and the bridge pulls its inputs low.
            bodies.inputs[i] = Inputs::default();
            power(i, Power::Lost);
        } else if !powered && volts > pack.brown_out_v + BROWN_OUT_HYSTERESIS_V {
            bodies.presence[i] = Presence::Present;
            power(i, Power::Restored);
        }
    }

    fn travel(&mut self, i: usize) {
        let bodies = &mut self.bodies;
        let (left, right) = (bodies.left[i], bodies.right[i]);
        if left == 0.0 && right == 0.0 {
            return;
        }
        let speed = (left + right) * 0.5;
        let turn = (right - left) / bodies.build[i].track_m * STEP_S;
        let theta = bodies.theta[i];
        bodies.theta[i] = wrap(theta + turn);
        if speed == 0.0 {
            return;
        }
        // Along the middle heading of the step: exact to third order for an arc.
        let heading = Vec2::unit(theta + turn * 0.5);
        let from = bodies.at[i];
        let want = from.plus(heading.times(speed * STEP_S));
        let to = self.free_place(i, from, want);
        let bodies = &mut self.bodies;
        bodies.at[i] = to;
        if to != want {
            // Held back: the wheels lose what the body lost, less the slip.
            let made = to.minus(from).dot(heading) * (1.0 / STEP_S);
            let lost = (speed - made) * (1.0 - SLIP_KEPT);
            bodies.left[i] -= lost;
            bodies.right[i] -= lost;
        }
    }

    /// The free place nearest to `want`, or `from`, which is free.
    fn free_place(&mut self, i: usize, from: Vec2, want: Vec2) -> Vec2 {
        let mut place = want;
        for _ in 0..SOLVER_PASSES {
            let pushed = self.push_out(i, place);
            if pushed == place {
                return place;
            }
            place = pushed;
        }
        from
    }

    /// Pushes a disc at `place` out of everything it overlaps, one thing after the other, and
    /// counts the contacts.
    fn push_out(&mut self, i: usize, mut place: Vec2) -> Vec2 {
        let radius = self.parameters.chassis.radius_m;
        let reach = radius + radius;
        let mut touched = false;

        let block = self
            .cells
            .around(place, Vec2::new(self.cells.side(), self.cells.side()));
        for row in block.rows.0..=block.rows.1 {
            let first = self.cells.index(block.columns.0, row);
            let last = self.cells.index(block.columns.1, row);
            for &other in self.robots.in_row(first, last) {
                let j = other as usize;
                if j == i || self.bodies.presence[j] == Presence::Removed {
                    continue;
                }
                let away = place.minus(self.bodies.at[j]);
                let square = away.dot(away);
                if square < reach * reach {
                    touched = true;
                    touch(&mut self.bodies.contacts[j], &mut self.bodies.hold[j]);
                    let distance = square.sqrt();
                    // Two centres in one point have no direction; the caller falls back.
                    let direction = if distance > 0.0 {
                        away.times(1.0 / distance)
                    } else {
                        Vec2::default()
                    };
                    place = self.bodies.at[j].plus(direction.times(reach + SKIN_M));
                }
            }
        }
        for &solid in self.solid_grid.in_cell(self.cells.at(place)) {
            let (distance, direction) = self.solids[solid as usize].separation(place);
            if distance < radius {
                touched = true;
                place = place.plus(direction.times(radius + SKIN_M - distance));
            }
        }
        let limit = Vec2::new(
            self.arena.width * 0.5 - radius,
            self.arena.height * 0.5 - radius,
        );
        if place.x.abs() > limit.x || place.y.abs() > limit.y {
            touched = true;
            place = Vec2::new(
                place.x.clamp(-limit.x, limit.x),
                place.y.clamp(-limit.y, limit.y),
            );
        }
        if touched {
            touch(&mut self.bodies.contacts[i], &mut self.bodies.hold[i]);
        }
        place
    }
}

fn touch(contacts: &mut u32, hold: &mut u8) {
    if *hold == 0 {
        *contacts = contacts.saturating_add(1);
    }
    *hold = CONTACT_HOLD;
}
