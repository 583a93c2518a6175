//! Records move from one engine to the other and back, and stay what they are; and the way to a
//! database may be checked by certificates.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::support::{
    Folder, digest, entry, fence, name, now, release, robot, rollout, rollout_step, user,
};
use crawler_access::Role;
use crawler_records::{
    Event, EventLevel, EventQuery, NewExperiment, NewTrials, Records, RecordsError, Refreshed,
    StoredTrial, Withdrawal, Written, backup,
};
use crawler_tests::engines::postgres::Postgres;

const HOUR: i64 = 3_600_000;

fn event(n: i64) -> Event {
    Event {
        at: 1_000 + n,
        level: EventLevel::Warn,
        robot: (n % 2 == 0).then(|| robot(7)),
        text: format!("event {n}"),
    }
}

/// The newest events and the last arena.
async fn recorded(records: &Records, limit: u32) -> (Vec<Event>, Option<String>) {
    let newest = EventQuery {
        from: 0,
        to: i64::MAX,
        level: EventLevel::Info,
        robot: None,
        before: None,
        limit,
    };
    let events = records.events().page(newest).await.unwrap();
    let events = events.into_iter().map(|stored| stored.event).collect();
    (events, records.arenas().at(i64::MAX).await.unwrap())
}

/// Something of everything, more than a page of some. Returns the session.
async fn fill(records: &Records) -> u64 {
    records.settings().set("key", &[0, 1, 255]).await.unwrap();
    for n in 0..250 {
        let mut user = user(&format!("user-{n:03}"), Role::Viewer);
        (user.disabled, user.password) = (n % 2 == 0, (n % 3 == 0).then(|| format!("hash {n}")));
        records.users().add(&user).await.unwrap();
    }
    records
        .users()
        .add(&user("ada", Role::Admin))
        .await
        .unwrap();
    records
        .invitations()
        .add(None, Role::Operator, digest(1), now() + HOUR)
        .await
        .unwrap();
    let guest = name("user-001");
    records
        .invitations()
        .add(Some(&guest), Role::Admin, digest(2), now() + HOUR)
        .await
        .unwrap();
    for n in 0..220 {
        records
            .credentials()
            .enroll(&format!("rover-{n}"), digest(n), 5, "ada")
            .await
            .unwrap();
    }
    records.credentials().revoke("rover-7", 9).await.unwrap();
    for n in 0..20 {
        records.fences().add(&fence(n)).await.unwrap();
    }
    for n in 1..=431 {
        records.audit().append(entry(n)).await.unwrap();
    }
    for n in 0..3 {
        let new = NewExperiment {
            kind: crawler_records::ExperimentKind::Evaluation,
            owner: "one".into(),
            name: format!("experiment {n}"),
            build: format!("build {n}"),
            recipe: "{}".into(),
            metrics: "[]".into(),
            seeds: 500,
            by: "ada".into(),
            created: n,
            start: n != 2,
        };
        let id = records.experiments().add(new).await.unwrap().id;
        if n != 2 {
            let trials = NewTrials {
                experiment: id,
                trials: (0..300).map(trial).collect(),
                results: "so far".into(),
                completed: None,
            };
            records.trials().add(trials).await.unwrap();
        }
    }
    let events = (0..431).map(event).collect();
    records.events().add(events).await.unwrap();
    records.arenas().add(5, Some("{}".into())).await.unwrap();
    records.arenas().add(6, None).await.unwrap();
    records.arenas().add(7, Some("[7]".into())).await.unwrap();
    for id in 1..=2 {
        let mut new = rollout(id);
        new.step.audit.clear();
        records.rollouts().add(new).await.unwrap();
        let mut step = rollout_step(1, Some("[]"));
        step.audit.clear();
        step.over = id == 1;
        let more = (2..450).map(|n| rollout_step(n, None));
        for more in more {
            step.robots.extend(more.robots);
            step.notes.extend(more.notes);
        }
        let written = records.rollouts().write(id, 1, step).await.unwrap();
        assert_eq!(written, Written::Stored);
    }
    // More pieces than a page has.
    for n in 0..4 {
        let bytes = if n == 3 { 9 } else { 70 * 65_536 };
        records.releases().add(release(n, bytes)).await.unwrap();
    }
    let gate = b"tried".to_vec();
    let (first, last) = (release(0, 1).id, release(3, 1).id);
    let passed = records.releases().set_gate(&first, gate, true).await;
    passed.unwrap();
    let withdrawal = Withdrawal {
        by: "ada".into(),
        at: 5,
        why: "too early".into(),
    };
    let withdrawn = records.releases().withdraw(&last, withdrawal).await;
    withdrawn.unwrap();
    let ada = name("ada");
    let session = records
        .sessions()
        .open(&ada, digest(3), now(), now() + HOUR, "here")
        .await;
    session.unwrap()
}

