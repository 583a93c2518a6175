//! The records, the audit log in them, and who has an account.

use std::path::Path;
use std::time::{Duration, Instant};

use crawler_access::Role;
use crawler_records::{Audit, RECORDS_FILE, Records, RecordsError, User};

use super::Finding;
use crate::config::{EngineUrl, Postgres, Settings};

/// A clock that is this much behind the newest entry went back.
const BACK_MS: i64 = 60_000;
/// A database that takes longer for a list of accounts is felt.
const SLOW: Duration = Duration::from_millis(250);
/// A log of changes this large is not written back any more.
const LONG_LOG: u64 = 256 * 1024 * 1024;

pub(super) async fn look(settings: &Settings) -> Vec<Finding> {
    const WHAT: &str = "records";
    if let Some(url) = &settings.database {
        return database(settings, url).await;
    }
    let file = settings.data.join(RECORDS_FILE);
    if !file.exists() {
        return vec![Finding::warn(
            WHAT,
            format!("{} is not there", file.display()),
            "the first start makes it; if the server has run before, restore a backup",
        )];
    }
    let opened = if settings.timeseries.is_some() {
        Records::open_without_history(&settings.data).await
    } else {
        Records::open(&settings.data).await
    };
    let records = match opened {
        Ok(records) => records,
        Err(error) => return vec![damaged(&error)],
    };
    let mut findings = vec![sizes(&file)];
    findings.extend(inside(&records, settings).await);
    records.close().await;
    findings
}

/// The database, and what is in it.
async fn database(settings: &Settings, url: &EngineUrl<Postgres>) -> Vec<Finding> {
    let records = match Records::connect(url.reveal(), None, false).await {
        Ok(records) => records,
        Err(error) => return vec![judge_database(&url.to_string(), &error)],
    };
    let began = Instant::now();
    let asked = records.users().all().await;
    let took = began.elapsed();
    let mut findings = vec![match asked {
        Ok(_) => judge_latency(&url.to_string(), took),
        Err(error) => judge_database(&url.to_string(), &error),
    }];
    if settings.data.join(RECORDS_FILE).exists() {
        findings.push(Finding::warn(
            "records",
            "there are records in the data directory as well, which are not used",
            "move them with `terracrawler backup` and `restore --database` (docs/operate.md), or remove them",
        ));
    }
    findings.extend(inside(&records, settings).await);
    records.close().await;
    findings
}

fn judge_latency(place: &str, took: Duration) -> Finding {
    const WHAT: &str = "database";
    let found = format!("{place} answers in {} ms", took.as_millis());
    if took > SLOW {
        return Finding::warn(
            WHAT,
            found,
            "every login waits for it: move it nearer, or find out what else it does",
        );
    }
    Finding::ok(WHAT, found)
}

fn judge_database(place: &str, error: &RecordsError) -> Finding {
    const WHAT: &str = "database";
    let advice = match error {
        RecordsError::NotFound => {
            return Finding::warn(
                WHAT,
                format!("{place} answers and is empty"),
                "the first start makes its tables; if the server has run before, name its database",
            );
        }
        RecordsError::Unavailable(_) => {
            "is it running, and can this machine reach it? `pg_isready -h HOST -p PORT` tells"
        }
        RecordsError::Refused(_) => "put right what it says, in the address or in the database",
        RecordsError::Foreign(_) => "make a database for the server alone, and name that",
        RecordsError::Newer { .. } => {
            "start the newer program again, or restore a backup of this one"
        }
        RecordsError::InUse(_) => "a restore is under way: wait for its end",
        _ => {
            "stop the servers, `pg_dump` the database, then `terracrawler restore --replace BACKUP --database URL`"
        }
    };
    Finding::fail(WHAT, error.to_string(), advice)
}

async fn inside(records: &Records, settings: &Settings) -> Vec<Finding> {
    let mut findings = vec![audit(records.audit()).await];
    findings.extend(newest(records.audit()).await);
    match records.users().all().await {
        Ok(users) => findings.push(judge_users(settings.open, &users)),
        Err(error) => findings.push(damaged(&error)),
    }
    match records.credentials().all().await {
        Ok(credentials) => {
            let valid = credentials
                .iter()
                .filter(|credential| credential.revoked.is_none())
                .count();
            findings.push(Finding::ok(
                "robots",
                format!(
                    "{valid} valid credentials, {} revoked",
                    credentials.len() - valid
                ),
            ));
        }
        Err(error) => findings.push(damaged(&error)),
    }
    findings
}

fn damaged(error: &RecordsError) -> Finding {
    let advice = match error {
        RecordsError::Newer { .. } => {
            "start the newer program again, or restore a backup of this one"
        }
        RecordsError::InUse(_) => "a restore is under way: wait for its end",
        _ => {
            "stop the server, copy the data directory, then `terracrawler restore --replace BACKUP`"
        }
    };
    Finding::fail("records", error.to_string(), advice)
}

