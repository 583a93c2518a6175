//! Worlds that were kept to go back to.

use std::fmt;
use std::rc::Rc;
use std::time::{SystemTime, UNIX_EPOCH};

use crawler_hal::Instant;
use crawler_sim_protocol::SnapshotName;

use crate::run::simulation::Checkpoint;

/// Most bookmarks of a live world.
pub const MAX_BOOKMARKS: usize = 16;
/// Most memory that they take together, in bytes, as nearly as that matters: sixteen of ten
/// thousand robots take half of it.
const MAX_BYTES: usize = 512 << 20;

/// What there is to know of a bookmark.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Bookmark {
    /// Its name.
    pub name: SnapshotName,
    /// Time of the world then.
    pub time: Instant,
    /// Unix time in milliseconds at which it was made.
    pub made_at: u64,
    /// Robots in it.
    pub robots: u32,
    /// Name of its scenario.
    pub scenario: String,
}

/// Why a bookmark is not made, or not found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum BookmarkError {
    /// There are [`MAX_BOOKMARKS`].
    Full,
    /// They would take more than [`MAX_BYTES`].
    TooLarge,
    /// None has this name.
    Unknown(SnapshotName),
}

impl fmt::Display for BookmarkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Full => write!(f, "{MAX_BOOKMARKS} bookmarks are kept already: forget one"),
            Self::TooLarge => f.write_str("the bookmarks would take too much memory: forget one"),
            Self::Unknown(name) => write!(f, "no bookmark is called {name}"),
        }
    }
}

/// All of them, the oldest first.
#[derive(Default)]
pub(super) struct Bookmarks(Vec<(Bookmark, Rc<Checkpoint>)>);

impl Bookmarks {
    /// Keeps a world under `name`, in place of the one that has that name.
    pub(super) fn add(
        &mut self,
        name: &SnapshotName,
        kept: Checkpoint,
    ) -> Result<(), BookmarkError> {
        let others = || self.0.iter().filter(|(other, _)| other.name != *name);
        if others().count() >= MAX_BOOKMARKS {
            return Err(BookmarkError::Full);
        }
        let bytes: usize = others().map(|(_, kept)| kept.footprint()).sum();
        if bytes + kept.footprint() > MAX_BYTES {
            return Err(BookmarkError::TooLarge);
        }
        // A clock before 1970 is none.
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let bookmark = Bookmark {
            name: name.clone(),
            time: kept.at(),
            made_at: since.map_or(0, |since| since.as_millis() as u64),
            robots: kept.present(),
            scenario: kept.scenario().name.clone(),
        };
        self.0.retain(|(other, _)| other.name != *name);
        self.0.push((bookmark, Rc::new(kept)));
        Ok(())
    }

    /// The world kept under `name`.
    pub(super) fn get(&self, name: &SnapshotName) -> Result<Rc<Checkpoint>, BookmarkError> {
        let found = self.0.iter().find(|(bookmark, _)| bookmark.name == *name);
        let (_, kept) = found.ok_or_else(|| BookmarkError::Unknown(name.clone()))?;
        Ok(Rc::clone(kept))
    }

    /// Keeps it no longer.
    pub(super) fn remove(&mut self, name: &SnapshotName) -> Result<(), BookmarkError> {
        self.get(name)?;
        self.0.retain(|(bookmark, _)| bookmark.name != *name);
        Ok(())
    }

    pub(super) fn list(&self) -> Vec<Bookmark> {
        let all = self.0.iter();
        all.map(|(bookmark, _)| bookmark.clone()).collect()
    }
}
