//! A server that is killed at any moment has everything that it acknowledged when it starts again.

use std::collections::HashMap;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{Folder, digest, entry, now, robot, sample};
use crawler_access::Digest;
use crawler_records::Records;

/// Names the directory to the process that is to be killed.
const DIRECTORY: &str = "RECORDS_TO_BE_KILLED";
const KILLS: u64 = 25;

/// Prints in one piece, so that a line that ends is whole.
fn acknowledge(line: &str) {
    let mut out = std::io::stdout().lock();
    let _ = out.write_all(format!("ack {line}\n").as_bytes());
    let _ = out.flush();
}

/// What the killed process does: writes, and says what was acknowledged.
#[test]
#[ignore = "is run by the other test, in a process of its own"]
fn child() {
    let Some(folder) = std::env::var_os(DIRECTORY) else {
        return;
    };
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_time()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let records = Records::open(Path::new(&folder)).await.expect("records");
        acknowledge("ready");
        let mut tasks = tokio::task::JoinSet::new();
        for _ in 0..4 {
            let records = records.clone();
            tasks.spawn(async move {
                for n in 0.. {
                    let seq = records.audit().append(entry(n)).await.expect("audit");
                    acknowledge(&format!("audit {seq} robot-{n}"));
                }
            });
        }
        let enrolling = records.clone();
        tasks.spawn(async move {
            for n in 0_u32.. {
                let (name, digest) = (format!("rover-{}", n % 40), digest(n ^ now() as u32));
                let enrolled = enrolling
                    .credentials()
                    .enroll(&name, digest, now(), "test")
                    .await;
                enrolled.expect("a credential");
                acknowledge(&format!("credential {name} {:?}", digest.0));
            }
        });
        tasks.spawn(async move {
            let begin = now();
            for n in 0_i64.. {
                for k in 0..20 {
                    let sample = sample(&robot(k), n, begin + n);
                    records.history().push(sample).expect("room");
                }
                if n % 7 == 3 {
                    records.history().settle().await.expect("history");
                } else {
                    records.history().flush().await.expect("history");
                }
                acknowledge(&format!("history {}", begin + n));
            }
        });
        tasks.join_all().await;
    });
}

#[derive(Default)]
struct Acknowledged {
    audit: HashMap<u64, String>,
    credentials: HashMap<String, String>,
    history: Vec<i64>,
}

/// Runs the child and kills it when it has acknowledged so many things of this kind; adds what it
/// acknowledged. It writes on meanwhile, so that the kill comes at any moment of that.
fn run_and_kill(folder: &Folder, kind: &str, mut count: u64, known: &mut Acknowledged) {
    let mut child = Command::new(std::env::current_exe().expect("this test"))
        .args(["killed::child", "--exact", "--ignored", "--nocapture"])
        .env(DIRECTORY, folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("a process");
    let mut out = BufReader::new(child.stdout.take().expect("its output"));
    let mut line = String::new();
    while !line.ends_with("ack ready\n") {
        line.clear();
        assert!(out.read_line(&mut line).expect("text") > 0, "it died alone");
    }
    loop {
        line.clear();
        // A line without an end was cut off by the kill, and nobody could have read it.
        if out.read_line(&mut line).expect("text") == 0 || !line.ends_with('\n') {
            break;
        }
        let words: Vec<&str> = line.trim_end().splitn(4, ' ').collect();
        if words.get(1) == Some(&kind) && count > 0 {
            count -= 1;
            if count == 0 {
                child.kill().expect("to kill it");
            }
        }
        match words[..] {
            ["ack", "audit", seq, target] => {
                let before = known.audit.insert(seq.parse().unwrap(), target.into());
                assert_eq!(before, None, "entry {seq} was acknowledged twice");
            }
            ["ack", "credential", name, digest] => {
                known.credentials.insert(name.into(), digest.into());
            }
            ["ack", "history", at] => known.history.push(at.parse().unwrap()),
            _ => {}
        }
    }
    let status = child.wait().expect("its end");
    assert!(!status.success() && count == 0, "it ended by itself");
}

#[tokio::test]
async fn nothing_acknowledged_is_lost() {
    let folder = Folder::new();
    let mut known = Acknowledged::default();
    // The moments differ from run to run all the same: the child goes on until it is dead.
    let seed = 1_u64;
    let mut random = seed;
    for kill in 0..KILLS {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let kind = ["audit", "credential", "history"][kill as usize % 3];
        let count = 2 + (random >> 33) % 30;
        run_and_kill(&folder, kind, count, &mut known);
        if kill % 5 != 4 {
            continue;
        }
        let what = format!("seed {seed}, kill {kill}");
        let records = Records::open(folder.path()).await.expect(&what);
        let verified = records.audit().verify().await.expect(&what);
        assert!(verified >= known.audit.len() as u64, "{what}");
        for (&seq, target) in &known.audit {
            let page = records.audit().page(Some(seq + 1), 1, None).await.unwrap();
            assert_eq!(page[0].seq, seq, "{what}");
            assert_eq!(&page[0].entry.target, target, "{what}");
        }
        for (name, digest) in &known.credentials {
            let found = records.credentials().get(name).await.unwrap().expect(&what);
            // One that was written but not acknowledged any more may have taken its place; then
            // another one is there, and whole.
            let Digest(bytes) = found.digest;
            if format!("{bytes:?}") != *digest {
                assert_eq!(bytes[4..], [7; 28], "{what}");
            }
        }
        for &at in &known.history {
            for k in [0, 19] {
                let points = records.history().query(&robot(k), at, at + 1, 1).await;
                let count: u64 = points.unwrap().iter().map(|point| point.count).sum();
                assert!(count >= 1, "{what}: {at} of robot {k}");
            }
        }
        let stats = records.history().stats();
        assert_eq!((stats.damaged, stats.set_aside), (0, None), "{what}");
        assert!(stats.keeper, "{what}: the dead still hold the lock");
        records.close().await;
    }
    let counts = [
        known.audit.len(),
        known.credentials.len(),
        known.history.len(),
    ];
    println!("acknowledged and found after {KILLS} kills: {counts:?}");
    assert!(counts.iter().all(|&count| count > 10), "{counts:?}");
}
