//! Commands for robots that are away, and answers that do not come.

use std::path::PathBuf;

use crawler_protocol::ResponseStatus;

use super::tests::{MOVE, answer, center, give, id, sent, set};
use super::*;
use crawler_system::data::DataDir;

fn status(center: &CommandCenter, number: u64) -> OutcomeStatus {
    center.view(number).expect("known").status
}

#[test]
fn motion_for_a_robot_that_is_away_expires_and_a_setting_is_held() {
    let (wire, center) = center();
    let start = Instant::now();
    center.status(&id("a"), false, 3, start);
    let motion = give(&center, MOVE, start);
    let setting = give(&center, set(420.0), start);
    let later = start + Duration::from_secs(3);
    let over = center.sweep(later);
    assert_eq!(over.len(), 1);
    assert_eq!(status(&center, motion), OutcomeStatus::Expired);
    assert_eq!(status(&center, setting), OutcomeStatus::Pending);
    assert_eq!(sent(&wire), []);

    center.status(&id("a"), true, 4, later);
    let [command] = &sent(&wire)[..] else {
        panic!("the setting alone")
    };
    assert_eq!(command.action, set(420.0));
    let completed = answer("a", command.seq, ResponseStatus::Completed);
    assert!(center.answer(&completed, true, later).is_some());
    assert_eq!(status(&center, setting), OutcomeStatus::Completed);
    assert_eq!(center.totals().open, 0);
}

#[test]
fn what_is_held_goes_under_a_number_above_all_that_went() {
    let (wire, center) = center();
    let now = Instant::now();
    center.status(&id("a"), false, 3, now);
    let setting = give(&center, set(420.0), now);
    let stop = give(&center, Action::Stop, now);
    assert_eq!(sent(&wire).len(), 1, "the stop");
    center.answer(&answer("a", stop, ResponseStatus::Completed), true, now);
    center.status(&id("a"), true, 3, now);
    let command = &sent(&wire)[0];
    assert!(command.seq > stop, "{} after {stop}", command.seq);
    let view = center.view(setting).expect("known");
    assert_eq!((view.id, view.seq), (setting.to_string(), command.seq));
    let accepted = answer("a", command.seq, ResponseStatus::Accepted);
    let completed = answer("a", command.seq, ResponseStatus::Completed);
    center.answer(&accepted, true, now);
    center.answer(&completed, true, now);
    assert_eq!(status(&center, setting), OutcomeStatus::Completed);
}

#[test]
fn silence_is_asked_again_under_the_same_number() {
    let (wire, center) = center();
    let start = Instant::now();
    let number = give(&center, Action::Identify, start);
    for second in 1..=4 {
        center.sweep(start + Duration::from_secs(second));
    }
    let commands = sent(&wire);
    assert!(commands.iter().all(|command| command.seq == number));
    assert_eq!(commands.len(), 4, "at 0, 1, 2 and 4 seconds");
    center.sweep(start + Duration::from_secs(5));
    assert_eq!(status(&center, number), OutcomeStatus::Timeout);
    let late = start + Duration::from_secs(9);
    center.answer(&answer("a", number, ResponseStatus::Completed), true, late);
    assert_eq!(status(&center, number), OutcomeStatus::Completed);
    center.sweep(start + Duration::from_secs(50));
    assert_eq!(sent(&wire), []);
}

#[test]
fn without_a_broker_settings_are_taken_and_go_when_it_is_back() {
    let (wire, center) = center();
    let now = Instant::now();
    *wire.broken.lock().expect("lock") = Some(PublishError::NotConnected);
    center.connection(false, now);
    let refused = center.send(MOVE, Target::Robot(id("a")), [id("a")], now);
    assert_eq!(refused.map(|view| view.seq), Err(SendError::NotConnected));
    let setting = give(&center, set(500.0), now);
    center.sweep(now);
    assert_eq!(sent(&wire), []);
    *wire.broken.lock().expect("lock") = None;
    center.connection(true, now);
    center.sweep(now);
    assert_eq!(sent(&wire)[0].seq, setting);
}

