//! Sends chunks to robots that have asked for some.

use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::{RobotId, Topic};
use crawler_release::chunk::Part;
use rumqttc::v5::mqttbytes::QoS;
use tokio_util::sync::CancellationToken;

use crate::Rollouts;
use crate::active::Asked;
use crate::pulls::Turn;

/// What there is to send.
enum Next {
    Chunk(RobotId, Part, Vec<u8>),
    /// Nothing before so many milliseconds have passed.
    In(u64),
    Nothing,
}

impl Rollouts {
    fn next_chunk(&self) -> Next {
        let now = self.now();
        let mut active = self.active();
        let mut pulls = self.pulls();
        let patches = self.patches();
        loop {
            let (robot, pull, index) = match pulls.next(now.monotonic_ms) {
                Turn::Of(robot, pull, index) => (robot, pull, index),
                Turn::At(at) => return Next::In(at.saturating_sub(now.monotonic_ms)),
                Turn::Nobody => return Next::Nothing,
            };
            match active.chunk(&patches, robot, pull, index, now) {
                Asked::Chunk(bytes) => {
                    let robot = robot.clone();
                    pulls.sent(now.monotonic_ms);
                    return Next::Chunk(robot, pull.want.part, bytes);
                }
                // Its robot has its turn again for the rest of its window.
                Asked::NoSuch => pulls.sent(now.monotonic_ms),
                Asked::Never => pulls.refuse(),
                Asked::Later(ms) => pulls.delay(ms, now.monotonic_ms),
            }
        }
    }
}

/// Sends until `stop`.
pub(crate) async fn run(rollouts: Arc<Rollouts>, stop: CancellationToken) {
    loop {
        let wait = match rollouts.next_chunk() {
            Next::Chunk(robot, part, bytes) => {
                if !send(&rollouts, robot, part, bytes).await {
                    rollouts.pulls().clear();
                }
                if stop.is_cancelled() {
                    return;
                }
                continue;
            }
            Next::In(ms) => Duration::from_millis(ms.max(1)),
            Next::Nothing => Duration::from_mins(1),
        };
        tokio::select! {
            () = stop.cancelled() => return,
            () = rollouts.pulled.notified() => {}
            () = tokio::time::sleep(wait) => {}
        }
    }
}

/// Whether the chunk was handed to the connection. Waits while that is busy. It does not expire, which would be five
/// bytes of each: a window at most waits for a robot, for as long as the broker keeps its session.
async fn send(rollouts: &Rollouts, robot: RobotId, part: Part, bytes: Vec<u8>) -> bool {
    let Some(client) = rollouts.client() else {
        return false;
    };
    let topic = Topic::Ota(robot).render(&rollouts.fleet);
    let length = bytes.len();
    let sent = client
        .publish(topic.as_str(), QoS::AtMostOnce, false, bytes)
        .await
        .is_ok();
    if sent {
        rollouts.numbers.sent_chunk(part, length);
    }
    sent
}
