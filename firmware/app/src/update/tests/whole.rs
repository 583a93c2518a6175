//! Whole updates, and what comes in between.

use crawler_boot::RollbackReason;
use crawler_boot::trailer::Outcome as Fate;
use crawler_hal::{Duration, ResetCause};
use crawler_protocol::{Action, BehaviourSpec, Reason, ResponseStatus, RobotState};

use super::life::{End, World};
use super::releases::Draft;

fn new() -> super::releases::Release {
    let mut draft = Draft::new("new", 12);
    draft.floor = 3;
    draft.release()
}

fn confirmed(life: &super::life::Life) -> bool {
    life.server.borrow().has_told("outcome", "confirmed")
}

#[test]
fn from_offer_to_confirmed() {
    for (lost, doubled, shuffled) in [(0, 0, false), (50, 50, true), (400, 200, true)] {
        let release = new();
        let world = World::new(&release);
        {
            let mut server = world.server.borrow_mut();
            (server.lost, server.doubled, server.shuffled) = (lost, doubled, shuffled);
        }
        let life = world.run_until(confirmed);
        assert_eq!((life.build.as_str(), life.slot), ("new", 1));
        assert_eq!(life.state(), RobotState::Idle);
        let server = life.server.borrow();
        for state in ["preparing", "receiving", "verifying", "staged", "trial"] {
            assert!(server.has_told("state", state), "{state}");
        }
        assert!(server.most_asked <= 16);
        if lost == 0 {
            let chunks = release.image.len().div_ceil(1_024) as u32 + 1;
            assert_eq!(server.sent, chunks, "nothing is sent twice");
        }
        // The first words of the old program, and the last ones of the new.
        assert_eq!(server.told[0]["update"], "have");
        assert_eq!(
            (&server.told[0]["sequence"], &server.told[0]["floor"]),
            (&0.into(), &0.into())
        );
        let have = server
            .told
            .iter()
            .rfind(|report| report["update"] == "have");
        let have = have.expect("told");
        assert_eq!(
            (have["build"].as_str(), &have["sequence"]),
            (Some("new"), &12.into())
        );
        assert_eq!(have["floor"], 3, "raised with the confirmation");
        let trial = server.told.iter().find(|report| report["state"] == "trial");
        let trial = trial.expect("told");
        assert_eq!(trial["build"], "new");
        assert_eq!(world.trailer(1).outcome(), Some(Fate::Confirmed));
    }
}

#[test]
fn one_update_follows_another_into_the_other_slot() {
    let world = World::new(&new());
    world.run_until(confirmed);
    let next = Draft::new("newer", 13).release();
    let mut world = world;
    world.learn(&next);
    world.server.borrow_mut().release = next.clone();
    world.server.borrow_mut().told.clear();
    let life = world.run_until(|life| {
        let server = life.server.borrow();
        server.told.iter().any(|report| {
            report["outcome"] == "confirmed" && report["release"] == std::format!("{}", next.id())
        })
    });
    assert_eq!((life.build.as_str(), life.slot), ("newer", 0));
    // Its own floor is 0: the sequence of what is installed stands for all that came before.
    drop(life);
    let old = Draft::new("old-again", 12).release();
    world.server.borrow_mut().release = old;
    world.server.borrow_mut().told.clear();
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("outcome", "refused");
    assert_eq!(
        life.server.borrow().reason("outcome", "refused"),
        Some("downgrade")
    );
}

#[test]
fn orders_to_move_are_refused_and_halts_obeyed() {
    let release = new();
    let world = World::new(&release);
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("state", "receiving");
    assert_eq!(life.state(), RobotState::Updating);
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    let refused = Some((ResponseStatus::Rejected, Some(Reason::Busy)));
    assert_eq!(life.command(wander), refused);
    assert_eq!(life.command(Action::Scan), refused);
    assert_eq!(
        life.command(Action::Stop),
        Some((ResponseStatus::Completed, None))
    );
    assert_eq!(life.state(), RobotState::Updating, "it stands in any case");

    // An emergency stop puts it off, and it goes on where it was.
    life.run_until(Duration::from_secs(60), |life| {
        let server = life.server.borrow();
        server.told.iter().any(|report| report["bytes"] == 65_536)
    });
    assert_eq!(
        life.command(Action::Estop),
        Some((ResponseStatus::Completed, None))
    );
    life.run_until_told("state", "deferred");
    assert_eq!(
        life.server.borrow().reason("state", "deferred"),
        Some("estopped")
    );
    assert_eq!(life.state(), RobotState::Error);
    life.executor.run_for(Duration::from_secs(20));
    assert_eq!(life.state(), RobotState::Error, "offers change nothing");
    assert_eq!(
        life.command(Action::Reset),
        Some((ResponseStatus::Completed, None))
    );
    assert_eq!(life.state(), RobotState::Idle);
    life.server.borrow_mut().told.clear();
    let end = life.run_until(Duration::from_secs(120), |_| false);
    assert_eq!(end, End::Restart);
    let chunks = release.image.len().div_ceil(1_024) as u32;
    let sent = life.server.borrow().sent;
    assert!(sent <= chunks + 1 + 64 + 16, "{sent} of {chunks}");
}

