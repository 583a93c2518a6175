//! The data directory, the disk below it, and the clock.

use std::fs::{self, File, TryLockError};
use std::io;
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _};
use std::path::Path;
use std::time::Duration;

use super::Finding;
use crate::config::Settings;

/// Below this the database may fail at any moment.
const FULL: u64 = 100_000_000;
/// Below this it is time to act.
const FILLING: u64 = 1_000_000_000;
/// One file for each robot and browser.
const FILES: u64 = 4_096;
/// For the program that knows about the clock.
const PATIENCE: Duration = Duration::from_secs(3);
/// 2026-01-01, before this program was written.
const LONG_AGO: u64 = 1_767_225_600;

pub(super) async fn look(settings: &Settings) -> Vec<Finding> {
    let data = &settings.data;
    let mut findings = vec![directory(data)];
    if data.is_dir() {
        findings.push(rights(data));
        findings.push(disk(data));
    }
    findings.push(files());
    findings.push(clock().await);
    findings
}

/// Whether a server holds the directory.
pub(super) fn is_running(data: &Path) -> bool {
    let lock = File::options().write(true).open(data.join("lock"));
    lock.is_ok_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock)))
}

fn directory(data: &Path) -> Finding {
    const WHAT: &str = "data directory";
    let shown = data.display();
    let metadata = match fs::metadata(data) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Finding::warn(
                WHAT,
                format!("{shown} is not there"),
                "the first start makes it; if the server has run before, name its directory with --data",
            );
        }
        Err(error) => {
            return Finding::fail(
                WHAT,
                format!("{shown}: {error}"),
                "run this as the account of the server",
            );
        }
    };
    if !metadata.is_dir() {
        return Finding::fail(
            WHAT,
            format!("{shown} is not a directory"),
            "name a directory with --data",
        );
    }
    if let Err(error) = crate::console::check_owner(data) {
        let found = format!("of user {}", metadata.uid());
        return Finding::fail(WHAT, found, error.to_string());
    }
    let probe = data.join(format!(".probe-{}", std::process::id()));
    let written = fs::write(&probe, "x").and_then(|()| fs::remove_file(&probe));
    match written {
        Ok(()) if is_running(data) => {
            Finding::ok(WHAT, format!("{shown}, a server is running on it"))
        }
        Ok(()) => Finding::ok(WHAT, format!("{shown}, no server is running on it")),
        Err(error) => Finding::fail(
            WHAT,
            format!("{shown} cannot be written: {error}"),
            "free space, or make it writable for the account of the server",
        ),
    }
}

/// Keys and hashes are nobody else's to read.
fn rights(data: &Path) -> Finding {
    const WHAT: &str = "rights";
    match most_open(data) {
        Ok(None) => Finding::ok(WHAT, "nobody else reads the data directory"),
        Ok(Some(mode)) => Finding::warn(
            WHAT,
            format!("other accounts can look into the data directory (mode {mode:o})"),
            format!("chmod 700 {}", data.display()),
        ),
        Err(error) => Finding::fail(
            WHAT,
            format!("cannot be read: {error}"),
            "run this as the account of the server",
        ),
    }
}

/// The mode of the directory when others get in.
fn most_open(data: &Path) -> io::Result<Option<u32>> {
    let mode = fs::metadata(data)?.permissions().mode() & 0o777;
    Ok((mode & 0o077 != 0).then_some(mode))
}

fn disk(data: &Path) -> Finding {
    match rustix::fs::statvfs(data) {
        Ok(found) => judge_disk(
            found.f_bavail.saturating_mul(found.f_frsize),
            // Some file systems have no such limit and say 0 of 0.
            (found.f_files > 0).then_some(found.f_favail),
        ),
        Err(error) => Finding::warn(
            "disk",
            format!("cannot tell how much is free: {error}"),
            "look with df",
        ),
    }
}

