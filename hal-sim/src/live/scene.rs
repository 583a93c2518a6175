//! What a live world is made of, for whoever shows it.

use std::sync::Arc;

use super::bookmarks::Bookmark;
use super::driver::Driver;
use crate::run::Simulation;
use crate::world::{Arena, DroppedItem};

/// What a live world is made of beside its robots. It changes seldom: by what the world is told.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct LiveScene {
    /// Name of the scenario.
    pub scenario: String,
    /// The arena, with what was dropped. Another one, if only in memory, after each change.
    pub arena: Arc<Arena>,
    /// What was dropped and lies there.
    pub dropped: Vec<DroppedItem>,
    /// Worlds that were kept to go back to, the oldest first.
    pub bookmarks: Vec<Bookmark>,
}

impl LiveScene {
    pub(super) fn of(simulation: &Simulation) -> Self {
        Self {
            scenario: simulation.scenario().name.clone(),
            arena: Arc::new(simulation.world().arena()),
            dropped: simulation.world().dropped(),
            bookmarks: Vec::new(),
        }
    }
}

impl Driver<'_> {
    /// The arena has changed, or is another one.
    pub(super) fn tell_arena(&self) {
        let scene = LiveScene {
            bookmarks: self.bookmarks.list(),
            ..LiveScene::of(&self.simulation)
        };
        self.scene.send_replace(scene);
    }

    /// There are other bookmarks.
    pub(super) fn tell_bookmarks(&self) {
        let bookmarks = self.bookmarks.list();
        self.scene.send_modify(|scene| scene.bookmarks = bookmarks);
    }
}
