//! Files with public keys, as one option.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use crawler_release::{PublicKey, PublicKeys};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_updates::release::public_from_pem;
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

    /// Reads the keys.
    ///
    /// # Errors
    /// Which file holds none, and what is wrong with it.
    pub fn read(&self) -> Result<PublicKeys, CliError> {
        let read = |path: &Path| {
            let text = crawler_system::text::read_text(path)
                .or_say(|error| format!("cannot read {}: {error}", path.display()))?;
            public_from_pem(&text).or_say(|fault| format!("{}: {fault}", path.display()))
        };
        Ok(PublicKeys {
            current: read(self.current())?,
            next: self.next().map(read).transpose()?,
        })
    }

    /// Reads the keys of these files, where there are any, as a list.
    ///
    /// # Errors
    /// As of [`KeyFiles::read`].
    pub fn list(files: Option<&Self>) -> Result<Vec<PublicKey>, CliError> {
        let keys = files.map(Self::read).transpose()?;
        let both = keys.map(|keys| [Some(keys.current), keys.next]);
        Ok(both.into_iter().flatten().flatten().collect())
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
    fn a_file_that_holds_no_key_is_named() {
        let files: KeyFiles = "/nowhere/key.pem".parse().expect("a file");
        let text = files.read().expect_err("no file").to_string();
        assert!(text.contains("/nowhere/key.pem"), "{text}");
        assert_eq!(KeyFiles::list(None).expect("none"), []);
    }

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
