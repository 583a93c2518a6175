//! What the view ahead means for the state, and what the robot wants to do about it.

use crawler_hal::{Duration, Instant};
use crawler_protocol::Reason;
use rand_core::Rng;

use super::aside::{keeps_off, way_round_others};
use super::{Controller, FAILSAFE, HOLD, Inputs, Note, Outputs, PERIOD};
use crate::behaviour::{
    Detour, MissionNews, MissionScene, Scene, VAGUE, Wish, escape_twist, goto_twist, place_twist,
    steer, swarm_twist,
};
use crate::goal::Goal;
use crate::motion::Twist;
use crate::motion::angle::{PoseMm, millimetres};
use crate::navigation::Way;
use crate::perception::{Charge, Sight};
use crate::policy::{Asked, Known};
use crate::state::{Event, Side, State};
use crate::tracking::TOLD_EVERY;
use crate::vision::View;

/// Share of the wanted speed that is left right before the critical distance.
const SLOWEST: f32 = 0.3;
/// Share of the wanted speed on a low battery.
const LOW_BATTERY: f32 = 0.5;
/// Fastest turn of a scan, in radians per second: at 16 readings a second one every 5°.
const SCAN_TURN: f32 = 1.5;
/// Leaving caution takes this much more than the safe distance, in millimetres: more than the
/// noise of the ranger.
const SAFE_HYSTERESIS_MM: u16 = 40;
/// A new obstacle within this time of the last one is taken for the same corner.
const SAME_CORNER: Duration = Duration::from_millis(2_500);
/// Difference between the duties of both wheels beyond which a robot turns.
const TURNING: f32 = 0.1;
/// Failed attempts at turning aside that are worth a note.
const HEMMED_IN: u8 = 3;

impl Controller {
    /// Feeds the view into the state machine; whether the wheels have to stand for it.
    pub(super) fn look_ahead<R: Rng>(
        &mut self,
        inputs: &Inputs<'_>,
        rng: &mut R,
        out: &mut Outputs,
        now: Instant,
    ) -> bool {
        let Some(goal) = self.state.goal() else {
            return false;
        };
        let view = inputs.reading.fresh(now);
        let autonomous = goal.is_autonomous();
        let event = if !self.needs_view() {
            if inputs.charge == Charge::Low {
                Event::Near
            } else {
                Event::Free
            }
        } else if let Some(sight) = view {
            self.judge(sight, &goal, inputs, rng, now)
        } else if autonomous {
            // It waits for a view; the sense activity decides when the ranger is lost for good.
            Event::Blind
        } else {
            self.finish(Err(Reason::NoRange), out);
            self.state = self.state.step(Event::End, now);
            return true;
        };
        let blocked = matches!(event, Event::Blocked(_));
        if blocked && !autonomous {
            self.finish(Err(Reason::Blocked), out);
        }
        let before = self.state;
        self.state = self.state.step(event, now);
        match (before, self.state) {
            (State::Avoiding(_, escape), State::Moving(_) | State::Caution(_)) => {
                self.last_escape = Some((escape.side, now));
            }
            (State::Avoiding(_, old), State::Avoiding(_, new)) if new.attempt > old.attempt => {
                if new.attempt == HEMMED_IN {
                    out.note(Note::HemmedIn(new.attempt));
                }
            }
            (
                State::Initializing
                | State::Idle
                | State::Moving(_)
                | State::Caution(_)
                | State::Avoiding(..)
                | State::Scanning { .. }
                | State::Error(_)
                | State::Updating,
                _,
            ) => {}
        }
        // Entering avoidance means driving forward too near: no rolling out. Staying in it, or
        // backing out of a manual block, has its own motion.
        blocked && !matches!(before, State::Avoiding(..))
    }

    /// Whether what the robot does needs its camera.
    pub fn wants_eyes(&self) -> bool {
        let behaves = match self.state {
            State::Moving(goal) | State::Caution(goal) | State::Avoiding(goal, _) => {
                matches!(goal, Goal::Wander { .. })
            }
            State::Scanning { .. } => true,
            State::Initializing | State::Idle | State::Error(_) | State::Updating => false,
        };
        behaves || self.tuning.vision_always
    }

    /// Whether what the robot does goes by where others are.
    pub fn wants_neighbours(&self) -> bool {
        let by_others = matches!(
            self.state.goal(),
            Some(Goal::Swarm(_) | Goal::Policy { .. } | Goal::Mission { .. })
        );
        by_others || keeps_off(&self.state)
    }

