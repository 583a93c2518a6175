//! What the scenario has in store: commands, faults, goals.

use crawler_hal::{Clock, Duration};
use crawler_protocol::{Action, BehaviourName, RobotState};

use super::{Machine, Simulation};
use crate::faults::Fault;
use crate::run::director::{Broken, Issued, ScenarioAction, Sighting, Target};

impl Simulation {
    /// The places that the scenario sends a robot to, in order.
    #[must_use]
    pub fn targets(&self, robot: usize) -> &[Target] {
        self.director.targets(robot)
    }

    /// Takes the commands that the scenario has given since the last call; of more than a few
    /// thousand, the first ones.
    pub fn take_issued(&mut self) -> Vec<Issued> {
        self.director.take_issued()
    }

    /// Takes the faults that the scenario has brought about since the last call; of more than a
    /// few thousand, the first ones.
    pub fn take_broken(&mut self) -> Vec<Broken> {
        self.director.take_broken()
    }

    /// Whether the scenario has nothing more in store: its timeline is over, and every goal was
    /// reached.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.director.is_over()
    }

    /// Whether a robot has booted and knows the time, so that it takes commands that reach it.
    #[must_use]
    pub fn takes_commands(&self, robot: usize) -> bool {
        self.machines
            .get(robot)
            .is_some_and(Machine::takes_commands)
    }

    /// Does what the scenario has for now.
    pub(super) fn direct(&mut self) {
        let now = self.now();
        for (robot, action) in self.director.due(self.machines.len(), now) {
            match action {
                ScenarioAction::Tell(action) if self.machines[robot].robot.is_some() => {
                    self.tell(robot, *action);
                }
                // It is another shard's.
                ScenarioAction::Tell(_) => {}
                ScenarioAction::Break(fault, lasting) => self.break_down(robot, fault, lasting),
            }
        }
        if !self.director.looks(now) {
            return;
        }
        for robot in 0..self.machines.len() {
            let machine = &self.machines[robot];
            // Robots of other shards are looked at there.
            let (Some(program), Some(pose)) = (&machine.robot, self.world.pose(machine.index))
            else {
                continue;
            };
            let snapshot = program.snapshot();
            let ready = machine.takes_commands();
            let seen = Sighting {
                pose,
                ready: ready.then_some((snapshot.state, snapshot.behaviour)),
            };
            if let Some(action) = self.director.look(robot, seen, now) {
                self.tell(robot, action);
            }
        }
    }

    /// Gives a robot a command of the scenario.
    pub(super) fn tell(&mut self, robot: usize, action: Action) {
        let name = action.command();
        let seq = self.start(robot, action);
        let at = self.now();
        self.director.note(Issued {
            robot,
            seq,
            at,
            command: name,
        });
    }

    fn break_down(&mut self, robot: usize, fault: Fault, lasting: Option<Duration>) {
        let now = self.now();
        let machine = &self.machines[robot];
        let Some(program) = &machine.robot else {
            return;
        };
        let broken = Broken {
            robot,
            at: now,
            until: lasting.map(|lasting| now + lasting),
            had_goal: program.snapshot().behaviour != BehaviourName::Manual,
            fault,
        };
        // Validated with the scenario; a link that is none cannot be lost.
        if self.break_part(robot, fault, lasting).is_ok() {
            self.director.note_broken(broken);
        }
    }
}

impl Machine {
    /// Whether the robot has booted and knows the time, without which it refuses to move.
    pub(super) fn takes_commands(&self) -> bool {
        self.running().is_some_and(|(robot, program)| {
            let booted = robot.snapshot().state != RobotState::Initializing;
            booted && robot.unix_ms(program.clock.now()).is_some()
        })
    }
}
