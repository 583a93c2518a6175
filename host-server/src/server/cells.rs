//! Who is near: told to robots that move by where others are, from telemetry.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use crawler_cells as cells;
use crawler_protocol::open::Telemetry;
use crawler_protocol::{Capability, MAX_MESSAGE, Neighbour, Pose, RobotId, Says, Topic};

use crawler_fleet::bus::Bus;
use crawler_fleet::{Presence, Robot, SharedFleet};

/// Less sure of its place than this, in metres of sigma, a robot is nobody's neighbour.
const VAGUE_M: f32 = 0.5;
/// Older telemetry says nothing about where a robot is.
const STALE_MS: u64 = 1_500;
/// Between two telemetry messages less than this apart no speed can be told.
const SHORTEST_MS: u64 = 50;

/// What is remembered of a robot to tell its speed.
#[derive(Debug, Clone, Copy)]
struct Last {
    timestamp: u64,
    pose: Pose,
    /// Forward and anticlockwise, in metres and radians per second.
    twist: [f32; 2],
}

/// Keeps the pace, and the speeds of robots from one message to the next.
#[derive(Debug, Default)]
pub(super) struct Cells {
    told: Option<Instant>,
    last: HashMap<RobotId, Last>,
}

impl Cells {
    /// Tells about the cells that robots listen to, when that is due. Does next to nothing while
    /// none does.
    ///
    /// `unix` is the time in milliseconds that is held against what robots say of their own clocks.
    pub(super) fn tell(&mut self, fleet: &SharedFleet, bus: &Bus, unix: u64, now: Instant) {
        let period = Duration::from_micros(cells::PERIOD.as_micros());
        if self
            .told
            .is_some_and(|at| now.saturating_duration_since(at) < period)
        {
            return;
        }
        self.told = Some(now);
        let (listeners, deaf, robots) = {
            let fleet = fleet.lock();
            let known = || {
                fleet
                    .robots()
                    .filter(|robot| robot.presence == Presence::Online)
                    .filter_map(|robot| Some((robot, robot.telemetry.as_ref()?)))
                    .filter(|(_, told)| unix.abs_diff(told.timestamp) <= STALE_MS)
            };
            let listening =
                || known().filter(|(_, told)| told.behaviour.known().is_none_or(cells::needed_for));
            let place = |told: &Telemetry| [told.pose.x, told.pose.y];
            let listeners: Vec<_> = listening().map(|(_, told)| place(told)).collect();
            // Robots older than what neighbours say would refuse a digest that tells it.
            let deaf = listening().filter(|(robot, _)| !knows_says(robot));
            let deaf: Vec<_> = deaf.map(|(_, told)| place(told)).collect();
            if listeners.is_empty() {
                self.last.clear();
                return;
            }
            let sure = known().filter(|(_, told)| told.pose.sigma <= VAGUE_M);
            let robots: Vec<_> = sure
                .map(|(_, told)| Told {
                    id: told.robot.clone(),
                    timestamp: told.timestamp,
                    pose: told.pose,
                    says: told.says,
                })
                .collect();
            (listeners, deaf, robots)
        };
        let robots = self.neighbours(robots, unix);
        let deaf = cells::wanted(deaf);
        let mut buffer = [0; MAX_MESSAGE];
        for mut digest in cells::digests(robots, &cells::wanted(listeners), unix) {
            let (x, y) = (digest.x, digest.y);
            if deaf.contains(&(x, y)) {
                for robot in &mut digest.robots {
                    robot.says = None;
                }
            }
            let Ok(length) = digest.to_json(&mut buffer) else {
                continue;
            };
            let payload = buffer.get(..length).unwrap_or_default();
            if let Err(error) = bus.publish(&Topic::Cell { x, y }, payload) {
                // The next ones are half a second away.
                tracing::debug!(?error, "who is near was not told");
                return;
            }
        }
    }