    /// Whether where others are is to be brought up to date for the next step.
    pub fn looks_around(&self) -> bool {
        match self.state.goal() {
            Some(Goal::Policy { .. }) => self.pilot.looks_around(),
            Some(Goal::Wander { .. }) => self.rules,
            Some(_) | None => self.rules || self.awaits_rule(),
        }
    }

    /// Whether a rule that goes by others is to be asked in the next step, because it has not been since the robot moves.
    const fn awaits_rule(&self) -> bool {
        matches!(
            self.state,
            State::Moving(Goal::Swarm(_) | Goal::Mission { .. })
                | State::Caution(Goal::Swarm(_) | Goal::Mission { .. })
        ) && self.wanted.is_none()
    }

    /// Whether the next step has time for a position reference: it says when it is of, so that it is no worse a few steps
    /// later, and with what is reckoned of others it would be too much for one.
    pub(crate) fn takes_fix(&self) -> bool {
        match self.state.goal() {
            Some(Goal::Policy { .. }) => self.pilot.has_time(),
            Some(Goal::Wander { .. } | Goal::Swarm(_) | Goal::Mission { .. }) => {
                self.rules && !self.awaits_rule()
            }
            Some(Goal::Manual { .. } | Goal::Goto { .. }) | None => true,
        }
    }

    /// What a decision is wanted for since the last step, and of which policy, while the robot drives by one.
    pub fn asked(&self) -> Option<(Asked, u32)> {
        let asked = self.pilot.asked()?;
        match self.state.goal() {
            Some(Goal::Policy { name }) => Some((asked, name)),
            _ => None,
        }
    }

    /// Takes in what was decided, and makes the observations that decisions are wanted for.
    pub(super) fn follow_policy(&mut self, inputs: &Inputs<'_>, now: Instant) {
        let Some(Goal::Policy { .. }) = self.state.goal() else {
            self.pilot.rest();
            return;
        };
        let pose = self.pose();
        let known = Known {
            pose,
            duties: self.duties(),
            reading: &inputs.reading,
            critical_mm: self.tuning.critical_mm,
            // Not sure of its place it would see others where they are not.
            near: if pose.sigma > VAGUE { &[] } else { inputs.near },
            now,
        };
        self.pilot.step(&known, inputs.decision);
    }

    /// Takes in what the camera has shown.
    pub(super) fn see(&mut self, view: &View) {
        self.in_the_way = view.in_the_way;
        if let Some(scan) = &mut self.scan {
            for thing in &view.things {
                scan.recognise(view.heading + thing.bearing, thing.spot.class);
            }
        }
    }

    /// Where to turn for something low in the way of a robot that wanders: to the side where it is
    /// not, but in one corner always to the same.
    fn low_way_round(&self, goal: &Goal, now: Instant) -> Option<Side> {
        let (Goal::Wander { .. }, Some(low)) = (goal, self.in_the_way) else {
            return None;
        };
        let bearing = low.ahead(self.pose().theta, now)?;
        Some(match self.last_escape {
            Some((side, at)) if now - at < SAME_CORNER => side,
            Some(_) | None if bearing > 0.0 => Side::Right,
            Some(_) | None => Side::Left,
        })
    }

    /// What a fresh view means for `goal`.
    fn judge<R: Rng>(
        &mut self,
        sight: Sight,
        goal: &Goal,
        inputs: &Inputs<'_>,
        rng: &mut R,
        now: Instant,
    ) -> Event {
        let distance = sight.distance_mm();
        let (critical, safe) = (self.tuning.critical_mm, self.tuning.safe_mm);
        if let State::Avoiding(_, escape) = self.state {
            if now >= escape.until {
                return Event::Stuck(side(rng));
            }
            // Clear is halfway to safe, so that the way out is one.
            let low = self.low_way_round(goal, now).is_some();
            if low || distance < critical.midpoint(safe) || self.leeway.holds_up() {
                return Event::Blocked(escape.side);
            }
        } else if distance < critical {
            match goal {
                Goal::Manual { twist, .. } if twist.v <= 0.0 => return Event::Near,
                Goal::Manual { .. } => return Event::Blocked(Side::Left),
                Goal::Goto { .. } if self.way(inputs).is_some() => {
                    return self.held_up(goal, rng, now);
                }
                // It finds its own way round, and its shield does not drive on.
                Goal::Policy { .. } => return Event::Near,
                Goal::Wander { .. } | Goal::Goto { .. } | Goal::Swarm(_) | Goal::Mission { .. } => {
                    return Event::Blocked(self.way_round(goal, rng, now));
                }
            }
        } else if let Some(side) = self.low_way_round(goal, now) {
            return Event::Blocked(side);
        } else if let Some(side) = way_round_others(self, goal, now) {
            return Event::Blocked(side);
        } else if goal.is_autonomous() && !matches!(goal, Goal::Policy { .. }) {
            let forward = self.ramps.iter().all(|ramp| ramp.duty() > 0.0);
            if !forward {
                self.progress.reset();
            } else if self.progress.observe(sight, now) {
                self.progress.reset();
                self.guided.bump();
                return Event::Stuck(side(rng));
            }
        }
        let hysteresis = match self.state {
            State::Caution(_) => SAFE_HYSTERESIS_MM,
            State::Initializing
            | State::Idle
            | State::Moving(_)
            | State::Avoiding(..)
            | State::Scanning { .. }
            | State::Error(_)
            | State::Updating => 0,
        };
        if distance < safe.saturating_add(hysteresis) || inputs.charge == Charge::Low {
            Event::Near
        } else {
            Event::Free
        }
    }