#[test]
fn a_swarm_setting_goes_to_each_robot_by_itself() {
    let (wire, center) = center();
    let now = Instant::now();
    let robots = ["a", "b"].map(id);
    let view = center.send(set(500.0), Target::Swarm, robots, now);
    let number = view.expect("sent").seq;
    let topics: Vec<Topic> = wire
        .sent
        .lock()
        .expect("lock")
        .iter()
        .map(|(topic, _)| topic.clone())
        .collect();
    assert_eq!(
        topics,
        ["a", "b"].map(|robot| Topic::CommandRobot(id(robot)))
    );
    for robot in ["a", "b"] {
        center.answer(&answer(robot, number, ResponseStatus::Completed), true, now);
    }
    assert_eq!(status(&center, number), OutcomeStatus::Completed);
}

#[test]
fn who_did_not_hear_the_swarm_command_gets_it_alone() {
    let (wire, center) = center();
    let start = Instant::now();
    let view = center.send(Action::Identify, Target::Swarm, ["a", "b"].map(id), start);
    let number = view.expect("sent").seq;
    center.answer(&answer("a", number, ResponseStatus::Completed), true, start);
    wire.sent.lock().expect("lock").clear();
    center.sweep(start + Duration::from_secs(1));
    let sent = wire.sent.lock().expect("lock");
    assert_eq!(sent.len(), 1);
    assert_eq!(sent[0].0, Topic::CommandRobot(id("b")));
    assert_eq!(Command::parse(&sent[0].1).expect("a command").seq, number);
}

/// Ends what writes the journal.
fn end(center: &CommandCenter) {
    let mut runtime = tokio::runtime::Builder::new_current_thread();
    runtime.build().expect("a runtime").block_on(center.close());
}

#[test]
fn what_is_owed_survives_a_crash() {
    let folder: PathBuf = std::env::temp_dir().join(format!("crawler-owed-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&folder);
    let data = || Arc::new(DataDir::open(&folder).expect("a folder"));
    let with_journal = |center: CommandCenter, now| {
        let data = data();
        let journal = Journal::of(&data).expect("a journal");
        center.with_journal(journal, &data, now).expect("a thread")
    };
    let now = Instant::now();
    let (held, reboot) = {
        let (wire, center) = center();
        let center = with_journal(center, now);
        center.status(&id("a"), false, 3, now);
        center.status(&id("b"), true, 7, now);
        let held = give(&center, set(420.0), now);
        let view = center.send(Action::Reboot, Target::Robot(id("b")), [id("b")], now);
        assert_eq!(sent(&wire).len(), 1);
        let kept = std::fs::read(folder.join("commands")).expect("a file");
        end(&center);
        // As if there had been no good-bye.
        std::fs::write(folder.join("commands"), kept).expect("a file");
        (held, view.expect("sent").seq)
    };
    let (wire, center) = center();
    let center = with_journal(center, now);
    assert_eq!(status(&center, held), OutcomeStatus::Pending);
    center.sweep(now);
    assert_eq!(sent(&wire), [], "nobody knows yet who is there");
    // It has done it: its program is another.
    center.status(&id("b"), true, 8, now);
    center.status(&id("a"), true, 3, now);
    let commands = sent(&wire);
    assert_eq!(commands.len(), 1);
    assert_eq!(commands[0].action, set(420.0));
    assert_eq!(status(&center, reboot), OutcomeStatus::Timeout);
    center.answer(
        &answer("a", commands[0].seq, ResponseStatus::Completed),
        true,
        now,
    );
    assert_eq!(status(&center, held), OutcomeStatus::Completed);
    end(&center);
    let journal = Journal::of(&data()).expect("a journal");
    assert_eq!(journal.owed().count(), 0);
    std::fs::remove_dir_all(folder).expect("clean up");
}
