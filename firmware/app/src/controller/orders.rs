//! Taking an order: refuse it with a reason, or begin.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Direction, Reason, ResponseStatus};

use super::{Controller, FAILSAFE, Inputs, LONGEST_MOVE, Outputs, SCAN_TIMEOUT};
use crate::behaviour::{Scan, Underway};
use crate::goal::{Goal, Mission};
use crate::motion::Twist;
use crate::order::{Order, Task};
use crate::perception::LinkHealth;
use crate::state::{Event, Fault, State};

/// Farthest a `goto` may lead, in metres from where the robot booted.
const FARTHEST_TARGET: f32 = 1_000.0;

/// What a `goto` may take in any case: turning round, and one obstacle.
const GOTO_LEAST: Duration = Duration::from_secs(20);

/// When an order gets its final answer.
enum Answering {
    /// Now: it is done, or in force.
    Now,
    /// When the goal ends; `accepted` now.
    AtEnd,
}

impl Controller {
    pub(super) fn take_order(
        &mut self,
        order: &Order,
        inputs: &Inputs<'_>,
        out: &mut Outputs,
        now: Instant,
    ) {
        let sender = order.sender.clone();
        if order.task.is_motion() {
            // What waited longer than continuous driving may last is not moved upon, whatever
            // kept it waiting.
            if now - order.arrived >= FAILSAFE {
                return out.answer(sender, ResponseStatus::Expired, None);
            }
            if let Err(reason) = self.may_move(&order.task, inputs, now) {
                return out.answer(sender, ResponseStatus::Rejected, Some(reason));
            }
        }
        if order.task.decides_motion() {
            self.resumption.forget();
        }
        match self.begin(order, out, now) {
            Answering::Now => out.answer(sender, ResponseStatus::Completed, None),
            Answering::AtEnd => {
                out.answer(sender.clone(), ResponseStatus::Accepted, None);
                self.pending = Some(sender);
            }
        }
    }

    fn may_move(&self, task: &Task, inputs: &Inputs<'_>, now: Instant) -> Result<(), Reason> {
        if let Some(fault) = self.state.fault() {
            return Err(reason_of(fault));
        }
        if self.rebooting || matches!(self.state, State::Initializing | State::Updating) {
            return Err(Reason::Busy);
        }
        if inputs.link == LinkHealth::Lost {
            return Err(Reason::LinkLost);
        }
        let view = inputs.reading.fresh(now);
        let guarded = self.tuning.avoidance || !is_manual(task);
        if guarded && view.is_none() {
            return Err(Reason::NoRange);
        }
        match *task {
            Task::Drive { v, w } if !(v.is_finite() && w.is_finite()) => Err(Reason::OutOfRange),
            Task::Goto { x, y }
                if !(libm::fabsf(x) <= FARTHEST_TARGET && libm::fabsf(y) <= FARTHEST_TARGET) =>
            {
                Err(Reason::OutOfRange)
            }
            Task::Policy { name } => inputs.policies.check(name),
            Task::Mission(mission) if !is_possible(&mission, inputs.own) => Err(Reason::OutOfRange),
            Task::Move { .. } | Task::Drive { .. } => {
                let near = view.is_some_and(|v| v.distance_mm() < self.tuning.critical_mm);
                if guarded && near && self.manual_twist(task).v > 0.0 {
                    Err(Reason::Blocked)
                } else {
                    Ok(())
                }
            }
            Task::Goto { .. }
            | Task::Scan
            | Task::Wander { .. }
            | Task::Swarm(_)
            | Task::Mission(_)
            | Task::Manual
            | Task::Reset
            | Task::Identify
            | Task::Reboot => Ok(()),
        }
    }

    fn begin(&mut self, order: &Order, out: &mut Outputs, now: Instant) -> Answering {
        match order.task {
            Task::Move { duration_ms, .. } => {
                let bounded = duration_ms > 0;
                let span = if bounded {
                    Duration::from_millis(u64::from(duration_ms)).min(LONGEST_MOVE)
                } else {
                    FAILSAFE
                };
                let goal = Goal::Manual {
                    twist: self.manual_twist(&order.task),
                    until: order.arrived + span,
                    bounded,
                };
                self.start_goal(goal, out, now);
                if bounded {
                    Answering::AtEnd
                } else {
                    Answering::Now
                }
            }
            Task::Drive { .. } => {
                let goal = Goal::Manual {
                    twist: self.manual_twist(&order.task),
                    until: order.arrived + FAILSAFE,
                    bounded: false,
                };
                self.start_goal(goal, out, now);
                Answering::Now
            }
            Task::Scan => {
                self.take_over(out);
                self.scan = Some(Scan::new(self.pose().theta));
                let deadline = now + SCAN_TIMEOUT;
                self.state = self.state.step(Event::BeginScan { deadline }, now);
                Answering::AtEnd
            }
            Task::Wander { speed } => {
                let speed = f32::from(speed.min(100)) * 0.01;
                self.start_goal(Goal::Wander { speed }, out, now);
                Answering::Now
            }
            Task::Swarm(swarm) => {
                self.start_goal(Goal::Swarm(swarm), out, now);
                Answering::Now
            }
            Task::Policy { name } => {
                self.start_goal(Goal::Policy { name }, out, now);
                Answering::Now
            }
            Task::Mission(mission) => {
                self.mission = Underway::begin(&mission, &self.pose());
                let goal = mission.goal();
                self.start_goal(goal, out, now);
                if goal.is_behaviour() {
                    Answering::Now
                } else {
                    Answering::AtEnd
                }
            }
            Task::Goto { x, y } => {
                let deadline = now + self.goto_patience([x, y]);
                self.start_goal(Goal::Goto { x, y, deadline }, out, now);
                Answering::AtEnd
            }
            Task::Manual => {
                self.take_over(out);
                self.state = self.state.step(Event::End, now);
                Answering::Now
            }
            Task::Reset => {
                if self.state.fault() == Some(Fault::EmergencyStop) {
                    out.note(super::Note::Cleared(Fault::EmergencyStop));
                }
                self.state = self.state.step(Event::Reset, now);
                Answering::Now
            }
            Task::Identify => {
                out.identify = true;
                Answering::Now
            }
            Task::Reboot => {
                self.restart(out, now);
                Answering::Now
            }
        }
    }