/// The records opened, so the database has found itself whole.
fn sizes(file: &Path) -> Finding {
    let size = |path: &Path| std::fs::metadata(path).map_or(0, |metadata| metadata.len());
    let mut log = file.as_os_str().to_owned();
    log.push("-wal");
    judge_sizes(size(file), size(Path::new(&log)))
}

fn judge_sizes(records: u64, log: u64) -> Finding {
    const WHAT: &str = "records";
    let found = format!("whole, {} KiB", records.div_ceil(1024));
    if log > LONG_LOG {
        return Finding::warn(
            WHAT,
            format!("{found}, and {} MiB not written back", log / 1024 / 1024),
            "something holds the file open for long: look for an old console or backup and end it",
        );
    }
    Finding::ok(WHAT, found)
}

async fn audit(log: Audit<'_>) -> Finding {
    const WHAT: &str = "audit log";
    match log.verify().await {
        Ok(entries) => {
            let found = match log.lost().await {
                Ok(lost) if lost > 0 => {
                    format!("{entries} entries, the chain is whole; {lost} were lost (`audit.gap`)")
                }
                _ => format!("{entries} entries, the chain is whole"),
            };
            Finding::ok(WHAT, found)
        }
        Err(broken) => Finding::fail(
            WHAT,
            format!("changed after it was written: {broken}"),
            "keep the data directory as it is, and compare with a backup (docs/operate.md)",
        ),
    }
}

/// Whether the newest entry is from the future.
async fn newest(log: Audit<'_>) -> Option<Finding> {
    let entries = log.page(None, 1, None).await.ok()?;
    judge_newest(entries.first()?.entry.at, crawler_system::clock::now_ms())
}

fn judge_newest(newest: i64, now: i64) -> Option<Finding> {
    (newest.saturating_sub(now) > BACK_MS).then(|| {
        Finding::fail(
            "clock",
            format!(
                "it is behind the newest entry of the audit log, of {}",
                crate::calendar::moment(newest)
            ),
            "the clock went back: set it right, or sessions and certificates do not work",
        )
    })
}

fn judge_users(open: bool, users: &[User]) -> Finding {
    const WHAT: &str = "accounts";
    let admins = users
        .iter()
        .filter(|user| user.role == Role::Admin && !user.disabled && user.password.is_some())
        .count();
    let found = format!("{} accounts, {admins} of them can administer", users.len());
    match admins {
        0 if !open => Finding::warn(
            WHAT,
            found,
            "open the link that the server prints when it starts, or `terracrawler user add NAME --role admin`",
        ),
        1 => Finding::ok(
            WHAT,
            format!("{found}; a second one helps when a password is lost"),
        ),
        _ => Finding::ok(WHAT, found),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Grade;
    use super::*;

    fn user(name: &str, role: Role, password: bool, disabled: bool) -> User {
        User {
            name: name.parse().expect("name"),
            role,
            password: password.then(|| "hash".into()),
            created: 0,
            disabled,
        }
    }

    #[test]
    fn somebody_must_be_able_to_administer() {
        let nobody = [
            user("ada", Role::Operator, true, false),
            user("bob", Role::Admin, false, false),
            user("eve", Role::Admin, true, true),
        ];
        assert_eq!(judge_users(false, &nobody).grade, Grade::Warn);
        assert_eq!(judge_users(false, &[]).grade, Grade::Warn);
        assert_eq!(judge_users(true, &[]).grade, Grade::Ok);
        let one = [user("ada", Role::Admin, true, false)];
        assert_eq!(judge_users(false, &one).grade, Grade::Ok);
    }

    #[test]
    fn a_database_that_does_not_work_says_what_to_do() {
        let place = "postgres://db:5432/fleet";
        let failed = [
            RecordsError::Unavailable("no answer within 5 s".into()),
            RecordsError::Refused("the database lets `ada` not in".into()),
            RecordsError::Foreign(place.into()),
        ];
        for error in failed {
            let finding = judge_database(place, &error);
            assert_eq!(finding.grade, Grade::Fail, "{error}");
            assert!(finding.advice.is_some(), "{error}");
        }
        assert_eq!(
            judge_database(place, &RecordsError::NotFound).grade,
            Grade::Warn
        );
        assert_eq!(
            judge_latency(place, Duration::from_millis(3)).grade,
            Grade::Ok
        );
        assert_eq!(
            judge_latency(place, Duration::from_secs(1)).grade,
            Grade::Warn
        );
    }

    #[test]
    fn a_clock_that_went_back_is_found() {
        assert_eq!(judge_newest(1_000_000, 1_000_000), None);
        assert_eq!(judge_newest(1_000_000, 990_000), None);
        let finding = judge_newest(1_000_000_000, 1_000).expect("found");
        assert_eq!(finding.grade, Grade::Fail);
        assert!(judge_newest(i64::MAX, i64::MIN).is_some());
    }

    #[test]
    fn a_log_that_only_grows_is_found() {
        assert_eq!(judge_sizes(1024, 4096).grade, Grade::Ok);
        assert_eq!(judge_sizes(1024, 1 << 30).grade, Grade::Warn);
    }
}
