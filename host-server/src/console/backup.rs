//! Backups: everything of the data directory that a server cannot make again, in one file.
//!
//! The file is a tar archive, the same wherever the records are: those of a database are in it as the
//! file that a server without one has, and so a backup is also the way from one to the other.
//!
//! Records are copied by the database itself, so a running server may go
//! on writing; small files beside them (numbers, keys and certificates) are replaced whole by whoever
//! writes them, so each is copied whole.

mod checksums;

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Component, Path, PathBuf};

use crawler_history::HISTORY_FILE;
use crawler_records::{RECORDS_FILE, RecordsError};
use serde_json::json;

use super::Console;
use crate::addresses::ADDRESSES_FILE;
use crate::config::Settings;
use checksums::{CHECKSUMS, Checksums, Hashing, append};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::now_ms;
use crawler_system::data::{self, DataDir};

/// What of the data directory itself is not copied as a file: locks and addresses belong to processes, and databases
/// are copied by themselves. Names within its folders may be those of robots.
fn is_skipped(name: &str) -> bool {
    is_lock(name)
        || name.contains(".sqlite")
        || name.starts_with(ASIDE)
        || name.starts_with(MAKING)
        || name == ADDRESSES_FILE
        || name == CHECKSUMS
}

fn is_lock(name: &str) -> bool {
    name == "lock" || has_ending(name, "lock")
}

fn has_ending(name: &str, ending: &str) -> bool {
    Path::new(name).extension().is_some_and(|has| has == ending)
}

fn is_database(name: &Path) -> bool {
    DATABASES.iter().any(|database| name == Path::new(database))
}

/// Directories with this beginning hold what a restore put aside.
const ASIDE: &str = "before-restore-";
/// And this one what is being made.
const MAKING: &str = ".making-";
/// More than any key, certificate or number. What is larger is not ours.
const LARGEST: u64 = 1024 * 1024;
/// Files beside the records: a handful, and the certificate of every robot.
const MOST: usize = 25_000;
/// Directories within directories.
const DEEPEST: usize = 4;
/// What the database copies.
const DATABASES: [&str; 2] = [RECORDS_FILE, HISTORY_FILE];
/// A database larger than this is not of a fleet that fits on one machine.
const LARGEST_DATABASE: u64 = 64 * 1024 * 1024 * 1024;

/// Makes a backup in `file`, which must not exist.
pub(super) async fn backup(file: &Path, settings: &Settings) -> Result<(), CliError> {
    let data = &settings.data;
    let console = Console::open_all(settings).await?;
    let cannot = |error: &io::Error| format!("cannot write {}: {error}", file.display());
    let out = File::options()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(file)
        .or_say(cannot)?;
    let made = write(&console, data, file, out).await;
    if let Err(error) = made {
        // Half a backup must not pass for one.
        let _ = fs::remove_file(file);
        console.close().await;
        return Err(error);
    }
    console
        .note("backup", &file.display().to_string(), json!({}), "ok")
        .await?;
    console.close().await;
    let size = fs::metadata(file).map_or(0, |metadata| metadata.len());
    println!(
        "{} holds the records, history, keys and certificates of this server ({} KiB). It lets its reader be this \
         server: keep it where the data directory would be safe.",
        file.display(),
        size.div_ceil(1024)
    );
    Ok(())
}

async fn write(console: &Console, data: &Path, file: &Path, out: File) -> Result<(), CliError> {
    let cannot = |error: &io::Error| format!("cannot write {}: {error}", file.display());
    // Beside the backup rather than in the data directory: there is room for it there.
    let mut copy = file.as_os_str().to_owned();
    copy.push(".records");
    let copy = Emptied(PathBuf::from(copy));
    data::make_private(&copy.0).or_say(cannot)?;
    crawler_records::backup::create(&console.records, &copy.0).await?;
    let mut tar = tar::Builder::new(out);
    let mut sums = Checksums::default();
    for name in DATABASES {
        let name = Path::new(name);
        append(&mut tar, &mut sums, &copy.0.join(name), name).or_say(cannot)?;
    }
    let mut files = Vec::new();
    collect(data, Path::new(""), (DEEPEST, MOST), &mut files)
        .or_say(|error| format!("cannot read {}: {error}", data.display()))?;
    for name in files {
        append(&mut tar, &mut sums, &data.join(&name), &name).or_say(cannot)?;
    }
    let text = sums.to_text();
    let mut header = tar::Header::new_gnu();
    header.set_mode(0o644);
    header.set_size(text.len() as u64);
    tar.append_data(&mut header, CHECKSUMS, text.as_bytes())
        .or_say(cannot)?;
    let out = tar.into_inner().or_say(cannot)?;
    out.sync_all().or_say(cannot)
}

