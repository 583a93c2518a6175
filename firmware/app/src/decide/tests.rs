//! What it decides, and when it lets others run.

use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::vec::Vec;

use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;
use crawler_protocol::Reason;

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_storage_async::nor_flash::NorFlash as _;
use proptest::prelude::*;

use super::*;
use crate::hold::Inline;
use crate::policy::{
    ACTIONS_VERSION, Action, FORMAT_VERSION, HEADER, LAYERS, MAGIC, OBSERVATION_VERSION,
    Observation, SHIELD_VERSION, STEPS, Unread, WIDTH,
};
use crate::testing::flash::TestFlash;
use crate::testing::{TestRng, TestRobot, robot};

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
    let asked = Asked {
        observation: Observation::NOTHING,
        number: 7,
    };
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
            let observation = Observation::NOTHING;
            let asked = Asked {
                observation,
                number,
            };
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
    let number = 1;
    let asked = Asked {
        observation,
        number,
    };
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

proptest! {
    /// Any network that is a policy decides the same from the shelf as from the program.
    #[test]
    fn the_shelf_decides_as_the_program_does(
        weights in prop::collection::vec(
            any::<u8>(),
            Dense::bytes(WIDTH, 9) + Dense::bytes(9, Action::COUNT),
        ),
        mode in 0..2_u8,
        numbers in prop::collection::vec(any::<i8>(), WIDTH),
    ) {
        let mut weights = weights;
        // Multipliers and shifts that make one.
        for (inputs, outputs, start) in [(WIDTH, 9_usize, 0), (9, Action::COUNT, Dense::bytes(WIDTH, 9))] {
            let padded = outputs.next_multiple_of(4);
            prop_assert!(start + Dense::bytes(inputs, outputs) <= weights.len());
            for bias in weights[start..start + 4 * padded].chunks_mut(4) {
                bias[2..].fill(0);
            }
            for byte in &mut weights[start + 4 * padded..start + 6 * padded] {
                *byte = 1 + *byte % 12;
            }
        }
        let blob = random(&weights, mode);
        prop_assert!(Policy::new(&blob).is_ok());
        let numbers = <[i8; WIDTH]>::try_from(numbers.as_slice()).expect("so many");
        let observation = Observation::new(numbers);
        let shelf = TestShelf::new();
        embassy_futures::block_on(async {
            let put = shelf.put(&mut flash(&blob).await, 0, blob.len() as u32).await;
            assert_eq!(put, Ok(()));
            shelf.allow(Some(named("brought"))).await;
        });
        let own = decided(&TestShelf::new(), &blob, "trained", observation);
        prop_assert!(own.is_some());
        prop_assert_eq!(decided(&shelf, &[], "brought", observation), own);
    }
}
