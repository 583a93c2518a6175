//! What tells that a backup came through whole: the SHA-256 of each of its files, in a last one that
//! `sha256sum --check` reads as well.

use crawler_system::cli_error::CliError;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

/// Name of the file in the archive.
pub(super) const CHECKSUMS: &str = "checksums";

/// Files and what they hash to.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Checksums(BTreeMap<PathBuf, String>);

impl Checksums {
    /// Takes in a file that was read to its end.
    pub(super) fn add<R>(&mut self, name: &Path, read: Hashing<R>) {
        let digest: [u8; 32] = read.hash.finalize().into();
        self.0
            .insert(name.to_owned(), crawler_system::text::hex(&digest));
    }

    /// The file.
    pub(super) fn to_text(&self) -> String {
        self.0.iter().fold(String::new(), |mut text, (name, hash)| {
            // Writing to a String does not fail.
            let _ = writeln!(text, "{hash}  {}", name.display());
            text
        })
    }

    /// Whether they are those that `text` has.
    ///
    /// # Errors
    /// What is wrong, in words.
    pub(super) fn check(&self, text: &str) -> Result<(), CliError> {
        let listed = text.lines().map(|line| {
            let (hash, name) = line.split_once("  ")?;
            Some((PathBuf::from(name), hash.to_owned()))
        });
        let listed: BTreeMap<PathBuf, String> = listed
            .collect::<Option<_>>()
            .ok_or_else(|| CliError::new("its list of checksums is damaged"))?;
        let names = || self.0.keys().chain(listed.keys());
        match names().find(|name| self.0.get(*name) != listed.get(*name)) {
            Some(name) => Err(CliError::new(format!(
                "`{}` is not what was put into it: the file was damaged since",
                name.display()
            ))),
            None => Ok(()),
        }
    }
}

/// Puts the file at `path` into the archive, under a name, and takes it in.
pub(super) fn append(
    tar: &mut tar::Builder<File>,
    sums: &mut Checksums,
    path: &Path,
    name: &Path,
) -> io::Result<()> {
    let file = File::open(path)?;
    let mut header = tar::Header::new_gnu();
    header.set_metadata_in_mode(&file.metadata()?, tar::HeaderMode::Deterministic);
    let mut file = Hashing::new(file);
    tar.append_data(&mut header, name, &mut file)?;
    sums.add(name, file);
    Ok(())
}

/// Hashes what is read through it.
pub(super) struct Hashing<R> {
    from: R,
    hash: Sha256,
}

impl<R> Hashing<R> {
    pub(super) fn new(from: R) -> Self {
        Self {
            from,
            hash: Sha256::new(),
        }
    }
}

impl<R: Read> Read for Hashing<R> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.from.read(to)?;
        self.hash.update(to.get(..count).unwrap_or_default());
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(files: &[(&str, &str)]) -> Checksums {
        let mut sums = Checksums::default();
        for (name, text) in files {
            let mut read = Hashing::new(text.as_bytes());
            io::copy(&mut read, &mut io::sink()).expect("bytes");
            sums.add(Path::new(name), read);
        }
        sums
    }

    #[test]
    fn every_file_counts() {
        let sums = of(&[("seq", "17"), ("tls/ca.key", "a key")]);
        let text = sums.to_text();
        assert!(text.contains("  tls/ca.key\n"), "{text}");
        sums.check(&text).expect("whole");
        for other in [
            of(&[("seq", "18"), ("tls/ca.key", "a key")]),
            of(&[("seq", "17")]),
            of(&[("seq", "17"), ("tls/ca.key", "a key"), ("new", "")]),
        ] {
            assert!(other.check(&text).is_err(), "{other:?}");
        }
        for text in ["", "nonsense", "\u{fffd}"] {
            assert!(sums.check(text).is_err(), "{text}");
        }
    }
}
