//! Time passes: programs, physics and what comes of them, each in its turn.

use crawler_app::perception::LinkHealth;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{MAX_MESSAGE, Neighbour, Topic};

use super::{EPOCH_MS, HISTORY_PERIOD, Simulation, TIME_PERIOD, Way};
use crate::devices::BodyEvent;
use crate::net::fix::pose_fix;
use crate::run::machine;
#[cfg(feature = "live")]
use crate::run::overhead;
use crate::world::PHYSICS_STEP;

impl Simulation {
    /// Lets `span` pass.
    pub fn run_for(&mut self, span: Duration) {
        self.run_until(self.now() + span);
    }

    /// Lets time pass until `end`.
    pub fn run_until(&mut self, end: Instant) {
        self.journal.runs();
        while !self.is_cut_off() {
            // What arrives in this moment comes before what programs make of it.
            if let Way::Lockstep(network) = &self.way {
                network.process();
            }
            self.sched.run();
            if self.handle_events() {
                continue;
            }
            if self.sched.now() >= self.next_time {
                self.next_time += TIME_PERIOD;
                self.tell_time();
                continue;
            }
            if self.sched.now() >= self.troubles.next() {
                self.pass_troubles();
                continue;
            }
            if self.sched.now() >= self.initial.due() {
                self.start_waiting();
                continue;
            }
            if self.sched.now() >= self.director.next_due() {
                self.direct();
                continue;
            }
            let due = self.next_due();
            if !self.step_physics(due.min(end)) {
                continue;
            }
            if due > end {
                self.sched.advance_to(end);
                return;
            }
            self.sched.advance_to(due);
        }
    }

    /// Steps physics up to `target`. False when something happened that programs must see first;
    /// time then stands at the step in which it did.
    fn step_physics(&mut self, target: Instant) -> bool {
        while self.next_step <= target {
            self.sched.advance_to(self.next_step);
            self.world.step();
            self.next_step += PHYSICS_STEP;
            if !self.exchange() {
                return false;
            }
            if self.sched.now() >= self.next_history {
                self.next_history += HISTORY_PERIOD;
                self.note_state();
            }
            let told = self.track() | self.tell_cells();
            // All of them have something for programs to do.
            if told | self.handle_events() {
                return false;
            }
        }
        true
    }

    /// What robots did to each other in this step: hands on their messages, shares airtime anew,
    /// and with several shards tells the others how the members fare and hears of theirs. False
    /// when the run is over because another shard has failed.
    fn exchange(&mut self) -> bool {
        self.listen();
        let network = match &self.way {
            Way::Lockstep(network) => Some(network),
            _ => None,
        };
        match (&mut self.shard_handle, network) {
            (Some(shard_handle), network) => {
                if !shard_handle.trade(&mut self.world, network, &mut self.said) {
                    return false;
                }
            }
            (None, Some(network)) => network.settle(),
            (None, None) => {}
        }
        if let Some(network) = network {
            let (world, machines) = (&self.world, &self.machines);
            network.look(|link| {
                let pose = world.pose(machines.get(link)?.index)?;
                Some((pose.x, pose.y))
            });
        }
        true
    }

    /// Takes down what robots say to those near them, when that is about to be told. Who has lost the link says
    /// nothing.
    fn listen(&mut self) {
        self.said.clear();
        if self.sched.now() < self.next_cells {
            return;
        }
        for (number, machine) in self.machines.iter().enumerate() {
            let robot = machine.robot.as_ref();
            let robot = robot.filter(|robot| robot.link_health() == LinkHealth::Up);
            if let Some(says) = robot.and_then(|robot| robot.snapshot().says) {
                self.said.insert(number, says);
            }
        }
    }

