//! Row by row, in 32 bits and in a small arena, the same comes out as in the plainest way.

// Each test file uses a part of it.
#[allow(dead_code)]
mod common;

use common::{Dice, Layer, Network};
use crawler_micromodel::{Model, ModelError, Runner, Step, arena_bytes};
use proptest::prelude::*;

/// A frame of noise, and what writes its rows.
fn frame(network: &Network, seed: u64) -> Vec<i8> {
    let mut dice = Dice::new(seed);
    (0..network.input.values()).map(|_| dice.byte()).collect()
}

fn rows(frame: &[i8]) -> impl Fn(usize, &mut [i8]) + '_ {
    |row, out| out.copy_from_slice(&frame[row * out.len()..][..out.len()])
}

proptest! {
    #![proptest_config(crawler_properties::cases(600))]

    #[test]
    fn the_same_comes_out(seed: u64) {
        let network = Network::random(seed);
        let blob = match network.blob(&[]) {
            Ok(blob) => blob,
            // A random sum may leave a layer that nobody looks at.
            Err(ModelError::Unused(_)) => return Ok(()),
            Err(error) => panic!("{error}"),
        };
        let model = Model::new(&blob).unwrap();
        prop_assert_eq!(arena_bytes(&blob), Ok(model.arena_bytes()));
        // What is left in the arena by somebody else must not matter, nor what is behind it.
        let mut arena = vec![55; model.arena_bytes() + 7];
        let mut runner = Runner::new(model, &mut arena).unwrap();
        for n in 0..2 {
            let frame = frame(&network, seed ^ n);
            prop_assert_eq!(runner.run(rows(&frame)), &network.expected(&frame)[..]);
        }
        prop_assert_eq!(&arena[model.arena_bytes()..], &[55; 7][..]);
    }
}

/// A seed whose network has rows to spare and a sum.
fn sizeable() -> (Network, Vec<u8>) {
    (0..1_000)
        .map(Network::random)
        .find_map(|network| {
            let sums = network
                .layers
                .iter()
                .any(|layer| matches!(layer, Layer::Sum(_)));
            let blob = network.blob(&[]).ok()?;
            (sums && network.input.height > 10 && network.layers.len() > 4)
                .then_some((network, blob))
        })
        .expect("some seed has")
}

#[test]
fn steps_can_be_taken_one_by_one_and_a_run_begun_again() {
    let (network, blob) = sizeable();
    let model = Model::new(&blob).unwrap();
    let mut arena = vec![0; model.arena_bytes()];
    let mut runner = Runner::new(model, &mut arena).unwrap();
    let (one, two) = (frame(&network, 1), frame(&network, 2));
    for _ in 0..9 {
        assert_eq!(runner.step(rows(&one)), Step::More);
    }
    runner.restart();
    let mut steps = 1;
    while runner.step(rows(&two)) == Step::More {
        steps += 1;
    }
    assert!(steps > usize::from(network.input.height));
    assert_eq!(runner.output(), network.expected(&two));
    // The step after the last one is the first of the next run.
    assert_eq!(runner.step(rows(&one)), Step::More);
    while runner.step(rows(&one)) == Step::More {}
    assert_eq!(runner.output(), network.expected(&one));
}

#[test]
fn an_arena_that_is_too_small_is_told_what_it_needs() {
    let (network, blob) = sizeable();
    let model = Model::new(&blob).unwrap();
    let needed = model.arena_bytes();
    let all: usize = network.input.values();
    assert!(needed > 0 && all > 0);
    let mut arena = vec![0; needed - 1];
    let error = Runner::new(model, &mut arena).unwrap_err();
    assert_eq!(error, ModelError::Arena { needed });
}

#[test]
fn labels_are_there_or_not() {
    let (network, blob) = sizeable();
    let model = Model::new(&blob).unwrap();
    assert_eq!(model.labels().count(), 0);
    let names: Vec<String> = (0..model.output().channels)
        .map(|channel| format!("klasse ä{channel}"))
        .collect();
    let mut labels: Vec<&str> = names.iter().map(String::as_str).collect();
    let blob = network.blob(&labels).unwrap();
    let read: Vec<&str> = Model::new(&blob).unwrap().labels().collect();
    assert_eq!(read, labels);
    labels.push("one more");
    assert_eq!(network.blob(&labels).unwrap_err(), ModelError::Labels);
}
