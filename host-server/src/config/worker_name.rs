//! What people call a process that works on experiments.

use std::fmt;
use std::str::FromStr;

use serde::Deserialize;

/// The name of a process among those that work on experiments.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct WorkerName(String);

impl WorkerName {
    /// As it is shown.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// A text that is no name of a worker.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoWorkerName;

impl fmt::Display for NoWorkerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("must be 1 to 64 of a-z, A-Z, 0-9, dot, underscore, hyphen")
    }
}

impl std::error::Error for NoWorkerName {}

impl FromStr for WorkerName {
    type Err = NoWorkerName;

    fn from_str(text: &str) -> Result<Self, NoWorkerName> {
        let fits = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
        if (1..=64).contains(&text.len()) && text.chars().all(fits) {
            Ok(Self(text.to_owned()))
        } else {
            Err(NoWorkerName)
        }
    }
}

impl TryFrom<String> for WorkerName {
    type Error = NoWorkerName;

    fn try_from(text: String) -> Result<Self, NoWorkerName> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_short_and_can_be_shown() {
        for name in ["a", "lab-1.example_2", &"x".repeat(64)] {
            assert_eq!(name.parse::<WorkerName>().expect(name).as_str(), name);
        }
        for name in ["", "a b", "a#1", "\u{e4}", "a\n", &"x".repeat(65)] {
            assert_eq!(name.parse::<WorkerName>(), Err(NoWorkerName), "{name:?}");
        }
    }
}
