//! What servers do with a rollout: send, stop, come back, take over.

use crawler_updates::rollout::{
    Command, Document, Event, Grant, LoadError, Now, Owner, PlanError, Reason, ReleaseId, Report,
    Rollout, ServerId, StaleEpoch, UpdateState,
};

use crate::scene::{NEW, Scene, build, id, plan, sighting};

#[test]
fn the_sender_gets_bytes_only_for_robots_that_receive() {
    let mut slow = plan(&[100]);
    slow.limits.bytes_per_second = Some(16_384);
    let mut scene = Scene::of(slow, 1);
    let release = scene.rollout.document().plan.releases[0].release.clone();
    let other = ReleaseId::new("other").unwrap();
    let robot = id("a0000");
    let take = |scene: &mut Scene, bytes| scene.rollout.take(&robot, &release, bytes, scene.now);
    assert_eq!(take(&mut scene, 8_192), Grant::In(500));
    scene.pass_s(1);
    assert_eq!(take(&mut scene, 16_384), Grant::Now);
    assert_eq!(take(&mut scene, 1_024), Grant::In(63));
    assert_eq!(take(&mut scene, 16_385), Grant::No);
    assert_eq!(
        scene.rollout.take(&id("x"), &release, 1, scene.now),
        Grant::No
    );
    assert_eq!(scene.rollout.take(&robot, &other, 1, scene.now), Grant::No);
    scene.pass_s(1);
    // A server that comes back does not send the same second again.
    scene.restart();
    assert_eq!(take(&mut scene, 1_024), Grant::In(63));
    scene.command(&Command::Pause).unwrap();
    scene.pass_s(1);
    assert_eq!(take(&mut scene, 1), Grant::No);
}

#[test]
fn a_former_owner_is_refused() {
    let mut scene = Scene::of(plan(&[100]), 2);
    scene.flush();
    let owner = |epoch| Owner {
        server: ServerId::new("b").unwrap(),
        epoch,
    };
    assert_eq!(
        scene.rollout.take_over(owner(1), scene.now),
        Err(StaleEpoch(1))
    );
    let step = scene.rollout.take_over(owner(2), scene.now).unwrap();
    // What the other may not have sent goes again, under the new epoch.
    assert_eq!(Scene::offered(&step.effects).len(), 2);
    assert!(step.effects.iter().all(|one| one.epoch == 2));
    assert!(!scene.rollout.accepts(1) && scene.rollout.accepts(2));
    assert_eq!(step.document.unwrap().owner, owner(2));
}

#[test]
fn after_a_restart_no_phase_passes_before_robots_are_heard_of() {
    let mut scene = Scene::of(plan(&[50, 100]), 20);
    let first = Scene::offered(&scene.flush());
    scene.command(&Command::Pause).unwrap();
    scene.command(&Command::Resume).unwrap();
    for robot in &first[1..] {
        scene.command(&Command::Skip(id(robot))).unwrap();
        scene.command(&Command::Retry(id(robot))).unwrap();
    }
    scene.told(&first[0], Report::Confirmed(build(NEW)));
    scene.command(&Command::Pause).unwrap();
    scene.restart();
    scene.command(&Command::Resume).unwrap();
    scene.pass_s(29);
    assert_eq!(scene.rollout.document().phase, 0);
    for robot in &first {
        scene.event(Event::Seen(sighting(robot)));
    }
    scene.pass_s(1);
    assert_eq!(scene.rollout.document().phase, 0, "nine robots wait for it");
    assert_eq!(scene.confirm_all(), 9);
    assert_eq!(scene.rollout.document().phase, 1);
}

#[test]
fn clocks_that_are_set_time_nothing_out() {
    let mut scene = Scene::of(plan(&[100]), 1);
    scene.flush();
    scene.now.unix_ms += 365 * 24 * 3_600_000;
    assert_eq!(scene.event(Event::Tick), []);
    scene.now.unix_ms = 0;
    scene.restart();
    assert_eq!(scene.robot("a0000").0, UpdateState::Offered);
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(15_000));
    scene.now = Now {
        unix_ms: u64::MAX,
        monotonic_ms: u64::MAX,
    };
    scene.event(Event::Tick);
    scene.restart();
    assert_eq!(
        scene.robot("a0000").1,
        Some(Reason::TimedOut(UpdateState::Offered))
    );
}

#[test]
fn what_a_clock_that_was_ahead_put_off_is_not_put_off_for_years() {
    let mut scene = Scene::of(plan(&[100]), 1);
    scene.flush();
    let right = scene.now.unix_ms;
    // It comes back years ahead: the offer has timed out, and is made again in a while.
    scene.now.unix_ms += 10 * 365 * 24 * 3_600_000;
    scene.restart();
    scene.event(Event::Seen(sighting("a0000")));
    scene.pass_s(40);
    assert_eq!(scene.robot("a0000").0, UpdateState::Waiting);
    // Its clock is set, and it comes back once more.
    scene.now.unix_ms = right;
    scene.restart();
    scene.event(Event::Seen(sighting("a0000")));
    let wait = scene.rollout.wake_in_ms(scene.now);
    assert!(wait.is_some_and(|ms| ms <= 60_000), "{wait:?}");
    scene.pass_s(60);
    assert_eq!(scene.robot("a0000").0, UpdateState::Offered);
}

#[test]
fn what_is_no_rollout_is_not_loaded() {
    let scene = Scene::of(plan(&[100]), 2);
    let (document, rows) = scene.store.read();
    let load = |change: &dyn Fn(&mut Document, &mut Vec<_>)| {
        let (mut document, mut rows) = (document.clone(), rows.clone());
        change(&mut document, &mut rows);
        Rollout::load(document, rows, scene.now)
            .map(|_| ())
            .unwrap_err()
    };
    assert_eq!(
        load(&|document, _| document.version = 2),
        LoadError::Version(2)
    );
    assert_eq!(
        load(&|document, _| document.plan.limits.parallel = 0),
        LoadError::Plan(PlanError::Range {
            what: "limits.parallel",
            least: 1,
            most: 20_000
        })
    );
    assert!(matches!(
        load(&|document, _| document.phase = 1),
        LoadError::Document(_)
    ));
    assert!(matches!(
        load(&|document, _| document.phases.clear()),
        LoadError::Document(_)
    ));
    assert!(matches!(
        load(&|_, rows| rows[0].release = Some(1)),
        LoadError::Row(..)
    ));
    assert!(matches!(
        load(&|_, rows| rows[0].release = None),
        LoadError::Row(..)
    ));
    assert!(matches!(
        load(&|_, rows| rows[0].phase = Some(9)),
        LoadError::Row(..)
    ));
    assert!(matches!(
        load(&|_, rows| rows[0].received = 1_001),
        LoadError::Row(..)
    ));
    assert!(matches!(
        load(&|_, rows| rows[1] = rows[0].clone()),
        LoadError::Row(..)
    ));
}