    pub(super) fn way_round<R: Rng>(&mut self, goal: &Goal, rng: &mut R, now: Instant) -> Side {
        if let Some([x, y]) = self.destination(goal) {
            let pose = self.pose();
            let distance = libm::hypotf(x - pose.x, y - pose.y);
            let detour = Detour::next(self.detour, distance, side(rng));
            self.detour = Some(detour);
            return detour.side();
        }
        // Who turns to where it wants to go turns on past what is in the way, and not back.
        let [left, right] = self.duties();
        if matches!(goal, Goal::Swarm(_)) && libm::fabsf(right - left) > TURNING {
            return if right > left {
                Side::Left
            } else {
                Side::Right
            };
        }
        self.same_corner(now).unwrap_or_else(|| side(rng))
    }

    /// The side turned to last, if that was in this corner.
    pub(super) fn same_corner(&self, now: Instant) -> Option<Side> {
        let (side, at) = self.last_escape?;
        (now - at < SAME_CORNER).then_some(side)
    }

    /// Wanted motion. Ends what has arrived or is complete.
    pub(super) fn wanted(&mut self, inputs: &Inputs<'_>, out: &mut Outputs, now: Instant) -> Twist {
        let mut wish = Wish::Rest;
        if !matches!(self.state, State::Moving(_) | State::Caution(_)) {
            self.wanted = None;
        }
        if inputs.order.is_some() && self.awaits_rule() {
            // The order has begun this, and the robot has not been told of others for it: the rule is asked in the next step.
            return Twist::ZERO;
        }
        let asked = self.rules || self.awaits_rule();
        if let Some(Goal::Mission { .. }) = self.state.goal()
            && asked
        {
            wish = self.go_on(inputs, out, now);
            if wish == Wish::Done {
                self.finish(Ok(()), out);
                self.state = self.state.step(Event::End, now);
            }
        }
        if self.way(inputs) == Some(Way::Nowhere) {
            self.finish(Err(Reason::Unreachable), out);
            self.state = self.state.step(Event::End, now);
        }
        let twist = match self.state {
            State::Initializing | State::Idle | State::Error(_) | State::Updating => {
                return Twist::ZERO;
            }
            State::Moving(Goal::Mission { .. }) | State::Caution(Goal::Mission { .. }) => {
                let twist = match self.wanted {
                    Some(twist) if !asked => twist,
                    Some(_) | None => self.mission_twist(wish, now),
                };
                self.wanted = Some(twist);
                self.slow_down(twist, inputs, now)
            }
            State::Moving(goal) | State::Caution(goal) => {
                let twist = match self.wanted {
                    Some(twist) if !asked => Some(twist),
                    Some(_) | None => self.goal_twist(&goal, inputs, now),
                };
                if matches!(goal, Goal::Swarm(_)) {
                    self.wanted = twist;
                }
                let Some(twist) = twist else {
                    self.finish(Ok(()), out);
                    self.state = self.state.step(Event::End, now);
                    return Twist::ZERO;
                };
                match goal {
                    // Its shield has seen to that.
                    Goal::Policy { .. } => twist,
                    Goal::Manual { .. }
                    | Goal::Wander { .. }
                    | Goal::Goto { .. }
                    | Goal::Swarm(_)
                    | Goal::Mission { .. } => self.slow_down(twist, inputs, now),
                }
            }
            State::Avoiding(_, escape) => {
                let (speed, turn) = (self.tuning.max_speed, self.tuning.max_turn);
                let twist = escape_twist(&escape, speed, turn, now);
                Twist {
                    v: self.leeway.left_of(twist.v),
                    ..twist
                }
            }
            State::Scanning { .. } => {
                let heading = self.pose().theta;
                let view = inputs.reading.fresh(now);
                if let Some(result) = self.scan.as_mut().and_then(|s| s.observe(heading, view)) {
                    self.finish(Ok(()), out);
                    out.note(Note::Scanned(result));
                    self.state = self.state.step(Event::End, now);
                    return Twist::ZERO;
                }
                Twist {
                    v: 0.0,
                    w: SCAN_TURN.min(self.tuning.max_turn),
                }
            }
        };
        if inputs.charge == Charge::Low {
            Twist {
                v: twist.v * LOW_BATTERY,
                w: twist.w * LOW_BATTERY,
            }
        } else {
            twist
        }
    }