#[test]
fn a_robot_that_has_no_time_says_so() {
    let world = World::new(&new());
    world.server.borrow_mut().offering = false;
    let mut life = world.start(ResetCause::PowerOn);
    life.executor.run_for(Duration::from_secs(3));
    let id = world.server.borrow().release.id();
    let wander = Action::Behave(BehaviourSpec::Wander { speed: 80 });
    assert_eq!(
        life.command(wander),
        Some((ResponseStatus::Completed, None))
    );
    life.say("offer", id);
    assert_eq!(
        life.server.borrow().reason("state", "deferred"),
        Some("driving")
    );
    assert_ne!(life.state(), RobotState::Updating);
    life.command(Action::Stop);
    life.executor.run_for(Duration::from_secs(2));

    let weak = crawler_drivers::battery::Config::STANDARD.divider;
    life.battery
        .0
        .set(Some(weak.pin(crawler_hal::Millivolts(6_800))));
    life.executor.run_for(Duration::from_secs(30));
    life.say("offer", id);
    assert_eq!(
        life.server.borrow().reason("state", "deferred"),
        Some("low_battery")
    );
    assert_eq!(world.cells.borrow().changes, 0);
}

#[test]
fn a_server_that_does_not_answer_is_not_waited_for() {
    let world = World::new(&new());
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("state", "receiving");
    life.server.borrow_mut().sending = false;
    life.run_until_told("state", "deferred");
    assert_eq!(
        life.server.borrow().reason("state", "deferred"),
        Some("no_data")
    );
    assert_eq!(life.state(), RobotState::Idle);
    // It asks less and less often.
    let wants = life
        .server
        .borrow()
        .told
        .iter()
        .filter(|r| r["update"] == "want")
        .count();
    assert!(wants < 30, "{wants}");
    life.server.borrow_mut().sending = true;
    life.server.borrow_mut().told.clear();
    drop(life);
    assert_eq!(world.run_until(confirmed).build, "new");
}

#[test]
fn what_is_withdrawn_is_given_up_and_gone_on_with_later() {
    let world = World::new(&new());
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("state", "receiving");
    let id = life.server.borrow().release.id();
    life.say("cancel", id);
    assert!(life.server.borrow().has_told("outcome", "withdrawn"));
    assert_eq!(life.state(), RobotState::Idle);
    let sent = life.server.borrow().sent;
    life.executor.run_for(Duration::from_secs(20));
    assert_eq!(life.server.borrow().sent, sent, "nothing more is asked for");
    life.say("offer", id);
    life.server.borrow_mut().told.clear();
    life.run_until_told("state", "receiving");
}

#[test]
fn a_session_that_is_lost_is_gone_on_with() {
    let world = World::new(&new());
    let mut life = world.start(ResetCause::PowerOn);
    for _ in 0..5 {
        life.run_until(Duration::from_millis(400), |_| false);
        life.server.borrow_mut().linked = false;
        life.executor.run_for(Duration::from_millis(700));
        life.server.borrow_mut().linked = true;
    }
    let end = life.run_until(Duration::from_secs(120), |_| false);
    assert_eq!(end, End::Restart);
    drop(life);
    assert_eq!(world.run_until(confirmed).build, "new");
}

/// What goes wrong in a trial, and the reason that the old program tells for having come back.
#[test]
fn a_program_that_does_not_prove_itself_is_given_up() {
    type Harm = fn(&mut super::life::Life);
    let harms: [(RollbackReason, Harm); 2] = [
        (RollbackReason::NoLink, |life| {
            life.server.borrow_mut().linked = false;
        }),
        (RollbackReason::UnhealthySensors, |life| {
            life.ranger.silent.set(true);
        }),
    ];
    for (reason, harm) in harms {
        let world = World::new(&new());
        world.server.borrow_mut().told.clear();
        let mut life = world.start(ResetCause::PowerOn);
        assert_eq!(
            life.run_until(Duration::from_secs(120), |_| false),
            End::Restart
        );
        drop(life);
        world.server.borrow_mut().offering = false;
        let mut life = world.start(ResetCause::Software);
        assert_eq!(life.build, "new");
        harm(&mut life);
        assert_eq!(
            life.run_until(Duration::from_secs(310), |_| false),
            End::Restart
        );
        drop(life);
        world.server.borrow_mut().linked = true;
        let mut life = world.start(ResetCause::Software);
        assert_eq!(life.build, "old");
        life.run_until_told("outcome", "rolled_back");
        let server = life.server.borrow();
        assert_eq!(server.reason("outcome", "rolled_back"), Some(reason.code()));
        let have = server
            .told
            .iter()
            .rfind(|report| report["update"] == "have");
        let have = have.expect("told");
        assert_eq!((&have["sequence"], &have["floor"]), (&0.into(), &0.into()));
    }
}

