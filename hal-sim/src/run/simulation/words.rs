//! What programs are called.

use std::collections::BTreeSet;

/// Versions and builds for as long as the process runs: a program takes what it is called from its constants,
/// so they have to outlast it. Each is kept once, at most 40 bytes for each version and build that the world
/// ever started.
#[derive(Debug, Default)]
pub(super) struct Words(BTreeSet<&'static str>);

impl Words {
    /// The same text, to stay.
    pub(super) fn keep(&mut self, text: &str) -> &'static str {
        if let Some(kept) = self.0.get(text) {
            return kept;
        }
        let kept: &'static str = Box::leak(text.into());
        self.0.insert(kept);
        kept
    }
}
