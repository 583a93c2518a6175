//! A disk that is slow or full, and who waits for it.

use std::path::PathBuf;
use std::task::Poll;

use crawler_protocol::ResponseStatus;
use futures_util::poll;

use super::tests::{MOVE, Wire, answer, center, id, set};
use super::*;
use crawler_system::data::DataDir;
use crawler_system::data::test_disk::{LIMIT, TestDisk};

/// Commands on a disk that the test has in its hand.
struct Scene {
    center: CommandCenter,
    wire: Arc<Wire>,
    disk: TestDisk,
    folder: PathBuf,
}

impl Scene {
    fn new(name: &str) -> Self {
        let name = format!("crawler-slow-disk-{name}-{}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        let _ = std::fs::remove_dir_all(&folder);
        let disk = TestDisk::default();
        let data = DataDir::open_on(&folder, disk.handle()).expect("a directory");
        let data = Arc::new(data);
        let journal = Journal::of(&data).expect("a journal");
        let (wire, center) = center();
        let center = center.with_journal(journal, &data, Instant::now());
        Self {
            center: center.expect("a thread"),
            wire,
            disk,
            folder,
        }
    }

    async fn give(&self, action: Action) -> Result<CommandView, SendError> {
        let target = Target::Robot(id("a"));
        let given = self.center.give(None, action, target, vec![id("a")]);
        tokio::time::timeout(LIMIT, given).await.expect("an answer")
    }

    /// What has gone out since this was asked last.
    fn sent(&self) -> Vec<Action> {
        let sent = std::mem::take(&mut *self.wire.sent.lock().expect("lock"));
        let commands = sent.iter();
        commands
            .map(|(_, payload)| Command::parse(payload).expect("a command").action)
            .collect()
    }

    fn file(&self) -> String {
        std::fs::read_to_string(self.folder.join("commands")).expect("a file")
    }

    async fn eventually(&self, what: &str, mut holds: impl FnMut() -> bool) {
        let end = Instant::now() + LIMIT;
        while !holds() {
            assert!(
                Instant::now() < end,
                "not within {LIMIT:?}: {what}; in the file: {}",
                self.file()
            );
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        self.disk.release();
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// On one thread: whatever waits for the disk on it holds up everything else here, and the test.
#[tokio::test]
async fn halts_and_motion_wait_for_no_disk() {
    let scene = Scene::new("held");
    let center = &scene.center;
    let now = Instant::now();
    center.status(&id("a"), true, 3, now);
    scene.disk.hold();
    let mut setting = Box::pin(scene.give(set(420.0)));
    assert_eq!(poll!(setting.as_mut()), Poll::Pending);
    scene.disk.wait_for_sync();
    let [sent] = &scene.sent()[..] else {
        panic!("it goes at once")
    };
    assert_eq!(*sent, set(420.0));

    for action in [Action::Stop, Action::Estop] {
        scene.give(action.clone()).await.expect("sent");
        assert_eq!(scene.sent(), [action]);
    }
    center.sweep(now);
    center.heard(&id("a"), now);
    // The robot answers, and makes way for what comes after.
    let seq = center.newest(None, false, 10).last().expect("known").seq;
    center.answer(&answer("a", seq, ResponseStatus::Completed), true, now);
    for open in center.newest(None, false, 10) {
        center.answer(&answer("a", open.seq, ResponseStatus::Completed), true, now);
    }
    scene.give(MOVE).await.expect("sent");
    assert_eq!(scene.sent(), [MOVE]);

    assert_eq!(poll!(setting.as_mut()), Poll::Pending, "nobody is told yet");
    scene.disk.release();
    let view = setting.await.expect("written");
    assert!(scene.file().contains(&view.id), "{}", scene.file());
}

#[tokio::test]
async fn who_hangs_up_tears_nothing() {
    let scene = Scene::new("hung-up");
    scene.disk.hold();
    for value in [410.0, 420.0] {
        let mut given = Box::pin(scene.give(set(value)));
        assert_eq!(poll!(given.as_mut()), Poll::Pending);
    }
    let mut third = Box::pin(scene.give(set(430.0)));
    assert_eq!(poll!(third.as_mut()), Poll::Pending);
    scene.disk.release();
    third.await.expect("written");
    assert_eq!(scene.file().lines().count(), 3, "{}", scene.file());
}

/// A command that waited gets a new number, which must be on the disk first. A stop does not wait with it.
#[tokio::test]
async fn a_stop_passes_a_command_whose_number_is_not_written() {
    let scene = Scene::new("number");
    let center = &scene.center;
    let now = Instant::now();
    center.status(&id("a"), false, 3, now);
    let setting = scene.give(set(420.0)).await.expect("held");
    let stop = scene.give(Action::Stop).await.expect("sent");
    center.answer(&answer("a", stop.seq, ResponseStatus::Completed), true, now);
    assert_eq!(scene.sent(), [Action::Stop]);

    scene.disk.hold();
    center.status(&id("a"), true, 3, now);
    scene.disk.wait_for_sync();
    center.sweep(now);
    assert_eq!(scene.sent(), [], "its number is not on the disk");
    scene.give(Action::Stop).await.expect("sent");
    assert_eq!(scene.sent(), [Action::Stop]);
    scene.disk.release();
    scene
        .eventually("the setting goes", || {
            center.sweep(now);
            scene.sent() == [set(420.0)]
        })
        .await;
    let number: u64 = setting.id.parse().expect("a number");
    let seq = center.view(number).expect("known").seq;
    assert!(seq > stop.seq, "{seq} after {}", stop.seq);
    assert!(
        scene.file().contains(&format!("\"seq\":{seq}")),
        "{}",
        scene.file()
    );
}

#[tokio::test]
async fn a_full_disk_refuses_what_must_outlive_the_server() {
    let scene = Scene::new("full");
    let center = &scene.center;
    let now = Instant::now();
    center.status(&id("a"), false, 3, now);
    scene.disk.set_full(true);
    // Found out with the first; it has not gone and does not go later.
    let sent = false;
    for _ in 0..2 {
        let refused = scene.give(set(420.0)).await;
        assert_eq!(refused, Err(SendError::NotWritten { sent }));
    }
    assert!(!center.is_written());
    assert_eq!(center.totals().open, 0);
    assert_eq!(center.totals().sent, 0);
    let stop = scene.give(Action::Stop).await.expect("sent");
    center.answer(&answer("a", stop.seq, ResponseStatus::Completed), true, now);
    center.status(&id("a"), true, 3, now);
    center.sweep(now);
    assert_eq!(scene.sent(), [Action::Stop]);

    scene.disk.set_full(false);
    scene.eventually("room again", || center.is_written()).await;
    let view = scene.give(set(430.0)).await.expect("written");
    assert_eq!(scene.file().lines().count(), 1, "{}", scene.file());
    assert!(scene.file().contains(&view.id), "{}", scene.file());
}

/// What has gone before the disk failed cannot be taken back, and whoever gave it is told.
#[tokio::test]
async fn what_has_gone_before_the_disk_failed_is_told() {
    let scene = Scene::new("gone");
    let now = Instant::now();
    scene.center.status(&id("a"), true, 3, now);
    scene.disk.set_full(true);
    let sent = true;
    assert_eq!(
        scene.give(set(420.0)).await,
        Err(SendError::NotWritten { sent })
    );
    assert_eq!(scene.sent(), [set(420.0)]);
    assert_eq!(scene.center.totals().open, 1, "it is followed");
}