    /// Tells the robots whose turn it is where they are. Returns whether there were any.
    fn track(&mut self) -> bool {
        let Some(camera) = &mut self.camera else {
            return false;
        };
        let robots = self.machines.len();
        let most = match &self.way {
            Way::None | Way::Lockstep(_) => u64::MAX,
            #[cfg(feature = "live")]
            Way::Live(_) => overhead::LIVE_MOST_PER_S,
        };
        let due = camera.pass(PHYSICS_STEP, robots, most);
        for _ in 0..due {
            let number = camera.turn(robots);
            let machine = &self.machines[number];
            // Robots of other shards have their turn too; theirs tells them.
            if machine.robot.is_none() {
                continue;
            }
            let Some(truth) = self.world.pose(machine.index) else {
                continue;
            };
            let pose = camera.see(number, truth);
            let id = &machine.id;
            match &self.way {
                Way::None => {}
                Way::Lockstep(network) => {
                    let unix = EPOCH_MS + self.sched.now().as_millis();
                    if let Some(payload) = pose_fix(id, unix, pose) {
                        let topic = Topic::Pose(id.clone()).render(&self.fleet);
                        network.publish(&topic, &payload, false, false);
                    }
                }
                #[cfg(feature = "live")]
                Way::Live(gateway) => gateway.outlet().push(id, pose, self.sched.now()),
            }
        }
        due > 0
    }

    /// Tells robots that listen in lockstep who is near, from where bodies are. Returns whether any
    /// did. In a live world that is up to the server, which has it from telemetry.
    fn tell_cells(&mut self) -> bool {
        if self.sched.now() < self.next_cells {
            return false;
        }
        self.next_cells += crawler_cells::PERIOD;
        let Way::Lockstep(network) = &self.way else {
            return false;
        };
        let wanted = network.listened_cells(&self.fleet);
        if wanted.is_empty() {
            return false;
        }
        let robots = self
            .machines
            .iter()
            .enumerate()
            .filter_map(|(number, machine)| {
                let (pose, [v, w]) = self.world.motion(machine.index)?;
                Some(Neighbour {
                    id: machine.id.clone(),
                    x: pose.x,
                    y: pose.y,
                    theta: pose.theta,
                    v,
                    w,
                    says: self.said.get(&number).copied(),
                })
            });
        let unix = EPOCH_MS + self.sched.now().as_millis();
        for digest in crawler_cells::digests(robots, &wanted, unix) {
            let (x, y) = (digest.x, digest.y);
            let mut buffer = [0; MAX_MESSAGE];
            // Bodies are where numbers are.
            if let Ok(len) = digest.to_json(&mut buffer) {
                let topic = Topic::Cell { x, y }.render(&self.fleet);
                network.publish(&topic, &buffer[..len], false, false);
            }
        }
        true
    }

    /// Gives the initial command to robots that can take it by now.
    fn start_waiting(&mut self) {
        let Some((action, waiting)) = self.initial.take() else {
            return;
        };
        let now = self.now();
        for number in waiting {
            let number = number as usize;
            if self.machines[number].takes_commands() {
                self.tell(number, action.clone());
            } else {
                self.initial.wait(number, now);
            }
        }
    }

    /// Sets the clocks of robots that no server tells the time.
    fn tell_time(&self) {
        for machine in &self.machines {
            if let Some((robot, program)) = machine.running() {
                program.tell_time(robot, self.unix_ms());
            }
        }
    }

    /// Resets and power cuts. Returns whether there were any.
    fn handle_events(&mut self) -> bool {
        let events = self.world.take_events();
        for event in &events {
            let (BodyEvent::PowerLost(index) | BodyEvent::Reset(index, _)) = *event;
            // Robots are added to both in the same order.
            let number = index.get() as usize;
            let Some(machine) = self.machines.get_mut(number) else {
                continue;
            };
            if let Some(program) = machine.program.take() {
                program.stop(&mut self.sched);
            }
            let BodyEvent::Reset(_, cause) = *event else {
                continue;
            };
            let Some(parts) = self.world.boot(index, cause) else {
                continue;
            };
            let link = machine.link;
            let robot = machine::context(self.config(number, Some(&parts.started)));
            let program = self.start_program(&robot, parts, number, link);
            let machine = &mut self.machines[number];
            machine.boots += 1;
            machine.program = Some(program);
            machine.robot = Some(robot);
            machine.history.word(self.sched.now().as_micros());
        }
        !events.is_empty()
    }
}
