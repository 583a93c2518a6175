//! What is broken about the robots of a simulation, and until when.

use std::collections::{BTreeMap, BTreeSet};

use crawler_hal::{Duration, Instant};

use super::hostile::Hostile;
use super::runtime::Runtime;
use crate::faults::{Fault, FaultError, LinkCut, Part};
use crate::net::lockstep::Cut;

/// A part of a robot.
type Place = (u32, Part);

/// A fault that holds.
#[derive(Debug)]
struct Active {
    #[cfg(feature = "live")]
    fault: Fault,
    /// When it is over by itself.
    until: Instant,
    /// When something is to be done about it.
    next: Instant,
    /// Who sends the packets, where the fault is that somebody does.
    hostile: Option<Box<Hostile>>,
}

/// All faults that hold, in order of robot and part.
#[derive(Debug, Default)]
pub(super) struct Troubles {
    active: BTreeMap<Place, Active>,
    /// When something is to be done about them, in order of time.
    timers: BTreeSet<(Instant, Place)>,
}

impl Troubles {
    /// When something is to be done next.
    pub(super) fn next(&self) -> Instant {
        self.timers
            .first()
            .map_or(Instant::FAR_FUTURE, |(at, _)| *at)
    }

    fn enter(&mut self, place: Place, active: Active) {
        self.leave(place);
        if active.next < Instant::FAR_FUTURE {
            self.timers.insert((active.next, place));
        }
        self.active.insert(place, active);
    }

    fn leave(&mut self, place: Place) -> Option<Active> {
        let active = self.active.remove(&place)?;
        self.timers.remove(&(active.next, place));
        Some(active)
    }

    /// The parts of a robot that are broken.
    fn of(&self, robot: usize) -> Vec<Place> {
        let robot = robot as u32;
        let all = (robot, Part::Ranger)..(robot.saturating_add(1), Part::Ranger);
        self.active.range(all).map(|(place, _)| *place).collect()
    }

    /// A robot is gone, and what was broken about it.
    pub(super) fn forget(&mut self, robot: usize) {
        for place in self.of(robot) {
            self.leave(place);
        }
    }

    /// What is broken: whose, what, and until when.
    #[cfg(feature = "live")]
    pub(super) fn all(&self) -> impl Iterator<Item = (usize, Fault, Instant)> {
        let all = self.active.iter();
        all.map(|((robot, _), active)| (*robot as usize, active.fault, active.until))
    }

    /// Whoever attacks a robot hears what it is told.
    pub(super) fn overhear(&mut self, robot: usize, payload: &[u8]) {
        let place = (robot as u32, Part::Packets);
        if let Some(Active {
            hostile: Some(hostile),
            ..
        }) = self.active.get_mut(&place)
        {
            hostile.overhear(payload);
        }
    }
}

impl Runtime {
    /// Breaks something about a robot, for so long or until it is mended.
    pub(super) fn break_part(
        &mut self,
        robot: usize,
        fault: Fault,
        lasting: Option<Duration>,
    ) -> Result<(), FaultError> {
        let machine = self.population.get(robot).ok_or(FaultError::NoRobot)?;
        let index = machine.index();
        if self.population.pose(robot).is_none() {
            return Err(FaultError::NoRobot);
        }
        let (now, until) = (self.now(), self.until(lasting));
        let mut active = Active {
            #[cfg(feature = "live")]
            fault,
            until,
            next: until,
            hostile: None,
        };
        match fault {
            Fault::LinkLoss { how } => self.lose_link(robot, Some(how))?,
            Fault::HostilePackets { per_s } => {
                let hostile = Hostile::new(self.seed, index, per_s);
                active.next = until.min(now + hostile.period());
                active.hostile = Some(Box::new(hostile));
            }
            Fault::ClockStep { ms } => {
                if let Some((robot, program)) = machine.running() {
                    program.step_clock(robot, ms);
                }
                return Ok(());
            }
            other => self.population.world.inject(index, other)?,
        }
        self.troubles
            .enter((robot as u32, Part::of(&fault)), active);
        Ok(())
    }

    /// Mends all that is broken about a robot.
    pub(super) fn heal(&mut self, robot: usize) {
        for (_, part) in self.troubles.of(robot) {
            self.mend(robot, part);
        }
    }

    fn mend(&mut self, robot: usize, part: Part) {
        if self.troubles.leave((robot as u32, part)).is_none() {
            return;
        }
        if part == Part::Link {
            // Whoever could lose a link can find it again.
            let _ = self.lose_link(robot, None);
        } else if let Some(machine) = self.population.get(robot) {
            let index = machine.index();
            self.population.world.mend(index, part);
        }
    }

    fn lose_link(&self, robot: usize, how: Option<LinkCut>) -> Result<(), FaultError> {
        let machine = self.population.get(robot).ok_or(FaultError::NoRobot)?;
        let cut = how.map_or(Cut::None, Cut::from);
        let had_one = self.uplink.cut(machine, cut);
        had_one.then_some(()).ok_or(FaultError::NoNetwork)
    }

    /// Does what is due about faults: ends them, and sends what is hostile.
    pub(super) fn pass_troubles(&mut self) {
        let now = self.now();
        while let Some(&(at, place)) = self.troubles.timers.first() {
            if at > now {
                return;
            }
            let (robot, part) = (place.0 as usize, place.1);
            let Some(mut active) = self.troubles.leave(place) else {
                continue;
            };
            if let Some(hostile) = &mut active.hostile
                && at < active.until
            {
                let packet = hostile.packet();
                active.next = active.until.min(at + hostile.period());
                self.troubles.enter(place, active);
                if let Some(machine) = self.population.get(robot) {
                    self.uplink.attack(machine, &packet);
                }
            } else {
                // It is entered once more for `mend`, which takes it out.
                active.next = Instant::FAR_FUTURE;
                self.troubles.enter(place, active);
                self.mend(robot, part);
            }
        }
    }
}

impl From<LinkCut> for Cut {
    fn from(how: LinkCut) -> Self {
        match how {
            LinkCut::Radio => Self::Radio,
            LinkCut::Password => Self::Password,
            LinkCut::NoAddress => Self::NoAddress,
            LinkCut::Silent => Self::Silent,
        }
    }
}
