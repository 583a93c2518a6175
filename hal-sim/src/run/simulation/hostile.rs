//! Somebody who sends a robot what nobody should.

use crawler_hal::Duration;
use crawler_protocol::MAX_MESSAGE;
use rand_core::Rng;
use rand_pcg::Pcg32;

use super::EPOCH_MS;
use crate::world::{Purpose, RobotIndex, stream};

/// Bytes of the largest packet: more than a robot takes, less than a broker refuses.
const MAX_PACKET: u32 = 8_192;

/// The attacker of one robot. What it sends depends on the seed and the robot alone, and on what
/// that robot was told meanwhile.
#[derive(Debug)]
pub(super) struct Hostile {
    rng: Pcg32,
    period: Duration,
    /// The last command that the robot was given while this one listened.
    overheard: Option<Box<[u8]>>,
}

/// One hostile packet.
#[derive(Debug)]
pub(super) struct Packet {
    pub(super) payload: Vec<u8>,
    /// Whether it poses as a word of the tracker rather than as a command.
    pub(super) as_pose: bool,
}

/// Commands of wrong types and values, and ones that are not allowed to do anything.
const TWISTED: [&str; 10] = [
    "",
    "{}",
    "null",
    r#"{"command":7,"parameters":[],"timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"fly","timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"drive","parameters":{"v":1e39,"w":0},"timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"drive","parameters":{"v":NaN,"w":0},"timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"move","parameters":{"direction":"forward","speed":"100","duration":9000},"timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"move","parameters":{"direction":"forward","speed":100,"duration":-1},"timestamp":0,"seq":9000000000,"source":"x"}"#,
    r#"{"command":"set","parameters":{"safe_distance_mm":{"a":[[[[[[[[[[]]]]]]]]]]}},"timestamp":0,"seq":9000000000,"source":"x"}"#,
];

impl Hostile {
    pub(super) fn new(seed: u64, robot: RobotIndex, per_s: u16) -> Self {
        Self {
            rng: stream(seed, robot.get(), Purpose::Hostile),
            period: Duration::from_micros(1_000_000 / u64::from(per_s.max(1))),
            overheard: None,
        }
    }

    pub(super) fn period(&self) -> Duration {
        self.period
    }

    pub(super) fn overhear(&mut self, payload: &[u8]) {
        if payload.len() <= MAX_MESSAGE {
            self.overheard = Some(payload.into());
        }
    }

    pub(super) fn packet(&mut self) -> Packet {
        let kind = self.rng.next_u32() % 6;
        let payload = match kind {
            0 | 1 => self.garbage(MAX_MESSAGE as u32),
            2 => self.garbage(MAX_PACKET),
            3 => self.stale(),
            4 => match &self.overheard {
                Some(command) => command.to_vec(),
                None => self.stale(),
            },
            _ => {
                let one = self.rng.next_u32() as usize % TWISTED.len();
                TWISTED[one].into()
            }
        };
        Packet {
            payload,
            as_pose: kind == 1,
        }
    }

    fn garbage(&mut self, most: u32) -> Vec<u8> {
        let len = self.rng.next_u32() % most;
        let mut bytes = vec![0; len as usize];
        self.rng.fill_bytes(&mut bytes);
        bytes
    }

    /// A command to move that was right an hour before the world began.
    fn stale(&mut self) -> Vec<u8> {
        let timestamp = EPOCH_MS - 3_600_000;
        // Beyond the numbers of whoever commands the robot: answers name no source.
        let seq = u64::from(self.rng.next_u32()) + (1 << 33);
        format!(
            r#"{{"command":"move","parameters":{{"direction":"forward","speed":100,"duration":5000}},"timestamp":{timestamp},"seq":{seq},"source":"attacker"}}"#
        )
        .into_bytes()
    }
}
