//! The `[radio]` section of a scenario.

use serde::{Deserialize, Serialize};

/// Most access points of a scenario.
pub const MAX_ACCESS_POINTS: usize = 64;
/// Most partitions of a scenario.
pub const MAX_PARTITIONS: usize = 256;

/// Access points, and when they are cut off from whom.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Radio {
    /// Where they stand. Without any there is one that everyone hears alike, with
    /// `link.rssi_dbm`, and whose airtime all share.
    pub access_points: Vec<AccessPoint>,
    /// When whom nothing reaches.
    pub partitions: Vec<Partition>,
}

/// A radio that robots can join. All share one network behind it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AccessPoint {
    /// Metres from the middle of the arena.
    pub x: f32,
    /// Metres from the middle of the arena.
    pub y: f32,
    /// Channel in the 2.4 GHz band, 1 to 13. Access points on the same channel share its airtime.
    #[serde(default = "first_channel")]
    pub channel: u8,
    /// How much weaker it is than `parameters.radio.power_dbm` says, decibels: a wall, a bad
    /// antenna.
    #[serde(default)]
    pub attenuation_db: f32,
}

const fn first_channel() -> u8 {
    1
}

/// A time in which nothing reaches some robots, nor they anything.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Partition {
    /// When it begins, seconds from the beginning of the world. Counts to a tenth.
    pub from_s: f64,
    /// When it ends.
    pub until_s: f64,
    /// Only robots in this part of the arena.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Region>,
    /// Only robots at this access point, counting from 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub access_point: Option<u16>,
    /// Only this share of robots, drawn from the seed.
    #[serde(default = "all")]
    pub share: f32,
    /// Robots can know: their radio has lost the access point. Otherwise nobody is told.
    #[serde(default)]
    pub known: bool,
}

const fn all() -> f32 {
    1.0
}

/// A rectangle along the axes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Middle, metres.
    pub x: f32,
    /// Middle, metres.
    pub y: f32,
    /// Length along x, metres.
    pub width: f32,
    /// Length along y, metres.
    pub height: f32,
}

impl Region {
    pub(super) fn contains(&self, (x, y): (f32, f32)) -> bool {
        (x - self.x).abs() * 2.0 <= self.width && (y - self.y).abs() * 2.0 <= self.height
    }
}

/// Farthest that an access point may stand from the middle of an arena, metres.
const FARTHEST: f32 = 10_000.0;
/// Longest world, seconds.
const LONGEST_S: f64 = 1e9;

impl Radio {
    /// Checks every value.
    ///
    /// # Errors
    /// The key below `radio` and what is wrong with it.
    pub fn validate(&self) -> Result<(), (String, String)> {
        fn check(
            place: &dyn Fn(&str) -> String,
            key: &str,
            value: f64,
            (low, high): (f64, f64),
        ) -> Result<(), (String, String)> {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err((place(key), format!("must be {low} to {high}, not {value}")))
        }
        for (name, len, most) in [
            ("access_points", self.access_points.len(), MAX_ACCESS_POINTS),
            ("partitions", self.partitions.len(), MAX_PARTITIONS),
        ] {
            if len > most {
                let rule = format!("must be at most {most}, not {len}");
                return Err((name.to_owned(), rule));
            }
        }
        let far = (-f64::from(FARTHEST), f64::from(FARTHEST));
        for (number, point) in self.access_points.iter().enumerate() {
            let place = |key: &str| format!("access_points[{number}].{key}");
            check(&place, "x", point.x.into(), far)?;
            check(&place, "y", point.y.into(), far)?;
            check(&place, "channel", point.channel.into(), (1.0, 13.0))?;
            let attenuation = point.attenuation_db.into();
            check(&place, "attenuation_db", attenuation, (-30.0, 100.0))?;
        }
        for (number, partition) in self.partitions.iter().enumerate() {
            let place = |key: &str| format!("partitions[{number}].{key}");
            check(&place, "from_s", partition.from_s, (0.0, LONGEST_S))?;
            let later = (partition.from_s, LONGEST_S);
            check(&place, "until_s", partition.until_s, later)?;
            check(&place, "share", partition.share.into(), (0.0, 1.0))?;
            if let Some(region) = &partition.region {
                check(&place, "region.x", region.x.into(), far)?;
                check(&place, "region.y", region.y.into(), far)?;
                let size = (0.001, 2.0 * far.1);
                check(&place, "region.width", region.width.into(), size)?;
                check(&place, "region.height", region.height.into(), size)?;
            }
            if let Some(point) = partition.access_point {
                let known = self.access_points.len().max(1);
                if usize::from(point) >= known {
                    let rule = format!("must be one of {known} access points, not {point}");
                    return Err((place("access_point"), rule));
                }
            }
        }
        Ok(())
    }
}
