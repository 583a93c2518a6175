use crawler_hal::Duration;
use crawler_protocol::{Action, BehaviourSpec};

use super::*;
use crate::faults::Fault;
use crate::net::lockstep::Cut;
use crate::run::SimulationError;
use crate::world::{DropError, Dropped, Obstacle};

fn scenario() -> Scenario {
    Scenario::built_in("arena").expect("there").with_robots(4)
}

/// A world that something happened to, at moments on and off the seconds.
fn eventful(link: Link) -> Simulation {
    let mut simulation = Simulation::linked(link, scenario(), 7).expect("sound");
    let ms = Instant::from_millis;
    simulation.submit(1, Action::Stop);
    simulation.run_until(ms(5_500));
    simulation.submit_all(Action::Behave(BehaviourSpec::Wander { speed: 60 }));
    simulation.run_until(ms(5_500));
    simulation.cut(1, Cut::Silent);
    simulation.submit_raw(2, b"\xFF not a command");
    simulation.run_until(ms(6_000));
    simulation.remove(0);
    let at = simulation.pose(1).expect("it is there");
    let (x, y) = (at.x * 0.5, at.y * 0.5);
    // Where robots are, so that it matters; perhaps on one, which must fail alike again.
    let posts = [(x, y, 0.2), (-x, y, 0.15), (at.x, at.y, 0.1), (x, -y, 0.25)];
    let mut dropped = posts.map(|(x, y, r)| {
        let post = Dropped::Obstacle(Obstacle::Circle { x, y, r });
        simulation.drop_in(post)
    });
    assert!(
        matches!(dropped[2], Err(DropError::OnRobot(_))),
        "{dropped:?}"
    );
    dropped.sort_by_key(Result::is_err);
    assert!(dropped[0].is_ok(), "{dropped:?}");
    simulation.spawn().expect("there is room");
    simulation.run_until(ms(7_250));
    simulation
        .inject(2, Fault::RangerDead, None)
        .expect("sound");
    simulation.cut(1, Cut::None);
    simulation.run_until(ms(8_001));
    simulation.crash(3, "src/x.rs:1: tired");
    let first = dropped[0].expect("the first that could be");
    assert!(simulation.take_away(first) && !simulation.take_away(first));
    simulation.run_until(ms(9_137));
    simulation
}

#[test]
fn a_restored_world_is_the_same_and_goes_on_the_same() {
    for link in [Link::Lockstep, Link::None] {
        let mut simulation = eventful(link);
        let snapshot = Snapshot::of(&simulation).expect("complete");
        let read = Snapshot::from_bytes(&snapshot.to_bytes().expect("fits")).expect("reads");
        assert_eq!(read, snapshot);
        let mut again = read.restore().expect("the same program");
        assert_eq!(again.now(), simulation.now());
        assert_eq!(again.history_hash(), simulation.history_hash());
        assert_eq!(Snapshot::of(&again).expect("complete"), snapshot);
        assert_eq!(again.world().arena(), simulation.world().arena());
        assert_eq!(again.world().dropped(), simulation.world().dropped());
        for simulation in [&mut simulation, &mut again] {
            simulation.submit(1, Action::Stop);
            simulation.run_for(Duration::from_secs(4));
        }
        assert_eq!(again.history_hash(), simulation.history_hash());
        assert_eq!(again.second_hashes(), simulation.second_hashes());
        assert_eq!(again.second_hashes().len(), 13);
    }
}

#[test]
fn another_world_is_refused_with_the_second_in_which_it_parts() {
    let snapshot = Snapshot::of(&eventful(Link::Lockstep)).expect("complete");
    let second = |snapshot: &Snapshot| match snapshot.restore() {
        Err(RestoreError::Differs { second, .. }) => second,
        other => panic!("{other:?}"),
    };
    let mut other_seed = snapshot.clone();
    other_seed.seed += 1;
    assert_eq!(second(&other_seed), 1);
    let mut forgotten = snapshot.clone();
    let cut = |entry: &Entry| matches!(entry.input, crate::run::journal::Input::Remove { .. });
    forgotten.entries.retain(|entry| !cut(entry));
    assert_eq!(
        second(&forgotten),
        7,
        "the robot went at the end of second 6"
    );
    let mut later = snapshot.clone();
    later.at += Duration::from_millis(1);
    assert_eq!(second(&later), 10);
}

