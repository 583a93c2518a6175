//! What a robot is told about itself before it starts.

use crawler_protocol::{Fleet, Kind, RobotId};
use heapless::String;

/// Identity, whereabouts of the broker, and shape of one robot. Fixed from boot to boot.
#[derive(Debug, Clone)]
pub struct Config {
    /// Name of the robot on the wire, and its MQTT client id.
    pub id: RobotId,
    /// Fleet the robot belongs to: the root of every topic.
    pub fleet: Fleet,
    /// Host name or address of the broker.
    pub broker_host: String<64>,
    /// TCP port of the broker.
    pub broker_port: u16,
    /// What sort of body this is; every view shows it.
    pub kind: Kind,
    /// Name of the board, at most 16 bytes.
    pub board: &'static str,
    /// Version of the program, at most 32 bytes.
    pub firmware: &'static str,
    /// Shape of the drive.
    pub geometry: Geometry,
}

/// Shape and motor model of a differential drive.
///
/// There are no wheel encoders: these numbers are all odometry has to go by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geometry {
    /// Distance between the contact points of the wheels, in metres.
    pub wheel_base_m: f32,
    /// Speed of a wheel at full duty once it has settled, in metres per second.
    pub top_speed_mps: f32,
    /// Time constant of the first-order lag from duty to speed, in seconds.
    pub time_constant_s: f32,
    /// Duty below which a motor does not turn, 0 to 1.
    pub stiction_duty: f32,
}

impl Default for Geometry {
    /// Nominal values of the two-wheel chassis with yellow TT gear motors (1:48) at 7.4 V: 65 mm
    /// wheels at about 180 turns a minute, 150 mm apart.
    fn default() -> Self {
        Self {
            wheel_base_m: 0.15,
            top_speed_mps: 0.6,
            time_constant_s: 0.12,
            stiction_duty: 0.12,
        }
    }
}
