//! A bare world as bytes.

use crawler_app::controller::PERIOD;
use crawler_hal::Instant;
use serde::{Deserialize, Serialize};

use super::BareWorld;
use super::robot::BareRobot;
use crate::world::Fingerprint;
use crate::world::{Arena, Parameters, Space, SpaceState};

/// What every stored world begins with.
const MAGIC: [u8; 4] = *b"TCBW";
/// Counts changes of what is stored, and of what worlds do with it: a state is gone on with by the
/// code that wrote it, or not at all.
const VERSION: u16 = 3;
/// Magic, version, and a check over the rest.
const HEAD: usize = 4 + 2 + 8;

/// Why bytes are no world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum StateError {
    /// They are something else.
    Foreign,
    /// They were written by a program whose worlds go on differently; its version.
    Version(u16),
    /// They are cut short, changed, or not what they say they are.
    Damaged,
    /// They name a world that cannot be: what is wrong with it.
    Unsound(&'static str),
}

impl core::fmt::Display for StateError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Foreign => f.write_str("no stored world"),
            Self::Version(version) => write!(
                f,
                "a stored world of version {version}; this program goes on with version {VERSION}"
            ),
            Self::Damaged => f.write_str("a stored world that is cut short or was changed"),
            Self::Unsound(what) => write!(f, "a stored world whose {what} cannot be"),
        }
    }
}

impl core::error::Error for StateError {}

/// Arena and parameters are stored as they stand in scenario files; the rest is binary.
#[derive(Serialize, Deserialize)]
struct Stored {
    seed: u64,
    now: Instant,
    arena: String,
    parameters: String,
    space: SpaceState,
    robots: Vec<BareRobot>,
}

impl BareWorld {
    /// The whole state. [`BareWorld::load`] goes on from it exactly as this world does.
    ///
    /// # Panics
    /// Never: a world holds nothing that cannot be written.
    pub fn save(&self) -> Vec<u8> {
        let written = "a world holds nothing that cannot be written";
        let stored = Stored {
            seed: self.seed,
            now: self.now,
            arena: serde_json::to_string(&self.space.arena).expect(written),
            parameters: serde_json::to_string(&self.space.parameters).expect(written),
            space: self.space.state(),
            robots: self.robots.clone(),
        };
        let body = postcard::to_allocvec(&stored).expect(written);
        let mut bytes = Vec::with_capacity(HEAD + body.len());
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&VERSION.to_le_bytes());
        bytes.extend_from_slice(&check(&body).to_le_bytes());
        bytes.extend_from_slice(&body);
        bytes
    }

    /// The world that [`BareWorld::save`] wrote.
    ///
    /// Bytes of any origin are safe to hand in: they make a sound world, or an error. Memory is
    /// bounded by their number, apart from the grid of the arena they name.
    ///
    /// # Errors
    /// See [`StateError`].
    pub fn load(bytes: &[u8]) -> Result<Self, StateError> {
        let (magic, rest) = bytes.split_first_chunk().ok_or(StateError::Foreign)?;
        if *magic != MAGIC {
            return Err(StateError::Foreign);
        }
        let (version, rest) = rest.split_first_chunk().ok_or(StateError::Damaged)?;
        let version = u16::from_le_bytes(*version);
        if version != VERSION {
            return Err(StateError::Version(version));
        }
        let (sum, body) = rest.split_first_chunk().ok_or(StateError::Damaged)?;
        if u64::from_le_bytes(*sum) != check(body) {
            return Err(StateError::Damaged);
        }
        let (stored, rest) =
            postcard::take_from_bytes::<Stored>(body).map_err(|_| StateError::Damaged)?;
        if !rest.is_empty() {
            return Err(StateError::Damaged);
        }
        let arena: Arena =
            serde_json::from_str(&stored.arena).map_err(|_| StateError::Unsound("arena"))?;
        let parameters: Parameters = serde_json::from_str(&stored.parameters)
            .map_err(|_| StateError::Unsound("parameters"))?;
        let mut world = Self::new(arena, parameters, stored.seed).map_err(|error| match error {
            crate::world::WorldError::Arena(_) => StateError::Unsound("arena"),
            _ => StateError::Unsound("parameters"),
        })?;
        if stored.space.robots() != stored.robots.len() {
            return Err(StateError::Unsound("number of robots"));
        }
        restore(&mut world.space, stored.space)?;
        let now = stored.now;
        if now > LATEST || !now.as_micros().is_multiple_of(PERIOD.as_micros()) {
            return Err(StateError::Unsound("time"));
        }
        world.now = now;
        world.robots = stored.robots;
        for robot in &mut world.robots {
            robot.settle(&world.settings, world.tuning);
            if !robot.is_sound(now) {
                return Err(StateError::Unsound("robot"));
            }
        }
        Ok(world)
    }
}

/// A thousand years: far from the end of the counters.
const LATEST: Instant = Instant::from_millis(1_000 * 366 * 24 * 3_600_000);

fn restore(space: &mut Space, state: SpaceState) -> Result<(), StateError> {
    space.restore(state).map_err(StateError::Unsound)
}

/// Against accidents, not against forgers: those meet the checks of what is read.
fn check(bytes: &[u8]) -> u64 {
    let mut sum = Fingerprint::new();
    sum.word(bytes.len() as u64);
    for chunk in bytes.chunks(8) {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        sum.word(u64::from_le_bytes(word));
    }
    sum.value()
}

#[cfg(test)]
pub(super) fn sealed(body: &[u8]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    bytes.extend_from_slice(&check(body).to_le_bytes());
    bytes.extend_from_slice(body);
    bytes
}

#[cfg(test)]
pub(super) const fn head() -> usize {
    HEAD
}
