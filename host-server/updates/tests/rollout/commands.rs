//! What people do with a rollout.

use crawler_updates::rollout::{
    Command, CommandError, Message, PauseReason, Reason, Report, RolloutState, UpdateState,
};

use crate::scene::{NEW, Scene, build, code, id, plan};

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
    scene.confirm_all();
    assert_eq!(scene.state(), RolloutState::Done);
}
