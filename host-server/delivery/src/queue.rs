//! The commands for one robot, in order.

use std::collections::VecDeque;

use crawler_protocol::RobotId;

use super::{
    Class, DeliverySink, End, LONGEST_PAUSE_MS, MOST_NUMBERS, Ms, RESEND_AFTER_MS, Sending,
};

/// One command that has not been answered.
#[derive(Debug, Clone)]
pub(super) struct PendingCommand {
    id: u64,
    class: Class,
    expires: Ms,
    /// `None` before it first went, and when a program that has started anew is to have it.
    flight: Option<Flight>,
    /// Whether it ever went.
    went: bool,
    /// Numbers it has had.
    numbers: u8,
}

#[derive(Debug, Clone, Copy)]
struct Flight {
    seq: u64,
    /// When it goes again.
    next: Ms,
    pause: Ms,
    /// The program it went to.
    boot: Option<u32>,
}

impl PendingCommand {
    pub(super) const fn new(id: u64, class: Class, expires: Ms) -> Self {
        Self {
            id,
            class,
            expires,
            flight: None,
            went: false,
            numbers: 0,
        }
    }

    pub(super) const fn id(&self) -> u64 {
        self.id
    }

    const fn take_off(&mut self, seq: u64, boot: Option<u32>, next: Ms) {
        self.flight = Some(Flight {
            seq,
            next,
            pause: RESEND_AFTER_MS,
            boot,
        });
        self.went = true;
        self.numbers = self.numbers.saturating_add(1);
    }

    /// Whether it may follow `earlier`, which has no answer yet.
    const fn follows(&self, earlier: Class) -> bool {
        matches!(
            (earlier, self.class),
            (_, Class::Halt) | (Class::Motion, Class::Motion)
        )
    }
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct RobotQueue {
    commands: VecDeque<PendingCommand>,
    /// It said so, or its broker did. Who has said nothing is taken to be there.
    offline: bool,
    boot: Option<u32>,
    /// The newest number that went to this robot alone.
    highest: u64,
}

impl RobotQueue {
    pub(super) fn len(&self) -> usize {
        self.commands.len()
    }

    pub(super) const fn is_online(&self) -> bool {
        !self.offline
    }

    pub(super) const fn boot(&self) -> Option<u32> {
        self.boot
    }

    pub(super) fn push(&mut self, pending: PendingCommand) {
        self.commands.push_back(pending);
    }

    /// A command that has just gone under its own number.
    pub(super) fn push_sent(&mut self, mut pending: PendingCommand, now: Ms) {
        pending.take_off(pending.id, self.boot, now + RESEND_AFTER_MS);
        self.commands.push_back(pending);
    }

    /// Corrects what is known of the flight of a command.
    pub(super) fn took_off(&mut self, id: u64, seq: u64, boot: Option<u32>, now: Ms) {
        if let Some(pending) = self.commands.iter_mut().find(|pending| pending.id == id) {
            pending.take_off(seq, boot, now);
            self.highest = self.highest.max(seq);
        }
    }

    /// Removes commands and returns how many.
    pub(super) fn remove(&mut self, which: impl Fn(&PendingCommand) -> bool) -> usize {
        let before = self.commands.len();
        self.commands.retain(|pending| !which(pending));
        before - self.commands.len()
    }

    /// Makes everything without an answer go again at once, in its order.
    pub(super) fn rouse(&mut self, now: Ms) {
        for flight in self
            .commands
            .iter_mut()
            .filter_map(|pending| pending.flight.as_mut())
        {
            flight.next = now;
            flight.pause = RESEND_AFTER_MS;
        }
    }

    pub(super) fn status(&mut self, online: bool, boot: u32, now: Ms) {
        self.offline = !online;
        // A last will can come after the first words of the next program.
        if online || self.boot.is_none() {
            self.boot = Some(boot);
        }
        if online {
            self.rouse(now);
        }
    }

    pub(super) fn heard(&mut self, now: Ms) {
        if self.offline {
            self.offline = false;
            self.rouse(now);
        }
    }

    pub(super) fn answered(&mut self, seq: u64) -> Option<u64> {
        let under =
            |pending: &PendingCommand| pending.flight.is_some_and(|flight| flight.seq == seq);
        let index = self.commands.iter().position(under)?;
        Some(self.commands.remove(index)?.id)
    }

    pub(super) fn poll(
        &mut self,
        robot: &RobotId,
        broadcast: u64,
        connected: bool,
        now: Ms,
        sink: &mut dyn DeliverySink,
    ) {
        self.give_up(robot, broadcast, now, sink);
        if !connected {
            return;
        }
        let mut earlier: Vec<Class> = Vec::new();
        // When one goes again all that went do: the robot takes them in order.
        let flights = self.commands.iter().filter_map(|pending| pending.flight);
        let again = flights.into_iter().any(|flight| flight.next <= now);
        let mut stuck = false;
        for pending in &mut self.commands {
            let free = earlier.iter().all(|&class| pending.follows(class));
            earlier.push(pending.class);
            let halt = pending.class == Class::Halt;
            if !halt && (stuck || !sink.may_go(pending.class)) {
                continue;
            }
            if self.offline && !(halt && pending.flight.is_none()) {
                continue;
            }
            let known = match pending.flight {
                // First its status must say whether it is the program that this went to.
                Some(flight) if again && (flight.boot.is_none() || self.boot.is_some()) => {
                    Some(flight)
                }
                None if free => None,
                Some(_) | None => continue,
            };
            let seq = match known {
                Some(flight) => flight.seq,
                None if pending.numbers == 0 && pending.id > self.highest.max(broadcast) => {
                    pending.id
                }
                None => sink.number(pending.id, robot, self.highest.max(broadcast)),
            };
            let sending = Sending {
                id: pending.id,
                robot,
                seq,
                again: known.is_some(),
                life_ms: pending.expires - now,
                boot: self.boot,
            };
            if !sink.send(&sending) {
                // What comes after must not go before; halts may.
                stuck = true;
                continue;
            }
            self.highest = self.highest.max(seq);
            match (&mut pending.flight, known) {
                (Some(flight), Some(_)) => {
                    flight.next = now + flight.pause;
                    flight.pause = (flight.pause * 2).min(LONGEST_PAUSE_MS);
                    if flight.boot.is_none() {
                        flight.boot = self.boot;
                    }
                }
                _ => pending.take_off(seq, self.boot, now + RESEND_AFTER_MS),
            }
        }
    }

    /// Drops what must not go any more.
    fn give_up(&mut self, robot: &RobotId, broadcast: u64, now: Ms, sink: &mut dyn DeliverySink) {
        let (boot, newest) = (self.boot, self.highest.max(broadcast));
        self.commands.retain_mut(|pending| {
            let mut end = (pending.expires <= now).then_some(if pending.went {
                End::Unanswered
            } else {
                End::Expired
            });
            if let Some(flight) = pending.flight {
                // A program that has started since knows nothing of it.
                let forgotten =
                    matches!((flight.boot, boot), (Some(then), Some(now)) if then != now);
                match pending.class {
                    Class::Halt if flight.seq < newest => end = Some(End::Unanswered),
                    Class::Plain | Class::Motion if forgotten => end = Some(End::Unanswered),
                    Class::Setting if forgotten && end.is_none() => {
                        if pending.numbers < MOST_NUMBERS {
                            pending.flight = None;
                        } else {
                            end = Some(End::Unanswered);
                        }
                    }
                    _ => {}
                }
            }
            if let Some(end) = end {
                sink.over(pending.id, robot, end);
            }
            end.is_none()
        });
    }
}
