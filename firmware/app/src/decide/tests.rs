//! What it decides, and when it lets others run.

use core::pin::pin;
use core::task::{Context, Poll, Waker};
use std::vec::Vec;

use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;
use crawler_protocol::Reason;

use super::*;
use crate::policy::{
    ACTIONS_VERSION, Action, FORMAT_VERSION, HEADER, LAYERS, MAGIC, OBSERVATION_VERSION,
    Observation, SHIELD_VERSION, STEPS, WIDTH,
};
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
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend(((rest.len() + 12) as u16).to_le_bytes());
    blob.extend(checksum(&rest).to_le_bytes());
    blob.extend(rest);
    assert_eq!(HEADER, 52 + LAYERS);
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
    assert_eq!(
        robot.installed_policy(),
        Installed::Policy(named("trained"))
    );
    assert_eq!(decision(&robot), None, "nobody has asked");
    robot.control_handle().ask_policy(Asked {
        observation: Observation::NOTHING,
        number: 7,
    });
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
            robot.control_handle().ask_policy(Asked {
                observation,
                number,
            });
            assert!(activity.as_mut().poll(&mut cx) == Poll::Pending);
            assert_eq!(decision(&robot), None);
        }
        let name = named("trained");
        assert_eq!(robot.installed_policy().check(name), Err(reason));
    }
}
