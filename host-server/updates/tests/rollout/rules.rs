//! The rules of a rollout, one by one.

use std::collections::BTreeMap;

use crawler_protocol::Kind;
use crawler_updates::rollout::{
    BoardName, Busy, Command, CommandError, Event, Grant, Happening, LoadError, Message, Now,
    Owner, PauseReason, PhaseState, PlanError, Reason, Report, Rollout, RolloutId, RolloutState,
    Selection, ServerId, StaleEpoch, StartError, UpdateState,
};

use crate::scene::{NEW, OLD, Scene, build, code, group, id, plan, release_for, sighting};

/// Takes every robot that is at work to its end.
fn confirm_all(scene: &mut Scene) -> usize {
    let mut count = 0;
    loop {
        let rows = scene.rollout.rows().filter(|row| row.state.is_in_flight());
        let names: Vec<String> = rows.map(|row| row.robot.to_string()).collect();
        if names.is_empty() {
            return count;
        }
        for name in names {
            scene.told(&name, Report::Confirmed(build(NEW)));
            count += 1;
        }
    }
}

#[test]
fn a_robot_goes_through_all_states() {
    use UpdateState::{
        Confirmed, Deferred, Offered, Preparing, Receiving, Staged, Trial, Verifying,
    };

    let mut scene = Scene::of(plan(&[100]), 1);
    let mut seen = vec![scene.robot("a0000").0];
    for report in [
        Report::Deferred(code("driving")),
        Report::Preparing,
        Report::Receiving(500),
        Report::Verifying,
        Report::Staged,
        Report::Trial(build(NEW)),
        Report::Confirmed(build(NEW)),
    ] {
        scene.told("a0000", report);
        seen.push(scene.robot("a0000").0);
    }
    assert_eq!(
        seen,
        [
            Offered, Deferred, Preparing, Receiving, Verifying, Staged, Trial, Confirmed
        ]
    );
    assert_eq!(scene.state(), RolloutState::Done);
    let told: Vec<_> = scene.notes.iter().map(|note| &note.what).collect();
    assert_eq!(told[..2], [&Happening::Started, &Happening::PhaseBegan(0)]);
    assert_eq!(
        told[told.len() - 2..],
        [&Happening::PhasePassed(0), &Happening::Done]
    );
    assert_eq!(told.len(), 4 + 8);
}

#[test]
fn only_the_new_build_counts() {
    for (reports, want, reason) in [
        (
            vec![Report::Confirmed(build(NEW))],
            UpdateState::Confirmed,
            None,
        ),
        (
            vec![Report::Confirmed(build("other"))],
            UpdateState::Failed,
            Some(Reason::WrongBuild(build("other"))),
        ),
        (vec![Report::Trial(build(OLD))], UpdateState::Offered, None),
        (
            vec![Report::Trial(build(NEW)), Report::RolledBack(code("panic"))],
            UpdateState::RolledBack,
            Some(Reason::Told(code("panic"))),
        ),
    ] {
        let mut scene = Scene::of(plan(&[100]), 1);
        for report in reports {
            scene.told("a0000", report);
        }
        assert_eq!(scene.robot("a0000"), (want, reason));
    }
}

#[test]
fn a_status_proves_trial_and_roll_back() {
    let mut scene = Scene::of(plan(&[100]), 2);
    let mut seen = sighting("a0000");
    scene.told("a0000", Report::Staged);
    // The new program shows itself before it has said so: it is heard.
    (seen.boot, seen.build) = (2, build(NEW));
    let sent = scene.event(Event::Seen(seen.clone()));
    assert_eq!(
        sent.iter().map(|one| one.message).collect::<Vec<_>>(),
        [Message::Confirm]
    );
    assert_eq!(scene.robot("a0000").0, UpdateState::Trial);
    // An old status that comes late says nothing.
    scene.event(Event::Seen(sighting("a0000")));
    assert_eq!(scene.robot("a0000").0, UpdateState::Trial);
    (seen.boot, seen.build) = (3, build(OLD));
    scene.event(Event::Seen(seen));
    assert_eq!(
        scene.robot("a0000"),
        (UpdateState::RolledBack, Some(Reason::OldBuild))
    );
}

