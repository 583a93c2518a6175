//! What a robot is told about itself before it starts.

use core::fmt;

use crawler_hal::Millivolts;
use crawler_protocol::{BuildId, Fleet, Kind, RobotId};
use heapless::String;

use crate::vision::lens::Lens;

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
    /// What names the program: no two programs have the same. `None` in worlds whose history is compared with
    /// that of earlier programs: the status then does not say it, and answers do not name the source of their
    /// command.
    pub build: Option<BuildId>,
    /// Shape of the drive.
    pub geometry: Geometry,
    /// What the broker asks for; `None` connects without a name.
    pub credentials: Option<Credentials>,
    /// Whether the body has a camera: the status then says so.
    pub camera: bool,
    /// How the camera sits, when the program has eyes to look through it (see
    /// [`camera_with_eyes()`](crate::camera_with_eyes())): the status then says so.
    pub eyes: Option<Lens>,
    /// Whether the robot stands on a bench and takes faults from the network. Only a program
    /// built with the feature `faults` can; a robot at work does not.
    pub faults: bool,
}

impl Config {
    /// Whether faults can be injected into this robot.
    pub(crate) const fn takes_faults(&self) -> bool {
        cfg!(feature = "faults") && self.faults
    }
}

/// Name and password for the broker.
#[derive(Clone, PartialEq, Eq)]
pub struct Credentials {
    /// User name.
    pub username: String<32>,
    /// Password. Goes to the broker and nowhere else: no log record, no message and no `Debug`
    /// tells it.
    pub password: String<64>,
}

impl fmt::Debug for Credentials {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Credentials")
            .field("username", &self.username)
            .finish_non_exhaustive()
    }
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
    /// Duty that friction takes, 0 to 1: a wheel at less than that does not turn.
    pub stiction_duty: f32,
    /// Voltage of the pack for which speed and duty above hold, in volts.
    pub nominal_v: f32,
    /// Volts that the motor driver keeps for itself.
    pub bridge_drop_v: f32,
}

impl Geometry {
    /// The same drive when the pack delivers `voltage`.
    ///
    /// Friction costs a voltage that does not depend on that of the pack; the rest of what
    /// reaches a motor is speed. A reading beyond half and one and a half of the nominal voltage
    /// is not of this pack: it is taken for the nearest of the two.
    #[must_use]
    pub fn at(&self, voltage: Millivolts) -> Self {
        let nominal = self.nominal_v - self.bridge_drop_v;
        let friction = self.stiction_duty * nominal;
        let supply =
            (f32::from(voltage.0) * 1e-3).clamp(0.5 * self.nominal_v, 1.5 * self.nominal_v);
        let motor = supply - self.bridge_drop_v;
        let share = (motor - friction) / (nominal - friction);
        // A drive whose numbers are nonsense is not made worse.
        if !(share.is_finite() && share > 0.0 && motor > friction) {
            return *self;
        }
        Self {
            top_speed_mps: self.top_speed_mps * share,
            stiction_duty: friction / motor,
            ..*self
        }
    }
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
            nominal_v: 7.4,
            bridge_drop_v: 1.4,
        }
    }
}
