//! What a program is given when it starts.

use crawler_app::vision::Lens;
use crawler_app::{Config, Credentials, Geometry};
use crawler_hal::ResetCause;
use crawler_protocol::{BuildId, Fleet, Kind, RobotId};
use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::{cause_name, cause_named};
use crate::devices::BodyParts;
use crate::run::journal::Payload;
use crate::world::Wiring;

/// Most sectors of a flash in a recording.
const MAX_SECTORS: usize = 256;

/// Everything that a program can tell about its body before it asks a device: one boot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Life {
    pub(crate) cause: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) panic: Option<String>,
    pub(crate) wiring: Wiring,
    pub(crate) rng: Pcg32,
    /// By how much the ranger's activity starts later than the others, microseconds.
    pub(crate) ranger_after_us: u64,
    /// Contents of each sector; the rest of it is blank.
    pub(crate) flash: Vec<Payload>,
    pub(crate) config: Identity,
}

/// A [`Config`] in a file: without its password.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Identity {
    pub(crate) id: RobotId,
    pub(crate) fleet: Fleet,
    pub(crate) broker_host: String,
    pub(crate) broker_port: u16,
    pub(crate) firmware: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) build: Option<BuildId>,
    /// Base, top speed, time constant, friction, nominal voltage, voltage of the bridge.
    pub(crate) geometry: [f32; 6],
    /// Lengths of name and password: they shape the greeting.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) credentials: Option<(usize, usize)>,
    pub(crate) camera: bool,
    /// Half the field of view, pitch, height and place ahead of a lens that is seen through.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) eyes: Option<[f32; 4]>,
}

impl Identity {
    fn of(config: &Config) -> Self {
        let shape = &config.geometry;
        Self {
            id: config.id.clone(),
            fleet: config.fleet.clone(),
            broker_host: config.broker_host.as_str().to_owned(),
            broker_port: config.broker_port,
            firmware: config.firmware.to_owned(),
            build: config.build.clone(),
            geometry: [
                shape.wheel_base_m,
                shape.top_speed_mps,
                shape.time_constant_s,
                shape.stiction_duty,
                shape.nominal_v,
                shape.bridge_drop_v,
            ],
            credentials: config
                .credentials
                .as_ref()
                .map(|known| (known.username.len(), known.password.len())),
            camera: config.camera,
            eyes: config
                .eyes
                .map(|lens| [lens.half_view, lens.pitch, lens.height_m, lens.forward_m]),
        }
    }

    /// The configuration again, for a program of this build; `None` when something in it is too
    /// long to be one.
    pub(crate) fn config(&self) -> Option<Config> {
        let [
            wheel_base_m,
            top_speed_mps,
            time_constant_s,
            stiction_duty,
            nominal_v,
            bridge_drop_v,
        ] = self.geometry;
        let credentials = match self.credentials {
            None => None,
            Some((name, password)) if name <= 32 && password <= 64 => Some(Credentials {
                username: "x".repeat(name).as_str().try_into().ok()?,
                password: "x".repeat(password).as_str().try_into().ok()?,
            }),
            Some(_) => return None,
        };
        Some(Config {
            id: self.id.clone(),
            fleet: self.fleet.clone(),
            broker_host: self.broker_host.as_str().try_into().ok()?,
            broker_port: self.broker_port,
            kind: Kind::Simulated,
            board: "sim",
            firmware: env!("CARGO_PKG_VERSION"),
            build: self.build.clone(),
            geometry: Geometry {
                wheel_base_m,
                top_speed_mps,
                time_constant_s,
                stiction_duty,
                nominal_v,
                bridge_drop_v,
            },
            credentials,
            camera: self.camera,
            eyes: self
                .eyes
                .map(|[half_view, pitch, height_m, forward_m]| Lens {
                    half_view,
                    pitch,
                    height_m,
                    forward_m,
                }),
            // Simulated bodies are broken from outside.
            faults: false,
        })
    }
}

impl Life {
    /// What `parts` will tell a program of this configuration.
    pub(crate) fn of(config: &Config, parts: &BodyParts) -> Self {
        use crawler_hal::{RangerPort, System as _};
        Self {
            cause: cause_name(parts.system.reset_cause()).to_owned(),
            panic: parts.system.last_panic().map(str::to_owned),
            wiring: match &parts.ranger {
                RangerPort::Uart(_) => Wiring::Uart,
                RangerPort::Pulse { .. } => Wiring::Pulse,
            },
            rng: parts.rng.clone(),
            ranger_after_us: parts.ranger_after.as_micros(),
            flash: parts
                .flash
                .image()
                .iter()
                .map(|sector| Payload::new(sector))
                .collect(),
            config: Identity::of(config),
        }
    }

    pub(crate) fn cause(&self) -> ResetCause {
        cause_named(&self.cause)
    }

    /// Whether its numbers can be those of a body.
    pub(crate) fn is_sound(&self) -> bool {
        let sector = crate::devices::ERASE_BYTES;
        self.flash.len() <= MAX_SECTORS
            && self.flash.iter().all(|bytes| bytes.len() <= sector)
            && self.config.geometry.iter().all(|number| number.is_finite())
    }
}
