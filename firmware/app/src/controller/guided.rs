//! Following the plan that [`navigation`](crate::navigation) makes on the way to a place.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Pose;
use rand_core::Rng;

use super::{Controller, Inputs};
use crate::behaviour::{HEADING_GAIN, SLOW_WITHIN, SLOWEST};
use crate::goal::Goal;
use crate::motion::angle::millimetres;
use crate::motion::{Twist, wrap};
use crate::navigation::{Destination, Way};
use crate::state::Event;

/// Beyond this heading error the robot turns in place: what is planned are straight lines.
const TURN_IN_PLACE: f32 = 0.6;
/// Within this heading error what is near ahead is on the way.
const ON_THE_WAY: f32 = 0.35;
/// How long a robot with a plan drives straight on after it has turned aside.
const STRAIGHT: Duration = Duration::from_millis(400);

/// What is kept of the way.
#[derive(Debug, Clone, Copy, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Guided {
    /// Where to.
    going: Option<Destination>,
    number: u16,
    /// Heading error of the last step.
    error: f32,
}

impl Guided {
    /// Notes where `goal` leads.
    pub(super) fn set_out(&mut self, goal: &Goal, speed: f32) {
        let Goal::Goto { x, y, .. } = *goal else {
            return;
        };
        self.number = self.number.wrapping_add(1);
        self.going = Some(Destination {
            number: self.number,
            // Casts saturate; a `goto` leads no farther than a kilometre.
            at: [x, y].map(|along| (along * 1_000.0) as i32),
            speed: millimetres(speed),
            bumps: 0,
        });
    }

    /// Notes that something keeps the robot from driving on although its ranger does not see it.
    pub(super) fn bump(&mut self) {
        if let Some(going) = &mut self.going {
            going.bumps = going.bumps.wrapping_add(1);
        }
    }
}

impl Controller {
    /// Where the robot is to go, while it is on its way.
    pub fn going(&self) -> Option<Destination> {
        matches!(self.state.goal(), Some(Goal::Goto { .. }))
            .then_some(self.guided.going)
            .flatten()
    }

    /// What the plan for the present way says.
    pub(super) fn way(&self, inputs: &Inputs<'_>) -> Option<Way> {
        let going = self.going()?;
        let guide = inputs.guide.filter(|guide| guide.number == going.number)?;
        Some(guide.way)
    }

    /// Whether the robot drives straight on after it has turned aside, before it follows its plan again.
    pub(super) fn is_leaving_with_a_plan(&self, now: Instant) -> bool {
        self.last_escape
            .is_some_and(|(_, left)| now - left < STRAIGHT)
    }

    /// What something nearer than the critical distance means for a robot with a plan: where the plan leads past it, it
    /// turns there, and otherwise it turns aside.
    pub(super) fn held_up<R: Rng>(&mut self, goal: &Goal, rng: &mut R, now: Instant) -> Event {
        if libm::fabsf(self.guided.error) > ON_THE_WAY {
            Event::Near
        } else {
            Event::Blocked(self.way_round(goal, rng, now))
        }
    }

    /// Motion to the next point of the way; `None` when the robot is there. `is_near` tells that something is
    /// too near to drive on.
    pub(super) fn follow(
        &mut self,
        point: [i32; 2],
        place: [f32; 2],
        speed: f32,
        is_near: bool,
    ) -> Option<Twist> {
        let Pose { x, y, theta, .. } = self.pose();
        let tolerance = self.tuning.arrive_tolerance;
        let [left_x, left_y] = [place[0] - x, place[1] - y];
        let left = left_x * left_x + left_y * left_y;
        if left <= tolerance * tolerance {
            return None;
        }
        let [dx, dy] = [point[0] as f32 * 0.001 - x, point[1] as f32 * 0.001 - y];
        let error = wrap(libm::atan2f(dy, dx) - theta);
        self.guided.error = error;
        let max_turn = self.tuning.max_turn;
        let w = (HEADING_GAIN * error).clamp(-max_turn, max_turn);
        let v = if is_near || libm::fabsf(error) > TURN_IN_PLACE {
            0.0
        } else if left < SLOW_WITHIN * SLOW_WITHIN {
            speed * (libm::sqrtf(left) / SLOW_WITHIN).max(SLOWEST)
        } else {
            // Slower in turns, as the cosine nearly is.
            speed * (1.0 - 0.5 * error * error)
        };
        Some(Twist { v, w })
    }
}

#[cfg(test)]
mod tests {
    use crawler_hal::Millimeters;
    use crawler_protocol::{Reason, ResponseStatus};

    use super::super::{Outputs, PERIOD, Tuning};
    use super::*;
    use crate::behaviour::Leeway;
    use crate::navigation::Guide;
    use crate::order::Task;
    use crate::perception::Sight;
    use crate::state::{Side, State};
    use crate::testing::{TestRng, asked, inputs};
    use crate::tracking::Fix;

    struct Bench {
        controller: Controller,
        now: Instant,
        sight: Sight,
        way: Option<Way>,
        leeway: Leeway,
        fix: Option<Fix>,
    }

