//! A policy from its bytes to its decisions.

use std::vec::Vec;

use crawler_micromodel::blob::checksum;
use crawler_micromodel::vector::Dense;
use proptest::prelude::*;

use super::*;

/// A blob with this header and these layers, whatever they are; its checksum fits.
fn sealed(
    versions: [u8; 3],
    how: [u8; 3],
    score: u16,
    widths: [u8; LAYERS],
    layers: &[u8],
) -> Vec<u8> {
    let mut rest = versions.to_vec();
    rest.extend(how);
    rest.extend(score.to_le_bytes());
    rest.extend([7; 32]);
    rest.extend(widths);
    rest.extend(layers);
    let mut blob = MAGIC.to_vec();
    blob.extend(FORMAT_VERSION.to_le_bytes());
    blob.extend(((rest.len() + 12) as u16).to_le_bytes());
    blob.extend(checksum(&rest).to_le_bytes());
    blob.extend(rest);
    blob
}

const VERSIONS: [u8; 3] = [OBSERVATION_VERSION, ACTIONS_VERSION, SHIELD_VERSION];

/// One layer that sees one number and has a logit of it for one action.
fn one_layer(number: usize, action: usize) -> Vec<u8> {
    let mut layer = std::vec![0; Dense::bytes(WIDTH, Action::COUNT)];
    let padded = Action::COUNT.next_multiple_of(4);
    layer[4 * padded..6 * padded].fill(1);
    layer[6 * padded + action / 4 * 4 * WIDTH + number * 4 + action % 4] = 64;
    layer
}

fn widths(first: usize) -> [u8; LAYERS] {
    [first as u8, 0, 0, 0]
}

fn small(mode: u8) -> Vec<u8> {
    let layer = one_layer(3, 5);
    sealed(
        VERSIONS,
        [mode, STEPS, 1],
        987,
        widths(Action::COUNT),
        &layer,
    )
}

fn seeing(number: usize, value: i8) -> Observation {
    let mut numbers = [0; WIDTH];
    numbers[number] = value;
    Observation::new(numbers)
}

#[test]
fn the_best_action_is_the_one_with_the_largest_logit() {
    let blob = small(0);
    let policy = Policy::new(&blob).unwrap();
    assert_eq!((policy.mode, policy.score), (Mode::Best, Some(987)));
    let chosen = |number, value| {
        choose(&policy, &seeing(number, value), || {
            unreachable!("nothing is drawn")
        })
    };
    assert_eq!(chosen(3, 1), Action::CurveLeft);
    assert_eq!(chosen(3, -1), Action::Stand, "of equal ones the first");
    assert_eq!(chosen(4, 127), Action::Stand);
}

#[test]
fn drawn_actions_have_the_probabilities_of_their_logits() {
    let blob = small(1);
    let policy = Policy::new(&blob).unwrap();
    // One logit is 2, six are 0: 4 · 64 / 2 steps of a 64th.
    let observation = seeing(3, 4);
    let mut state = 1_u32;
    let mut counts = [0_u32; Action::COUNT];
    for _ in 0..70_000 {
        let action = choose(&policy, &observation, || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        });
        counts[action as usize] += 1;
    }
    let sum = 6.0 + libm::exp(2.0);
    for (action, count) in counts.into_iter().enumerate() {
        let expected = if action == 5 { libm::exp(2.0) } else { 1.0 } / sum;
        let share = f64::from(count) / 70_000.0;
        assert!(
            (share - expected).abs() < 0.01,
            "{action}: {share} {expected}"
        );
    }
}