#[test]
fn who_runs_it_already_is_sent_nothing() {
    let mut there = sighting("b");
    there.build = build(NEW);
    let mut other = sighting("c");
    other.board = BoardName::new("esp32-c3").unwrap();
    let scene = Scene::start(plan(&[100]), &[sighting("a"), there, other]);
    assert_eq!(
        scene.robot("b"),
        (UpdateState::Confirmed, Some(Reason::AlreadyThere))
    );
    assert_eq!(
        scene.robot("c"),
        (UpdateState::NotApplicable, Some(Reason::NoRelease))
    );
    assert_eq!(Scene::offered(&scene.waiting), ["a"]);
}

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
    assert_eq!(confirm_all(&mut scene), 2);
    assert!(matches!(
        scene.rollout.document().phases[0],
        PhaseState::Soaking { .. }
    ));
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(600_000));
    assert_eq!(scene.pass_s(599), []);
    assert_eq!(Scene::offered(&scene.pass_s(1)).len(), 18);
    assert_eq!(confirm_all(&mut scene), 18);
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
    confirm_all(&mut scene);
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
    assert_eq!(confirm_all(&mut scene), 8);
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
        confirm_all(&mut scene);
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
    confirm_all(&mut scene);
    assert_eq!(scene.rollout.wake_in_ms(scene.now), Some(60_000));
    scene.pass_s(60);
    assert_eq!(
        scene.robot("b"),
        (UpdateState::Skipped, Some(Reason::NeverReached))
    );
    assert_eq!(scene.state(), RolloutState::Done);
}

#[test]
fn a_robot_that_goes_away_gives_its_place_to_another_and_goes_on_later() {
    let mut limited = plan(&[100]);
    limited.limits.parallel = 1;
    let mut scene = Scene::of(limited, 2);
    let first = Scene::offered(&scene.flush()).remove(0);
    scene.told(&first, Report::Receiving(700));
    let mut seen = sighting(&first);
    seen.online = false;
    let sent = scene.event(Event::Seen(seen.clone()));
    assert_eq!(
        scene.robot(&first),
        (UpdateState::Waiting, Some(Reason::Interrupted))
    );
    let second = Scene::offered(&sent).remove(0);
    assert_ne!(first, second);
    seen.online = true;
    assert_eq!(scene.event(Event::Seen(seen)), []);
    // It goes on by itself, but has no place.
    let sent = scene.told(&first, Report::Receiving(800));
    assert_eq!(
        sent.iter().map(|one| one.message).collect::<Vec<_>>(),
        [Message::Cancel]
    );
    let sent = scene.told(&second, Report::Confirmed(build(NEW)));
    assert_eq!(Scene::offered(&sent), [first.as_str()]);
    let row = scene.rollout.row(&id(&first)).unwrap();
    assert_eq!((row.attempts, row.offers, row.received), (0, 2, 700));
}

#[test]
fn silence_in_any_state_is_a_failed_attempt() {
    let reports = [
        Report::Preparing,
        Report::Receiving(1),
        Report::Verifying,
        Report::Staged,
    ];
    for report in reports.into_iter().map(Some).chain([None]) {
        let mut scene = Scene::of(plan(&[100]), 1);
        if let Some(report) = report.clone() {
            scene.told("a0000", report);
        }
        let (mut cancels, mut offers) = (0, 0);
        for _ in 0..500 {
            for effect in scene.pass_s(15) {
                cancels += u32::from(effect.message == Message::Cancel);
                offers += u32::from(effect.message == Message::Offer);
            }
        }
        assert_eq!(
            scene.robot("a0000"),
            (
                UpdateState::Failed,
                Some(Reason::TimedOut(UpdateState::Offered))
            )
        );
        assert_eq!(cancels, 3, "{report:?}");
        assert!(offers >= 2);
        assert_eq!(scene.state(), RolloutState::Paused(PauseReason::Threshold));
    }
}

#[test]
fn a_robot_that_only_talks_runs_out_of_time_too() {
    let mut short = plan(&[100]);
    short.timeouts.attempt_s = 300;
    short.retries.attempts = 1;
    let mut scene = Scene::of(short, 1);
    for n in 0..29 {
        scene.pass_s(10);
        scene.told(
            "a0000",
            if n % 2 == 0 {
                Report::Verifying
            } else {
                Report::Preparing
            },
        );
    }
    assert_eq!(scene.robot("a0000").0, UpdateState::Verifying);
    scene.pass_s(10);
    assert_eq!(
        scene.robot("a0000").1,
        Some(Reason::TimedOut(UpdateState::Verifying))
    );
}