    /// Goes on with the mission by one step, whatever is in the way at the moment.
    fn go_on(&mut self, inputs: &Inputs<'_>, out: &mut Outputs, now: Instant) -> Wish {
        let pose = self.pose();
        let scene = MissionScene {
            pose: &pose,
            near: inputs.near,
            own: inputs.own,
            reading: &inputs.reading,
            speed: self.tuning.goto_speed * self.tuning.max_speed,
            now,
        };
        let (wish, news) = self.mission.step(&scene);
        match news {
            Some(MissionNews::LeaderLost)
                if self.told_lost.is_some_and(|at| now - at < TOLD_EVERY) => {}
            Some(news) => {
                if news == MissionNews::LeaderLost {
                    self.told_lost = Some(now);
                }
                out.note(Note::Mission(news));
            }
            None => {}
        }
        wish
    }

    /// What a mission wants on a free way.
    fn mission_twist(&mut self, wish: Wish, now: Instant) -> Twist {
        /// Nearer than this, in metres, a robot has been at a place: another one may stand there.
        const THERE: f32 = 0.2;
        let (max_speed, max_turn) = (self.tuning.max_speed, self.tuning.max_turn);
        match wish {
            Wish::Rest | Wish::Done => Twist::ZERO,
            Wish::Velocity(wish) => {
                let here = PoseMm::new(&self.pose());
                steer(wish, &here, max_speed, max_turn)
            }
            Wish::Place(place, pace) => {
                let tolerance = millimetres(self.tuning.arrive_tolerance.max(THERE));
                let speed = pace * self.tuning.goto_speed * max_speed;
                let here = PoseMm::new(&self.pose());
                let twist = place_twist(&here, place.map(millimetres), tolerance, speed, max_turn);
                let twist = twist.map(|twist| self.or_straight(twist, speed, now));
                twist.unwrap_or_else(|| {
                    self.mission.arrived();
                    self.detour = None;
                    Twist::ZERO
                })
            }
        }
    }

    /// The place that `goal` leads to.
    fn destination(&self, goal: &Goal) -> Option<[f32; 2]> {
        match *goal {
            Goal::Goto { x, y, .. } => Some([x, y]),
            Goal::Mission { .. } => self.mission.destination(),
            Goal::Manual { .. } | Goal::Wander { .. } | Goal::Swarm(_) | Goal::Policy { .. } => {
                None
            }
        }
    }

    /// `twist` on the way to a place, or straight on past what has been in the way.
    fn or_straight(&self, twist: Twist, speed: f32, now: Instant) -> Twist {
        match self.last_escape {
            Some((_, left)) if now - left < Detour::straight(self.detour.as_ref()) => {
                Twist { v: speed, w: 0.0 }
            }
            Some(_) | None => twist,
        }
    }