#[test]
fn what_is_no_policy_is_refused_with_a_reason() {
    let good = small(0);
    assert_eq!(Policy::new(&[]), Err(PolicyError::Foreign));
    assert_eq!(Policy::new(b"TCMM...."), Err(PolicyError::Foreign));
    for len in 4..good.len() {
        assert!(Policy::new(&good[..len]).is_err(), "{len}");
    }
    for at in 4..good.len() {
        let mut bad = good.clone();
        bad[at] ^= 0x40;
        let expected = match at {
            4 | 5 => PolicyError::Version(if at == 4 { 0x41 } else { 0x4001 }),
            6 | 7 => PolicyError::Length,
            _ => PolicyError::Checksum,
        };
        assert_eq!(Policy::new(&bad), Err(expected), "{at}");
    }
    let layer = one_layer(0, 0);
    let first = widths(Action::COUNT);
    let with = |versions, how, score, widths| sealed(versions, how, score, widths, &layer);
    for (blob, error) in [
        (
            with([2, 1, 1], [0, STEPS, 1], 0, first),
            PolicyError::OtherObservation,
        ),
        (
            with([1, 2, 1], [0, STEPS, 1], 0, first),
            PolicyError::OtherObservation,
        ),
        (
            with([1, 1, 2], [0, STEPS, 1], 0, first),
            PolicyError::OtherObservation,
        ),
        (
            with(VERSIONS, [0, 4, 1], 0, first),
            PolicyError::OtherObservation,
        ),
        (with(VERSIONS, [2, STEPS, 1], 0, first), PolicyError::Header),
        (
            with(VERSIONS, [0, STEPS, 0], 0, [0; LAYERS]),
            PolicyError::Header,
        ),
        (with(VERSIONS, [0, STEPS, 5], 0, first), PolicyError::Header),
        (
            with(VERSIONS, [0, STEPS, 1], 1_001, first),
            PolicyError::Header,
        ),
        (
            with(VERSIONS, [0, STEPS, 1], 0, [7, 1, 0, 0]),
            PolicyError::Header,
        ),
        (
            with(VERSIONS, [0, STEPS, 1], 0, widths(8)),
            PolicyError::Network(1),
        ),
        (
            with(VERSIONS, [0, STEPS, 1], 0, widths(200)),
            PolicyError::Network(1),
        ),
        (
            with(VERSIONS, [0, STEPS, 2], 0, [7, 7, 0, 0]),
            PolicyError::Network(2),
        ),
        (
            sealed(
                VERSIONS,
                [0, STEPS, 1],
                0,
                first,
                &[layer.clone(), std::vec![0]].concat(),
            ),
            PolicyError::Network(1),
        ),
        (
            sealed(VERSIONS, [0, STEPS, 1], 0, first, &std::vec![0; 13_000]),
            PolicyError::Length,
        ),
    ] {
        assert_eq!(Policy::new(&blob), Err(error));
    }
    let unscored = with(VERSIONS, [0, STEPS, 1], NO_SCORE, first);
    assert_eq!(Policy::new(&unscored).map(|policy| policy.score), Ok(None));
}

#[test]
fn a_robot_says_why_it_does_not_drive_by_a_policy() {
    use crawler_protocol::Reason;
    let (none, here) = (Installed::None, Installed::Policy(7));
    let (bad, other) = (Installed::Bad(7), Installed::Other(7));
    for (own, brought, name, expected) in [
        (here, none, 7, Ok(())),
        (none, here, 7, Ok(())),
        (here, none, 8, Err(Reason::NoPolicy)),
        (none, none, 7, Err(Reason::NoPolicy)),
        (bad, none, 7, Err(Reason::BadPolicy)),
        (none, bad, 7, Err(Reason::BadPolicy)),
        (none, bad, 8, Err(Reason::NoPolicy)),
        (none, other, 7, Err(Reason::OtherObservation)),
        // The one before it is used, and may be called otherwise.
        (none, here, 7, Ok(())),
        // The one of the program is there whatever came under its name.
        (here, bad, 7, Ok(())),
        (here, other, 7, Ok(())),
    ] {
        let policies = Policies {
            own,
            brought,
            unfit: Installed::None,
        };
        assert_eq!(policies.check(name), expected, "{policies:?} {name}");
    }
}

proptest! {
    /// Whatever the weights are: an action, and no panic.
    #[test]
    fn any_network_decides_something(
        weights in prop::collection::vec(any::<u8>(), Dense::bytes(WIDTH, 9) + Dense::bytes(9, Action::COUNT)),
        numbers in prop::collection::vec(any::<i8>(), WIDTH),
        mode in 0..2_u8,
        random: u8,
    ) {
        let blob = sealed(VERSIONS, [mode, STEPS, 2], 0, [9, Action::COUNT as u8, 0, 0], &weights);
        if let Ok(policy) = Policy::new(&blob) {
            let numbers = <[i8; WIDTH]>::try_from(numbers.as_slice()).unwrap();
            let mut byte = random;
            let _ = choose(&policy, &Observation::new(numbers), || { byte = byte.wrapping_add(101); byte });
        }
    }

    #[test]
    fn no_bytes_make_reading_panic(
        bytes in prop::collection::vec(any::<u8>(), 0..600),
        how in any::<[u8; 3]>(),
        widths in any::<[u8; LAYERS]>(),
    ) {
        let _ = Policy::new(&bytes);
        let how = [how[0] % 3, STEPS, how[2] % 6];
        let _ = Policy::new(&sealed(VERSIONS, how, 5, widths.map(|width| width % 12), &bytes));
    }
}
