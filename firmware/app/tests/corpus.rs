//! The corpus of the fuzz target of policies is replayed.

// The same bodies as under the fuzzer; there they are public.
#[allow(unreachable_pub)]
#[path = "../../../fuzz/src/robots.rs"]
mod robots;

use std::fs;
use std::path::PathBuf;

use crawler_app::policy::{
    ACTIONS_VERSION, Action, FORMAT_VERSION, LAYERS, MAGIC, NO_SCORE, OBSERVATION_VERSION, Policy,
    SHIELD_VERSION, STEPS, WIDTH,
};
use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus/policy_blob")
}

#[test]
fn the_corpus_is_replayed() {
    for (name, body) in robots::TARGETS {
        assert!(corpus().ends_with(name));
        let mut replayed = 0;
        for entry in fs::read_dir(corpus()).expect("a corpus") {
            body(&fs::read(entry.expect("an entry").path()).expect("readable"));
            replayed += 1;
        }
        assert!(replayed > 10, "{name} has a corpus of {replayed}");
    }
}

/// A policy whose layers have these outputs, with weights of any kind.
fn policy(mode: u8, score: u16, outputs: &[u8]) -> Vec<u8> {
    let mut rest = vec![OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];
    rest.extend([mode, STEPS, outputs.len() as u8]);
    rest.extend(score.to_le_bytes());
    rest.extend([0x5A; 32]);
    let mut widths = [0; LAYERS];
    widths[..outputs.len()].copy_from_slice(outputs);
    rest.extend(widths);
    let (mut inputs, mut state) = (WIDTH, 1_u32);
    for outputs in outputs {
        let outputs = usize::from(*outputs);
        let padded = outputs.next_multiple_of(4);
        let mut layer = vec![0; Dense::bytes(inputs, outputs)];
        layer[4 * padded..5 * padded].fill(200);
        layer[5 * padded..6 * padded].fill(12);
        for weight in &mut layer[6 * padded..] {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *weight = (state >> 24) as u8;
        }
        rest.extend(layer);
        inputs = outputs;
    }
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend(((rest.len() + 12) as u16).to_le_bytes());
    blob.extend(checksum(&rest).to_le_bytes());
    blob.extend(rest);
    blob
}

/// What the target begins with: policies of all shapes, and some that are none.
fn seeds() -> Vec<(String, Vec<u8>)> {
    let actions = Action::COUNT as u8;
    let shapes: [&[u8]; 4] = [
        &[actions],
        &[4, actions],
        &[8, 4, actions],
        &[4, 4, 4, actions],
    ];
    let mut seeds = Vec::new();
    for (mode, how) in [(0, "best"), (1, "drawn")] {
        for shape in shapes {
            let name = format!("{how}-{}", shape.len());
            seeds.push((name, policy(mode, 880, shape)));
        }
    }
    assert!(seeds.iter().all(|(_, blob)| Policy::new(blob).is_ok()));
    let sound = seeds[1].1.clone();
    let changed = |at: usize, to: u8| {
        let mut blob = sound.clone();
        blob[at] = to;
        blob
    };
    seeds.push(("unscored".into(), policy(0, NO_SCORE, &[actions])));
    seeds.push(("other-observation".into(), changed(12, 9)));
    seeds.push(("other-mode".into(), changed(15, 2)));
    seeds.push(("no-shift".into(), changed(56 + 5 * 4, 0)));
    seeds.push(("cut".into(), sound[..60].to_vec()));
    seeds.push(("head".into(), sound[..12].to_vec()));
    seeds
}

#[test]
fn the_corpus_has_what_is_written_today() {
    for (name, blob) in seeds() {
        let kept = fs::read(corpus().join(&name)).expect("a seed");
        assert!(kept == blob, "{name} is written otherwise today");
    }
}

#[test]
#[ignore = "writes the seeds of the corpus"]
fn seeds_are_written() {
    fs::create_dir_all(corpus()).expect("a folder");
    for (name, blob) in seeds() {
        fs::write(corpus().join(name), blob).expect("written");
    }
}