    /// Comes to rest, and restarts once that and the answers are out.
    pub(super) fn restart(&mut self, out: &mut Outputs, now: Instant) {
        out.unfinished = self.state.goal().filter(Goal::is_behaviour);
        self.take_over(out);
        self.state = self.state.step(Event::End, now);
        self.rebooting = true;
        out.reboot = true;
    }

    /// How long a `goto` to `target` may take: four times the straight way at its speed, for
    /// detours, and [`GOTO_LEAST`].
    fn goto_patience(&self, [x, y]: [f32; 2]) -> Duration {
        let pose = self.pose();
        let way = libm::hypotf(x - pose.x, y - pose.y);
        let seconds = 4.0 * way / (self.tuning.goto_speed * self.tuning.max_speed);
        // Saturating cast, and neither speed is ever zero.
        GOTO_LEAST + Duration::from_millis((seconds * 1_000.0) as u64)
    }

    pub(super) fn start_goal(&mut self, goal: Goal, out: &mut Outputs, now: Instant) {
        let renewed = matches!(goal, Goal::Manual { bounded: false, .. })
            && matches!(self.state.goal(), Some(Goal::Manual { bounded: false, .. }));
        if !renewed {
            self.take_over(out);
        }
        self.wanted = None;
        let speed = self.tuning.goto_speed * self.tuning.max_speed;
        self.guided.set_out(&goal, speed);
        if let Goal::Policy { .. } = goal {
            self.pilot.begin(&self.odometry.pose());
        }
        self.state = self.state.step(Event::Begin(goal), now);
    }

    /// Tells whoever waits for the present goal that another order took over.
    fn take_over(&mut self, out: &mut Outputs) {
        if let Some(sender) = self.pending.take() {
            out.answer(sender, ResponseStatus::Failed, Some(Reason::Interrupted));
        }
        self.scan = None;
        self.detour = None;
        self.progress.reset();
    }

    /// Wanted motion of a manual task; none of others.
    fn manual_twist(&self, task: &Task) -> Twist {
        match *task {
            Task::Move {
                direction, speed, ..
            } => {
                let share = f32::from(speed.min(100)) * 0.01;
                let v = share * self.tuning.max_speed;
                let w = share * self.tuning.max_turn;
                match direction {
                    Direction::Forward => Twist { v, w: 0.0 },
                    Direction::Backward => Twist { v: -v, w: 0.0 },
                    Direction::Left => Twist { v: 0.0, w },
                    Direction::Right => Twist { v: 0.0, w: -w },
                }
            }
            Task::Drive { v, w } => Twist { v, w },
            Task::Scan
            | Task::Wander { .. }
            | Task::Swarm(_)
            | Task::Mission(_)
            | Task::Policy { .. }
            | Task::Goto { .. }
            | Task::Manual
            | Task::Reset
            | Task::Identify
            | Task::Reboot => Twist::ZERO,
        }
    }
}

/// Whether a mission leads no farther than a `goto` may, nor after the robot itself.
fn is_possible(mission: &Mission, own: u32) -> bool {
    let near = |along: &f32| libm::fabsf(*along) <= FARTHEST_TARGET;
    !matches!(mission, Mission::Follow { leader, .. } if *leader == own)
        && mission.places().iter().flatten().all(near)
}

const fn is_manual(task: &Task) -> bool {
    matches!(task, Task::Move { .. } | Task::Drive { .. })
}

/// What to answer for `fault`.
pub(super) const fn reason_of(fault: Fault) -> Reason {
    match fault {
        Fault::EmergencyStop => Reason::Estopped,
        Fault::Motor => Reason::Fault,
        Fault::Battery => Reason::LowBattery,
        Fault::Ranger => Reason::NoRange,
    }
}
