//! Copies of source trees, changed on the way.

use std::fs;
use std::path::Path;

use crate::run::{Failure, Outcome};

/// Folders that are no sources.
const SKIPPED: [&str; 2] = ["target", ".git"];

/// Adds the path to an error of the file system.
fn at<T>(path: &Path, result: std::io::Result<T>) -> Outcome<T> {
    result.map_err(|error| Failure(format!("{}: {error}", path.display())))
}

/// Removes a folder and everything in it; nothing when it is not there.
///
/// # Errors
/// Names the folder that cannot be removed.
pub(crate) fn remove(folder: &Path) -> Outcome {
    if folder.exists() {
        at(folder, fs::remove_dir_all(folder))?;
    }
    Ok(())
}

/// Writes a file, and its folder where that is missing.
///
/// # Errors
/// Names the file and why it cannot be written.
pub(crate) fn write(path: &Path, text: &str) -> Outcome {
    if let Some(folder) = path.parent() {
        at(folder, fs::create_dir_all(folder))?;
    }
    at(path, fs::write(path, text))
}

/// Changes a text file in place.
///
/// # Errors
/// When it cannot be read or written, or the change refuses it.
pub(crate) fn edit(path: &Path, change: fn(&str) -> Outcome<String>) -> Outcome {
    let text = at(path, fs::read_to_string(path))?;
    let changed = change(&text)
        .map_err(|Failure(reason)| Failure(format!("{}: {reason}", path.display())))?;
    write(path, &changed)
}

/// Copies a folder; `change` sees every Rust source and manifest.
///
/// # Errors
/// Names what cannot be read or written.
pub(crate) fn copy(
    from: &Path,
    to: &Path,
    change: &mut dyn FnMut(&Path, String) -> String,
) -> Outcome {
    at(to, fs::create_dir_all(to))?;
    for entry in at(from, fs::read_dir(from))? {
        let path = at(from, entry)?.path();
        let name = path.file_name().unwrap_or_default();
        let target = to.join(name);
        if path.is_dir() {
            if !SKIPPED.iter().any(|skipped| name == *skipped) {
                copy(&path, &target, change)?;
            }
        } else if is_text(&path) {
            let text = at(&path, fs::read_to_string(&path))?;
            let changed = change(&path, text);
            // A file that did not change keeps its time, and cargo what it made of it.
            if fs::read_to_string(&target).ok().as_ref() != Some(&changed) {
                at(&target, fs::write(&target, changed))?;
            }
        } else if fs::read(&path).ok() != fs::read(&target).ok() || !target.exists() {
            at(&path, fs::copy(&path, &target).map(|_| ()))?;
        }
    }
    Ok(())
}

/// As [`copy`], and removes from `to` what is no longer in `from`.
///
/// # Errors
/// As [`copy`].
pub(crate) fn mirror(from: &Path, to: &Path, change: &dyn Fn(&Path, String) -> String) -> Outcome {
    copy(from, to, &mut |path, text| change(path, text))?;
    prune(from, to)
}

fn prune(from: &Path, to: &Path) -> Outcome {
    for entry in at(to, fs::read_dir(to))? {
        let path = at(to, entry)?.path();
        let original = from.join(path.file_name().unwrap_or_default());
        if path.is_dir() {
            if original.is_dir() {
                prune(&original, &path)?;
            } else {
                remove(&path)?;
            }
        } else if !original.is_file() {
            at(&path, fs::remove_file(&path))?;
        }
    }
    Ok(())
}

fn is_text(path: &Path) -> bool {
    path.extension()
        .is_some_and(|ending| ending == "rs" || ending == "toml")
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::{copy, mirror, remove, write};
    use crate::run;

    #[test]
    fn a_mirror_follows_its_original() {
        let base = run::target_dir().join(format!("files-test-{}", std::process::id()));
        let (from, to) = (base.join("from"), base.join("to"));
        write(&from.join("src/a.rs"), "one").expect("written");
        write(&from.join("b.bin"), "two").expect("written");
        write(&from.join("target/c.rs"), "three").expect("written");
        mirror(&from, &to, &|_, text| text + "!").expect("mirrored");
        assert_eq!(fs::read_to_string(to.join("src/a.rs")).expect("a"), "one!");
        assert_eq!(fs::read_to_string(to.join("b.bin")).expect("b"), "two");
        assert!(!to.join("target").exists());

        let written = |path: &str| fs::metadata(to.join(path)).and_then(|file| file.modified());
        let before = written("src/a.rs").expect("time");
        fs::remove_file(from.join("b.bin")).expect("removed");
        mirror(&from, &to, &|_, text| text + "!").expect("mirrored again");
        assert_eq!(written("src/a.rs").expect("time"), before);
        assert!(!to.join("b.bin").exists());
        assert!(copy(&base.join("nowhere"), &to, &mut |_, text| text).is_err());
        remove(&base).expect("removed");
        assert!(!base.exists());
    }
}
