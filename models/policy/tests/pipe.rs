//! Worlds over a pipe: the same as here, and nothing but an error for what is no frame.

use std::io::Cursor;
use std::num::NonZeroUsize;

use crawler_policy::gym::{Fault, ServeError, VERSION, serve};
use crawler_policy::{Environment, Seed, Status};
use proptest::prelude::*;

use crate::client::{Client, Order, Worlds, advance, frame, hello, read};
use crate::environments::cartpole::CartPole;
use crate::environments::pair::Pair;

fn count(number: usize) -> NonZeroUsize {
    NonZeroUsize::new(number).expect("not zero")
}

/// What is answered to these bytes, and how it ended.
fn answer<E: Environment + Default>(
    worlds: usize,
    threads: usize,
    asked: &[u8],
) -> (Vec<u8>, Result<(), ServeError>) {
    let mut answered = Vec::new();
    let (worlds, threads) = (count(worlds), count(threads));
    let result = serve("pair", worlds, E::default, threads, asked, &mut answered);
    (answered, result)
}

/// The same worlds without a pipe.
struct Here<E> {
    worlds: Vec<(E, u8)>,
}

impl<E: Environment + Default> Here<E> {
    fn new(worlds: usize) -> Self {
        Self {
            worlds: (0..worlds).map(|_| (E::default(), 3)).collect(),
        }
    }

    fn advance(&mut self, orders: &[Order], before: Option<&Worlds>) -> Worlds {
        let mut all = Worlds {
            observations: Vec::new(),
            rewards: Vec::new(),
            states: Vec::new(),
            statuses: Vec::new(),
        };
        for (number, ((world, status), order)) in self.worlds.iter_mut().zip(orders).enumerate() {
            let interface = world.interface();
            let mut rewards = vec![0.0; interface.agents];
            let mut observed = vec![0.0; interface.agents * interface.observation];
            let mut state = vec![0.0; interface.agents * interface.state];
            let mut begin = |seed| {
                world.reset(seed);
                *status = 0;
            };
            match order {
                Order::Act(actions) => {
                    *status = match world.step(actions, &mut rewards) {
                        Status::Running => 0,
                        Status::Terminated => 1,
                        Status::Truncated => 2,
                    };
                    if *status > 0 && world.succeeded() {
                        *status += 4;
                    }
                }
                Order::Train(run, environment, episode) => {
                    begin(Seed::training(*run, *environment, *episode));
                }
                Order::Evaluate(number) => begin(Seed::evaluation(*number)),
                Order::Rest => {}
            }
            if let (Order::Rest, Some(before)) = (order, before) {
                let (o, s) = (observed.len(), state.len());
                observed.copy_from_slice(&before.observations[number * o..][..o]);
                state.copy_from_slice(&before.states[number * s..][..s]);
            } else if *order != Order::Rest {
                for agent in 0..interface.agents {
                    let (o, s) = (interface.observation, interface.state);
                    world.observe(agent, &mut observed[agent * o..][..o]);
                    world.state(agent, &mut state[agent * s..][..s]);
                }
            }
            all.observations.extend(observed);
            all.rewards.extend(rewards);
            all.states.extend(state);
            all.statuses.push(*status);
        }
        all
    }
}

/// A session that was asked for in one go: what is asked next depends on this side alone.
fn same_as_here<E: Environment + Default>(worlds: usize, threads: usize, steps: usize) {
    let interface = E::default().interface();
    let mut here = Here::<E>::new(worlds);
    let (mut asked, mut expected) = (hello(VERSION, 1), Vec::new());
    let (mut draws, mut episodes) = (1_u64, vec![0; worlds]);
    let mut draw = |end: u64| {
        draws = draws.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(1);
        (draws >> 33) % end
    };
    for _ in 0..steps {
        let orders: Vec<Order> = (0..worlds)
            .map(|world| {
                let runs = here.worlds[world].1 == 0;
                match (draw(20), runs) {
                    (0, _) => Order::Rest,
                    (1, _) => Order::Evaluate(draw(9) as u32),
                    (2, _) | (_, false) => {
                        episodes[world] += 1;
                        Order::Train(7, world as u32, episodes[world])
                    }
                    _ => Order::Act(
                        (0..interface.agents)
                            .map(|_| draw(interface.actions as u64) as u8)
                            .collect(),
                    ),
                }
            })
            .collect();
        expected.push(here.advance(&orders, expected.last()));
        asked.extend(advance(&orders, interface.agents));
    }
    asked.extend(frame(3, &[]));
    asked.extend(b"not read any more");
    let (answered, result) = answer::<E>(worlds, threads, &asked);
    result.expect("nothing is wrong");
    let mut client = Client::new(Cursor::new(answered), std::io::sink(), true);
    assert_eq!(client.hello.worlds, worlds);
    assert_eq!(client.hello.name, "pair");
    let ended = |worlds: &&Worlds| {
        worlds
            .statuses
            .iter()
            .any(|status| ![0, 3].contains(status))
    };
    assert!(expected.iter().filter(ended).count() > 2);
    for expected in expected {
        let orders = vec![Order::Rest; worlds];
        assert_eq!(client.advance(&orders), expected);
    }
}