#[test]
fn a_trial_without_a_word_has_failed_until_the_robot_says_otherwise() {
    for (report, want) in [
        (Report::RolledBack(code("panic")), UpdateState::RolledBack),
        (Report::Confirmed(build(NEW)), UpdateState::Confirmed),
    ] {
        let mut scene = Scene::of(plan(&[100]), 2);
        scene.told("a0000", Report::Trial(build(NEW)));
        assert!(
            scene
                .pass_s(15)
                .iter()
                .any(|one| one.message == Message::Confirm)
        );
        scene.pass_s(600);
        assert_eq!(
            scene.robot("a0000"),
            (
                UpdateState::Failed,
                Some(Reason::TimedOut(UpdateState::Trial))
            )
        );
        scene.told("a0000", report);
        assert_eq!(scene.robot("a0000").0, want);
    }
}

#[test]
fn refusals_are_retried_unless_they_last() {
    let mut scene = Scene::of(plan(&[100]), 1);
    let refused = |lasting| Report::Refused {
        code: code("flash"),
        lasting,
    };
    let told = Some(Reason::Told(code("flash")));
    for pause in [60, 120] {
        scene.told("a0000", refused(false));
        assert_eq!(scene.robot("a0000"), (UpdateState::Waiting, told.clone()));
        assert_eq!(scene.pass_s(pause - 1), []);
        assert_eq!(Scene::offered(&scene.pass_s(1)), ["a0000"]);
    }
    scene.told("a0000", refused(false));
    assert_eq!(scene.robot("a0000"), (UpdateState::Failed, told.clone()));
    let mut scene = Scene::of(plan(&[100]), 1);
    scene.told("a0000", refused(true));
    assert_eq!(scene.robot("a0000"), (UpdateState::Failed, told));
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
fn it_pauses_resumes_and_forgives() {
    let mut scene = Scene::of(plan(&[10, 100]), 40);
    let first = Scene::offered(&scene.flush());
    assert_eq!(first.len(), 4);
    scene.told(&first[0], Report::RolledBack(code("panic")));
    scene.told(&first[2], Report::Trial(build(NEW)));
    assert_eq!(scene.state(), RolloutState::Running);
    scene.told(&first[1], Report::RolledBack(code("panic")));
    assert_eq!(scene.state(), RolloutState::Paused(PauseReason::Failures));
    // The trial goes on, the fourth robot gives up.
    assert_eq!(scene.robot(&first[2]).0, UpdateState::Trial);
    assert_eq!(
        scene.robot(&first[3]),
        (UpdateState::Waiting, Some(Reason::Paused))
    );
    assert_eq!(scene.sent.last().unwrap().message, Message::Cancel);
    assert_eq!(
        scene
            .pass_s(10_000)
            .iter()
            .filter(|one| one.message == Message::Offer)
            .count(),
        0
    );
    assert_eq!(scene.command(&Command::Pause), Err(CommandError::Paused));
    let sent = scene.command(&Command::Resume).unwrap();
    assert_eq!(Scene::offered(&sent), [first[3].as_str()]);
    assert_eq!(
        scene.command(&Command::Resume),
        Err(CommandError::NotPaused)
    );
    // The trial has run out of time meanwhile; that was forgiven with the rest.
    assert_eq!(scene.counts().phases[0].failures, 0);
    scene.told(&first[3], Report::Confirmed(build(NEW)));
    assert_eq!(scene.rollout.document().phase, 1);
    // One more try, and it counts again.
    let sent = scene.command(&Command::Retry(id(&first[0]))).unwrap();
    assert_eq!(Scene::offered(&sent), [first[0].as_str()]);
    scene.told(&first[0], Report::RolledBack(code("panic")));
    assert_eq!(scene.counts().phases[1].failures, 1);
}

#[test]
fn after_an_abort_nothing_is_offered() {
    let mut scene = Scene::of(plan(&[10, 100]), 40);
    let first = Scene::offered(&scene.flush());
    scene.told(&first[0], Report::Trial(build(NEW)));
    scene.told(&first[1], Report::Receiving(5));
    let sent = scene.command(&Command::Abort).unwrap();
    assert_eq!(sent.len(), 3);
    assert!(sent.iter().all(|one| one.message == Message::Cancel));
    assert_eq!(scene.state(), RolloutState::Aborting);
    for command in [
        Command::Pause,
        Command::Resume,
        Command::Abort,
        Command::Retry(id(&first[1])),
    ] {
        assert_eq!(scene.command(&command), Err(CommandError::Over));
    }
    // The word was lost: it is said again to whoever goes on.
    assert_eq!(scene.told(&first[1], Report::Receiving(6)).len(), 1);
    scene.told(&first[0], Report::Confirmed(build(NEW)));
    assert_eq!(scene.state(), RolloutState::Aborted);
    assert_eq!(
        scene.told(&first[1], Report::Staged)[0].message,
        Message::Cancel
    );
    scene.told(&first[1], Report::Withdrawn);
    assert_eq!(
        scene.command(&Command::Skip(id(&first[0]))),
        Err(CommandError::Over)
    );
    assert_eq!(scene.robot(&first[0]).0, UpdateState::Confirmed);
    assert_eq!(
        scene.robot(&first[1]),
        (UpdateState::Skipped, Some(Reason::Aborted))
    );
    assert_eq!(scene.pass_s(100_000), []);
}

#[test]
fn single_robots_are_left_out_and_taken_in_again() {
    let mut scene = Scene::of(plan(&[50, 100]), 4);
    let first = Scene::offered(&scene.flush());
    let [a, b] = [0, 1].map(|n| id(&first[n]));
    assert_eq!(
        scene.command(&Command::Skip(id("x"))),
        Err(CommandError::UnknownRobot)
    );
    assert_eq!(
        scene.command(&Command::Retry(a.clone())),
        Err(CommandError::NothingToRetry)
    );
    assert_eq!(
        scene.command(&Command::Skip(a.clone())).unwrap()[0].message,
        Message::Cancel
    );
    assert_eq!(
        scene.robot(&first[0]),
        (UpdateState::Skipped, Some(Reason::LeftOut))
    );
    assert_eq!(
        scene.command(&Command::Skip(a.clone())),
        Err(CommandError::Ended)
    );
    scene.told(&first[1], Report::Trial(build(NEW)));
    assert_eq!(
        scene.command(&Command::Supersede(b.clone())),
        Err(CommandError::InTrial)
    );
    scene.told(&first[1], Report::Confirmed(build(NEW)));
    assert_eq!(scene.rollout.document().phase, 1);
    let sent = scene.command(&Command::Retry(a)).unwrap();
    assert_eq!(Scene::offered(&sent), [first[0].as_str()]);
    let waiting = scene
        .sent
        .iter()
        .map(|one| one.robot.clone())
        .find(|one| !first.contains(&one.to_string()));
    let other = waiting.unwrap();
    scene.command(&Command::Supersede(other.clone())).unwrap();
    assert_eq!(scene.robot(other.as_str()).0, UpdateState::Superseded);
    confirm_all(&mut scene);
    assert_eq!(scene.state(), RolloutState::Done);
}

#[test]
fn robots_that_turn_up_later_join() {
    let mut scene = Scene::of(plan(&[50, 100]), 2);
    scene.flush();
    assert_eq!(scene.event(Event::Seen(sighting("late"))), []);
    assert_eq!(scene.rollout.row(&id("late")).unwrap().phase, Some(1));
    confirm_all(&mut scene);
    assert_eq!(scene.state(), RolloutState::Done);
    assert_eq!(scene.robot("late").0, UpdateState::Confirmed);
    assert_eq!(scene.event(Event::Seen(sighting("later"))), []);
    assert!(scene.rollout.row(&id("later")).is_none());
}

#[test]
fn the_sender_gets_bytes_only_for_robots_that_receive() {
    let mut slow = plan(&[100]);
    slow.limits.bytes_per_second = Some(16_384);
    let mut scene = Scene::of(slow, 1);
    let release = scene.rollout.document().plan.releases[0].release.clone();
    let other = crawler_updates::rollout::ReleaseId::new("other").unwrap();
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
    assert_eq!(confirm_all(&mut scene), 9);
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
fn what_is_no_rollout_is_not_loaded() {
    let scene = Scene::of(plan(&[100]), 2);
    let (document, rows) = scene.store.read();
    let load = |change: &dyn Fn(&mut crawler_updates::rollout::Document, &mut Vec<_>)| {
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
