//! What is decided and what the wheels then do.

use crawler_hal::{Duration, Instant, Millimeters};
use crawler_protocol::{BehaviourName, Reason, ResponseStatus};

use super::{Action, Asked, DECIDED_WITHIN, Decision, Installed, Policies};
use crate::controller::{Controller, Inputs, Outputs, PERIOD, Tuning};
use crate::order::Task;
use crate::perception::Sight;
use crate::state::State;
use crate::testing::{TestRng, asked, inputs};

const NAME: u32 = 7;

fn own(own: Installed) -> Policies {
    Policies {
        own,
        ..Policies::NONE
    }
}

fn brought(brought: Installed) -> Policies {
    Policies {
        brought,
        ..Policies::NONE
    }
}

struct Bench {
    controller: Controller,
    rng: TestRng,
    now: Instant,
    sight: Sight,
    installed: Policies,
    /// Of the step before.
    asked: Option<Asked>,
}

impl Bench {
    fn new() -> Self {
        let mut bench = Self {
            controller: Controller::new(Tuning::default()),
            rng: TestRng(7),
            now: Instant::BOOT,
            sight: Sight::Clear,
            installed: own(Installed::Policy(NAME)),
            asked: None,
        };
        bench.step(None, None);
        bench
    }

    fn told(&mut self, name: u32) -> Option<(ResponseStatus, Option<Reason>)> {
        let out = self.step(Some(Task::Policy { name }), None);
        out.answers
            .first()
            .map(|answer| (answer.status, answer.reason))
    }

    /// A control step, with what a network decides for the observation of the step before.
    fn step(&mut self, task: Option<Task>, action: Option<Action>) -> Outputs {
        self.now += PERIOD;
        let order = task.map(|task| asked(task, self.now));
        let decision = self.asked.zip(action).map(|(asked, action)| Decision {
            action: action as u8,
            number: asked.number,
        });
        let inputs = Inputs {
            policies: self.installed,
            decision,
            ..inputs(self.sight, self.now, order.as_ref())
        };
        let out = self.controller.step(&inputs, &mut self.rng, self.now);
        self.asked = self.controller.asked().map(|(asked, _)| asked);
        out
    }

    /// The duties after so long, with this action for each observation.
    fn after(&mut self, span: Duration, action: Option<Action>) -> [f32; 2] {
        let mut duties = self.controller.duties();
        for _ in 0..span.as_micros() / PERIOD.as_micros() {
            duties = self.step(None, action).duties;
        }
        duties
    }
}

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn a_robot_drives_as_was_decided_and_stands_without_decisions() {
    let mut bench = Bench::new();
    assert_eq!(bench.told(NAME), Some((ResponseStatus::Completed, None)));
    assert_eq!(bench.controller.behaviour(), BehaviourName::Policy);
    assert_eq!(bench.after(SECOND, None), [0.0; 2], "nothing was decided");
    let ahead = bench.after(SECOND, Some(Action::Ahead));
    assert_eq!(ahead, [0.0; 2], "it has not looked to either side");
    let [left, right] = bench.after(Duration::from_secs(6), Some(Action::Left));
    assert!(left < 0.0 && right > 0.0);
    // A network that hangs: it counts for so long, then the ramp leads to rest.
    let before = bench.after(SECOND, Some(Action::Ahead));
    let some = DECIDED_WITHIN.saturating_sub(Duration::from_millis(100));
    assert!(before[0] > 0.0 && before[1] > 0.0, "and then it drives");
    assert_eq!(bench.after(some, None), before, "the last one still counts");
    assert_eq!(bench.after(SECOND, None), [0.0; 2]);
    assert!(matches!(bench.controller.state(), State::Moving(_)));
    let [left, right] = bench.after(SECOND, Some(Action::CurveRight));
    assert!(left > right && right > 0.0, "and goes on with the next one");
}

#[test]
fn the_shield_and_the_critical_distance_hold_whatever_was_decided() {
    let mut bench = Bench::new();
    bench.told(NAME);
    bench.sight = Sight::Range(Millimeters(100));
    for action in Action::ALL {
        for _ in 0..100 {
            let [left, right] = bench.step(None, Some(action)).duties;
            assert!(left + right < 1e-6, "{action:?} drives ahead");
        }
        assert!(!matches!(bench.controller.state(), State::Avoiding(..)));
    }
}

#[test]
fn a_policy_that_is_not_there_is_refused_with_its_reason() {
    for (installed, reason) in [
        (Installed::None, Reason::NoPolicy),
        (Installed::Policy(NAME + 1), Reason::NoPolicy),
        (Installed::Bad(NAME), Reason::BadPolicy),
        (Installed::Other(NAME), Reason::OtherObservation),
    ]
    .into_iter()
    .flat_map(|(installed, reason)| [(own(installed), reason), (brought(installed), reason)])
    {
        let mut bench = Bench::new();
        bench.installed = installed;
        let refused = Some((ResponseStatus::Rejected, Some(reason)));
        assert_eq!(bench.told(NAME), refused);
        assert_eq!(bench.after(SECOND, Some(Action::Ahead)), [0.0; 2]);
        assert_eq!(bench.controller.behaviour(), BehaviourName::Manual);
    }
}
