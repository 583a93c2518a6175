//! Files that are damaged, foreign, newer or in use are refused with a reason, and left as they are;
//! backups come back.

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::{Folder, digest, entry, memory, now, open, robot, sample, user};
use crawler_access::Role;
use crawler_history::HISTORY_FILE;
use crawler_records::{RECORDS_FILE, Records, RecordsError, Refreshed, backup};
use sqlx::Connection as _;
use sqlx::sqlite::{SqliteConnectOptions, SqliteConnection};

async fn execute(file: &Path, sql: &'static str) {
    let options = SqliteConnectOptions::new()
        .filename(file)
        .create_if_missing(true);
    let mut connection = SqliteConnection::connect_with(&options).await.unwrap();
    sqlx::raw_sql(sql).execute(&mut connection).await.unwrap();
    connection.close().await.unwrap();
}

/// Records with something in them.
async fn filled(folder: &Folder) -> Records {
    let records = open(folder).await;
    records
        .users()
        .add(&user("ada", Role::Admin))
        .await
        .unwrap();
    records
        .settings()
        .set("big", &vec![5; 60_000])
        .await
        .unwrap();
    for n in 0..20 {
        records.audit().append(entry(n)).await.unwrap();
    }
    let at = now() - 60_000;
    for n in 0..500 {
        let sample = sample(&robot(n as usize % 5), n, at + n);
        records.history().push(sample).unwrap();
    }
    records.history().settle().await.unwrap();
    records
}

/// A closed directory with something in it, and its two files.
async fn closed() -> (Folder, PathBuf, PathBuf) {
    let folder = Folder::new();
    filled(&folder).await.close().await;
    let file = folder.path().join(RECORDS_FILE);
    let history = folder.path().join(HISTORY_FILE);
    (folder, file, history)
}

#[tokio::test]
async fn a_damaged_file_is_refused_and_left_as_it_is() {
    for damage in ["garbage", "cut", "pages", "emptied"] {
        let (folder, file, _) = closed().await;
        let mut bytes = fs::read(&file).unwrap();
        match damage {
            "garbage" => bytes = b"this is no database".repeat(1_000),
            "cut" => bytes.truncate(bytes.len() / 2),
            "emptied" => bytes.clear(),
            _ => {
                let begin = 2 * 4_096;
                bytes[begin..].iter_mut().for_each(|byte| *byte ^= 0x5a);
            }
        }
        fs::write(&file, &bytes).unwrap();
        let error = Records::open(folder.path()).await.expect_err(damage);
        assert!(
            matches!(error, RecordsError::Damaged { .. }),
            "{damage}: {error:?}"
        );
        assert!(error.to_string().contains("restore a backup"), "{error}");
        assert_eq!(fs::read(&file).unwrap(), bytes, "{damage}");
    }
}

#[tokio::test]
async fn files_of_newer_or_other_programs_are_refused() {
    let (folder, file, history) = closed().await;
    execute(&history, "PRAGMA user_version = 999").await;
    let error = Records::open(folder.path()).await.expect_err("history");
    assert!(
        matches!(error, RecordsError::Newer { found: 999, .. }),
        "{error}"
    );
    execute(&file, "PRAGMA user_version = 999").await;
    let error = Records::open(folder.path()).await.expect_err("newer");
    let RecordsError::Newer { found, known, .. } = error else {
        panic!("{error}");
    };
    assert!(found == 999 && known < 999 && error.to_string().contains("newer version"));

    let (folder, file, _) = closed().await;
    execute(&file, "PRAGMA application_id = 77").await;
    let error = Records::open(folder.path()).await.expect_err("foreign");
    assert!(matches!(error, RecordsError::Foreign(_)), "{error}");

    let folder = Folder::new();
    let file = folder.path().join(RECORDS_FILE);
    execute(&file, "CREATE TABLE theirs (a)").await;
    let error = Records::open(folder.path()).await.expect_err("theirs");
    assert!(matches!(error, RecordsError::Foreign(_)), "{error}");
}

#[tokio::test]
async fn a_directory_that_is_none_is_an_error() {
    let folder = Folder::new();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    for path in [file.clone(), file.join("below")] {
        let error = Records::open(&path).await.expect_err("no directory");
        assert!(matches!(error, RecordsError::Io { .. }), "{error:?}");
        assert!(error.to_string().contains("file"), "{error}");
    }
    fs::create_dir(folder.path().join(RECORDS_FILE)).unwrap();
    let error = Records::open(folder.path()).await.expect_err("no file");
    assert!(matches!(error, RecordsError::Storage(_)), "{error:?}");
}

#[tokio::test]
async fn a_damaged_history_is_put_aside_and_begun_anew() {
    let (folder, _, history) = closed().await;
    let damaged = b"no database either".repeat(5_000);
    fs::write(&history, &damaged).unwrap();
    let records = open(&folder).await;
    let aside = records.history().stats().set_aside.expect("put aside");
    assert_eq!(fs::read(aside).unwrap(), damaged);
    assert_eq!(records.users().all().await.unwrap().len(), 1);
    let at = now();
    records.history().push(sample(&robot(1), 1, at)).unwrap();
    records.history().settle().await.unwrap();
    let points = records.history().query(&robot(1), at, at + 1, 1).await;
    assert_eq!(points.unwrap().len(), 1);
}

#[tokio::test]
async fn a_damaged_block_costs_that_block() {
    let (folder, _, history) = closed().await;
    execute(
        &history,
        "UPDATE block SET data = x'feff' WHERE level = 0 AND robot =
         (SELECT id FROM robot WHERE name = 'sim-00001')",
    )
    .await;
    let records = open(&folder).await;
    let to = now();
    let ask = async |n, step| {
        let (robot, from) = (robot(n), to - 120_000);
        let points = records.history().query(&robot, from, to, step).await;
        points.unwrap().iter().map(|point| point.count).sum::<u64>()
    };
    assert_eq!(ask(1, 100).await, 0);
    assert_eq!(ask(1, 1_000).await, 100, "seconds are other blocks");
    assert_eq!(ask(2, 100).await, 100);
    assert_eq!(records.history().stats().damaged, 1);
}

