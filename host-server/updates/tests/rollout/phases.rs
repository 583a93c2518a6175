//! Who belongs to which phase, and when the next one begins.

use std::collections::BTreeMap;

use crawler_protocol::Kind;
use crawler_updates::rollout::{
    BoardName, Busy, Event, Now, Owner, PauseReason, PhaseState, Reason, Report, Rollout,
    RolloutId, RolloutState, Selection, ServerId, StartError, UpdateState,
};

use crate::scene::{NEW, Scene, build, group, id, plan, release_for, sighting};

#[test]
fn a_mixed_fleet_gets_a_release_for_each_board() {
    let mut mixed = plan(&[100]);
    mixed.releases.push(release_for("esp32-c3"));
    let mut c3 = sighting("b");
    c3.board = BoardName::new("esp32-c3").unwrap();
    let mut scene = Scene::start(mixed, &[sighting("a"), c3]);
    let offers = scene.flush();
    let releases: BTreeMap<_, _> = offers
        .iter()
        .map(|one| (one.robot.as_str(), one.release.as_str()))
        .collect();
    assert_eq!(
        releases,
        BTreeMap::from([("a", "sim-4"), ("b", "esp32-c3")])
    );
}

#[test]
fn phases_select_by_share_group_board_and_kind() {
    let mut mixed = plan(&[10, 100]);
    mixed.releases.push(release_for("esp32-c3"));
    mixed.phases.insert(0, mixed.phases[0].clone());
    mixed.phases[0].select = group(&["a03", "a04"]);
    mixed.phases.insert(1, mixed.phases[0].clone());
    mixed.phases[1].select = Selection::Board(BoardName::new("esp32-c3").unwrap());
    mixed.phases.insert(2, mixed.phases[0].clone());
    mixed.phases[2].select = Selection::Kind(Kind::Emulated);
    let mut fleet: Vec<_> = (0..40).map(|n| sighting(&format!("a{n:02}"))).collect();
    fleet[7].board = BoardName::new("esp32-c3").unwrap();
    fleet[8].kind = Kind::Emulated;
    let scene = Scene::start(mixed, &fleet);
    let phase = |name: &str| scene.rollout.row(&id(name)).unwrap().phase.unwrap();
    assert_eq!(
        [phase("a03"), phase("a04"), phase("a07"), phase("a08")],
        [0, 0, 1, 2]
    );
    let of = |wanted: u8| {
        scene
            .rollout
            .rows()
            .filter(|row| row.phase == Some(wanted))
            .count()
    };
    // Four of forty, of which earlier phases may have some.
    assert!(of(3) <= 4 && of(3) > 0);
    assert_eq!(of(0) + of(1) + of(2) + of(3) + of(4), 40);
}

#[test]
fn phases_follow_each_other_after_their_soak() {
    let mut soaking = plan(&[10, 100]);
    soaking.phases[0].soak_s = 600;
    let mut scene = Scene::of(soaking, 20);
    assert_eq!(Scene::offered(&scene.flush()).len(), 2);
    assert_eq!(scene.confirm_all(), 2);
    assert!(matches!(
        scene.rollout.document().phases[0],
        PhaseState::Soaking { .. }
    ));
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(600_000));
    assert_eq!(scene.pass_s(599), []);
    assert_eq!(Scene::offered(&scene.pass_s(1)).len(), 18);
    assert_eq!(scene.confirm_all(), 18);
    assert_eq!(scene.state(), RolloutState::Done);
    assert_eq!(scene.rollout.wake_in_ms(scene.now), None);
}

#[test]
fn a_failure_in_the_soak_stops_it() {
    let mut soaking = plan(&[10, 100]);
    soaking.phases[0].soak_s = 600;
    soaking.phases[0].success_percent = 50;
    let mut scene = Scene::of(soaking, 20);
    let robots = Scene::offered(&scene.flush());
    scene.confirm_all();
    for robot in robots {
        let mut seen = sighting(&robot);
        seen.boot = 3; // A watchdog has taken it back.
        scene.event(Event::Seen(seen));
    }
    assert_eq!(scene.state(), RolloutState::Paused(PauseReason::Failures));
}

#[test]
fn whoever_waits_for_himself_holds_nothing_up() {
    let mut limited = plan(&[50, 100]);
    limited.limits.parallel = 3;
    let mut fleet: Vec<_> = (0..20).map(|n| sighting(&format!("a{n:04}"))).collect();
    let busy = [
        Some(Busy::Asleep),
        Some(Busy::Driving),
        Some(Busy::LowBattery),
        None,
    ];
    for (robot, busy) in fleet.iter_mut().zip(busy.iter().cycle()).take(12) {
        robot.busy = *busy;
        robot.online = busy.is_some();
    }
    let mut scene = Scene::start(limited, &fleet);
    assert_eq!(scene.confirm_all(), 8);
    assert_eq!(scene.rollout.document().phase, 1);
    assert!(matches!(
        scene.rollout.document().phases[1],
        PhaseState::Passed { .. }
    ));
    assert_eq!(scene.counts().robots[&UpdateState::Waiting], 12);
    assert_eq!(scene.state(), RolloutState::Running);
    // Each is served when it comes, and the rollout ends with the last.
    for robot in fleet.iter_mut().take(12) {
        (robot.online, robot.busy) = (true, None);
        let sent = scene.event(Event::Seen(robot.clone()));
        assert_eq!(Scene::offered(&sent), [robot.robot.as_str()]);
        scene.confirm_all();
    }
    assert_eq!(scene.state(), RolloutState::Done);
}