fn judge_disk(free: u64, files: Option<u64>) -> Finding {
    const WHAT: &str = "disk";
    const ADVICE: &str =
        "free space; \"The disk is full\" in docs/operate.md says what may go and what not";
    let found = format!("{} MB free", free / 1_000_000);
    if files.is_some_and(|files| files < 100) {
        return Finding::fail(WHAT, "no room for more files", ADVICE);
    }
    if free < FULL {
        Finding::fail(WHAT, found, ADVICE)
    } else if free < FILLING {
        Finding::warn(WHAT, found, ADVICE)
    } else {
        Finding::ok(WHAT, found)
    }
}

fn files() -> Finding {
    const WHAT: &str = "open files";
    match rlimit::Resource::NOFILE.get_hard() {
        Ok(limit) if limit < FILES => Finding::warn(
            WHAT,
            format!(
                "at most {limit}: enough for about {} robots and browsers",
                limit / 2
            ),
            "raise it: LimitNOFILE= of the unit, or ulimit -n",
        ),
        Ok(limit) => Finding::ok(WHAT, format!("up to {limit}")),
        Err(error) => Finding::warn(WHAT, format!("cannot tell: {error}"), "look with ulimit -n"),
    }
}

/// Whether somebody sets the clock, as far as this machine can tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Synchronised {
    Yes,
    No,
    Unknown,
}

async fn clock() -> Finding {
    let asked = tokio::task::spawn_blocking(|| {
        std::process::Command::new("timedatectl")
            .args(["show", "--property=NTPSynchronized", "--value"])
            .stdin(std::process::Stdio::null())
            .output()
    });
    let synchronised = match tokio::time::timeout(PATIENCE, asked).await {
        Ok(Ok(Ok(output))) if output.status.success() => {
            match String::from_utf8_lossy(&output.stdout).trim() {
                "yes" => Synchronised::Yes,
                "no" => Synchronised::No,
                _ => Synchronised::Unknown,
            }
        }
        _ => Synchronised::Unknown,
    };
    judge_clock(crawler_system::clock::unix_ms() / 1_000, synchronised)
}

fn judge_clock(now: u64, synchronised: Synchronised) -> Finding {
    const WHAT: &str = "clock";
    let shown =
        crate::calendar::moment(i64::try_from(now).unwrap_or(i64::MAX).saturating_mul(1_000));
    if now < LONG_AGO {
        return Finding::fail(
            WHAT,
            format!("it says {shown}, which is past"),
            "set it: certificates, sessions and commands of robots depend on it",
        );
    }
    match synchronised {
        Synchronised::Yes => Finding::ok(WHAT, format!("{shown}, kept right by the network")),
        Synchronised::No => Finding::warn(
            WHAT,
            format!("{shown}, and nobody keeps it right"),
            "timedatectl set-ntp true, or another NTP client",
        ),
        Synchronised::Unknown => Finding::warn(
            WHAT,
            format!("{shown}; whether anybody keeps it right cannot be told here"),
            "compare it with another clock; in a container the host keeps it",
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Grade;
    use super::*;

    #[test]
    fn disks_are_judged() {
        for (free, files, grade) in [
            (50_000_000, Some(10_000), Grade::Fail),
            (500_000_000, Some(10_000), Grade::Warn),
            (5_000_000_000, Some(10_000), Grade::Ok),
            (5_000_000_000, None, Grade::Ok),
            (5_000_000_000, Some(3), Grade::Fail),
            (0, None, Grade::Fail),
            (u64::MAX, Some(u64::MAX), Grade::Ok),
        ] {
            assert_eq!(judge_disk(free, files).grade, grade, "{free} {files:?}");
        }
    }

    #[test]
    fn clocks_are_judged() {
        for (now, synchronised, grade) in [
            (0, Synchronised::Yes, Grade::Fail),
            (1_800_000_000, Synchronised::Yes, Grade::Ok),
            (1_800_000_000, Synchronised::No, Grade::Warn),
            (1_800_000_000, Synchronised::Unknown, Grade::Warn),
        ] {
            let finding = judge_clock(now, synchronised);
            assert_eq!(finding.grade, grade, "{finding:?}");
        }
    }
}
