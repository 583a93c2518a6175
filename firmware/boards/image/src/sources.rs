//! Which sources a robot program is made of, as one hash: the same for the program in an image and for the one that a
//! simulator is compiled with, where both come from the same tree. The image tool, and the builds of
//! experiments and of the server's command line, include this file.

use std::fmt::Write as _;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};

/// The crates that the robot program consists of on every board, and in the simulator: folders below the root of the
/// repository.
pub(crate) const CRATES: [&str; 8] = [
    "firmware/app",
    "firmware/boot",
    "firmware/delta",
    "firmware/drivers",
    "firmware/hal",
    "firmware/protocol",
    "firmware/release",
    "models/micromodel",
];

/// As [`hash_of`] the manifests and sources of `crates`. Of [`CRATES`] it stands for the robot program; what a board adds
/// is not in it.
///
/// # Errors
/// When a file cannot be read.
pub(crate) fn hash(root: &Path, crates: &[&str]) -> io::Result<String> {
    let parts = crates
        .iter()
        .flat_map(|name| [format!("{name}/Cargo.toml"), format!("{name}/src")]);
    hash_of(root, parts)
}

/// SHA-256, in hexadecimal digits, over files and what is in folders, by name: name, a zero, length, content of each
/// file.
///
/// # Errors
/// When a file cannot be read.
pub(crate) fn hash_of(root: &Path, parts: impl Iterator<Item = String>) -> io::Result<String> {
    let mut files = Vec::new();
    for part in parts {
        if path(root, &part).is_dir() {
            below(root, &part, &mut files)?;
        } else {
            files.push(part);
        }
    }
    files.sort_unstable();
    let mut hash = Sha256::new();
    for file in files {
        let content = fs::read(path(root, &file))?;
        hash.update(file.as_bytes());
        hash.update([0]);
        hash.update((content.len() as u64).to_le_bytes());
        hash.update(content);
    }
    let mut digits = String::new();
    for byte in hash.finalize() {
        // Writing to a String does not fail.
        let _ = write!(digits, "{byte:02x}");
    }
    Ok(digits)
}

fn path(root: &Path, name: &str) -> PathBuf {
    name.split('/')
        .fold(root.to_owned(), |path, part| path.join(part))
}

/// The files in a folder and those below it.
fn below(root: &Path, folder: &str, files: &mut Vec<String>) -> io::Result<()> {
    for entry in fs::read_dir(path(root, folder))? {
        let entry = entry?;
        let name = entry.file_name();
        let name = name.to_str().ok_or(io::ErrorKind::InvalidFilename)?;
        let name = format!("{folder}/{name}");
        if entry.file_type()?.is_dir() {
            below(root, &name, files)?;
        } else {
            files.push(name);
        }
    }
    Ok(())
}
