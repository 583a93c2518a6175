//! A database that is gone, hangs, is of somebody else or damaged.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::support::{entry, name, user};
use crawler_access::Role;
use crawler_records::{Records, RecordsError};
use crawler_tests::ReservedPort;
use crawler_tests::engines::postgres::{PASSWORD, Postgres, QUOTED, USER};
use sqlx::Connection as _;

/// How long a test waits for something that is to happen, however slow the machine is.
const LIMIT: Duration = Duration::from_mins(1);

/// Waits for the end of a call that must not hang.
fn within<T>(what: &str, call: impl Future<Output = T>) -> impl Future<Output = T> {
    // The calls are large: on the stack of a test they would be copied.
    let call = Box::pin(call);
    async move {
        tokio::time::timeout(LIMIT, call)
            .await
            .unwrap_or_else(|_| panic!("not within {LIMIT:?}: {what}"))
    }
}

async fn connect(url: &str) -> Records {
    Records::connect(url, None, true).await.expect("records")
}

/// What the records say about an address that does not work.
async fn refused(url: &str) -> RecordsError {
    let connected = within("an answer", Records::connect(url, None, true));
    let error = connected.await.expect_err(url);
    let text = error.to_string();
    assert!(!text.contains('\n') && !text.contains(PASSWORD), "{text}");
    error
}

