//! Sends chunks to robots that have asked for some.

use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::{RobotId, Topic};
use crawler_release::chunk::Part;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::PublishProperties;
use tokio_util::sync::CancellationToken;

use crate::Rollouts;
use crate::active::Asked;

/// What a broker could not hand on for so long is of no use: the robot asks again. In seconds.
const EXPIRY: u32 = 5;

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
        let mut wait: Option<u64> = None;
        let mut turns = pulls.waiting();
        while turns > 0 {
            let Some((robot, pull, index)) = pulls.front() else {
                break;
            };
            match active.chunk(&patches, robot, pull, index, now) {
                Asked::Chunk(bytes) => {
                    let robot = robot.clone();
                    pulls.sent();
                    return Next::Chunk(robot, pull.want.part, bytes);
                }
                // Its robot has its turn again for the rest of its window.
                Asked::NoSuch => pulls.sent(),
                Asked::Never => {
                    pulls.refuse();
                    turns -= 1;
                }
                Asked::Later(ms) => {
                    wait = Some(wait.map_or(ms, |before| before.min(ms)));
                    pulls.pass();
                    turns -= 1;
                }
            }
        }
        wait.map_or(Next::Nothing, Next::In)
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

/// Whether the chunk was handed to the connection. Waits while that is busy.
async fn send(rollouts: &Rollouts, robot: RobotId, part: Part, bytes: Vec<u8>) -> bool {
    let Some(client) = rollouts.client() else {
        return false;
    };
    let topic = Topic::Ota(robot).render(&rollouts.fleet);
    let length = bytes.len();
    let properties = PublishProperties {
        message_expiry_interval: Some(EXPIRY),
        ..PublishProperties::default()
    };
    let sent = client
        .publish_with_properties(topic.as_str(), QoS::AtMostOnce, false, bytes, properties)
        .await
        .is_ok();
    if sent {
        rollouts.numbers.sent_chunk(part, length);
    }
    sent
}
