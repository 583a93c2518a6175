//! What several tests need.
#![allow(dead_code, reason = "each test uses a part of it")]

use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crawler_access::{Digest, Role, UserName};
use crawler_history::Sample;
use crawler_protocol::RobotState;
use crawler_records::{
    Entry, KeptFence, NewRelease, NewRollout, Records, RolloutRobot, RolloutStep, StepNote, User,
};
use crawler_tests::engines::postgres::Postgres;
use serde_json::json;
use sqlx::Connection as _;

/// Whether this is the suite of the other engine: `on_postgres.rs` holds the same tests.
pub(crate) fn on_postgres() -> bool {
    env!("CARGO_CRATE_NAME") == "on_postgres"
}

/// A directory of its own, gone with the value, and a database where the records are in one.
pub(crate) struct Folder {
    path: PathBuf,
    database: Option<(Arc<Postgres>, String)>,
}

impl Folder {
    pub(crate) fn new() -> Self {
        let path = Self::empty();
        let database = on_postgres().then(|| {
            let server = Postgres::shared();
            let url = server.database();
            (server, url)
        });
        Self { path, database }
    }

    /// What is in this one, again: records that were closed.
    pub(crate) fn copy(&self) -> Self {
        let path = Self::empty();
        for entry in std::fs::read_dir(&self.path).expect("a directory") {
            let file = entry.expect("an entry").path();
            let name = file.file_name().expect("a name");
            std::fs::copy(&file, path.join(name)).expect("a copy");
        }
        let database = self.database.as_ref().map(|(server, url)| {
            let copy = server.database_like(url);
            (server.clone(), copy)
        });
        Self { path, database }
    }

    fn empty() -> PathBuf {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let name = format!(
            "records-{}-{}",
            std::process::id(),
            NEXT.fetch_add(1, Ordering::Relaxed)
        );
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        // A run before may have had the same process id.
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).expect("a directory");
        path
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// What somebody does who goes past the program.
    pub(crate) async fn tamper(&self, sql: &'static str) -> Result<(), sqlx::Error> {
        if let Some((_, url)) = &self.database {
            let mut connection = sqlx::PgConnection::connect(url).await?;
            let outcome = sqlx::raw_sql(sql).execute(&mut connection).await;
            connection.close().await?;
            return outcome.map(|_| ());
        }
        let file = self.path.join(crawler_records::RECORDS_FILE);
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file);
        let mut connection = sqlx::SqliteConnection::connect_with(&options).await?;
        let outcome = sqlx::raw_sql(sql).execute(&mut connection).await;
        connection.close().await?;
        outcome.map(|_| ())
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
}

pub(crate) fn name(text: &str) -> UserName {
    text.parse().expect("a user name")
}

/// A digest that is like no other `n`'s.
pub(crate) fn digest(n: u32) -> Digest {
    let mut bytes = [7; 32];
    bytes[..4].copy_from_slice(&n.to_be_bytes());
    Digest(bytes)
}

pub(crate) fn user(text: &str, role: Role) -> User {
    User {
        name: name(text),
        role,
        password: Some("$argon2id$...".into()),
        created: 1_000,
        disabled: false,
    }
}

pub(crate) fn entry(n: i64) -> Entry {
    Entry {
        at: 1_000 + n,
        who: if n % 2 == 0 { "ada" } else { "bob" }.into(),
        from: "127.0.0.1".into(),
        action: "command".into(),
        target: format!("robot-{n}"),
        detail: json!({ "command": "stop", "seq": n }),
        outcome: "ok".into(),
    }
}

/// The `n`th fence; every one is different.
pub(crate) fn fence(n: i64) -> KeptFence {
    KeptFence {
        id: format!("{n:08x}"),
        name: format!("yard {n} \u{e4}"),
        kind: if n % 2 == 0 { "keep_in" } else { "keep_out" }.into(),
        action: if n % 3 == 0 { "stop" } else { "warn" }.into(),
        corners: format!("[[0,0],[{n},0],[0,1.5]]"),
        by: "ada".into(),
        made_at: 1_000 + n,
    }
}

