//! Who is near whom, told cell by cell to robots that listen in lockstep. In a live world that is up to the server,
//! which has it from telemetry.

use std::collections::BTreeMap;

use crawler_app::perception::LinkHealth;
use crawler_hal::Instant;
use crawler_protocol::{MAX_MESSAGE, Neighbour, Says, Topic};

use super::EPOCH_MS;
use super::population::Population;
use super::uplink::Uplink;

/// See the [module](self).
pub(super) struct Cells {
    /// When robots that listen are told.
    next: Instant,
    /// What they say to those near them, by number, in the step in which that is told.
    said: BTreeMap<usize, Says>,
}

impl Cells {
    pub(super) fn new() -> Self {
        Self {
            next: Instant::BOOT + crawler_cells::PERIOD,
            said: BTreeMap::new(),
        }
    }

    /// For a world that goes on after `now`.
    #[cfg(feature = "live")]
    pub(super) fn go_on(now: Instant) -> Self {
        let period = crawler_cells::PERIOD.as_micros();
        let next = (now.as_micros() / period + 1).saturating_mul(period);
        Self {
            next: Instant::from_micros(next),
            said: BTreeMap::new(),
        }
    }

    /// What robots of this shard say, and after the exchange with others what all do.
    pub(super) const fn said_mut(&mut self) -> &mut BTreeMap<usize, Says> {
        &mut self.said
    }

    /// Takes down what robots say to those near them, when that is about to be told. Who has lost the link says
    /// nothing.
    pub(super) fn listen(&mut self, population: &Population) {
        self.said.clear();
        if population.sched.now() < self.next {
            return;
        }
        for (number, machine) in population.iter().enumerate() {
            let robot = machine.robot();
            let robot = robot.filter(|robot| robot.link_health() == LinkHealth::Up);
            if let Some(says) = robot.and_then(|robot| robot.snapshot().says) {
                self.said.insert(number, says);
            }
        }
    }

    /// Tells robots that listen who is near, from where bodies are. Returns whether any did.
    pub(super) fn tell(&mut self, population: &Population, uplink: &Uplink) -> bool {
        let now = population.sched.now();
        if now < self.next {
            return false;
        }
        self.next += crawler_cells::PERIOD;
        let Some(network) = uplink.network() else {
            return false;
        };
        let wanted = network.listened_cells(uplink.fleet());
        if wanted.is_empty() {
            return false;
        }
        let robots = population.iter().enumerate();
        let robots = robots.filter_map(|(number, machine)| {
            let (pose, [v, w]) = population.world.motion(machine.index())?;
            Some(Neighbour {
                id: machine.id().clone(),
                x: pose.x,
                y: pose.y,
                theta: pose.theta,
                v,
                w,
                says: self.said.get(&number).copied(),
            })
        });
        let unix = EPOCH_MS + now.as_millis();
        for digest in crawler_cells::digests(robots, &wanted, unix) {
            let (x, y) = (digest.x, digest.y);
            let mut buffer = [0; MAX_MESSAGE];
            // Bodies are where numbers are.
            if let Ok(len) = digest.to_json(&mut buffer) {
                let topic = Topic::Cell { x, y }.render(uplink.fleet());
                uplink.publish(&topic, &buffer[..len], false, false);
            }
        }
        true
    }
}