#[test]
fn bytes_that_are_no_snapshot_are_refused() {
    let snapshot = Snapshot::of(&eventful(Link::None)).expect("complete");
    let good = snapshot.to_bytes().expect("fits");
    let refused = |bytes: &[u8]| match Snapshot::from_bytes(bytes) {
        Err(RestoreError::File(text)) => text,
        other => panic!("{other:?}"),
    };
    assert!(refused(b"").contains("first line"));
    assert!(refused(b"\n").contains("does not begin"));
    assert!(refused(&[0xFF; 100]).contains("first line"));
    assert!(refused(b"terracrawler-snapshot 2 0\n{}").contains("version 2"));
    assert!(refused(b"terracrawler-snapshot x 0\n{}").contains("version"));
    for at in (0..good.len()).step_by(37) {
        let mut bytes = good.clone();
        bytes[at] ^= 0x11;
        assert!(Snapshot::from_bytes(&bytes).is_err(), "byte {at}");
        assert!(Snapshot::from_bytes(&good[..at]).is_err(), "cut at {at}");
    }
    // Sound fingerprints over unsound contents.
    let body = |change: &dyn Fn(&mut serde_json::Value)| {
        let at = good.iter().position(|&byte| byte == b'\n').expect("a line") + 1;
        let mut value = serde_json::from_slice(&good[at..]).expect("JSON");
        change(&mut value);
        let body = serde_json::to_vec(&value).expect("writes");
        let mut print = crate::world::Fingerprint::new();
        print.bytes(&body);
        let mut bytes = format!("terracrawler-snapshot 1 {:016x}\n", print.value()).into_bytes();
        bytes.extend(body);
        bytes
    };
    assert!(Snapshot::from_bytes(&body(&|_| {})).is_ok());
    let endless = body(&|value| value["at_us"] = u64::MAX.into());
    assert!(refused(&endless).contains("do not go together"));
    let backwards = body(&|value| {
        let journal = value["journal"].as_array_mut().expect("an array");
        journal.reverse();
    });
    assert!(refused(&backwards).contains("out of order"));
    let crowded = body(&|value| value["scenario"] = "name='x'\nrobots=99999".into());
    assert!(refused(&crowded).contains("robots"));
    let more = body(&|value| value["more"] = 1.into());
    assert!(refused(&more).contains("more"));
}

#[test]
fn a_world_whose_journal_has_gaps_cannot_be_kept() {
    let mut simulation = Simulation::lockstep(scenario(), 1).expect("sound");
    simulation.require_credentials(Some(("rover", "open sesame")));
    assert_eq!(Snapshot::of(&simulation), Err(SnapshotError::Withheld(1)));
    let mut crowded = Simulation::lockstep(scenario(), 1).expect("sound");
    for _ in 0..=crate::run::journal::MAX_ENTRIES {
        crowded.cut(0, Cut::None);
    }
    assert_eq!(Snapshot::of(&crowded), Err(SnapshotError::Lost(1)));
}

#[test]
fn a_robot_that_finds_no_room_is_part_of_the_story() {
    let mut simulation = Simulation::lockstep(scenario(), 3).expect("sound");
    let taken = simulation.observe(0).expect("there").pose;
    let refused = simulation.spawn_at(taken);
    assert!(matches!(refused, Err(SimulationError::Placement(_))));
    simulation.run_for(Duration::from_millis(1_500));
    simulation.spawn().expect("there is room");
    simulation.run_for(Duration::from_millis(1_500));
    let again = Snapshot::of(&simulation).expect("complete").restore();
    let again = again.expect("the same");
    assert_eq!(again.history_hash(), simulation.history_hash());
    assert_eq!(again.robots(), 5);
}