fn trial(number: u32) -> StoredTrial {
    StoredTrial {
        number,
        seed: u64::from(number),
        success: number > 3,
        reason: (number <= 3).then(|| "reach".into()),
        measured: vec![None, Some(f64::from(number) / 3.0)],
    }
}

/// All that was put in by [`fill`] is there, after a restore.
async fn assert_filled(records: &Records, like: &Records, session: u64) {
    assert_eq!(
        records.settings().get("key").await.unwrap(),
        Some(vec![0, 1, 255])
    );
    assert_eq!(
        records.users().all().await.unwrap(),
        like.users().all().await.unwrap()
    );
    assert_eq!(records.users().all().await.unwrap().len(), 251);
    assert_eq!(
        records.credentials().all().await.unwrap(),
        like.credentials().all().await.unwrap()
    );
    assert_eq!(records.fences().all().await.unwrap().len(), 20);
    assert_eq!(
        records.fences().all().await.unwrap(),
        like.fences().all().await.unwrap()
    );
    for n in [1, 2] {
        let invitation = records.invitations().get(digest(n), now()).await.unwrap();
        assert!(invitation.is_some());
        assert_eq!(
            invitation,
            like.invitations().get(digest(n), now()).await.unwrap()
        );
    }
    let experiments = records.experiments().page(None, 100).await.unwrap();
    assert_eq!(
        experiments,
        like.experiments().page(None, 100).await.unwrap()
    );
    assert_eq!(experiments.len(), 3);
    let of = |index: usize| records.trials().page(experiments[index].id, 0, 1_000);
    assert_eq!(of(0).await.unwrap(), []);
    for index in [1, 2] {
        let wanted: Vec<_> = (0..300).map(trial).collect();
        assert_eq!(of(index).await.unwrap(), wanted);
    }
    assert_eq!(
        records.rollouts().page(None, 9).await.unwrap(),
        like.rollouts().page(None, 9).await.unwrap()
    );
    for id in 1..=2 {
        let whole = records.rollouts().whole(id).await.unwrap();
        assert_eq!(whole, like.rollouts().whole(id).await.unwrap());
        assert_eq!(whole.map(|(_, robots)| robots.len()), Some(450));
        let notes = records.rollouts().notes(id, None, 1_000).await.unwrap();
        assert_eq!(notes, like.rollouts().notes(id, None, 1_000).await.unwrap());
        assert_eq!(notes.len(), 450);
    }
    let leases = records.rollouts().leases().await.unwrap();
    assert_eq!(leases, like.rollouts().leases().await.unwrap());
    assert_eq!(leases.len(), 1);
    let releases = records.releases().page(None, 10).await.unwrap();
    assert_eq!(releases, like.releases().page(None, 10).await.unwrap());
    assert_eq!(releases.len(), 4);
    for n in 0..4 {
        let wanted = release(n, 70 * 65_536);
        let image = records.releases().image(&wanted.id, 0, usize::MAX).await;
        assert!(image.unwrap() == (n != 3).then_some(wanted.image), "{n}");
        let gate = records.releases().gate(&wanted.id).await.unwrap();
        assert_eq!(gate.as_deref(), (n == 0).then_some(&b"tried"[..]));
    }
    assert_eq!(records.audit().verify().await, Ok(431));
    let (mut text, mut other) = (Vec::new(), Vec::new());
    records.audit().export(&mut text).await.unwrap();
    like.audit().export(&mut other).await.unwrap();
    assert!(text == other, "the audit logs differ");
    // A restore ends sessions, and their numbers do not come back.
    let refreshed = records
        .sessions()
        .refresh(digest(3), digest(4), now())
        .await;
    assert_eq!(refreshed.unwrap(), Refreshed::Unknown);
    let ada = name("ada");
    let next = records
        .sessions()
        .open(&ada, digest(5), now(), now() + HOUR, "there")
        .await;
    assert!(next.unwrap() > session + 1_000);
    let kept = recorded(records, 1_000).await;
    assert_eq!(kept, recorded(like, 1_000).await);
    assert_eq!((kept.0.len(), kept.1.as_deref()), (431, Some("[7]")));
    assert_eq!(records.arenas().at(6).await.unwrap(), None);
    // New ones come after them.
    records.events().add(vec![event(431)]).await.unwrap();
    records.arenas().add(8, None).await.unwrap();
    assert_eq!(recorded(records, 1).await, (vec![event(431)], None));
    // The log goes on, guarded as before.
    assert_eq!(records.audit().append(entry(432)).await.unwrap(), 432);
    assert_eq!(records.audit().verify().await, Ok(432));
}

