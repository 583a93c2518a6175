//! What an overhead camera tells a robot, and the client that tells it in a live world.

#[cfg(feature = "live")]
pub(crate) mod publisher;

use crawler_protocol::{MAX_MESSAGE, Pose, PoseFix, RobotId};

/// A fix as bytes; `None` when it cannot be written, which finite numbers always can.
pub(crate) fn pose_fix(robot: &RobotId, timestamp: u64, pose: Pose) -> Option<Vec<u8>> {
    let fix = PoseFix {
        robot: robot.clone(),
        timestamp,
        pose,
    };
    let mut buffer = [0; MAX_MESSAGE];
    let len = fix.to_json(&mut buffer).ok()?;
    Some(buffer[..len].to_vec())
}
