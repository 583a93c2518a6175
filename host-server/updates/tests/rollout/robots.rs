//! The way of one robot, state by state.

use crawler_updates::rollout::{
    BoardName, Event, Happening, Message, PauseReason, Reason, Report, RolloutState, Sighting,
    UpdateState,
};

use crate::scene::{NEW, OLD, Scene, build, code, id, plan, sighting};

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
fn a_model_is_for_robots_that_see() {
    let mut model = plan(&[50, 100]);
    model.releases[0].model = Some("eyes".parse().unwrap());
    let sees = |name| Sighting {
        vision: true,
        ..sighting(name)
    };
    let mut other = sighting("d");
    other.board = BoardName::new("esp32-c3").unwrap();
    let mut scene = Scene::start(model, &[sees("a"), sighting("b"), sees("c"), other]);
    let left_out = |why| (UpdateState::NotApplicable, Some(why));
    assert_eq!(scene.robot("b"), left_out(Reason::NoVision));
    assert_eq!(scene.robot("d"), left_out(Reason::NoRelease));
    // A half of those that see.
    assert_eq!(Scene::offered(&scene.waiting).len(), 1);
    scene.event(Event::Seen(sighting("e")));
    assert_eq!(scene.robot("e"), left_out(Reason::NoVision));
    scene.event(Event::Seen(sees("f")));
    assert_eq!(scene.robot("f").0, UpdateState::Waiting);
}

#[test]
fn a_policy_is_for_robots_that_have_room_for_one() {
    let mut policy = plan(&[100]);
    policy.releases[0].model = Some("apart".parse().unwrap());
    policy.releases[0].policy = true;
    let has_room = Sighting {
        policies: true,
        ..sighting("a")
    };
    let sees = Sighting {
        vision: true,
        ..sighting("b")
    };
    let scene = Scene::start(policy, &[has_room, sees]);
    let left_out = (UpdateState::NotApplicable, Some(Reason::NoPolicies));
    assert_eq!(scene.robot("b"), left_out);
    assert_eq!(Scene::offered(&scene.waiting), ["a"]);
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