/// A step of a rollout that changes robot `n` and says so.
pub(crate) fn rollout_step(n: usize, document: Option<&str>) -> RolloutStep {
    RolloutStep {
        at: 1_000 + n as i64,
        document: document.map(str::to_owned),
        over: false,
        robots: vec![RolloutRobot {
            robot: robot(n),
            state: if n.is_multiple_of(2) {
                "waiting"
            } else {
                "offered"
            }
            .into(),
            entry: format!("entry {n}"),
        }],
        notes: vec![
            StepNote {
                robot: Some(robot(n)),
                revision: 1,
                what: format!("note {n}"),
            },
            StepNote {
                robot: None,
                revision: n as u32,
                what: format!("step {n}"),
            },
        ],
        audit: vec![entry(n as i64)],
    }
}

/// Rollout `id`, which begins with robot 0.
pub(crate) fn rollout(id: i64) -> NewRollout {
    NewRollout {
        id,
        by: "ada".into(),
        owner: "one".into(),
        step: rollout_step(0, Some("{}")),
    }
}

/// The `n`th release, with an image of so many bytes; every one is different.
pub(crate) fn release(n: u32, bytes: usize) -> NewRelease {
    NewRelease {
        id: format!("{n:016x}"),
        kind: if n.is_multiple_of(2) {
            "program"
        } else {
            "model"
        }
        .into(),
        name: (!n.is_multiple_of(2)).then(|| "eyes".into()),
        board: "sim".into(),
        version: format!("0.{n}.0"),
        build: format!("b{n}"),
        sequence: n + 1,
        floor: n / 2,
        expires: n.is_multiple_of(3).then_some(4_000_000_000 + i64::from(n)),
        envelope: vec![n as u8; 300],
        image: (0..bytes).map(|at| (at / 7 + n as usize) as u8).collect(),
        by: "ada".into(),
        added: 1_000 + i64::from(n / 2),
    }
}

/// Records that are gone with the value.
pub(crate) struct Passing {
    records: Records,
    _folder: Option<Folder>,
}

impl Deref for Passing {
    type Target = Records;
    fn deref(&self) -> &Records {
        &self.records
    }
}

pub(crate) async fn memory() -> Passing {
    if on_postgres() {
        let folder = Folder::new();
        return Passing {
            records: open(&folder).await,
            _folder: Some(folder),
        };
    }
    Passing {
        records: Records::in_memory().await.expect("records"),
        _folder: None,
    }
}

pub(crate) async fn open(folder: &Folder) -> Records {
    match &folder.database {
        Some((_, url)) => Records::connect(url, None, true).await,
        None => Records::open(folder.path()).await,
    }
    .expect("records")
}

pub(crate) fn now() -> i64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    since.expect("after 1970").as_millis() as i64
}

pub(crate) fn robot(n: usize) -> crawler_protocol::RobotId {
    format!("sim-{n:05}").parse().expect("a robot id")
}

/// The `n`th sample of a robot that drives about; every one is different.
pub(crate) fn sample(robot: &crawler_protocol::RobotId, n: i64, at: i64) -> Sample {
    Sample {
        robot: robot.clone(),
        at,
        x: n as f32 * 0.001,
        y: -0.5,
        theta: (n % 6_000) as f32 * 0.001,
        range_mm: (n % 3 != 0).then_some((n % 4_000) as u16),
        battery_mv: 8_400 - (n % 1_000) as u16,
        battery_percent: 100 - (n % 100) as u8,
        rssi: (n % 2 == 0).then_some(-60 - (n % 20) as i8),
        left: 0.25,
        right: -0.25,
        state: RobotState::ALL[n as usize % RobotState::ALL.len()],
    }
}