/// The files beside the records, by their names below `data`, at most `most` and in folders of this `depth`.
fn collect(
    data: &Path,
    below: &Path,
    (depth, most): (usize, usize),
    files: &mut Vec<PathBuf>,
) -> io::Result<()> {
    for entry in fs::read_dir(data.join(below))? {
        let entry = entry?;
        let (Some(name), kind) = (
            entry.file_name().to_str().map(str::to_owned),
            entry.file_type()?,
        ) else {
            continue;
        };
        // Of a file that is being replaced the one before is there as well.
        if has_ending(&name, "new") || (below == Path::new("") && is_skipped(&name)) {
            continue;
        }
        let path = below.join(&name);
        if kind.is_dir() && depth > 0 {
            collect(data, &path, (depth - 1, most), files)?;
        } else if kind.is_file() && entry.metadata()?.len() <= LARGEST {
            // A backup without some of them must not pass for one.
            if files.len() >= most {
                return Err(io::Error::other(format!(
                    "there are more than {most} files"
                )));
            }
            files.push(path);
        }
    }
    Ok(())
}

/// Puts the contents of a backup where the data directory is.
pub(super) async fn restore(
    file: &Path,
    replace: bool,
    settings: &Settings,
) -> Result<(), CliError> {
    let target = &settings.data;
    if target.exists() {
        super::check_owner(target)?;
    } else {
        data::make_private(target)
            .or_say(|error| format!("cannot make {}: {error}", target.display()))?;
    }
    // Held to the end: no server starts meanwhile, and none runs.
    let held = DataDir::open(target).or_say(|error| format!("{error}; stop it first"))?;
    let making = Emptied(target.join(format!("{MAKING}{}", std::process::id())));
    fs::DirBuilder::new()
        .mode(0o700)
        .create(&making.0)
        .or_say(|error| format!("cannot make {}: {error}", making.0.display()))?;
    let names = unpack(file, &making.0)?;
    // Checked before anything is put aside.
    let ready = making.0.join("checked");
    crawler_records::backup::restore(&making.0, &ready)
        .await
        .or_say(|error| format!("{}: {error}", file.display()))?;

    let there = held_files(target)?;
    if !there.is_empty() && !replace {
        return Err(CliError::new(format!(
            "{} holds a server's data already; --replace puts it aside first",
            target.display()
        )));
    }
    let aside = target.join(format!("{ASIDE}{}", now_ms()));
    let cannot_aside = |error: &io::Error| format!("cannot put the old data aside: {error}");
    if replace {
        fs::DirBuilder::new()
            .mode(0o700)
            .create(&aside)
            .or_say(cannot_aside)?;
    }
    if let Some(url) = &settings.database {
        // All or nothing, and before anything is put aside here.
        let loaded = crawler_records::backup::restore_database(
            &ready,
            url.reveal(),
            replace.then_some(aside.as_path()),
        );
        if let Err(error) = loaded.await {
            // Empty, or with a copy of what is still there.
            let _ = fs::remove_dir_all(&aside);
            return Err(match error {
                RecordsError::Exists => CliError::new(format!(
                    "{url} holds a server's records already; --replace puts them aside first"
                )),
                error => error.into(),
            });
        }
        fs::remove_file(ready.join(RECORDS_FILE))
            .or_say(|error| format!("cannot write to {}: {error}", target.display()))?;
    }
    there
        .iter()
        .try_for_each(|name| fs::rename(target.join(name), aside.join(name)))
        .or_say(cannot_aside)?;
    // It goes away if there was nothing to put into it.
    if replace && fs::remove_dir(&aside).is_err() {
        println!("What was there lies in {} now.", aside.display());
    }
    let cannot = |error: &io::Error| format!("cannot write to {}: {error}", target.display());
    for name in names.iter().filter(|name| !is_database(name)) {
        if let Some(parent) = name.parent() {
            data::make_private(&target.join(parent)).or_say(cannot)?;
        }
        fs::rename(making.0.join(name), target.join(name)).or_say(cannot)?;
    }
    for name in DATABASES {
        let made = ready.join(name);
        if made.exists() {
            fs::rename(made, target.join(name)).or_say(cannot)?;
        }
    }
    drop(making);
    drop(held);
    settle(settings, file).await
}

