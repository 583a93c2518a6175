//! What the scenario has in store: commands, faults, goals.

use crawler_hal::Duration;
use crawler_protocol::{Action, BehaviourName};

use super::command;
use super::population::Machine;
use super::runtime::Runtime;
use crate::faults::Fault;
use crate::run::director::{Broken, Issued, ScenarioAction, Sighting};

impl Runtime {
    /// Does what the scenario has for now.
    pub(super) fn direct(&mut self) {
        let now = self.now();
        for (robot, action) in self.director.due(self.population.len(), now) {
            match action {
                ScenarioAction::Tell(action) if self.runs(robot) => self.tell(robot, *action),
                // It is another shard's.
                ScenarioAction::Tell(_) => {}
                ScenarioAction::Break(fault, lasting) => self.break_down(robot, fault, lasting),
            }
        }
        if !self.director.looks(now) {
            return;
        }
        for robot in 0..self.population.len() {
            let Some(machine) = self.population.get(robot) else {
                continue;
            };
            // Robots of other shards are looked at there.
            let pose = self.population.world.pose(machine.index());
            let (Some(program), Some(pose)) = (machine.robot(), pose) else {
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

    /// Gives the initial command to robots that can take it by now.
    pub(super) fn start_waiting(&mut self) {
        let Some((action, waiting)) = self.initial.take() else {
            return;
        };
        let now = self.now();
        for number in waiting {
            let number = number as usize;
            if self.takes_commands(number) {
                self.tell(number, action.clone());
            } else {
                self.initial.wait(number, now);
            }
        }
    }

    /// Lets nothing of the scenario happen any more: no command, no fault, no goal.
    #[cfg(feature = "live")]
    pub(super) fn end_scenario(&mut self) {
        self.initial.end();
        self.director.end();
    }

    /// Whether a robot has booted and knows the time, so that it takes commands that reach it.
    pub(super) fn takes_commands(&self, robot: usize) -> bool {
        let machine = self.population.get(robot);
        machine.is_some_and(Machine::takes_commands)
    }

    /// Whether its program runs in this shard, when it has power.
    fn runs(&self, robot: usize) -> bool {
        let machine = self.population.get(robot);
        machine.is_some_and(|machine| machine.robot().is_some())
    }

    /// Gives a robot a command of the scenario.
    fn tell(&mut self, robot: usize, action: Action) {
        let name = action.command();
        let before = self.director.count(robot);
        let (seq, payload) = command::of_scenario(before, action, self.command_time());
        self.hand(robot, &payload);
        self.director.note(Issued {
            robot,
            seq,
            at: self.now(),
            command: name,
        });
    }

    fn break_down(&mut self, robot: usize, fault: Fault, lasting: Option<Duration>) {
        let machine = self.population.get(robot);
        let Some(program) = machine.and_then(Machine::robot) else {
            return;
        };
        let broken = Broken {
            robot,
            at: self.now(),
            until: lasting.map(|lasting| self.now() + lasting),
            had_goal: program.snapshot().behaviour != BehaviourName::Manual,
            fault,
        };
        // Validated with the scenario; a link that is none cannot be lost.
        if self.break_part(robot, fault, lasting).is_ok() {
            self.director.note_broken(broken);
        }
    }
}

#[cfg(all(test, feature = "live"))]
mod tests {
    use super::*;
    use crate::run::simulation::Simulation;
    use crate::scenario::Scenario;
    use crate::world::Pose;

    const FLOOR: &str = r#"
name = "floor"
robots = 3
arena = { width = 6.0, height = 6.0, scatter = { per_square_metre = 0.0 } }
"#;
    const WANDER: &str = "command = \"behave\"\nparameters = { behaviour = \"wander\" }";

    /// How far one of them goes in three seconds once all were told to stop, metres.
    fn way_after_a_stop(scenario: &str, before_ms: u64, ends: bool) -> f32 {
        let scenario = Scenario::parse(scenario).expect("a scenario");
        let mut world = Simulation::without_network(scenario, 1).expect("a world");
        world.run_for(Duration::from_millis(before_ms));
        if ends {
            world.end_scenario();
        }
        world.submit_all(Action::Stop);
        world.run_for(Duration::from_millis(1_000));
        let poses = |world: &Simulation| -> Vec<Pose> {
            let robots = 0..world.robots();
            robots.filter_map(|robot| world.pose(robot)).collect()
        };
        let stood = poses(&world);
        world.run_for(Duration::from_millis(3_000));
        let ways = stood.iter().zip(poses(&world));
        ways.map(|(from, to)| (from.x - to.x).hypot(from.y - to.y))
            .fold(0.0, f32::max)
    }

    #[test]
    fn a_scenario_that_has_ended_sets_nobody_going_again() {
        // Those who wait for their clock, who are told again and again, and who have somewhere to go.
        let first = format!("{FLOOR}[command]\n{WANDER}\n");
        let again = format!("{FLOOR}[[commands]]\nat_s = 0.0\nevery_s = 2.0\n{WANDER}\n");
        let goal = format!("{FLOOR}[[goals]]\nx = 2.0\ny = 2.0\nr = 0.5\n");
        for (scenario, before_ms) in [(&first, 0), (&again, 5_000), (&goal, 5_000)] {
            let way = |ends| way_after_a_stop(scenario, before_ms, ends);
            let [goes_on, ended] = [false, true].map(way);
            assert!(
                goes_on > 0.1 && ended < 0.01,
                "{goes_on}, {ended} m: {scenario}"
            );
        }
    }
}
