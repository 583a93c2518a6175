//! What it decides, and when it lets others run.

use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::vec::Vec;

use crawler_hal::Instant;
use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;
use crawler_protocol::{Action as Order, Command, PolicyName, Reason, ResponseStatus, Shadow};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage_async::nor_flash::NorFlash as _;
use proptest::prelude::*;

use super::*;
use crate::hold::Inline;
use crate::policy::{
    ACTIONS_VERSION, Around, FORMAT_VERSION, HEADER, LAYERS, MAGIC, OBSERVATION_VERSION,
    SHIELD_VERSION, STEPS, Unread, WIDTH, shield,
};
use crate::testing::flash::TestFlash;
use crate::testing::{TestRng, TestRobot, robot, source};

/// Two layers that prefer action 2, whatever they see.
fn blob() -> Vec<u8> {
    let mut rest = std::vec![OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];
    rest.extend([0, STEPS, 2, 0, 0]);
    rest.extend([0; 32]);
    rest.extend([4, Action::COUNT as u8, 0, 0]);
    for (inputs, outputs) in [(WIDTH, 4), (4, Action::COUNT)] {
        let padded = outputs.next_multiple_of(4);
        let mut layer = std::vec![0; Dense::bytes(inputs, outputs)];
        layer[4 * 2] = 100;
        layer[4 * padded..6 * padded].fill(1);
        rest.extend(layer);
    }
    assert_eq!(HEADER, 52 + LAYERS);
    sealed(&rest)
}

/// Two layers of these weights, of which the first has nine outputs.
fn random(weights: &[u8], mode: u8) -> Vec<u8> {
    let mut rest = std::vec![OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];
    rest.extend([mode, STEPS, 2, 0, 0]);
    rest.extend([0; 32]);
    rest.extend([9, Action::COUNT as u8, 0, 0]);
    rest.extend(weights);
    sealed(&rest)
}

fn sealed(rest: &[u8]) -> Vec<u8> {
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend(((rest.len() + 12) as u16).to_le_bytes());
    blob.extend(checksum(rest).to_le_bytes());
    blob.extend(rest);
    blob
}

fn trained(blob: &[u8]) -> Named<'_> {
    Named {
        name: "trained",
        blob,
    }
}

fn asked(observation: Observation, number: u16) -> Asked {
    Asked {
        observation,
        around: Around::CLEAR,
        number,
    }
}

fn decision(robot: &TestRobot) -> Option<Decision> {
    robot.control_handle().take_decision()
}

#[test]
fn it_decides_when_asked_and_lets_others_run_between_layers() {
    let (robot, blob) = (robot("decide"), blob());
    let mut activity = pin!(decide(&robot, trained(&blob), TestRng(1)));
    let mut cx = Context::from_waker(Waker::noop());
    assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    assert_eq!(robot.policies().own, Installed::Policy(named("trained")));
    assert_eq!(decision(&robot), None, "nobody has asked");
    let asked = asked(Observation::NOTHING, 7);
    robot.control_handle().ask_policy(asked, named("trained"));
    for layer in 0..2 {
        assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
        assert_eq!(decision(&robot), None, "layer {layer} and no more");
    }
    assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    let action = Action::Left as u8;
    assert_eq!(decision(&robot), Some(Decision { action, number: 7 }));
    assert_eq!(decision(&robot), None, "it was taken");
}

#[test]
fn what_is_no_policy_is_told_and_decides_nothing() {
    let (mut other, mut bad) = (blob(), blob());
    other[12] += 1;
    let sum = checksum(&other[12..]).to_le_bytes();
    other[8..12].copy_from_slice(&sum);
    *bad.last_mut().expect("bytes") ^= 1;
    for (blob, reason) in [(other, Reason::OtherObservation), (bad, Reason::BadPolicy)] {
        let robot = robot("decide");
        let mut activity = pin!(decide(&robot, trained(&blob), TestRng(1)));
        let mut cx = Context::from_waker(Waker::noop());
        for number in 0..5 {
            let asked = asked(Observation::NOTHING, number);
            robot.control_handle().ask_policy(asked, named("trained"));
            assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
            assert_eq!(decision(&robot), None);
        }
        let name = named("trained");
        assert_eq!(robot.policies().check(name), Err(reason));
    }
}

