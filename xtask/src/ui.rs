//! The control room: npm's part of the build.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use crate::run::{self, Failure, Outcome};
use crate::tools;

/// Vite 8 needs it.
const OLDEST_NODE: (u32, u32) = (20, 19);

/// Where the control room lives.
pub(crate) fn folder() -> PathBuf {
    run::root().join("host-server/ui")
}

/// Builds `dist/` unless it is newer than everything it is made from.
///
/// # Errors
/// When npm or a new enough Node.js is missing, or the build fails.
pub(crate) fn build() -> Outcome {
    let folder = folder();
    let page = folder.join("dist/index.html");
    if let Some(built) = modified(&page)
        && newest(&folder)? < built
    {
        return Ok(());
    }
    install()?;
    run::run(&folder, "npm", &["run", "--silent", "build"])
}

/// Lints, type-checks and unit-tests the control room, unless it is as it was when it passed.
///
/// # Errors
/// As [`build`].
pub(crate) fn check() -> Outcome {
    let passed = run::target_dir().join("control-room-passed");
    if let Some(when) = modified(&passed)
        && newest(&folder())? < when
    {
        println!("nothing has changed since it passed");
        return Ok(());
    }
    install()?;
    // Otherwise its folder would be new after the beginning.
    run::run(&folder(), "npm", &["run", "--silent", "generate"])?;
    // What is changed meanwhile may have been looked at before.
    let began = SystemTime::now();
    run::run(&folder(), "npm", &["run", "--silent", "check"])?;
    let noted = File::create(&passed).and_then(|note| note.set_modified(began));
    noted.map_err(|error| Failure(format!("cannot write {}: {error}", passed.display())))
}

/// `npm ci`, only when the lock file is newer than what is installed.
fn install() -> Outcome {
    tools::NPM.require()?;
    let version = run::output("node", &["--version"]).unwrap_or_default();
    if parse_version(&version).is_none_or(|version| version < OLDEST_NODE) {
        return Err(Failure(format!(
            "Node.js {}.{} or newer is needed for the control room, found '{version}': see https://nodejs.org/en/download",
            OLDEST_NODE.0, OLDEST_NODE.1
        )));
    }
    let folder = folder();
    let installed = modified(&folder.join("node_modules/.package-lock.json"));
    let locked = modified(&folder.join("package-lock.json"));
    if installed.is_some() && installed >= locked {
        return Ok(());
    }
    run::run(
        &folder,
        "npm",
        &["ci", "--no-audit", "--no-fund", "--loglevel=error"],
    )
}

/// Major and minor number of `v20.19.2`.
fn parse_version(version: &str) -> Option<(u32, u32)> {
    let mut numbers = version.strip_prefix('v')?.split('.');
    Some((numbers.next()?.parse().ok()?, numbers.next()?.parse().ok()?))
}

fn modified(path: &Path) -> Option<SystemTime> {
    fs::metadata(path).ok()?.modified().ok()
}

/// When something below `folder` was last changed, put there or taken away.
fn newest(folder: &Path) -> Outcome<SystemTime> {
    let unreadable =
        |error: std::io::Error| Failure(format!("cannot read {}: {error}", folder.display()));
    let mut newest = SystemTime::UNIX_EPOCH;
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let entry = entry.map_err(unreadable)?;
        let name = entry.file_name();
        // Installed, built, and made from `interface.json`.
        if ["node_modules", "dist", ".generated"]
            .iter()
            .any(|made| name == *made)
        {
            continue;
        }
        // That of a folder tells what went from it.
        let changed = modified(&entry.path());
        newest = newest.max(changed.unwrap_or(SystemTime::UNIX_EPOCH));
        if entry.file_type().map_err(unreadable)?.is_dir() {
            newest = newest.max(self::newest(&entry.path())?);
        }
    }
    Ok(newest)
}

#[cfg(test)]
mod tests {
    use std::fs::{self, File};
    use std::path::Path;
    use std::time::{Duration, SystemTime};

    use super::{OLDEST_NODE, newest, parse_version};
    use crate::{files, run};

    #[test]
    fn a_change_and_a_removal_are_seen() {
        let base = run::target_dir().join(format!("ui-test-{}", std::process::id()));
        files::write(&base.join("src/a.ts"), "one").expect("written");
        files::write(&base.join("src/b.ts"), "two").expect("written");
        files::write(&base.join("dist/c.js"), "three").expect("written");
        let set = |path: &Path, time| File::open(path).and_then(|file| file.set_modified(time));
        let then = SystemTime::UNIX_EPOCH + Duration::from_secs(1_000);
        for path in ["src/a.ts", "src/b.ts", "src"] {
            set(&base.join(path), then).expect("set");
        }
        assert_eq!(newest(&base).expect("read"), then);
        let later = then + Duration::from_secs(1);
        set(&base.join("src/a.ts"), later).expect("set");
        assert_eq!(newest(&base).expect("read"), later);
        fs::remove_file(base.join("src/b.ts")).expect("removed");
        assert!(newest(&base).expect("read") > later);
        files::remove(&base).expect("removed");
    }

    #[test]
    fn node_versions_compare() {
        assert!(parse_version("v20.20.2").is_some_and(|version| version >= OLDEST_NODE));
        assert!(parse_version("v18.19.0").is_some_and(|version| version < OLDEST_NODE));
        assert_eq!(parse_version("nonsense"), None);
        assert_eq!(parse_version(""), None);
    }
}