    /// Where the robots are at `unix`, and how fast, by what they told last and before that.
    fn neighbours(&mut self, told: Vec<Told>, unix: u64) -> Vec<Neighbour> {
        let mut before = std::mem::take(&mut self.last);
        told.into_iter()
            .map(|told| {
                let Told {
                    id,
                    timestamp,
                    pose,
                    says,
                } = told;
                let last = before.remove(&id);
                let twist = match last {
                    Some(last) if timestamp >= last.timestamp + SHORTEST_MS => {
                        twist(&last.pose, &pose, timestamp - last.timestamp)
                    }
                    Some(last) => last.twist,
                    None => [0.0; 2],
                };
                // Measured over one message and not over the time since the last look.
                let kept = match last {
                    Some(last) if timestamp < last.timestamp + SHORTEST_MS => last,
                    Some(_) | None => Last {
                        timestamp,
                        pose,
                        twist,
                    },
                };
                self.last.insert(id.clone(), kept);
                let age = unix.saturating_sub(timestamp) as f32 / 1_000.0;
                let [v, w] = twist;
                Neighbour {
                    id,
                    x: pose.x + v * age * pose.theta.cos(),
                    y: pose.y + v * age * pose.theta.sin(),
                    theta: pose.theta,
                    v,
                    w,
                    says,
                }
            })
            .collect()
    }
}

/// What a robot told last.
struct Told {
    id: RobotId,
    timestamp: u64,
    pose: Pose,
    says: Option<Says>,
}

/// Whether a robot takes a digest in which others say something.
fn knows_says(robot: &Robot) -> bool {
    robot.status.as_ref().is_some_and(|status| {
        let mut capabilities = status.capabilities.iter();
        capabilities.any(|capability| *capability == Capability::Missions)
    })
}

/// The twist that leads from `a` to `b` in so many milliseconds.
fn twist(a: &Pose, b: &Pose, ms: u64) -> [f32; 2] {
    /// Faster than any robot: the estimate has jumped.
    const JUMP: f32 = 2.0;
    let seconds = ms as f32 / 1_000.0;
    let heading = a.theta.midpoint(b.theta);
    let v = ((b.x - a.x) * heading.cos() + (b.y - a.y) * heading.sin()) / seconds;
    let turned = (b.theta - a.theta + std::f32::consts::PI).rem_euclid(std::f32::consts::TAU)
        - std::f32::consts::PI;
    if v.abs() > JUMP {
        return [0.0; 2];
    }
    // Around π the middle of two headings is behind the robot.
    let v = if (b.theta - a.theta).abs() > std::f32::consts::PI {
        -v
    } else {
        v
    };
    [v, turned / seconds]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(x: f32, y: f32, theta: f32) -> Pose {
        Pose {
            x,
            y,
            theta,
            sigma: 0.05,
        }
    }

    #[test]
    fn speeds_come_from_two_messages_and_jumps_are_none() {
        let mut cells = Cells::default();
        let id = RobotId::new("a").expect("legal");
        let mut at = |ms: u64, pose| {
            let told = Told {
                id: id.clone(),
                timestamp: 10_000 + ms,
                pose,
                says: Says::of_numbers(&[9, 1]),
            };
            cells.neighbours(vec![told], 10_100 + ms)[0].clone()
        };
        assert_eq!(at(0, pose(0.0, 0.0, 0.0)).v, 0.0, "of one message");
        let moving = at(500, pose(0.1, 0.0, 0.0));
        assert!((moving.v - 0.2).abs() < 1e-4, "{moving:?}");
        assert_eq!(moving.says, Says::of_numbers(&[9, 1]), "word for word");
        assert!(
            (moving.x - 0.12).abs() < 1e-4,
            "0.1 s further on: {moving:?}"
        );
        assert!(
            (at(500, pose(0.1, 0.0, 0.0)).v - 0.2).abs() < 1e-4,
            "told again"
        );
        let turning = at(1_000, pose(0.1, 0.0, 0.5));
        assert!((turning.w - 1.0).abs() < 1e-3, "{turning:?}");
        assert_eq!(at(1_500, pose(9.0, 0.0, 0.5)).v, 0.0, "a jump");
    }

    #[test]
    fn a_turn_across_the_back_is_a_small_one() {
        let [v, w] = twist(&pose(0.0, 0.0, 3.1), &pose(-0.1, 0.0, -3.1), 500);
        assert!((v - 0.2).abs() < 0.01, "{v}");
        assert!((w - 0.166).abs() < 0.01, "{w}");
    }
}