    impl Bench {
        /// A robot on its way to a place two metres ahead.
        fn going() -> Self {
            let mut bench = Self {
                controller: Controller::new(Tuning::default()),
                now: Instant::BOOT,
                sight: Sight::Clear,
                way: None,
                leeway: Leeway::ALL,
                fix: None,
            };
            bench.step(None);
            bench.step(Some(Task::Goto { x: 2.0, y: 0.0 }));
            bench
        }

        fn step(&mut self, task: Option<Task>) -> Outputs {
            self.now += PERIOD;
            let order = task.map(|task| asked(task, self.now));
            let number = self.controller.going().map_or(0, |going| going.number);
            let inputs = Inputs {
                own: 3,
                guide: self.way.map(|way| Guide { number, way }),
                leeway: self.leeway,
                fix: self.fix.take(),
                ..inputs(self.sight, self.now, order.as_ref())
            };
            self.controller.step(&inputs, &mut TestRng(7), self.now)
        }

        fn run(&mut self, steps: u32) -> Outputs {
            let mut last = Outputs::default();
            for _ in 0..steps {
                last = self.step(None);
            }
            last
        }
    }

    #[test]
    fn it_drives_to_the_next_point_and_not_to_the_place() {
        let mut bench = Bench::going();
        let going = bench.controller.going().expect("on its way");
        assert_eq!(going.at, [2_000, 0]);
        bench.way = Some(Way::To([0, 1_500]));
        bench.run(150);
        let pose = bench.controller.pose();
        assert!(pose.y > 0.3 && libm::fabsf(pose.x) < 0.1, "{pose:?}");
        // The plan of another order is none.
        bench.step(Some(Task::Goto { x: 2.0, y: 0.0 }));
        let next = bench.controller.going().expect("on its way");
        assert_ne!(next.number, going.number);
    }

    #[test]
    fn what_is_near_ahead_has_it_turn_in_place_to_where_the_plan_leads() {
        let mut bench = Bench::going();
        bench.way = Some(Way::To([2_000, 0]));
        bench.run(50);
        let from = bench.controller.pose();
        assert!(from.x > 0.1, "{from:?}");
        bench.way = Some(Way::To([(from.x * 1_000.0) as i32, -1_000]));
        bench.step(None);
        bench.sight = Sight::Range(Millimeters(200));
        bench.run(29);
        let to = bench.controller.pose();
        assert!(to.theta < -0.5 && to.x - from.x < 0.05, "{to:?}");
        assert!(matches!(bench.controller.state(), State::Caution(_)));
    }

    #[test]
    fn what_is_ahead_on_the_way_is_turned_aside_for() {
        let mut bench = Bench::going();
        bench.way = Some(Way::To([2_000, 0]));
        bench.run(50);
        bench.sight = Sight::Range(Millimeters(200));
        let out = bench.step(None);
        assert_eq!(out.duties, [0.0; 2], "it stops first");
        assert!(matches!(bench.controller.state(), State::Avoiding(..)));
        // Then it goes a little way straight on, before it follows the plan again.
        bench.run(30);
        bench.sight = Sight::Clear;
        bench.step(None);
        assert!(matches!(bench.controller.state(), State::Moving(_)));
        let from = bench.controller.pose();
        assert!(libm::fabsf(from.theta) > 0.4, "{from:?}");
        bench.run(15);
        let on = bench.controller.pose();
        let side = libm::copysignf(1.0, from.theta);
        assert!(side * on.theta > 0.4, "{from:?} {on:?}");
        bench.run(80);
        let back = bench.controller.pose();
        assert!(libm::fabsf(back.theta) < 0.4, "{back:?}");
    }

    #[test]
    fn who_is_in_the_way_is_waited_for_and_turned_aside_for_when_that_takes_long() {
        let mut bench = Bench::going();
        bench.way = Some(Way::To([2_000, 0]));
        bench.leeway = Leeway {
            speed: 30,
            side: Side::Left,
        };
        // Where it does not know its place, others are anywhere.
        bench.run(50);
        let x = bench.controller.pose().x;
        assert!(x > 0.1, "{x}");
        bench.fix = Some(Fix {
            pose: Pose {
                sigma: 0.02,
                ..Pose::default()
            },
            seen: bench.now,
        });
        bench.run(25);
        let from = bench.controller.pose();
        bench.run(20);
        let to = bench.controller.pose();
        assert!(matches!(bench.controller.state(), State::Moving(_)));
        assert!((to.x - from.x) / 0.4 < 0.05, "{from:?} {to:?}");
        bench.run(30);
        let State::Avoiding(_, escape) = bench.controller.state() else {
            panic!("{:?}", bench.controller.state());
        };
        assert_eq!(escape.side, Side::Right);
        // It goes on as soon as there is room.
        bench.leeway = Leeway::ALL;
        bench.run(60);
        assert!(matches!(bench.controller.state(), State::Moving(_)));
        assert!(bench.controller.pose().x > to.x + 0.1);
    }

    #[test]
    fn without_a_way_it_says_so() {
        let mut bench = Bench::going();
        bench.way = Some(Way::Nowhere);
        let out = bench.step(None);
        let answer = out.answers.last().expect("an answer");
        assert_eq!(answer.status, ResponseStatus::Failed);
        assert_eq!(answer.reason, Some(Reason::Unreachable));
        assert_eq!(*bench.controller.state(), State::Idle);
        assert_eq!(bench.controller.going(), None);
    }
}
