//! The versions of programs.

use std::collections::BTreeSet;

/// Versions for as long as the process runs: a program takes its own from its constants, so the texts have to
/// outlast it. Each is kept once, at most [`crawler_bundle::VERSION_MAX`] bytes for each version that the world
/// ever started.
#[derive(Debug, Default)]
pub(super) struct Versions(BTreeSet<&'static str>);

impl Versions {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_version_is_kept_once() {
        let mut versions = Versions::default();
        let first = versions.keep("1.0.0");
        for _ in 0..1_000 {
            let elsewhere = String::from("1.0.0");
            assert!(std::ptr::eq(first, versions.keep(&elsewhere)));
        }
        versions.keep("1.0.1");
        assert_eq!(versions.0.len(), 2);
    }
}