/// Opens what was restored, and says what a person has to put right after time went back.
async fn settle(settings: &Settings, file: &Path) -> Result<(), CliError> {
    let console = Console::open(settings, false).await?;
    console
        .note("restore", &file.display().to_string(), json!({}), "ok")
        .await?;
    console.close().await;
    println!(
        "Restored. Everybody has to log in again. What was revoked, locked or changed since the backup \
         is as it was then: look through `terracrawler robot list` and `terracrawler user list` before \
         you start the server."
    );
    Ok(())
}

/// What a server has left in `target`, apart from locks and what restores left.
fn held_files(target: &Path) -> Result<Vec<String>, CliError> {
    let entries = fs::read_dir(target)
        .and_then(Iterator::collect::<io::Result<Vec<_>>>)
        .or_say(|error| format!("cannot read {}: {error}", target.display()))?;
    Ok(entries
        .iter()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| !name.starts_with(ASIDE) && !name.starts_with(MAKING) && !is_lock(name))
        .collect())
}

/// Unpacks the archive into an empty directory, and nothing beside it. Returns the names.
fn unpack(file: &Path, into: &Path) -> Result<Vec<PathBuf>, CliError> {
    let broken = |error: &dyn std::fmt::Display| {
        format!(
            "{} is not a backup of this program: {error}",
            file.display()
        )
    };
    let archive =
        File::open(file).or_say(|error| format!("cannot read {}: {error}", file.display()))?;
    let mut archive = tar::Archive::new(archive);
    let mut names = Vec::new();
    let mut sums = Checksums::default();
    for entry in archive.entries().or_say(|error| broken(error))? {
        let mut entry = entry.or_say(|error| broken(error))?;
        let name = entry.path().or_say(|error| broken(error))?.into_owned();
        let plain = name
            .components()
            .all(|part| matches!(part, Component::Normal(_)));
        if !plain || !entry.header().entry_type().is_file() {
            let text = format!("`{}` has no place in one", name.display());
            return Err(CliError::new(broken(&text)));
        }
        let largest = if is_database(&name) {
            LARGEST_DATABASE
        } else {
            LARGEST
        };
        if entry.size() > largest || names.len() > MOST + DATABASES.len() {
            let text = format!("`{}` is too large", name.display());
            return Err(CliError::new(broken(&text)));
        }
        let path = into.join(&name);
        let mut content = Hashing::new(entry.by_ref().take(largest));
        let written = path
            .parent()
            .map_or(Ok(()), data::make_private)
            .and_then(|()| {
                File::options()
                    .write(true)
                    .create_new(true)
                    .mode(0o600)
                    .open(&path)
            })
            .and_then(|mut out| {
                io::copy(&mut content, &mut out)?;
                out.sync_all()
            });
        written.or_say(|error| broken(error))?;
        if name != Path::new(CHECKSUMS) {
            sums.add(&name, content);
            names.push(name);
        }
    }
    if !names.iter().any(|name| name == Path::new(RECORDS_FILE)) {
        return Err(CliError::new(broken(&"it holds no records")));
    }
    match fs::read_to_string(into.join(CHECKSUMS)) {
        Ok(text) => sums
            .check(&text)
            .map_err(|error| CliError::new(broken(&error)))?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => eprintln!(
            "{} has no checksums, as backups of earlier versions: whether it is whole cannot be told.",
            file.display()
        ),
        Err(error) => return Err(error).or_say(|error| broken(error)),
    }
    Ok(names)
}

/// A directory that goes away with the value.
struct Emptied(PathBuf);