#[tokio::test]
async fn a_backup_is_made_in_use_and_comes_back() {
    let folder = Folder::new();
    let records = filled(&folder).await;
    let ada = user("ada", Role::Admin);
    let hour = 3_600_000;
    let session = records
        .sessions()
        .open(&ada.name, digest(1), now(), now() + hour, "x")
        .await
        .unwrap();
    let copies = Folder::new();
    let to = copies.path().join("copy");
    let at = now() - 30_000;
    records.history().push(sample(&robot(9), 1, at)).unwrap();
    // Others write meanwhile.
    let busy = records.clone();
    let writer = tokio::spawn(async move {
        for n in 20..60 {
            busy.audit().append(entry(n)).await.unwrap();
        }
    });
    backup::create(&records, &to).await.unwrap();
    writer.await.unwrap();
    assert!(matches!(
        backup::create(&records, &to).await,
        Err(RecordsError::Exists)
    ));
    assert!(matches!(
        backup::create(&*memory().await, &copies.path().join("x")).await,
        Err(RecordsError::Invalid(_))
    ));
    records.settings().set("big", b"later").await.unwrap();
    assert!(matches!(
        backup::restore(&to, folder.path()).await,
        Err(RecordsError::InUse(_))
    ));
    records.close().await;
    drop(records);

    let replaced = backup::restore(&to, folder.path()).await.unwrap();
    let records = open(&folder).await;
    assert_eq!(
        records.settings().get("big").await.unwrap(),
        Some(vec![5; 60_000]),
        "as it was then"
    );
    assert!(records.audit().verify().await.unwrap() >= 20);
    let points = records.history().query(&robot(9), at, at + 1, 1).await;
    assert_eq!(points.unwrap().len(), 1);
    // Whoever was logged in logs in again, with a session of another number.
    assert_eq!(
        records
            .sessions()
            .refresh(digest(1), digest(2), now())
            .await
            .unwrap(),
        Refreshed::Unknown
    );
    let next = records
        .sessions()
        .open(&ada.name, digest(3), now(), now() + hour, "x")
        .await
        .unwrap();
    assert!(next > session + 1_000);
    // What was there before is kept, and opens.
    let before = Records::open(&replaced).await.unwrap();
    assert_eq!(
        before.settings().get("big").await.unwrap().as_deref(),
        Some(&b"later"[..])
    );
    assert_eq!(before.audit().verify().await, Ok(60));
}

#[tokio::test]
async fn a_bad_backup_changes_nothing() {
    let (folder, _, _) = closed().await;
    for damage in ["none", "garbage", "pages", "empty", "newer", "in use"] {
        let (backup, file, history) = closed().await;
        let mut bytes = fs::read(&file).unwrap();
        match damage {
            "none" => fs::remove_file(&file).unwrap(),
            "garbage" => fs::write(&history, [9; 9_000]).unwrap(),
            "pages" => {
                bytes[8_192..].fill(0x41);
                fs::write(&file, bytes).unwrap();
            }
            "empty" => fs::write(&file, "").unwrap(),
            "newer" => execute(&file, "PRAGMA user_version = 999").await,
            _ => fs::write(backup.path().join("records.sqlite-wal"), [1; 99]).unwrap(),
        }
        let error = backup::restore(backup.path(), folder.path())
            .await
            .expect_err(damage);
        match (damage, &error) {
            ("none", RecordsError::NotFound)
            | ("garbage" | "pages" | "empty", RecordsError::Damaged { .. })
            | ("newer", RecordsError::Newer { .. })
            | ("in use", RecordsError::Invalid(_)) => {}
            _ => panic!("{damage}: {error:?}"),
        }
        let records = open(&folder).await;
        assert_eq!(records.audit().verify().await, Ok(20), "{damage}");
        records.close().await;
        drop(records);
        let left: Vec<_> = fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .filter(|name| name.to_string_lossy().contains("partial"))
            .collect();
        assert!(left.is_empty(), "{damage}: {left:?}");
    }
}

#[tokio::test]
async fn a_backup_comes_back_over_a_damaged_file() {
    let (backup, _, _) = closed().await;
    let (folder, file, _) = closed().await;
    fs::write(&file, [3; 10_000]).unwrap();
    let replaced = backup::restore(backup.path(), folder.path()).await.unwrap();
    assert_eq!(fs::read(replaced.join(RECORDS_FILE)).unwrap(), [3; 10_000]);
    assert_eq!(open(&folder).await.audit().verify().await, Ok(20));
    // Into a directory that is new, too.
    let folder = Folder::new();
    let dir = folder.path().join("new");
    backup::restore(backup.path(), &dir).await.unwrap();
    let records = Records::open(&dir).await.unwrap();
    assert_eq!(records.audit().verify().await, Ok(20));
}

#[cfg(unix)]
#[tokio::test]
async fn nobody_else_may_read_the_files() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = Folder::new();
    let records = filled(&folder).await;
    let to = folder.path().join("copy");
    backup::create(&records, &to).await.unwrap();
    for dir in [folder.path(), &to] {
        for file in fs::read_dir(dir).unwrap() {
            let file = file.unwrap();
            let name = file.file_name().to_string_lossy().into_owned();
            if name.contains(".sqlite") {
                let mode = file.metadata().unwrap().permissions().mode();
                assert_eq!(mode & 0o077, 0, "{name}: {mode:o}");
            }
        }
    }
}