    /// What `goal` wants on a free way; `None` when it has arrived.
    fn goal_twist(&mut self, goal: &Goal, inputs: &Inputs<'_>, now: Instant) -> Option<Twist> {
        let max_speed = self.tuning.max_speed;
        match *goal {
            Goal::Manual { twist, .. } => Some(twist),
            Goal::Wander { speed } => Some(Twist {
                v: speed * max_speed,
                w: 0.0,
            }),
            Goal::Swarm(swarm) => {
                let speed = self.tuning.goto_speed * max_speed;
                let pose = self.pose();
                let scene = Scene {
                    here: PoseMm::new(&pose),
                    sigma: pose.sigma,
                    near: inputs.near,
                    ahead_mm: inputs.reading.fresh(now).map(Sight::distance_mm),
                    speed,
                    max_turn: self.tuning.max_turn,
                };
                Some(swarm_twist(swarm, &scene))
            }
            Goal::Goto { x, y, .. } => {
                let speed = self.tuning.goto_speed * max_speed;
                if let Some(Way::To(point)) = self.way(inputs)
                    && !self.is_leaving_with_a_plan(now)
                {
                    let distance = inputs.reading.fresh(now).map_or(0, Sight::distance_mm);
                    let is_near = distance < self.tuning.critical_mm;
                    return self.follow(point, [x, y], speed, is_near);
                }
                let (tolerance, turn) = (self.tuning.arrive_tolerance, self.tuning.max_turn);
                let twist = goto_twist(&self.pose(), [x, y], tolerance, speed, turn)?;
                Some(self.or_straight(twist, speed, now))
            }
            Goal::Policy { .. } => Some(self.pilot.twist()),
            // It has been asked already: see `mission_twist`.
            Goal::Mission { .. } => Some(Twist::ZERO),
        }
    }

    /// Forward speed in proportion to the room that is left between the safe distance and the
    /// critical one.
    fn slow_down(&self, twist: Twist, inputs: &Inputs<'_>, now: Instant) -> Twist {
        if twist.v <= 0.0 || !self.needs_view() {
            return twist;
        }
        let distance = inputs.reading.fresh(now).map_or(0, Sight::distance_mm);
        let room = f32::from(distance.saturating_sub(self.tuning.critical_mm));
        let full = f32::from(self.tuning.safe_mm - self.tuning.critical_mm);
        Twist {
            v: self
                .leeway
                .left_of(twist.v * (room / full).clamp(SLOWEST, 1.0)),
            ..twist
        }
    }

    /// Moves the duties towards `twist`, by the ramp; faster towards zero where the wheels would not
    /// stand by the end of continuous driving otherwise.
    pub(super) fn drive(&mut self, twist: Twist, elapsed: Duration, now: Instant) {
        // Nearly always it is a period or more.
        let share = if elapsed >= PERIOD {
            1.0
        } else {
            elapsed.as_secs_f32() / PERIOD.as_secs_f32()
        };
        let step = self.tuning.ramp_step * share;
        let left = self.steps_left(now);
        for (ramp, duty) in self.ramps.iter_mut().zip(self.tuning.duties(twist)) {
            let Some(left) = left else {
                ramp.towards(duty, step, now);
                continue;
            };
            // The most from which the steps left lead to zero: by the ramp, or evenly where it is
            // too slow.
            let before = libm::fabsf(ramp.duty());
            let most = left * self.tuning.ramp_step.max(before / (left + 1.0));
            ramp.towards(duty.clamp(-most, most), step.max(before - most), now);
        }
    }

    /// How many steps are to come until the wheels have to stand because no word of continuous
    /// driving has come; `None` while there is time, and for what needs no words.
    ///
    /// Reckons with the wheels standing a period early, so that a step may come late by as much.
    fn steps_left(&self, now: Instant) -> Option<f32> {
        let Some(Goal::Manual {
            until,
            bounded: false,
            ..
        }) = self.state.goal()
        else {
            return None;
        };
        let left = until - now;
        if left + HOLD > FAILSAFE {
            return None;
        }
        // At most nine. In 32 bits, in which boards divide by themselves.
        let periods = left.saturating_sub(PERIOD).as_micros() as u32 / PERIOD.as_micros() as u32;
        Some(periods as f32)
    }

    /// The last gate before the wheels, whatever was decided above: where avoidance counts, no
    /// motion without a fresh view.
    pub(super) fn permits_motion(&self, inputs: &Inputs<'_>, now: Instant) -> bool {
        !self.needs_view() || inputs.reading.fresh(now).is_some()
    }

    /// The same for what the wheels are about to do: nothing forward into what is too near. Also
    /// catches a wheel that starts its turn while the other one still rests before reversing.
    pub(super) fn permits_duties(&self, inputs: &Inputs<'_>, now: Instant) -> bool {
        /// Rounding of two duties that add up to nothing.
        const NOTHING: f32 = 1e-6;
        let [left, right] = self.duties();
        if !self.needs_view() || left + right <= NOTHING {
            return true;
        }
        let view = inputs.reading.fresh(now);
        view.is_some_and(|sight| sight.distance_mm() >= self.tuning.critical_mm)
    }
}

fn side<R: Rng>(rng: &mut R) -> Side {
    if rng.next_u32() & 1 == 0 {
        Side::Left
    } else {
        Side::Right
    }
}
