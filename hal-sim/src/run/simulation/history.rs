//! What the history of a simulation comes to, in one number.

use crawler_hal::{Duration, Instant};

use super::population::{Machine, Population};
use super::uplink::Uplink;
use crate::run::hashes::Hashes;
use crate::world::Fingerprint;

/// How often the state of the world goes into the history.
const PERIOD: Duration = Duration::from_secs(1);

/// The fingerprints of a world second by second, and when the next second ends. What each robot adds to them is kept
/// with the robot.
pub(super) struct History {
    hashes: Hashes,
    next: Instant,
}

impl History {
    pub(super) fn new() -> Self {
        Self {
            hashes: Hashes::default(),
            next: Instant::BOOT + PERIOD,
        }
    }

    /// One that goes on after `now`.
    #[cfg(feature = "live")]
    pub(super) fn go_on(hashes: Hashes, now: Instant) -> Self {
        let seconds = now.as_micros() / PERIOD.as_micros() + 1;
        Self {
            hashes,
            next: Instant::from_micros(seconds.saturating_mul(PERIOD.as_micros())),
        }
    }

    pub(super) const fn hashes(&self) -> &Hashes {
        &self.hashes
    }

    /// Takes in the state of every robot, at the end of a second.
    pub(super) fn pass(&mut self, population: &mut Population, uplink: &Uplink) {
        if population.sched.now() < self.next {
            return;
        }
        self.next += PERIOD;
        population.note_states();
        let share = share(population, |machine| so_far(machine, uplink).value());
        self.hashes.push(share);
    }
}

/// The fingerprint of all that a robot did, up to now. `None` when it never existed, or another shard runs it.
pub(super) fn of_robot(population: &Population, uplink: &Uplink, robot: usize) -> Option<u64> {
    of(population, uplink, population.get(robot)?)
}

/// The share of this shard's robots in the fingerprint of the world.
pub(super) fn of_shard(population: &Population, uplink: &Uplink) -> u64 {
    share(population, |machine| {
        of(population, uplink, machine).unwrap_or_default()
    })
}

fn of(population: &Population, uplink: &Uplink, machine: &Machine) -> Option<u64> {
    let state = population.world.robot_hash(machine.index())?;
    let mut history = so_far(machine, uplink);
    history.word(state);
    Some(history.value())
}

/// What has gone into a robot's history so far.
fn so_far(machine: &Machine, uplink: &Uplink) -> Fingerprint {
    let mut history = machine.history();
    history.word(u64::from(machine.boots()));
    if let Some(network) = uplink.network() {
        history.word(network.fingerprint(machine.link()));
    }
    history
}

/// The sum over the robots of this shard. Those of all shards are added up, so that it does
/// not matter whose a robot is.
fn share(population: &Population, of: impl Fn(&Machine) -> u64) -> u64 {
    let members = population.world.members().iter(population.len());
    members
        .filter_map(|robot| {
            let mut share = Fingerprint::new();
            share.word(robot as u64);
            share.word(of(population.get(robot)?));
            Some(share.value())
        })
        .fold(0, u64::wrapping_add)
}