/// Puts the backup in `from` into the database, by way of the directory `ready`.
async fn restore(from: &Path, ready: &Path, url: &str) -> Result<(), RecordsError> {
    backup::restore(from, ready).await?;
    backup::restore_database(ready, url, None).await
}

#[tokio::test]
async fn a_file_moves_into_a_database_and_back() {
    let server = Postgres::shared();
    let folder = Folder::new();
    let file = Records::open(&folder.path().join("file")).await.unwrap();
    let session = fill(&file).await;
    let backup = folder.path().join("backup");
    backup::create(&file, &backup).await.unwrap();

    let url = server.database();
    restore(&backup, &folder.path().join("ready"), &url)
        .await
        .unwrap();
    let dir = folder.path().join("beside");
    let database = Records::connect(&url, Some(&dir), false).await.unwrap();
    assert_filled(&database, &file, session).await;
    for sql in ["UPDATE audit SET who = 'eve'", "TRUNCATE audit, audit_end"] {
        let refused = std::panic::catch_unwind(|| server.sql(&url, sql));
        assert!(refused.is_err(), "{sql}");
    }

    let again = folder.path().join("again");
    backup::create(&database, &again).await.unwrap();
    assert!(again.join("history.sqlite").is_file() && !dir.join("records.sqlite").exists());
    let place = folder.path().join("file-again");
    backup::restore(&again, &place).await.unwrap();
    let file = Records::open(&place).await.unwrap();
    assert_eq!(file.audit().verify().await, Ok(432));
    assert_eq!(
        file.users().all().await.unwrap(),
        database.users().all().await.unwrap()
    );
    let experiments = file.experiments().page(None, 100).await.unwrap();
    assert_eq!(
        experiments,
        database.experiments().page(None, 100).await.unwrap()
    );
    assert_eq!(
        file.trials().page(experiments[1].id, 299, 9).await.unwrap(),
        [trial(299)]
    );
    assert_eq!(
        recorded(&file, 1_000).await,
        recorded(&database, 1_000).await
    );
    file.events().add(vec![event(432)]).await.unwrap();
    let refused = sqlx_in(&place, "DELETE FROM audit")
        .await
        .expect_err("append-only");
    assert!(refused.to_string().contains("append-only"), "{refused}");
    let ada = name("ada");
    let next = file
        .sessions()
        .open(&ada, digest(6), now(), now() + HOUR, "x")
        .await
        .unwrap();
    assert!(next > session + 1_000_000_000, "{next}");
}

async fn sqlx_in(dir: &Path, sql: &'static str) -> Result<(), sqlx::Error> {
    use sqlx::Connection as _;
    let file = dir.join(crawler_records::RECORDS_FILE);
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(file);
    let mut connection = sqlx::SqliteConnection::connect_with(&options).await?;
    sqlx::raw_sql(sql).execute(&mut connection).await?;
    connection.close().await
}

