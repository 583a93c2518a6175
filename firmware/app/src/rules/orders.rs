//! Every order that control takes gets its answers: `accepted` at most once and first, and
//! exactly one final one.

use std::collections::HashMap;
use std::string::String;
use std::vec;

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Direction, Formation, Measure, Places, ResponseStatus, Shape};
use heapless::Vec;
use proptest::prelude::*;

use crate::config::Geometry;
use crate::controller::{Controller, Inputs, Outputs, Tuning};
use crate::goal::{Mission, Swarm};
use crate::order::{Halt, Order, Sender, Task};
use crate::parameters::Parameters;
use crate::perception::{LinkHealth, Reading, SensorHealth, Sight};
use crate::testing::{TestRng, inputs, source};

/// Order, halt, whether it sees, whether it is linked, milliseconds.
type Step = (Option<Task>, Option<bool>, bool, bool, u64);

fn task() -> impl Strategy<Value = Task> {
    prop_oneof![
        (0_u8..=100, 0_u32..500).prop_map(|(speed, duration_ms)| Task::Move {
            direction: Direction::Forward,
            speed,
            duration_ms,
        }),
        Just(Task::Drive { v: 0.2, w: 0.5 }),
        Just(Task::Drive {
            v: f32::NAN,
            w: 0.5
        }),
        Just(Task::Scan),
        Just(Task::Wander { speed: 70 }),
        Just(Task::Swarm(Swarm::Flock)),
        Just(Task::Swarm(Swarm::Gather { x: 1.0, y: -2.0 })),
        (0_u32..2).prop_map(|leader| Task::Mission(Mission::Follow {
            leader,
            distance: 0.5,
        })),
        Just(Task::Mission(Mission::Consensus {
            measure: Measure::Temperature,
            f: 1,
        })),
        (-2_000.0_f32..2_000.0).prop_map(|far| {
            let tasks = Places::new(&[[0.1, 0.0], [far, 0.0]]);
            Task::Mission(Mission::Allocate {
                tasks: tasks.expect("two places"),
            })
        }),
        (-2_000.0_f32..2_000.0).prop_map(|far| {
            let area = Places::new(&[[0.0, 0.0], [1.0, 0.0], [0.0, far]]);
            Task::Mission(Mission::Cover {
                area: area.expect("three corners"),
            })
        }),
        (prop::sample::select(Shape::ALL), -2_000.0_f32..2_000.0).prop_map(|(shape, far)| {
            let path = Places::new(&[[0.0, 0.0], [far, 0.0]]).expect("two places");
            let (_, _, size) = Formation::size_of(shape);
            Task::Mission(Mission::Shaped(Formation {
                shape,
                size,
                heading: 1.0,
                path,
            }))
        }),
        (0_u16..2, -2_000.0_f32..2_000.0).prop_map(|(laps, far)| {
            let waypoints = Places::new(&[[0.0, 0.0], [0.1, 0.0], [0.0, far]]);
            Task::Mission(Mission::Patrol {
                waypoints: waypoints.expect("three places"),
                laps,
            })
        }),
        Just(Task::Goto { x: 0.1, y: 0.0 }),
        Just(Task::Goto {
            x: f32::INFINITY,
            y: 0.0
        }),
        Just(Task::Manual),
        Just(Task::Reset),
        Just(Task::Identify),
    ]
}

proptest! {
    #[test]
    fn every_order_is_finally_answered_once(
        steps in prop::collection::vec(
            (
                prop::option::weighted(0.5, task()),
                prop::option::weighted(0.05, any::<bool>()),
                prop::bool::weighted(0.9),
                prop::bool::weighted(0.9),
                1_u64..400,
            ),
            1..300,
        ),
    ) {
        let tuning = Tuning::new(&Parameters::default(), &Geometry::default());
        let mut controller = Controller::new(tuning);
        let mut rng = TestRng(5);
        let mut now = Instant::BOOT;
        let mut book: HashMap<(String, u64), std::vec::Vec<ResponseStatus>> = HashMap::new();
        let mut seq = 0;
        let mut last = false;
        let mut feed = |steps: &[Step]| {
            for (task, halt, sees, linked, ms) in steps {
                now += Duration::from_millis(*ms);
                seq += 1;
                let sender = |name| Sender { source: source(name), seq };
                let order = task.map(|task| Order { task, sender: sender("a"), arrived: now });
                let halt = halt.map(|emergency| Halt {
                    emergency,
                    senders: Vec::from_iter([sender("b"), sender("c")]),
                });
                for sent in order.iter().map(|o| &o.sender).chain(halt.iter().flat_map(|h| &h.senders)) {
                    book.insert((sent.source.as_str().into(), sent.seq), std::vec::Vec::new());
                }
                let inputs = Inputs {
                    reading: Reading {
                        sight: sees.then_some((Sight::Clear, now)),
                        health: SensorHealth::Good,
                        temperature: None,
                    },
                    link: if *linked { LinkHealth::Up } else { LinkHealth::Lost },
                    halt: halt.as_ref(),
                    ..inputs(Sight::Clear, now, order.as_ref())
                };
                let out: Outputs = controller.step(&inputs, &mut rng, now);
                for answer in &out.answers {
                    let key = (answer.sender.source.as_str().into(), answer.sender.seq);
                    book.get_mut(&key).expect("was sent").push(answer.status);
                }
            }
            last = true;
        };
        feed(&steps);
        // A halt ends whatever is still open.
        feed(&[(None, Some(false), true, true, 20)]);
        prop_assert!(last);
        for (key, answers) in book {
            let finals = answers.iter().filter(|status| status.is_final()).count();
            prop_assert_eq!(finals, 1, "{:?}: {:?}", key, answers);
            prop_assert!(answers.len() <= 2, "{:?}: {:?}", key, answers);
            prop_assert!(answers.last().is_some_and(|status| status.is_final()));
        }
    }
}
