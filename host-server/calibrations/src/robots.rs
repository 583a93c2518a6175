//! What is known of the robots, and told to them.

use crawler_protocol::{RobotId, RobotState};

use crate::ground::Ground;

/// A robot, as it tells of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotView {
    /// Whether it is there.
    pub is_online: bool,
    /// Whether two robots seem to have its name.
    pub is_doubled: bool,
    /// Whether it has the capability `drive`.
    pub drives: bool,
    /// What it is doing, where that is known.
    pub state: Option<RobotState>,
    /// The behaviour in force, where that is more than to do what it is told.
    pub behaviour: Option<String>,
    /// How often it has started.
    pub boot: u32,
    /// Its program.
    pub firmware: String,
    /// Its parameters `max_speed` and `max_turn`, and how often it tells telemetry, where it told.
    pub max_speed: Option<f32>,
    /// See `max_speed`.
    pub max_turn: Option<f32>,
    /// See `max_speed`.
    pub telemetry_hz: Option<f32>,
}

/// What is farther away, metres, is in no robot's way.
pub const AROUND_M: f64 = 6.0;

/// The fleet.
pub trait Fleet: Send + Sync + 'static {
    /// What is known of a robot; `None` for one that nobody knows.
    fn robot(&self, robot: &RobotId) -> Option<RobotView>;
    /// Where others are that are there, within [`AROUND_M`] of a place.
    fn others(&self, robot: &RobotId, at: [f64; 2]) -> Vec<(RobotId, [f64; 2])>;
    /// The ground around a robot, but for what a person says to be free.
    fn ground(&self, robot: &RobotId, at: [f64; 2]) -> Ground;
    /// Sends a robot a word of driving, under the source [`SOURCE`]; false where it did not go out.
    fn drive(&self, robot: &RobotId, v: f64, w: f64) -> bool;
    /// Tells a robot to stop, at once, under the same.
    fn stop(&self, robot: &RobotId);
    /// Has a robot tell telemetry so often; it may wait until the robot is there.
    fn set_rate(&self, robot: &RobotId, hz: f32);
    /// Tells those who watch.
    fn tell(&self, robot: &RobotId, is_bad: bool, text: String);
}

/// As whose commands a calibration drives.
pub const SOURCE: &str = "calibration";
/// Others whose commands move no robot.
pub const HARMLESS: [&str; 2] = ["map", "settings"];