#[test]
fn worlds_over_a_pipe_are_the_same_to_the_last_bit() {
    same_as_here::<Pair>(3, 1, 400);
    // As many as are worth threads.
    same_as_here::<Pair>(20, 3, 100);
    same_as_here::<CartPole>(17, 2, 600);
}

#[test]
fn what_a_critic_sees_is_said_where_it_was_asked_for() {
    let begin = advance(&[Order::Train(1, 0, 0)], 2);
    let lengths = |flags| {
        let (answered, result) =
            answer::<Pair>(1, 1, &[hello(VERSION, flags), begin.clone()].concat());
        result.expect("nothing is wrong");
        let mut input = Cursor::new(answered);
        [read(&mut input), read(&mut input)].map(|frame| frame.expect("an answer").1.len())
    };
    assert_eq!(lengths(0), [30, 4 * (2 * 2 + 2) + 1]);
    assert_eq!(lengths(1), [30, 4 * (2 * 2 + 2 + 2 * 2) + 1]);
}

/// How a session of two worlds of two agents with three actions ends that begins with hello.
fn fault(asked: &[u8]) -> Fault {
    let (answered, result) = answer::<Pair>(2, 1, asked);
    let Err(ServeError::Refused(fault)) = result else {
        panic!("{result:?}")
    };
    let mut input = Cursor::new(answered);
    let last = std::iter::from_fn(|| read(&mut input)).last();
    let (kind, text) = last.expect("an answer");
    assert_eq!(kind, 3);
    assert_eq!(String::from_utf8(text).expect("UTF-8"), fault.to_string());
    fault
}

#[test]
fn each_fault_is_said() {
    let greeted = |more: &[u8]| fault(&[&hello(VERSION, 0), more].concat());
    let act = |actions: [u8; 2]| Order::Act(actions.to_vec());
    let (begin, rest) = (Order::Train(1, 2, 3), Order::Rest);
    let told = |first: &Order, second: &Order| advance(&[first.clone(), second.clone()], 2);
    assert_eq!(fault(&[1, 0]), Fault::Cut);
    assert_eq!(fault(&hello(VERSION, 0)[..7]), Fault::Cut);
    let most = 1 + 2 * (1 + 2 + 16);
    assert_eq!(fault(&[0; 4]), Fault::Length { told: 0, most });
    let told_length = u32::MAX;
    let length = Fault::Length {
        told: told_length,
        most,
    };
    assert_eq!(fault(&[0xFF; 200]), length);
    assert_eq!(fault(b"\x06\0\0\0\x01HTTP/"), Fault::Foreign);
    assert_eq!(fault(b"\x08\0\0\0\x01TCGZ\x01\0\0"), Fault::Foreign);
    assert_eq!(fault(&hello(2, 0)), Fault::Version(2));
    // Whatever another version says more.
    assert_eq!(fault(&frame(1, b"TCGY\x09\0 and more")), Fault::Version(9));
    assert_eq!(fault(&hello(VERSION, 2)), Fault::Flags(2));
    assert_eq!(fault(&frame(3, &[])), Fault::NoHello);
    assert_eq!(fault(&told(&begin, &begin)), Fault::NoHello);
    assert_eq!(greeted(&hello(VERSION, 0)), Fault::Again);
    assert_eq!(greeted(&frame(9, &[])), Fault::Kind(9));
    let size = |kind, told, wanted| Fault::Size { kind, told, wanted };
    assert_eq!(greeted(&frame(3, &[0])), size(3, 1, 0));
    assert_eq!(greeted(&frame(2, &[])), size(2, 0, 6));
    assert_eq!(greeted(&frame(2, &[3, 3, 0, 0, 0])), size(2, 5, 6));
    assert_eq!(greeted(&frame(2, &[1, 3, 0, 0, 0, 0])), size(2, 6, 22));
    let order = Fault::Order { world: 1, order: 4 };
    assert_eq!(greeted(&frame(2, &[3, 4, 0, 0, 0, 0])), order);
    let action = Fault::Action {
        world: 1,
        agent: 1,
        action: 3,
        actions: 3,
    };
    assert_eq!(greeted(&told(&rest, &act([2, 3]))), action);
    let none = |world| Fault::NoEpisode { world };
    assert_eq!(greeted(&told(&act([0, 0]), &rest)), none(0));
    assert_eq!(greeted(&told(&begin, &act([0, 0]))), none(1));
    let mut training = told(&rest, &Order::Evaluate(3));
    let at = training.len() - 5;
    training[at] = 1;
    assert_eq!(greeted(&training), Fault::Seed { world: 1 });
}