/// A flash with these bytes from its beginning on.
async fn flash(bytes: &[u8]) -> TestFlash {
    let mut flash = TestFlash::new(16);
    let whole = bytes.len().next_multiple_of(4);
    let mut words = bytes.to_vec();
    words.resize(whole, 0xFF);
    flash.write(0, &words).await.expect("blank");
    flash
}

type TestShelf = Shelf<NoopRawMutex, Inline>;

/// What is decided for that, if anything.
fn decided(
    shelf: &TestShelf,
    own: &[u8],
    name: &str,
    observation: Observation,
) -> Option<Decision> {
    let robot = robot("decide");
    let mut activity = pin!(decide_with_shelf(&robot, trained(own), shelf, TestRng(3)));
    let mut cx = Context::from_waker(Waker::noop());
    let asked = asked(observation, 1);
    robot.control_handle().ask_policy(asked, named(name));
    for _ in 0..5 {
        assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    }
    decision(&robot)
}

#[test]
fn a_policy_on_the_shelf_is_decided_by_under_its_name_and_no_other() {
    embassy_futures::block_on(async {
        let shelf = TestShelf::new();
        let nothing = Observation::NOTHING;
        let decides = |name| decided(&shelf, &[], name, nothing).map(|made| made.action);
        assert_eq!(decides("brought"), None, "there is none");
        let blob = blob();
        let bytes = blob.len() as u32;
        let put = shelf.put(&mut flash(&blob).await, 0, bytes).await;
        assert_eq!(put, Ok(()));
        assert_eq!(decides("brought"), None, "nobody has allowed it");
        shelf.allow(Some(named("brought"))).await;
        assert_eq!(decides("brought"), Some(Action::Left as u8));
        assert_eq!(decides("other"), None);
        // Of two that are called the same it is the one.
        let mut own = blob.clone();
        own.truncate(20);
        let made = decided(&shelf, &own, "brought", nothing);
        assert_eq!(made.map(|made| made.action), Some(Action::Left as u8));
        shelf.allow(None).await;
        assert_eq!(decides("brought"), None, "it was taken away");
    });
}

#[test]
fn what_cannot_be_driven_by_is_not_put_on_the_shelf_and_takes_the_place_of_nothing() {
    embassy_futures::block_on(async {
        let shelf = TestShelf::new();
        let good = blob();
        let (mut bad, mut other, mut deaf) = (good.clone(), good.clone(), flash(&good).await);
        *bad.last_mut().expect("bytes") ^= 1;
        other[12] += 1;
        let other = sealed(&other[12..]);
        for (blob, bytes, why) in [
            (&bad, bad.len(), PolicyError::Checksum),
            (&other, other.len(), PolicyError::OtherObservation),
            (&good, good.len() - 1, PolicyError::Length),
            (&good, 3, PolicyError::Foreign),
            (&good, 0, PolicyError::Foreign),
            (&good, 12 * 1_024 + 1, PolicyError::Length),
            (&good, u32::MAX as usize, PolicyError::Length),
        ] {
            let put = shelf.put(&mut flash(blob).await, 0, bytes as u32).await;
            assert_eq!(put, Err(Unread::Policy(why)), "{bytes}");
            shelf.allow(Some(named("brought"))).await;
            let made = decided(&shelf, &[], "brought", Observation::NOTHING);
            assert_eq!(made, None);
        }
        deaf.0.borrow_mut().deaf = true;
        let put = shelf.put(&mut deaf, 0, good.len() as u32).await;
        assert_eq!(put, Err(Unread::Flash));
        shelf.allow(Some(named("brought"))).await;
        let made = decided(&shelf, &[], "brought", Observation::NOTHING);
        assert_eq!(made, None, "half of it is not driven by");
    });
}

/// A shelf with this policy, which may be driven by as `brought`.
fn shelf_of(blob: &[u8]) -> TestShelf {
    let shelf = TestShelf::new();
    embassy_futures::block_on(async {
        let mut flash = flash(blob).await;
        let put = shelf.put(&mut flash, 0, blob.len() as u32).await;
        assert_eq!(put, Ok(()));
        shelf.allow(Some(named("brought"))).await;
    });
    shelf
}

