//! Files with public keys, as one option.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use serde::Deserialize;

/// One file or two with the public keys of releases.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct KeyFiles {
    current: PathBuf,
    next: Option<PathBuf>,
}

impl KeyFiles {
    /// The key that signs now.
    #[must_use]
    pub fn current(&self) -> &Path {
        &self.current
    }

    /// The key that will sign once the other is lost, or given up.
    #[must_use]
    pub fn next(&self) -> Option<&Path> {
        self.next.as_deref()
    }
}

/// A text that names no file, or more than two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoKeyFiles;

impl fmt::Display for NoKeyFiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("must be one file, or two separated by a comma")
    }
}

impl std::error::Error for NoKeyFiles {}

impl FromStr for KeyFiles {
    type Err = NoKeyFiles;

    fn from_str(text: &str) -> Result<Self, NoKeyFiles> {
        let files: Vec<_> = text.split(',').map(str::trim).collect();
        if files.iter().any(|file| file.is_empty()) {
            return Err(NoKeyFiles);
        }
        match files[..] {
            [current] => Ok(Self {
                current: current.into(),
                next: None,
            }),
            [current, next] => Ok(Self {
                current: current.into(),
                next: Some(next.into()),
            }),
            _ => Err(NoKeyFiles),
        }
    }
}

impl TryFrom<String> for KeyFiles {
    type Error = NoKeyFiles;

    fn try_from(text: String) -> Result<Self, NoKeyFiles> {
        text.parse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_or_two() {
        let files = |text: &str| {
            let files = text.parse::<KeyFiles>()?;
            Ok((files.current().to_owned(), files.next().map(Path::to_owned)))
        };
        assert_eq!(files("a.pem"), Ok(("a.pem".into(), None)));
        assert_eq!(files("a, b/c"), Ok(("a".into(), Some("b/c".into()))));
        for wrong in ["", ",", "a,", ",a", "a,b,c"] {
            assert_eq!(files(wrong), Err(NoKeyFiles), "{wrong}");
        }
    }
}
