//! Domain randomisation: worlds that differ from the nominal one.

use rand_pcg::Pcg32;
use serde::{Deserialize, Serialize};

use super::Parameters;
use super::table::{Row, TABLE, Vary};
use crate::world::rng::{mix, uniform};

/// How far worlds differ from what their scenario says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Profile {
    /// Not at all.
    #[default]
    None,
    /// As robots of one make in one room do.
    Mild,
    /// As far as a policy should still cope with.
    Wild,
}

impl Profile {
    /// All profiles, tamest first.
    pub const ALL: [Self; 3] = [Self::None, Self::Mild, Self::Wild];

    /// Its name in a scenario file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Mild => "mild",
            Self::Wild => "wild",
        }
    }
}

impl core::fmt::Display for Profile {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.name())
    }
}

impl Row {
    /// How `profile` varies it.
    pub const fn variation(&self, profile: Profile) -> Vary {
        match profile {
            Profile::None => Vary::Fixed,
            Profile::Mild => self.mild,
            Profile::Wild => self.wild,
        }
    }

    /// A value drawn from the seed. Each parameter has a stream of its own, so that a new one
    /// leaves the draws of the others alone.
    fn draw(&self, value: f32, profile: Profile, seed: u64) -> f32 {
        let place = self.key.bytes().fold(0xCBF2_9CE4_8422_2325, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3_u64)
        });
        let share = uniform(&mut Pcg32::new(mix(seed ^ mix(place)), place));
        let about = |deviation: f32| value + deviation * (2.0 * share - 1.0);
        match self.variation(profile) {
            Vary::Fixed => value,
            Vary::Times(times) => about(value * times),
            Vary::Plus(deviation) => about(deviation),
            Vary::Within(least, most) => least + (most - least) * share,
        }
    }
}

impl Parameters {
    /// The parameters of one world of this profile: each drawn from `seed` around the value it
    /// has here, and brought into its allowed range. Valid parameters stay valid;
    /// [`Profile::None`] changes nothing.
    ///
    /// Beside this every robot differs from the others by the `spread` section.
    #[must_use]
    pub fn randomised(&self, profile: Profile, seed: u64) -> Self {
        if profile == Profile::None {
            return *self;
        }
        let mut drawn = *self;
        for row in TABLE {
            let value = row.draw(row.value(self), profile, seed);
            // A bound may be a parameter that was just drawn. `max` and `min` never panic and
            // leave a value alone that is not a number; validation tells of it.
            let (least, most) = row.range(&drawn);
            row.set(&mut drawn, if value < least { least } else { value });
            if value > most {
                row.set(&mut drawn, most);
            }
        }
        drawn
    }
}
