//! What disks do to the journal: they are slow, they fail, and the power goes.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crawler_protocol::{Action, Source};
use proptest::prelude::*;

use super::super::pending::Store as _;
use super::queue::Lines;
use super::writer::Writer;
use super::*;
use crawler_metrics::Metrics;
use crawler_system::data::DataDir;
use crawler_system::data::test_disk::{LIMIT, TestDisk};

struct Scratch(PathBuf);

impl Scratch {
    fn new(name: &str) -> Self {
        let name = format!("crawler-slow-journal-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let _ = fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn owed(id: u64, robots: u8) -> JournalEntry {
    let command = Command {
        action: Action::Identify,
        timestamp: 5,
        seq: id,
        source: Source::new("server").expect("source"),
    };
    let robots = (0..robots).map(|robot| (robot_id(robot), Some(3)));
    let record = Record::new(command, Target::Swarm, [], Instant::now());
    JournalEntry::new(&record, 99, robots).expect("a command")
}

fn robot_id(robot: u8) -> RobotId {
    RobotId::new(&format!("r-{robot}")).expect("robot id")
}

fn start(scratch: &Scratch, disk: &TestDisk) -> (JournalQueue, PathBuf) {
    let data = Arc::new(DataDir::open_on(&scratch.0, disk.handle()).expect("a directory"));
    let path = data.file("commands");
    let journal = Journal::open(&path, data.disk()).expect("a journal");
    let queue = journal.start(data, "numbers", Arc::new(Metrics::new()));
    (queue.expect("a thread"), path)
}

fn eventually(what: &str, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + LIMIT;
    while !holds() {
        assert!(Instant::now() < end, "not within {LIMIT:?}: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn commands_that_wait_together_are_written_together() {
    const MANY: u64 = 200;
    let scratch = Scratch::new("together");
    let disk = TestDisk::default();
    let (mut queue, path) = start(&scratch, &disk);
    disk.hold();
    let mut tickets = vec![queue.accepted(owed(1, 1)).expect("a ticket")];
    disk.wait_for_sync();
    let before = disk.begun();
    tickets.extend((2..=MANY).filter_map(|id| queue.accepted(owed(id, 1))));
    assert!(tickets.iter_mut().all(|ticket| ticket.decided().is_none()));
    disk.release();
    assert!(tickets.into_iter().all(Ticket::wait));
    // One for all those that waited while the first was written.
    assert_eq!(disk.begun() - before, 1);
    let text = fs::read_to_string(&path).expect("a file");
    assert_eq!(text.lines().count() as u64, MANY);
}

#[test]
fn what_waits_is_bounded() {
    let scratch = Scratch::new("bounded");
    let disk = TestDisk::default();
    let (mut queue, _) = start(&scratch, &disk);
    disk.hold();
    let first = queue.accepted(owed(1, 1)).expect("a ticket");
    disk.wait_for_sync();
    assert_eq!(queue.check(1_000_000), Ok(()), "one alone always goes");
    let mut waiting = Vec::new();
    while queue.check(200) == Ok(()) {
        let id = waiting.len() as u64 + 2;
        waiting.extend(queue.accepted(owed(id, 200)));
        assert!(waiting.len() <= 250, "no end");
    }
    assert_eq!(queue.check(200), Err(Refused::Full));
    disk.release();
    assert!(first.wait() && waiting.into_iter().all(Ticket::wait));
    assert_eq!(queue.check(200), Ok(()));
}

#[test]
fn a_full_disk_refuses_and_takes_again_when_there_is_room() {
    let scratch = Scratch::new("full");
    let disk = TestDisk::default();
    let (mut queue, path) = start(&scratch, &disk);
    assert!(queue.accepted(owed(1, 2)).expect("a ticket").wait());
    disk.set_full(true);
    assert!(!queue.accepted(owed(2, 1)).expect("a ticket").wait());
    assert_eq!(queue.check(1), Err(Refused::Failing));
    // What is known of earlier commands is not lost with that.
    queue.done(1, &robot_id(0));
    assert_eq!(queue.reserved(1, &robot_id(1), 0), None);
    assert!(queue.may_go(1, &robot_id(1), 7, Some(4)), "it was accepted");
    disk.set_full(false);
    eventually("room again", || queue.check(1) == Ok(()));
    assert_eq!(queue.reserved(1, &robot_id(1), 0), Some(7));
    assert!(queue.may_go(1, &robot_id(1), 7, Some(4)));
    assert!(queue.accepted(owed(3, 1)).expect("a ticket").wait());
    let journal = Journal::open(&path, &Disk::default()).expect("a journal");
    assert_eq!(journal.ids(), [1, 3], "not what was refused");
    let legs = &journal.owed().next().expect("the first").robots;
    let (seq, boot) = (7, Some(4));
    let left = BTreeMap::from([("r-1".to_owned(), Leg { seq, boot })]);
    assert_eq!(*legs, left);
}

#[test]
fn nothing_counts_as_written_before_its_number_is_kept_free() {
    let scratch = Scratch::new("free");
    let disk = TestDisk::default();
    let (mut queue, _) = start(&scratch, &disk);
    let numbers = scratch.0.join("numbers");
    disk.hold();
    queue.lines().reserve(500);
    let mut ticket = queue.accepted(owed(499, 1)).expect("a ticket");
    disk.wait_for_sync();
    assert_eq!(ticket.decided(), None);
    assert!(!numbers.exists());
    disk.release();
    assert!(ticket.wait());
    assert_eq!(fs::read_to_string(numbers).expect("a file"), "500\n");
}

#[test]
fn the_end_writes_what_waits() {
    let scratch = Scratch::new("end");
    let disk = TestDisk::default();
    let (mut queue, path) = start(&scratch, &disk);
    disk.hold();
    let ticket = queue.accepted(owed(1, 1)).expect("a ticket");
    queue.done(1, &robot_id(0));
    // Of what is not in it nothing is said.
    queue.done(2, &robot_id(0));
    let ended = queue.lines().end();
    assert_eq!(queue.check(1), Err(Refused::Failing), "nobody writes it");
    disk.wait_for_sync();
    assert!(!ended.is_cancelled());
    disk.release();
    assert!(ticket.wait());
    eventually("the end", || ended.is_cancelled());
    let text = fs::read_to_string(&path).expect("a file");
    assert_eq!(text.lines().count(), 2, "{text}");
    let journal = Journal::open(&path, &Disk::default()).expect("a journal");
    assert_eq!(journal.ids(), [0; 0]);
}

/// What happens to a journal, one after the other.
#[derive(Debug, Clone)]
enum Step {
    Accept(u8),
    Number(usize, u8),
    Done(usize, u8),
    /// The thread writes what waits; the disk takes it or not.
    Write(bool),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (1_u8..4).prop_map(Step::Accept),
        1 => (any::<usize>(), 0_u8..4).prop_map(|(id, robot)| Step::Number(id, robot)),
        2 => (any::<usize>(), 0_u8..4).prop_map(|(id, robot)| Step::Done(id, robot)),
        3 => prop::bool::weighted(0.8).prop_map(Step::Write),
    ]
}

/// What whoever gives commands knows of them.
#[derive(Debug, Clone, Default)]
struct Known {
    /// Told to be safe, and what is not done of them.
    safe: BTreeMap<u64, BTreeSet<u8>>,
    /// Told not to be.
    refused: BTreeSet<u64>,
    /// Numbers that commands may go under.
    numbers: BTreeMap<(u64, u8), u64>,
}

impl Known {
    /// Holds what a crash left against it.
    fn check(&self, left: &Journal, failing: bool) {
        for (id, robots) in &self.safe {
            for robot in robots {
                let owed = left.owed.get(id).map(|owed| &owed.robots);
                let name = robot_id(*robot);
                let leg = owed.and_then(|robots| robots.get(name.as_str()));
                let leg = leg.unwrap_or_else(|| panic!("{id} to {name} is lost"));
                if let Some(seq) = self.numbers.get(&(*id, *robot)) {
                    assert_eq!(leg.seq, *seq, "{id} to {name}");
                }
            }
        }
        // Until the next write that succeeds nobody can say what a failing disk has kept.
        let back = left.ids().into_iter().find(|id| self.refused.contains(id));
        assert!(failing || back.is_none(), "{back:?} was refused");
    }
}

fn crash(path: &Path, bytes: &[u8], known: &Known, failing: bool) {
    let copy = path.with_extension("copy");
    fs::write(&copy, bytes).expect("a copy");
    known.check(
        &Journal::open(&copy, &Disk::default()).expect("a journal"),
        failing,
    );
}

fn live(scratch: &Scratch, steps: Vec<Step>, cut: prop::sample::Index) {
    let _ = fs::remove_dir_all(&scratch.0);
    let disk = TestDisk::default();
    let data = Arc::new(DataDir::open_on(&scratch.0, disk.handle()).expect("a directory"));
    let path = data.file("commands");
    let lines = Arc::new(Lines::default());
    let journal = Journal::open(&path, data.disk()).expect("a journal");
    let mut queue = JournalQueue::new(Arc::clone(&lines), journal.owed());
    let mut writer = Writer {
        journal,
        data,
        numbers: "numbers",
        reserve: None,
        metrics: Arc::new(Metrics::new()),
    };
    let mut known = Known::default();
    let mut waiting: BTreeMap<u64, (Ticket, BTreeSet<u8>)> = BTreeMap::new();
    let (mut next, mut synced) = (1, 0);
    let pick = |known: &Known, at: usize| {
        let ids: Vec<u64> = known.safe.keys().copied().collect();
        ids.get(at % ids.len().max(1)).copied()
    };
    for step in steps {
        match step {
            Step::Accept(robots) => {
                if queue.check(robots.into()).is_ok() {
                    let ticket = queue.accepted(owed(next, robots)).expect("a ticket");
                    waiting.insert(next, (ticket, (0..robots).collect()));
                    next += 1;
                }
            }
            Step::Number(at, robot) => {
                if let Some(id) = pick(&known, at) {
                    let seq = queue.reserved(id, &robot_id(robot), 0).unwrap_or(next);
                    next += 1;
                    let may_go = queue.may_go(id, &robot_id(robot), seq, Some(3));
                    if may_go && !lines.is_failing() {
                        known.numbers.insert((id, robot), seq);
                    }
                }
            }
            Step::Done(at, robot) => {
                if let Some(id) = pick(&known, at)
                    && let Some(robots) = known.safe.get_mut(&id)
                {
                    robots.remove(&robot);
                    queue.done(id, &robot_id(robot));
                }
            }
            Step::Write(fits) => {
                let (before, told) = (fs::read(&path).expect("a file"), known.clone());
                let syncs = disk.begun();
                disk.set_full(!fits);
                writer.step(lines.next(Some(Duration::ZERO)), &lines);
                for (id, (mut ticket, robots)) in std::mem::take(&mut waiting) {
                    match ticket.decided() {
                        Some(true) => drop(known.safe.insert(id, robots)),
                        Some(false) => drop(known.refused.insert(id)),
                        None => panic!("nobody says what became of {id}"),
                    }
                }
                assert_eq!(lines.is_failing(), !fits && disk.begun() > syncs);
                let after = fs::read(&path).expect("a file");
                if after.starts_with(&before) {
                    // The power goes while it is written: somewhere behind what was synced.
                    let cut = synced + cut.index(after.len() - synced + 1);
                    crash(&path, &after[..cut], &told, true);
                }
                if fits && (disk.begun() > syncs || !after.starts_with(&before)) {
                    synced = after.len();
                } else if !after.starts_with(&before) {
                    synced = synced.min(after.len());
                }
            }
        }
        let bytes = fs::read(&path).expect("a file");
        let cut = synced + cut.index(bytes.len() - synced + 1);
        crash(&path, &bytes[..cut], &known, lines.is_failing());
    }
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]

    /// Whatever comes between giving a command and its crash: what somebody was told to be safe is owed
    /// by the next start, under the number that it may have gone under.
    #[test]
    fn nothing_that_was_accepted_is_lost(
        steps in prop::collection::vec(step(), 1..40),
        cut in any::<prop::sample::Index>(),
    ) {
        live(&Scratch::new("crash"), steps, cut);
    }
}