#[test]
fn a_program_that_panics_is_given_up_and_may_be_tried_again() {
    let world = World::new(&new());
    let mut life = world.start(ResetCause::PowerOn);
    assert_eq!(
        life.run_until(Duration::from_secs(120), |_| false),
        End::Restart
    );
    drop(life);
    let mut life = world.start(ResetCause::Software);
    life.run_until_told("state", "trial");
    drop(life);
    assert_eq!(world.start(ResetCause::Panic).build, "new", "once");
    world.server.borrow_mut().offering = false;
    let mut life = world.start(ResetCause::Panic);
    assert_eq!(life.build, "old");
    life.run_until_told("outcome", "rolled_back");
    assert_eq!(
        life.server.borrow().reason("outcome", "rolled_back"),
        Some("panic")
    );
    let id = life.server.borrow().release.id();
    life.server.borrow_mut().told.clear();
    life.say("confirm", id);
    assert_eq!(
        life.server.borrow().reason("outcome", "rolled_back"),
        Some("panic")
    );
    life.say("offer", id);
    drop(life);
    world.server.borrow_mut().offering = true;
    assert_eq!(world.run_until(confirmed).build, "new");
}

#[test]
fn a_confirmation_is_answered_again() {
    let world = World::new(&new());
    let mut life = world.run_until(confirmed);
    let id = life.server.borrow().release.id();
    for word in ["confirm", "offer", "cancel"] {
        life.server.borrow_mut().told.clear();
        life.say(word, id);
        assert!(
            life.server.borrow().has_told("outcome", "confirmed"),
            "{word}"
        );
        assert_eq!(life.state(), RobotState::Idle);
    }
}

#[test]
fn a_flash_that_wears_out_ends_it() {
    let world = World::new(&new());
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("state", "receiving");
    world.cells.borrow_mut().worn = true;
    life.run_until_told("outcome", "refused");
    assert_eq!(
        life.server.borrow().reason("outcome", "refused"),
        Some("flash_failed")
    );
    assert_eq!(life.state(), RobotState::Idle);
}

/// What is refused is not started by the next restart either, whatever the flash says of what was written.
#[test]
fn what_could_not_be_activated_is_refused_and_not_started() {
    let world = World::new(&new());
    world.cells.borrow_mut().denying = true;
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("outcome", "refused");
    assert_eq!(
        life.server.borrow().reason("outcome", "refused"),
        Some("flash_failed")
    );
    assert_eq!(world.trailer(1).outcome(), Some(Fate::Activated));
    drop(life);
    world.server.borrow_mut().offering = false;
    assert_eq!(world.start(ResetCause::PowerOn).build, "old");
}

#[test]
fn an_image_that_is_not_what_was_signed_is_never_started() {
    let mut release = new();
    release.image[70_000] ^= 1;
    let world = World::new(&release);
    world.server.borrow_mut().offering = true;
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("outcome", "refused");
    assert_eq!(
        life.server.borrow().reason("outcome", "refused"),
        Some("bad_block")
    );
    assert_eq!(world.trailer(1).staged(), None);
    drop(life);
    assert_eq!(world.start(ResetCause::PowerOn).build, "old");
}

/// What was signed by mistake: right blocks that do not make the image. It may be what was in flash, once.
#[test]
fn an_image_that_is_wrong_as_a_whole_is_begun_anew_once() {
    let mut draft = Draft::new("new", 12);
    draft.wrong_whole = true;
    let release = draft.release();
    let world = World::new(&release);
    let mut life = world.start(ResetCause::PowerOn);
    life.run_until_told("outcome", "refused");
    let server = life.server.borrow();
    assert_eq!(server.reason("outcome", "refused"), Some("bad_hash"));
    let refusal = server
        .told
        .iter()
        .rfind(|report| report["outcome"] == "refused");
    assert_eq!(refusal.expect("told")["lasting"], true);
    // Twice the image and its trailer; and a sector of otadata, to name what runs.
    let sectors = release.image.len().div_ceil(4_096);
    let erased = world.cells.borrow().erased;
    assert!(erased <= 2 * (sectors + 1) + 1, "{erased} of {sectors}");
    let chunks = release.image.len().div_ceil(1_024) as u32;
    assert_eq!(server.sent, 1 + 2 * chunks);
    assert_eq!(world.trailer(1).staged(), None);
}