/// Has the robot compare a policy, or none.
fn compare(robot: &TestRobot, seq: u64, policy: Option<&str>) {
    let policy = policy.map(|name| PolicyName::new(name).expect("a name"));
    let command = Command {
        action: Order::Shadow { policy },
        timestamp: 0,
        seq,
        source: source("operator:ada"),
    };
    let mut buffer = [0; 1_024];
    let length = command.to_json(&mut buffer).expect("fits");
    robot.submit(&buffer[..length], Instant::BOOT);
}

/// The answer to that, and the reason.
fn answer(robot: &TestRobot) -> Option<(ResponseStatus, Option<Reason>)> {
    let (ticket, answer) = robot.outbox.next_answer()?;
    robot.outbox.sent(ticket);
    robot.outbox.delivered(ticket);
    Some((answer.status, answer.reason))
}

/// What is decided in turn by `driving`, which has the other place than the candidate, if there is one; and how that
/// compares.
fn series(
    [own, brought]: [&[u8]; 2],
    (driving, candidate): (&str, Option<&str>),
    seen: &[Asked],
) -> (Vec<Option<Decision>>, Option<Shadow>) {
    let (robot, shelf) = (robot("decide"), shelf_of(brought));
    let mut activity = pin!(decide_with_shelf(&robot, trained(own), &shelf, TestRng(3)));
    let mut cx = Context::from_waker(Waker::noop());
    assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    let installed = Installed::Policy(named("brought"));
    robot.update_handle().bring(installed, Installed::None);
    compare(&robot, 1, candidate);
    let decided = seen.iter().map(|asked| {
        robot.control_handle().ask_policy(*asked, named(driving));
        for _ in 0..10 {
            assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
        }
        decision(&robot)
    });
    (decided.collect(), robot.shadow())
}

#[test]
fn a_candidate_decides_after_the_one_that_drives_and_gives_way_to_the_next_observation() {
    let (robot, blob) = (robot("decide"), blob());
    let shelf = shelf_of(&blob);
    let mut activity = pin!(decide_with_shelf(
        &robot,
        trained(&blob),
        &shelf,
        TestRng(1)
    ));
    let mut cx = Context::from_waker(Waker::noop());
    assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    let rejected = |reason| Some((ResponseStatus::Rejected, Some(reason)));
    compare(&robot, 1, Some("brought"));
    assert_eq!(answer(&robot), rejected(Reason::NoPolicy));
    let (bad, other) = (named("bad"), named("other"));
    for (unfit, name, reason) in [
        (Installed::Bad(bad), "bad", Reason::BadPolicy),
        (Installed::Other(other), "other", Reason::OtherObservation),
    ] {
        robot.update_handle().bring(Installed::None, unfit);
        compare(&robot, 2 + u64::from(name == "other"), Some(name));
        assert_eq!(answer(&robot), rejected(reason));
    }
    assert_eq!(robot.shadow(), None);
    let installed = Installed::Policy(named("brought"));
    robot.update_handle().bring(installed, Installed::None);
    compare(&robot, 4, Some("brought"));
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    let decisions = || robot.shadow().expect("begun").decisions;
    // Two layers of each network, and a look around before those of the candidate.
    for (polls, number) in (3..7).zip(0..) {
        let next = asked(Observation::NOTHING, number);
        robot.control_handle().ask_policy(next, named("trained"));
        for _ in 0..polls {
            assert_eq!(decisions(), 0);
            assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
        }
        let made = decision(&robot).expect("without waiting for the candidate");
        assert_eq!(made.number, number, "after {polls}");
    }
    assert_eq!(decisions(), 1, "the last one alone had the time");
    for _ in 0..9 {
        assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
    }
    assert_eq!(decisions(), 1, "and nobody asked again");
    // It ends by a command, and so does what is counted.
    compare(&robot, 5, None);
    assert_eq!(answer(&robot), Some((ResponseStatus::Completed, None)));
    assert_eq!(robot.shadow(), None);
}

