//! The environment beside the world that it stands for.

use proptest::prelude::*;

use super::*;

fn world() -> Spread {
    Spread::new(Arc::new(Spread::scenario().unwrap()))
}

/// Drives an episode of this seed with actions drawn from it; what was observed and earned.
fn drive(seed: Seed, draws: u64, most: u32) -> (Vec<(Vec<i8>, f32)>, Status) {
    let mut world = world();
    world.reset(seed);
    let (mut seen, mut state) = (Vec::new(), draws);
    let mut rewards = [0.0; 3];
    for _ in 0..most {
        let mut actions = [0; 3];
        for (agent, action) in actions.iter_mut().enumerate() {
            state = state.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(1);
            *action = (state >> 33) as u8 % Action::COUNT as u8;
            seen.push((world.observation(agent).numbers().to_vec(), rewards[agent]));
        }
        let status = world.step(&actions, &mut rewards);
        if status != Status::Running {
            return (seen, status);
        }
    }
    (seen, Status::Running)
}

#[test]
fn an_episode_follows_from_its_seed_and_the_actions() {
    let seed = Seed::training(7, 1, 2);
    assert_eq!(drive(seed, 3, 60), drive(seed, 3, 60));
    assert_ne!(drive(seed, 3, 60), drive(seed, 4, 60));
    assert_ne!(drive(seed, 3, 60), drive(Seed::training(7, 1, 3), 3, 60));
}

#[test]
fn robots_observe_each_other_and_do_what_is_decided() {
    let mut world = world();
    world.reset(Seed::evaluation(1));
    let mut rewards = [0.0; 3];
    assert_eq!(
        world.observation(0).numbers()[32],
        0,
        "nobody was told of yet"
    );
    for _ in 0..7 {
        world.step(&[Action::Stand as u8; 3], &mut rewards);
    }
    for agent in 0..3 {
        let observation = world.observation(agent);
        let numbers = observation.numbers();
        assert!(
            numbers[32] > 0 && numbers[36] > 0,
            "two others: {numbers:?}"
        );
        assert_eq!(numbers[40], 0, "and no third");
    }
    let heading = |world: &Spread| {
        let episode = world.episode.as_ref().unwrap();
        episode.world.observe(index(0)).unwrap().pose.theta
    };
    let before = heading(&world);
    for _ in 0..5 {
        world.step(
            &[Action::Left as u8, Action::Stand as u8, Action::Stand as u8],
            &mut rewards,
        );
    }
    let turned = heading(&world) - before;
    let turned = libm::remainderf(turned, core::f32::consts::TAU);
    assert!(
        (0.2..0.8).contains(&turned),
        "1.2 rad/s for half a second, from standing: {turned}"
    );
    assert_eq!(
        world.observation(0).numbers()[47],
        127,
        "it knows that it turns left"
    );
}

/// Who only stands touches nobody, and whoever goes on for fifty seconds is broken off.
#[test]
fn an_episode_has_an_end() {
    let mut world = world();
    world.reset(Seed::evaluation(2));
    let mut rewards = [0.0; 3];
    let mut steps = 0;
    let status = loop {
        steps += 1;
        let status = world.step(&[0; 3], &mut rewards);
        if status != Status::Running {
            break status;
        }
    };
    let apart = world.succeeded();
    assert!(apart || (status, steps) == (Status::Truncated, LONGEST));
    assert!(!world.driven().unwrap().touched);
}

/// How far robots come in an episode, in metres from where they began, who choose by chance and keep to it for `hold`
/// decisions.
fn come(hold: u32) -> f32 {
    const EPISODES: u32 = 20;
    let mut world = world();
    let (mut rewards, mut state) = ([0.0; 3], 1_u64);
    let places = |world: &Spread| {
        let episode = world.episode.as_ref().unwrap();
        (0..3)
            .map(|robot| episode.world.observe(index(robot)).unwrap().pose)
            .collect::<Vec<_>>()
    };
    let mut come = 0.0;
    for number in 0..EPISODES {
        world.reset(Seed::training(1, number, 0));
        let began = places(&world);
        let mut actions = [0; 3];
        for step in 0.. {
            for action in actions.iter_mut().filter(|_| step % hold == 0) {
                state = state.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(1);
                *action = ((state >> 33) % Action::COUNT as u64) as u8;
            }
            if world.step(&actions, &mut rewards) != Status::Running {
                break;
            }
        }
        for (began, ended) in began.iter().zip(places(&world)) {
            come += libm::hypotf(ended.x - began.x, ended.y - began.y);
        }
    }
    come / (3 * EPISODES) as f32
}

/// Why a training has robots keep to what they chose: the shield lets nobody drive who has not looked around.
#[test]
fn who_chooses_anew_each_time_goes_nowhere() {
    let (anew, kept) = (come(1), come(8));
    assert!(anew < 0.02 && kept > 0.15, "{anew} {kept}");
}

proptest! {
    #![proptest_config(crawler_properties::cases(24))]
    #[test]
    fn what_is_earned_and_observed_is_within_bounds(number in 0..1_000_u32, draws: u64) {
        let (seen, _) = drive(Seed::evaluation(number), draws, 80);
        for (numbers, reward) in seen {
            prop_assert_eq!(numbers.len(), WIDTH);
            prop_assert!((-15.0..=10.0).contains(&reward), "{reward}");
        }
    }
}