/// What `attempt` comes to when the database has noticed that connections are gone, which it does a
/// moment after they went: those of a refused attempt as well.
async fn once_free<T>(
    attempt: impl AsyncFn() -> Result<T, RecordsError>,
) -> Result<T, RecordsError> {
    let end = Instant::now() + Duration::from_mins(1);
    loop {
        match attempt().await {
            Err(error) if error.is_passing() && Instant::now() < end => {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
            outcome => return outcome,
        }
    }
}

#[tokio::test]
async fn a_database_with_records_or_readers_is_not_overwritten() {
    let server = Postgres::shared();
    let folder = Folder::new();
    let file = Records::open(&folder.path().join("file")).await.unwrap();
    file.settings().set("from", b"file").await.unwrap();
    let (backup, ready) = (folder.path().join("backup"), folder.path().join("ready"));
    backup::create(&file, &backup).await.unwrap();
    backup::restore(&backup, &ready).await.unwrap();

    let url = server.database();
    let running = Records::connect(&url, None, true).await.unwrap();
    running.settings().set("from", b"database").await.unwrap();
    let aside = folder.path().join("aside");
    std::fs::create_dir(&aside).unwrap();
    let replace = || backup::restore_database(&ready, &url, Some(&aside));
    let error = replace().await.expect_err("a server runs");
    assert!(matches!(error, RecordsError::InUse(_)), "{error:?}");
    running.close().await;
    let refused = once_free(|| backup::restore_database(&ready, &url, None)).await;
    let error = refused.expect_err("it holds records");
    assert!(matches!(error, RecordsError::Exists), "{error:?}");
    once_free(replace).await.unwrap();
    let there = Records::connect(&url, None, false).await.unwrap();
    assert_eq!(
        there.settings().get("from").await.unwrap().as_deref(),
        Some(&b"file"[..])
    );
    // What was there is a backup.
    let before = Records::open(&aside).await.unwrap();
    assert_eq!(
        before.settings().get("from").await.unwrap().as_deref(),
        Some(&b"database"[..])
    );
}

#[tokio::test]
async fn certificates_are_checked_when_the_address_asks() {
    use rcgen::{CertificateParams, IsCa, Issuer, KeyPair};
    let mut server = Postgres::start();
    let url = server.database();
    let folder = Folder::new();
    let authority = |file: &str| {
        let key = KeyPair::generate().unwrap();
        let mut parameters = CertificateParams::default();
        parameters.is_ca = IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
        let certificate = parameters.self_signed(&key).unwrap();
        let path = folder.path().join(file);
        std::fs::write(&path, certificate.pem()).unwrap();
        (path, Issuer::new(parameters, key))
    };
    let (ours, issuer) = authority("ours.pem");
    let (theirs, _) = authority("theirs.pem");
    let key = KeyPair::generate().unwrap();
    let names = vec!["localhost".to_owned()];
    let certificate = CertificateParams::new(names)
        .unwrap()
        .signed_by(&key, &issuer)
        .unwrap();
    server.stop();
    server.configure_tls(&certificate.pem(), &key.serialize_pem());
    server.resume();

    let by_name = url.replace("127.0.0.1", "localhost");
    let with = |url: &str, mode: &str, root: &Path| {
        format!("{url}?sslmode={mode}&sslrootcert={}", root.display())
    };
    let records = Records::connect(&with(&by_name, "verify-full", &ours), None, true).await;
    let records = records.expect("the right certificate");
    records.audit().append(entry(1)).await.unwrap();
    let encrypted = server.sql(
        &url,
        "SELECT count(*) FROM pg_stat_ssl JOIN pg_stat_activity
         USING (pid) WHERE ssl AND application_name = 'terracrawler'",
    );
    assert_ne!(encrypted, "0");
    for (url, mode, root) in [
        (&by_name, "verify-full", &theirs),
        (&by_name, "verify-ca", &theirs),
        (&url, "verify-full", &ours),
    ] {
        let error = Records::connect(&with(url, mode, root), None, true).await;
        let error = error.expect_err(mode);
        assert!(matches!(error, RecordsError::Refused(_)), "{error:?}");
        assert!(error.to_string().contains("TLS fails"), "{error}");
    }
    Records::connect(&with(&url, "verify-ca", &ours), None, true)
        .await
        .expect("another name");
}