/// Tries until it works, as callers do.
async fn until_it_works(records: &Records, n: i64) -> u64 {
    let began = Instant::now();
    loop {
        let error = match records.audit().append(entry(n)).await {
            Ok(seq) => return seq,
            Err(error) => error,
        };
        assert!(error.is_passing(), "{error:?}");
        assert!(
            began.elapsed() < LIMIT,
            "it never came back: {error}, {:?}",
            records.database()
        );
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

/// Waits until the numbers say whether the database is up: a caller may have its answer before.
async fn wait_told(records: &Records, up: bool) {
    let began = Instant::now();
    while records.database().expect("a database").up != up {
        assert!(began.elapsed() < LIMIT, "{:?}", records.database());
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

#[tokio::test]
async fn an_address_that_does_not_work_says_why() {
    let server = Postgres::shared();
    let port = server.port();
    for (url, says) in [
        (
            format!("postgres://{USER}:wrong@127.0.0.1:{port}/postgres"),
            "password authentication",
        ),
        (
            server.url("nowhere"),
            "createdb --owner=terracrawler nowhere",
        ),
        (format!("{}?sslmode=require", server.database()), "TLS"),
        (format!("{}?sslmod=require", server.database()), "`sslmod`"),
    ] {
        let error = refused(&url).await;
        assert!(matches!(error, RecordsError::Refused(_)), "{error:?}");
        assert!(error.to_string().contains(says), "{url}: {error}");
    }
    let nobody = ReservedPort::new();
    let free = nobody.number();
    let error = refused(&format!("postgres://x:{QUOTED}@127.0.0.1:{free}/x")).await;
    assert!(matches!(error, RecordsError::Unavailable(_)), "{error:?}");
    assert!(
        error.to_string().contains(&format!("127.0.0.1:{free}/x")),
        "{error}"
    );
    // Somebody who takes the connection and says nothing.
    let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let error = refused(&format!("postgres://x@{address}/x")).await;
    assert!(
        error.to_string().contains("no answer within 5 s"),
        "{error}"
    );
}

#[tokio::test]
async fn a_role_that_may_not_make_tables_is_told_so() {
    let server = Postgres::shared();
    let url = server.database();
    server.sql(&url, "CREATE ROLE guest_of_tables LOGIN PASSWORD 'guest'");
    server.sql(&url, "REVOKE CREATE ON SCHEMA public FROM public");
    let guest = url.replace(&format!("{USER}:{QUOTED}"), "guest_of_tables:guest");
    let error = refused(&guest).await.to_string();
    assert!(
        error.contains("make it the owner of the database"),
        "{error}"
    );
}

#[tokio::test]
async fn databases_of_newer_or_other_programs_or_with_damage_are_refused() {
    let server = Postgres::shared();
    let url = server.database();
    assert!(matches!(
        Records::connect(&url, None, false).await,
        Err(RecordsError::NotFound)
    ));
    server.sql(&url, "CREATE TABLE theirs (a int)");
    let error = refused(&url).await;
    assert!(matches!(error, RecordsError::Foreign(_)), "{error:?}");
    for (sql, says) in [
        (
            "UPDATE terracrawler SET version = 999",
            "newer version (tables 999, this program knows ",
        ),
        ("DELETE FROM terracrawler", "of which version"),
        ("DROP TABLE invitation", "table invitation is missing"),
        (
            "DROP TRIGGER audit_never_changes ON audit",
            "audit_never_changes",
        ),
        (
            "ALTER TABLE audit DISABLE TRIGGER audit_only_grows",
            "audit_only_grows",
        ),
    ] {
        let url = server.database();
        connect(&url).await.close().await;
        server.sql(&url, sql);
        let error = refused(&url).await.to_string();
        assert!(error.contains(says), "{sql}: {error}");
    }
}

#[tokio::test]
async fn servers_that_start_at_once_make_the_tables_once() {
    let server = Postgres::shared();
    let url = server.database();
    let mut starts = tokio::task::JoinSet::new();
    for n in 0..6 {
        let url = url.clone();
        starts.spawn(async move {
            let records = connect(&url).await;
            let key = records
                .settings()
                .get_or_set("key", &[n])
                .await
                .expect("a key");
            records
                .audit()
                .append(entry(n.into()))
                .await
                .expect("an entry");
            (records, key)
        });
    }
    let started = starts.join_all().await;
    let (records, key) = &started[0];
    assert!(started.iter().all(|(_, other)| other == key));
    assert_eq!(records.audit().verify().await, Ok(6));
    let version = server.sql(&url, "SELECT version FROM terracrawler");
    assert!(version.parse::<u32>().is_ok(), "one version: {version}");
}

#[tokio::test]
async fn the_last_two_administrators_cannot_both_go() {
    let server = Postgres::shared();
    let url = server.database();
    let (one, other) = (connect(&url).await, connect(&url).await);
    for round in 0..10 {
        for who in ["ada", "bob"] {
            let _ = one.users().delete(&name(who), round).await;
            let added = one.users().add(&user(who, Role::Admin)).await;
            assert!(
                matches!(added, Ok(()) | Err(RecordsError::Exists)),
                "{added:?}"
            );
        }
        let (ada, bob) = (name("ada"), name("bob"));
        let (left, right) = tokio::join!(
            one.users().set_role(&ada, Role::Viewer),
            other.users().set_role(&bob, Role::Viewer)
        );
        assert!(left.is_ok() != right.is_ok(), "{left:?} {right:?}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nothing_acknowledged_is_lost_when_the_database_is_killed() {
    let mut server = Postgres::start();
    let url = server.database();
    let records = connect(&url).await;
    let mut acknowledged = Vec::new();
    let count = Arc::new(AtomicUsize::new(0));
    for kill in 0..3_i64 {
        let mut tasks = tokio::task::JoinSet::new();
        for task in 0..4 {
            let (records, count) = (records.clone(), Arc::clone(&count));
            tasks.spawn(async move {
                let mut acknowledged = Vec::new();
                for n in 0.. {
                    let n = kill * 1_000_000 + task * 100_000 + n;
                    match records.audit().append(entry(n)).await {
                        Ok(seq) => {
                            acknowledged.push((seq, entry(n).target));
                            count.fetch_add(1, Ordering::Relaxed);
                        }
                        Err(error) => {
                            assert!(error.is_passing(), "{error:?}");
                            break;
                        }
                    }
                }
                acknowledged
            });
        }
        // In the middle of it, each time after more.
        let enough = count.load(Ordering::Relaxed) + 10 * (kill as usize + 1);
        within("enough is acknowledged", async {
            while count.load(Ordering::Relaxed) < enough {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await;
        server.kill();
        acknowledged.extend(tasks.join_all().await.into_iter().flatten());
        wait_told(&records, false).await;
        assert!(records.database().expect("a database").failures > 0);
        let reading = within("an answer", records.users().all()).await;
        let reading = reading.expect_err("nobody is there");
        assert!(reading.is_passing(), "{reading:?}");
        server.resume();
        let seq = until_it_works(&records, kill).await;
        acknowledged.push((seq, entry(kill).target));
        wait_told(&records, true).await;
    }
    assert!(acknowledged.len() >= 60, "{}", acknowledged.len());
    let last = records.audit().verify().await.expect("a whole chain");
    assert!(last >= acknowledged.len() as u64);
    for (seq, target) in acknowledged {
        let page = records.audit().page(Some(seq + 1), 1, None).await.unwrap();
        assert_eq!((page[0].seq, &page[0].entry.target), (seq, &target));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_database_that_hangs_holds_nobody_up() {
    let server = Postgres::start();
    let url = server.database();
    let records = connect(&url).await;
    records.audit().append(entry(1)).await.unwrap();
    // A lock that somebody else holds stands for all that can hang inside.
    let mut hanging = sqlx::PgConnection::connect(&url).await.unwrap();
    sqlx::raw_sql("BEGIN; SELECT pg_advisory_xact_lock(1413698162, 1)")
        .execute(&mut hanging)
        .await
        .unwrap();
    let answer = within("an answer", records.audit().append(entry(2))).await;
    let error = answer.expect_err("it hangs");
    assert!(error.is_passing(), "{error:?}");
    assert_eq!(records.audit().page(None, 9, None).await.unwrap().len(), 1);
    drop(hanging);
    until_it_works(&records, 3).await;
}

/// Something between the records and the database that can stop passing anything on.
struct Network {
    port: u16,
    silent: Arc<AtomicBool>,
}

impl Network {
    fn to(port: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let network = Self {
            port: listener.local_addr().expect("its address").port(),
            silent: Arc::default(),
        };
        let silent = network.silent.clone();
        std::thread::spawn(move || {
            for near in listener.incoming().flatten() {
                let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else {
                    continue;
                };
                let (back, forth) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                for (from, to) in [(near, far), (forth, back)] {
                    let silent = silent.clone();
                    std::thread::spawn(move || pass(from, to, &silent));
                }
            }
        });
        network
    }
}

fn pass(mut from: TcpStream, mut to: TcpStream, silent: &AtomicBool) {
    let mut buffer = [0; 4_096];
    while let Ok(length @ 1..) = from.read(&mut buffer) {
        while silent.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(20));
        }
        if to.write_all(&buffer[..length]).is_err() {
            return;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_network_that_swallows_everything_holds_nobody_up() {
    let server = Postgres::shared();
    let url = server.database();
    let network = Network::to(server.port());
    let far = url.replace(
        &format!(":{}/", server.port()),
        &format!(":{}/", network.port),
    );
    let records = connect(&far).await;
    records.audit().append(entry(1)).await.unwrap();
    records.users().all().await.unwrap();
    network.silent.store(true, Ordering::Relaxed);
    let (write, read) = within("answers", async {
        tokio::join!(records.audit().append(entry(2)), records.users().all())
    })
    .await;
    for outcome in [write.map(|_| ()), read.map(|_| ())] {
        let error = outcome.expect_err("nothing comes back");
        assert!(error.is_passing(), "{error:?}");
    }
    wait_told(&records, false).await;
    network.silent.store(false, Ordering::Relaxed);
    let seq = until_it_works(&records, 3).await;
    assert_eq!(records.audit().verify().await, Ok(seq));
    // Nor does it keep from ending.
    network.silent.store(true, Ordering::Relaxed);
    within("an end", records.close()).await;
    network.silent.store(false, Ordering::Relaxed);
}