#[test]
fn it_does_not_wait_for_ever_when_told_so() {
    let mut short = plan(&[100]);
    short.limits.wait_s = Some(60);
    let mut away = sighting("b");
    away.online = false;
    let mut scene = Scene::start(short, &[sighting("a"), away]);
    scene.confirm_all();
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(60_000));
    scene.pass_s(60);
    assert_eq!(
        scene.robot("b"),
        (UpdateState::Skipped, Some(Reason::NeverReached))
    );
    assert_eq!(scene.state(), RolloutState::Done);
}

#[test]
fn nothing_is_offered_outside_of_the_window() {
    let mut nightly = plan(&[100]);
    nightly.limits.parallel = 1;
    nightly.window = Some(serde_json::from_str(r#"{"from": "23:00", "to": "01:00"}"#).unwrap());
    // It is 22:13:20 UTC.
    let mut scene = Scene::of(nightly, 3);
    assert_eq!(scene.waiting, []);
    let opens = 46 * 60 + 40;
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(opens * 1_000));
    let first = Scene::offered(&scene.pass_s(opens)).remove(0);
    scene.told(&first, Report::Receiving(10));
    scene.pass_s(60);
    // Begun is begun, but the next waits for the next night.
    for _ in 0..120 {
        scene.told(
            &first,
            Report::Receiving(scene.rollout.row(&id(&first)).unwrap().received + 1),
        );
        scene.pass_s(60);
    }
    assert_eq!(scene.robot(&first).0, UpdateState::Receiving);
    assert_eq!(scene.told(&first, Report::Confirmed(build(NEW))), []);
    assert!(scene.rollout.wake_in_ms(scene.now).unwrap() > 21 * 3_600_000);
    assert_eq!(Scene::offered(&scene.pass_s(22 * 3_600)).len(), 1);
}

#[test]
fn robots_that_turn_up_later_join() {
    let mut scene = Scene::of(plan(&[50, 100]), 2);
    scene.flush();
    assert_eq!(scene.event(Event::Seen(sighting("late"))), []);
    assert_eq!(scene.rollout.row(&id("late")).unwrap().phase, Some(1));
    scene.confirm_all();
    assert_eq!(scene.state(), RolloutState::Done);
    assert_eq!(scene.robot("late").0, UpdateState::Confirmed);
    assert_eq!(scene.event(Event::Seen(sighting("later"))), []);
    assert!(scene.rollout.row(&id("later")).is_none());
}

#[test]
fn a_rollout_for_nobody_does_not_begin() {
    let start = |plan, fleet: &[_]| {
        let owner = Owner {
            server: ServerId::new("a").unwrap(),
            epoch: 1,
        };
        let now = Now {
            unix_ms: 0,
            monotonic_ms: 0,
        };
        Rollout::start(RolloutId::new("x").unwrap(), plan, owner, fleet, now)
            .map(|_| ())
            .unwrap_err()
    };
    assert_eq!(start(plan(&[100]), &[]), StartError::Nobody);
    let mut other = sighting("a");
    other.board = BoardName::new("esp32-c3").unwrap();
    assert_eq!(start(plan(&[100]), &[other]), StartError::Nobody);
    assert!(matches!(
        start(plan(&[0]), &[sighting("a")]),
        StartError::Plan(_)
    ));
    assert_eq!(
        start(plan(&[100]), &vec![sighting("a"); 20_001]),
        StartError::TooManyRobots
    );
}

#[test]
fn the_way_back_needs_a_new_sequence() {
    let back = plan(&[100]);
    let newest = |sequence| BTreeMap::from([(BoardName::new("sim").unwrap(), sequence)]);
    assert_eq!(back.check_sequences(&BTreeMap::new()), Ok(()));
    assert_eq!(back.check_sequences(&newest(3)), Ok(()));
    for sequence in [4, 9] {
        let error = back
            .check_sequences(&newest(sequence))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains(&format!("sequence 4 must exceed {sequence}")),
            "{error}"
        );
        assert!(
            error.contains(&format!("at least {}", sequence + 1)),
            "{error}"
        );
    }
}

#[test]
fn the_numbers_say_how_long_it_will_take() {
    let mut limited = plan(&[100]);
    limited.limits.parallel = 2;
    let mut scene = Scene::of(limited, 10);
    let robots = Scene::offered(&scene.flush());
    scene.told(&robots[1], Report::Receiving(250));
    assert_eq!(scene.counts().phases[0].left_s, None);
    scene.pass_s(30);
    scene.told(&robots[0], Report::Confirmed(build(NEW)));
    let counts = scene.counts();
    assert_eq!((counts.bytes, counts.elapsed_s), (1_250, 30));
    // One in half a minute; nine are left.
    assert_eq!(
        (counts.phases[0].ended_per_hour, counts.phases[0].left_s),
        (120, Some(270))
    );
    assert_eq!(
        (counts.phases[0].failures, counts.phases[0].most_failures),
        (0, 2)
    );
}