impl Drop for Emptied {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> Emptied {
        let path =
            std::env::temp_dir().join(format!("crawler-backup-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("directory");
        Emptied(path)
    }

    fn archive(scratch: &Emptied, entries: &[(&str, tar::EntryType)]) -> PathBuf {
        let path = scratch.0.join("archive");
        let mut tar = tar::Builder::new(File::create(&path).expect("file"));
        for (name, kind) in entries {
            let mut header = tar::Header::new_ustar();
            // Written by hand: the library refuses to make names that a stranger could send.
            header.as_old_mut().name[..name.len()].copy_from_slice(name.as_bytes());
            header.set_entry_type(*kind);
            header.set_size(2);
            header.set_mode(0o4777);
            header.set_cksum();
            tar.append(&header, &b"hi"[..]).expect("entry");
        }
        tar.finish().expect("end");
        path
    }

    #[test]
    fn no_archive_writes_outside() {
        use tar::EntryType as Kind;
        for (number, bad) in [
            vec![("../outside", Kind::Regular)],
            vec![("/tmp/crawler-outside", Kind::Regular)],
            vec![("tls/../../outside", Kind::Regular)],
            vec![("link", Kind::Symlink)],
            vec![("link", Kind::Link)],
            vec![("device", Kind::Char)],
            vec![("folder", Kind::Directory)],
            vec![(RECORDS_FILE, Kind::Regular), (RECORDS_FILE, Kind::Regular)],
            vec![("seq", Kind::Regular)],
            vec![],
        ]
        .iter()
        .enumerate()
        {
            let scratch = scratch(&format!("bad-{number}"));
            let path = archive(&scratch, bad);
            let into = scratch.0.join("into");
            fs::create_dir(&into).expect("directory");
            let error = unpack(&path, &into).expect_err("refused");
            let told = error.to_string();
            assert!(told.contains("not a backup"), "{bad:?}: {told}");
            assert!(!scratch.0.join("outside").exists(), "{bad:?}");
        }
    }

    #[test]
    fn what_it_unpacks_is_private() {
        use std::os::unix::fs::PermissionsExt as _;
        let scratch = scratch("private");
        let path = archive(
            &scratch,
            &[
                (RECORDS_FILE, tar::EntryType::Regular),
                ("tls/ca.key", tar::EntryType::Regular),
            ],
        );
        let into = scratch.0.join("into");
        fs::create_dir(&into).expect("directory");
        unpack(&path, &into).expect("a backup");
        let mode = |name: &str| {
            let metadata = fs::metadata(into.join(name)).expect("there");
            metadata.permissions().mode() & 0o7777
        };
        assert_eq!(mode("tls/ca.key"), 0o600);
        assert_eq!(mode("tls"), 0o700);
    }

    #[test]
    fn locks_databases_and_leftovers_stay_out() {
        let scratch = scratch("collect");
        for name in [
            "seq",
            "lock",
            "records.sqlite",
            "records.sqlite-wal",
            "records.lock",
            "seq.new",
        ] {
            fs::write(scratch.0.join(name), "1").expect("file");
        }
        fs::create_dir_all(scratch.0.join("tls")).expect("directory");
        fs::write(scratch.0.join("tls/ca.key"), "key").expect("file");
        fs::write(scratch.0.join("tls/ca.key.new"), "key").expect("file");
        // Robots may be called like a lock.
        fs::create_dir_all(scratch.0.join("twins")).expect("directory");
        fs::write(scratch.0.join("twins/block-1.json"), "{}").expect("file");
        fs::create_dir_all(scratch.0.join("before-restore-1")).expect("directory");
        fs::write(scratch.0.join("before-restore-1/seq"), "1").expect("file");
        std::os::unix::fs::symlink("/etc/passwd", scratch.0.join("link")).expect("link");
        let mut files = Vec::new();
        let all = ["seq", "tls/ca.key", "twins/block-1.json"].map(Path::new);
        collect(&scratch.0, Path::new(""), (DEEPEST, all.len()), &mut files).expect("read");
        files.sort();
        assert_eq!(files, all);
        // Fewer are none.
        let fewer = (DEEPEST, all.len() - 1);
        let error = collect(&scratch.0, Path::new(""), fewer, &mut Vec::new()).unwrap_err();
        assert!(error.to_string().contains("more than 2 files"), "{error}");
    }
}
