use std::time::Instant;

use crawler_protocol::{Action, Source};

use super::*;

fn scratch(name: &str) -> PathBuf {
    let folder =
        std::env::temp_dir().join(format!("crawler-journal-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder.join("commands")
}

fn owed(seq: u64, robots: &[&str]) -> JournalEntry {
    let command = Command {
        action: Action::Identify,
        timestamp: 5,
        seq,
        source: Source::new("server").expect("source"),
    };
    let target = match robots {
        [robot] => Target::Robot(id(robot)),
        _ => Target::Swarm,
    };
    let record = Record::new(command, target, [], Instant::now());
    let robots = robots.iter().map(|robot| (id(robot), Some(3)));
    JournalEntry::new(&record, 99, robots).expect("a command")
}

fn id(text: &str) -> RobotId {
    RobotId::new(text).expect("robot id")
}

fn open(path: &Path) -> io::Result<Journal> {
    Journal::open(path, &Disk::default())
}

fn accept(journal: &mut Journal, owed: JournalEntry) {
    journal.write(vec![Line::Accepted(owed)]).expect("written");
}

fn numbered(journal: &mut Journal, command: u64, robot: &RobotId, seq: u64, boot: Option<u32>) {
    let robot = robot.as_str().to_owned();
    let leg = Leg { seq, boot };
    let id = command;
    let line = Line::Numbered { id, robot, leg };
    journal.write(vec![line]).expect("written");
}

fn done(journal: &mut Journal, command: u64, robot: &RobotId) {
    let robot = robot.as_str().to_owned();
    let line = Line::Done { id: command, robot };
    journal.write(vec![line]).expect("written");
}

fn all(journal: &Journal) -> Vec<(u64, Vec<(String, u64)>)> {
    let legs = |owed: &JournalEntry| -> Vec<_> {
        let legs = owed.robots.iter();
        legs.map(|(robot, leg)| (robot.clone(), leg.seq)).collect()
    };
    journal.owed().map(|owed| (owed.id, legs(owed))).collect()
}

/// Wherever a crash cuts the file, what was accepted before is still there, and nothing that
/// was not.
#[test]
fn a_file_cut_anywhere_tells_what_was_on_it() {
    let path = scratch("cut");
    let mut journal = open(&path).expect("open");
    let mut states = vec![(0, all(&journal))];
    let length = || fs::metadata(&path).expect("file").len() as usize;
    accept(&mut journal, owed(7, &["a", "b"]));
    states.push((length(), all(&journal)));
    numbered(&mut journal, 7, &id("b"), 12, Some(4));
    states.push((length(), all(&journal)));
    done(&mut journal, 7, &id("a"));
    states.push((length(), all(&journal)));
    accept(&mut journal, owed(13, &["a"]));
    states.push((length(), all(&journal)));
    done(&mut journal, 7, &id("b"));
    states.push((length(), all(&journal)));
    done(&mut journal, 99, &id("b"));
    states.push((length(), all(&journal)));
    assert_eq!(all(&journal), [(13, vec![("a".to_owned(), 13)])]);
    drop(journal);
    let whole = fs::read(&path).expect("read");
    for cut in 0..=whole.len() {
        fs::write(&path, &whole[..cut]).expect("write");
        let journal = open(&path).expect("open");
        // A line counts with or without its end.
        let known = states
            .iter()
            .rev()
            .find(|(at, _)| at.saturating_sub(1) <= cut);
        assert_eq!(all(&journal), known.expect("a state").1, "cut at {cut}");
    }
    fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
}

#[test]
fn it_is_rewritten_before_it_is_long_and_refuses_what_is_huge() {
    let path = scratch("long");
    let mut journal = open(&path).expect("open");
    accept(&mut journal, owed(1, &["kept"]));
    for number in 2..5_000 {
        accept(&mut journal, owed(number, &["a"]));
        done(&mut journal, number, &id("a"));
    }
    let lines = fs::read_to_string(&path).expect("read").lines().count();
    assert!(lines <= MANY + 2, "{lines} lines");
    drop(journal);
    let journal = open(&path).expect("open");
    assert_eq!(all(&journal), [(1, vec![("kept".to_owned(), 1)])]);
    assert_eq!(
        journal
            .owed()
            .next()
            .and_then(|owed| owed.command.command())
            .map(|c| c.action),
        Some(Action::Identify)
    );
    drop(journal);
    File::create(&path)
        .and_then(|file| file.set_len(MAX_BYTES + 1))
        .expect("grow");
    assert!(open(&path).is_err());
    fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
}

#[test]
fn garbage_between_lines_costs_only_itself() {
    let path = scratch("garbage");
    let mut journal = open(&path).expect("open");
    accept(&mut journal, owed(1, &["a"]));
    drop(journal);
    let mut bytes = fs::read(&path).expect("read");
    let good = bytes.clone();
    bytes.extend_from_slice(b"\xff\x00nonsense\n{\"accepted\":{\"id\":3}}\n");
    bytes.extend_from_slice(
        &String::from_utf8(good)
            .expect("text")
            .replace(":1,", ":2,")
            .into_bytes(),
    );
    fs::write(&path, bytes).expect("write");
    let journal = open(&path).expect("open");
    let ids: Vec<u64> = journal.owed().map(|owed| owed.id).collect();
    assert_eq!(ids, [1, 2]);
    fs::remove_dir_all(path.parent().expect("folder")).expect("clean up");
}
