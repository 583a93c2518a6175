//! Fuzz target of what a robot takes for a policy. The fuzzer and the replay of its corpus in the tests of
//! `crawler-app` include this file.

use crawler_app::policy::{Action, Mode, Observation, Policy, Scratch, WIDTH, choose};
use crawler_micromodel::blob::checksum;

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 1] = [("policy_blob", policy)];

/// Whatever is accepted decides, whatever is observed, and the same again; nothing is drawn where the best action is
/// asked for. Length and checksum are made right first, or nothing would get past them.
fn policy(data: &[u8]) {
    let mut blob = data.to_vec();
    let _ = Policy::new(&blob);
    if let Some(length) = blob.get_mut(6..8) {
        length.copy_from_slice(&(data.len() as u16).to_le_bytes());
    }
    let sum = checksum(blob.get(12..).unwrap_or_default());
    if let Some(place) = blob.get_mut(8..12) {
        place.copy_from_slice(&sum.to_le_bytes());
    }
    let Ok(policy) = Policy::new(&blob) else {
        return;
    };
    let mut seen = [0; WIDTH];
    for (number, byte) in seen.iter_mut().zip(blob.iter().rev()) {
        *number = byte.cast_signed();
    }
    for numbers in [[0; WIDTH], [i8::MIN; WIDTH], [i8::MAX; WIDTH], seen] {
        let observation = Observation::new(numbers);
        for draw in [0, 0x80, u8::MAX] {
            let mut draws = 0;
            let mut random = || {
                draws += 1;
                draw
            };
            let action = choose(&policy, &observation, &mut random);
            let expected = match policy.mode {
                Mode::Best => 0,
                Mode::Drawn => Action::COUNT,
            };
            assert_eq!(draws, expected);
            let mut scratch = Scratch::new(&observation);
            for layer in policy.layers() {
                scratch.run(layer);
            }
            assert_eq!(scratch.action(policy.mode, || draw), action);
        }
    }
}