fn some_seen() -> impl Strategy<Value = Vec<Asked>> {
    let one = (
        prop::collection::vec(any::<i8>(), WIDTH),
        any::<(u16, u16)>(),
    );
    prop::collection::vec(one, 1..12).prop_map(|seen| {
        let of = |(number, (numbers, (ahead, behind))): (usize, (Vec<i8>, (u16, u16)))| Asked {
            observation: Observation::new(numbers.as_slice().try_into().expect("so many")),
            around: Around {
                // Mostly what is too near for some of the actions.
                ahead: ahead % 300,
                behind: behind % 300,
            },
            number: number as u16,
        };
        seen.into_iter().enumerate().map(of).collect()
    })
}

fn weights() -> impl Strategy<Value = Vec<u8>> {
    prop::collection::vec(
        any::<u8>(),
        Dense::bytes(WIDTH, 9) + Dense::bytes(9, Action::COUNT),
    )
}

/// A policy of these weights, but for multipliers, shifts and large biases, which have to make one.
fn network(mut weights: Vec<u8>, mode: u8) -> Vec<u8> {
    for (outputs, start) in [(9_usize, 0), (Action::COUNT, Dense::bytes(WIDTH, 9))] {
        let padded = outputs.next_multiple_of(4);
        for bias in weights[start..start + 4 * padded].chunks_mut(4) {
            bias[2..].fill(0);
        }
        for byte in &mut weights[start + 4 * padded..start + 6 * padded] {
            *byte = 1 + *byte % 12;
        }
    }
    random(&weights, mode)
}

proptest! {
    /// Any network that is a policy decides the same from the shelf as from the program.
    #[test]
    fn the_shelf_decides_as_the_program_does(
        weights in weights(),
        mode in 0..2_u8,
        numbers in prop::collection::vec(any::<i8>(), WIDTH),
    ) {
        let blob = network(weights, mode);
        prop_assert!(Policy::new(&blob).is_ok());
        let numbers = <[i8; WIDTH]>::try_from(numbers.as_slice()).expect("so many");
        let observation = Observation::new(numbers);
        let shelf = shelf_of(&blob);
        let own = decided(&TestShelf::new(), &blob, "trained", observation);
        prop_assert!(own.is_some());
        prop_assert_eq!(decided(&shelf, &[], "brought", observation), own);
    }

    /// Whatever a candidate is: what drives decides what it decides without one, and draws what it draws.
    #[test]
    fn a_candidate_changes_nothing_of_what_drives(
        driving in (weights(), 0..2_u8),
        candidate in (weights(), 0..2_u8),
        seen in some_seen(),
        changed: bool,
    ) {
        let [driving, candidate] = [driving, candidate].map(|(weights, mode)| network(weights, mode));
        let mut places = [driving.as_slice(), &candidate];
        let mut names = ["trained", "brought"];
        if changed {
            places.reverse();
            names.reverse();
        }
        let (alone, nothing) = series(places, (names[0], None), &seen);
        prop_assert_eq!(nothing, None);
        prop_assert!(alone.iter().all(Option::is_some));
        let (beside, told) = series(places, (names[0], Some(names[1])), &seen);
        prop_assert_eq!(beside, alone);
        let told = told.expect("begun");
        prop_assert_eq!(told.decisions as usize, seen.len());
        prop_assert!(told.agreed.max(told.vetoes).max(told.driving_vetoes) <= told.decisions);
        prop_assert_eq!(told.policy.as_str(), names[1]);
    }

    /// Who has the same network chooses the same, also where actions are drawn.
    #[test]
    fn a_policy_agrees_with_itself(weights in weights(), mode in 0..2_u8, seen in some_seen()) {
        let blob = network(weights, mode);
        let (decided, told) = series([&blob, &blob], ("trained", Some("brought")), &seen);
        let told = told.expect("begun");
        prop_assert_eq!((told.decisions, told.agreed), (seen.len() as u32, seen.len() as u32));
        prop_assert_eq!(told.vetoes, told.driving_vetoes);
        let vetoed = decided.iter().zip(&seen).filter(|(decided, asked)| {
            let action = decided.and_then(|decided| Action::of(decided.action));
            shield(action.expect("one of them"), asked.around).1
        });
        prop_assert_eq!(told.vetoes as usize, vetoed.count());
        // Under its own name there is nobody to compare it with.
        let (alone, told) = series([&blob, &blob], ("trained", Some("trained")), &seen);
        prop_assert_eq!(alone, decided);
        prop_assert_eq!(told.expect("begun").decisions, 0);
    }
}