#[test]
fn a_world_does_not_act_beyond_the_end_of_its_episode() {
    let mut asked = [hello(VERSION, 0), advance(&[Order::Train(1, 0, 0)], 1)].concat();
    let push = advance(&[Order::Act(vec![1])], 1);
    asked.extend(push.repeat(500));
    let (answered, result) = answer::<CartPole>(1, 1, &asked);
    assert!(matches!(
        result,
        Err(ServeError::Refused(Fault::NoEpisode { world: 0 }))
    ));
    let mut input = Cursor::new(answered);
    let kinds: Vec<u8> = std::iter::from_fn(|| read(&mut input).map(|(kind, _)| kind)).collect();
    assert!(kinds.len() < 30 && kinds.ends_with(&[2, 3]), "{kinds:?}");
}

#[test]
fn a_reader_that_goes_away_ends_it() {
    let mut room = [0; 10];
    let (one, asked) = (NonZeroUsize::MIN, hello(VERSION, 0));
    let result = serve("x", one, Pair::default, one, &asked[..], &mut room[..]);
    assert!(matches!(result, Err(ServeError::Output(_))), "{result:?}");
}

/// Sessions of two worlds that are fine.
fn session() -> impl Strategy<Value = Vec<u8>> {
    let order = prop_oneof![
        prop::collection::vec(0..3_u8, 2).prop_map(Order::Act),
        (any::<u64>(), any::<u32>(), any::<u32>()).prop_map(|(a, b, c)| Order::Train(a, b, c)),
        any::<u32>().prop_map(Order::Evaluate),
        Just(Order::Rest),
    ];
    let orders = prop::collection::vec(order, 2).prop_map(|orders| advance(&orders, 2));
    let begin = advance(&[Order::Train(1, 0, 0), Order::Evaluate(1)], 2);
    (0..2_u8, prop::collection::vec(orders, 0..6)).prop_map(move |(flags, rest)| {
        [hello(VERSION, flags), begin.clone(), rest.concat()].concat()
    })
}

proptest! {
    #![proptest_config(crawler_properties::cases(256))]

    /// Whatever comes in: whole frames go out, no more than came in, none longer than all worlds.
    #[test]
    fn any_bytes_are_answered_or_refused(
        mut asked in session(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        cut in prop::option::weighted(0.3, any::<prop::sample::Index>()),
        noise in prop::collection::vec(any::<u8>(), 0..80),
        noisy in prop::bool::weighted(0.1),
    ) {
        for (place, value) in changes {
            let place = place.index(asked.len());
            asked[place] = value;
        }
        if let Some(cut) = cut {
            asked.truncate(cut.index(asked.len()));
        }
        asked.extend(&noise);
        if noisy {
            asked = noise;
        }
        let (answered, result) = answer::<Pair>(2, 1, &asked);
        let mut input = Cursor::new(&answered);
        let frames: Vec<_> = std::iter::from_fn(|| read(&mut input)).collect();
        prop_assert_eq!(input.position() as usize, answered.len());
        prop_assert!(frames.len() <= asked.len() / 5 + 1);
        let refused = matches!(result, Err(ServeError::Refused(_)));
        prop_assert!(result.is_ok() || refused);
        for (number, (kind, body)) in frames.iter().enumerate() {
            let last = number + 1 == frames.len();
            prop_assert_eq!(*kind == 3, refused && last);
            prop_assert!(body.len() <= 4 * 20 + 2 || *kind == 3 && body.len() < 200);
        }
    }
}
