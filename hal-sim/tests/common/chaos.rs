//! A server, its broker and its robots, and everything between them going wrong: with the server's
//! own delivery of commands and the real program of the robots, in virtual time.

#[path = "chaos/driver.rs"]
mod driver;
#[path = "chaos/judge.rs"]
mod judge;
#[path = "chaos/report.rs"]
mod report;

use std::collections::{BTreeMap, BTreeSet};

use crawler_delivery::{Class, Delivery, DeliverySink as _, Ms, Sending};
use crawler_hal::{Duration, Instant};
use crawler_protocol::{
    Action, Direction, ParameterValue, ParameterValues, Reason, Response, ResponseStatus, RobotId,
    StatusMessage, Topic,
};
use crawler_sim::net::lockstep::{Cut, LinkModel};
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg32;

use driver::{CommandTable, DeliveryDriver, Given, Kept};
use report::{Kind, Report};

/// What robots may need from the end of a fault until they are back.
pub(crate) const BACK_WITHIN_MS: u64 = 10_000;
/// A robot stands so long after the last word of its controller reached it.
const LEASE: Duration = Duration::from_millis(500);
const TICK: Duration = Duration::from_millis(50);
/// Longer than anything but a setting lives.
const CALM_MS: u64 = 65_000;
/// From the beginning of one fault to that of the next: robots call a session of a minute stable.
const FAULT_EVERY_MS: u64 = 75_000;
const STARTED_MS: u64 = 8_000;
/// Share of messages that arrive twice, at robots and at the server.
const TWICE: f32 = 0.05;

/// 5 % loss, and up to 200 ms more than the shortest way takes.
pub(crate) const BAD_LINK: LinkModel = LinkModel {
    latency_ms: 5.0,
    jitter_ms: 200.0,
    loss: 0.05,
    retransmit_ms: 200.0,
    rssi_dbm: -80,
};

const KINDS: [Kind; 6] = [
    Kind::BrokerRestart,
    Kind::SilentPartition,
    Kind::ServerCutOff,
    Kind::RadioPartition,
    Kind::ServerKilled,
    Kind::BothKilled,
];

struct Fault {
    kind: Kind,
    ends: Ms,
    robots: Vec<usize>,
}

pub(crate) struct Chaos {
    simulation: Simulation,
    rng: Pcg32,
    delivery: Delivery,
    table: CommandTable,
    ids: Vec<RobotId>,
    by_id: BTreeMap<RobotId, usize>,
    topics: BTreeMap<RobotId, String>,
    /// Retained at the broker, for a server that comes back.
    retained: BTreeMap<usize, (bool, u32)>,
    alive: bool,
    connected: bool,
    fault: Option<Fault>,
    /// Since when robots are to be back, and who is.
    returning: Option<(Kind, Ms, BTreeSet<usize>)>,
    report: Report,
    careless: bool,
}

impl Chaos {
    /// `careless`: commands are sent once, as a server does that leaves everything to MQTT.
    pub(crate) fn new(robots: u32, seed: u64, careless: bool) -> Self {
        let mut scenario = Scenario::built_in("arena").unwrap().with_robots(robots);
        scenario.command = None;
        scenario.link = Some(BAD_LINK);
        let simulation = Simulation::lockstep(scenario, seed).unwrap();
        let network = simulation.network().unwrap();
        network.record(200_000);
        network.repeat(TWICE);
        let ids: Vec<RobotId> = (0..robots as usize)
            .map(|robot| simulation.id(robot).unwrap().clone())
            .collect();
        let topic = |id: &RobotId| Topic::CommandRobot(id.clone()).render(simulation.fleet());
        Self {
            topics: ids
                .iter()
                .map(|id| (id.clone(), topic(id).to_string()))
                .collect(),
            by_id: ids.iter().cloned().zip(0..).collect(),
            report: Report {
                robots: ids.len(),
                ..Report::default()
            },
            ids,
            rng: Pcg32::seed_from_u64(seed),
            delivery: Delivery::new(),
            table: CommandTable {
                number: 1_000_000,
                given: BTreeMap::new(),
                numbers: BTreeMap::new(),
                journal: BTreeMap::new(),
                sent: 0,
                again: 0,
            },
            retained: BTreeMap::new(),
            alive: true,
            connected: true,
            fault: None,
            returning: None,
            simulation,
            careless,
        }
    }

    fn now(&self) -> Ms {
        self.simulation.now().as_millis()
    }

    fn draw(&mut self, below: u64) -> u64 {
        self.rng.next_u64() % below
    }

    fn chance(&mut self, share: f32) -> bool {
        (self.rng.next_u32() as f32) < share * u32::MAX as f32
    }

    /// Lets so many milliseconds of faults pass, and then calm.
    pub(crate) fn run(mut self, chaos_ms: u64) -> Report {
        let mut kinds = 0;
        while self.now() < STARTED_MS + chaos_ms {
            if self.now() >= STARTED_MS + FAULT_EVERY_MS * kinds {
                self.strike(KINDS[kinds as usize % KINDS.len()]);
                kinds += 1;
            }
            if self.now() >= STARTED_MS - 1_000 {
                self.operate();
            }
            self.tick();
        }
        let end = self.now() + CALM_MS;
        while self.now() < end {
            self.tick();
        }
        self.judge()
    }

    fn strike(&mut self, kind: Kind) {
        let ends = self.now() + 1_000 + self.draw(19_000);
        let mut robots = Vec::new();
        match kind {
            Kind::BrokerRestart | Kind::BothKilled => {
                self.simulation.network().unwrap().stop_broker();
                self.retained.clear();
            }
            Kind::SilentPartition | Kind::RadioPartition => {
                let cut = match kind {
                    Kind::SilentPartition => Cut::Silent,
                    _ => Cut::Radio,
                };
                for robot in 0..self.ids.len() {
                    if self.chance(0.4) {
                        self.simulation.cut(robot, cut);
                        robots.push(robot);
                    }
                }
            }
            Kind::ServerCutOff | Kind::ServerKilled => {}
        }
        if !matches!(kind, Kind::SilentPartition | Kind::RadioPartition) {
            self.connected = false;
            let now = self.now();
            self.delivery.connection(false, now);
        }
        if matches!(kind, Kind::ServerKilled | Kind::BothKilled) {
            self.alive = false;
            self.table.forget_halts();
        }
        *self.report.faults.entry(kind).or_default() += 1;
        self.fault = Some(Fault { kind, ends, robots });
    }

    fn recover(&mut self) {
        let now = self.now();
        let Some(fault) = self.fault.take_if(|fault| fault.ends <= now) else {
            return;
        };
        if matches!(fault.kind, Kind::BrokerRestart | Kind::BothKilled) {
            self.simulation.network().unwrap().start_broker();
        }
        for robot in &fault.robots {
            self.simulation.cut(*robot, Cut::None);
        }
        if !self.alive {
            self.alive = true;
            self.delivery = Delivery::new();
            let journal = std::mem::take(&mut self.table.journal);
            for (&id, kept) in journal.iter().filter(|(_, kept)| kept.expires > now) {
                let given = &self.table.given[&id];
                let (robot, flight) = (&self.ids[given.robot], (kept.seq, kept.boot));
                let times = (now, kept.expires);
                self.delivery.resume(id, robot, given.class, flight, times);
            }
            self.table.journal = journal;
        }
        if !self.connected {
            self.connected = true;
            self.delivery.connection(true, now);
            for (&robot, &(online, boot)) in &self.retained {
                self.delivery.status(&self.ids[robot], online, boot, now);
            }
        }
        self.returning = Some((fault.kind, now, BTreeSet::new()));
    }

    /// What people do meanwhile: some steer, others set and ask.
    fn operate(&mut self) {
        if !self.alive {
            return;
        }
        let steered = self.ids.len().div_ceil(5);
        for robot in 0..self.ids.len() {
            let turn = (self.now() / 50 + robot as u64).is_multiple_of(4);
            if robot < steered && turn {
                let w = if robot % 2 == 0 { 1.0 } else { -1.0 };
                self.give(robot, Action::Drive { v: 0.0, w });
            }
            // Each robot every four seconds.
            if !self.chance(0.0125) {
                continue;
            }
            let action = match self.draw(10) {
                0..4 => {
                    let mut values = ParameterValues::new();
                    let name = heapless::String::try_from("safe_distance_mm").unwrap();
                    let value = 300.0 + self.draw(400) as f32;
                    values.push((name, ParameterValue::Number(value))).unwrap();
                    Action::Set(values)
                }
                4..6 => Action::Identify,
                6..9 => Action::Move {
                    direction: Direction::Left,
                    speed: 50,
                    duration_ms: 300,
                },
                _ => Action::Stop,
            };
            self.give(robot, action);
        }
    }

    fn give(&mut self, robot: usize, action: Action) {
        let class = Class::of(&action);
        // As the server has it: without a broker only settings are taken.
        if !self.connected && class != Class::Setting {
            return;
        }
        let now = self.now();
        let id = self.table.number + 1;
        if self
            .delivery
            .submit(id, &self.ids[robot], class, now)
            .is_err()
        {
            return;
        }
        self.table.number = id;
        if matches!(class, Class::Plain | Class::Setting) {
            let boot = self.delivery.boot(&self.ids[robot]);
            let expires = now + class.life_ms();
            self.table.journal.insert(
                id,
                Kept {
                    seq: id,
                    boot,
                    expires,
                },
            );
        }
        let given = Given {
            robot,
            action,
            class,
            at: now,
            timestamp: self.simulation.unix_ms(),
            end: None,
            ran: BTreeSet::new(),
            answered: None,
            forgotten: false,
        };
        self.table.given.insert(id, given);
        if self.careless {
            let id_of = self.ids[robot].clone();
            let sending = Sending {
                id,
                robot: &id_of,
                seq: id,
                again: false,
                life_ms: 1,
                boot: None,
            };
            let mut driver = DeliveryDriver {
                table: &mut self.table,
                simulation: &mut self.simulation,
                topics: &self.topics,
            };
            driver.send(&sending);
            return;
        }
        self.poll_one(robot);
    }

    fn poll_one(&mut self, robot: usize) {
        let now = self.now();
        let mut driver = DeliveryDriver {
            table: &mut self.table,
            simulation: &mut self.simulation,
            topics: &self.topics,
        };
        if self.alive && !self.careless {
            self.delivery.poll_one(&self.ids[robot], now, &mut driver);
        }
    }

    fn tick(&mut self) {
        self.simulation.run_for(TICK);
        self.recover();
        self.listen();
        let now = self.now();
        if self.alive && !self.careless {
            let mut driver = DeliveryDriver {
                table: &mut self.table,
                simulation: &mut self.simulation,
                topics: &self.topics,
            };
            self.delivery.poll(now, &mut driver);
        }
        self.watch();
        if let Some((kind, since, back)) = &self.returning {
            let (kind, took) = (*kind, now - since);
            let all = back.len() == self.ids.len();
            if all || took > BACK_WITHIN_MS {
                let slowest = self.report.slowest_return_ms.entry(kind).or_default();
                *slowest = took.max(*slowest);
                self.report.late_returns += u64::from(!all);
                self.returning = None;
            }
        }
    }

    /// Whatever reached the broker, and from there the server if it listens.
    fn listen(&mut self) {
        let record = self.simulation.network().unwrap().take_record();
        for published in record {
            let topic = Topic::parse(self.simulation.fleet(), &published.topic).unwrap();
            if let Topic::Status(id) = &topic {
                let status = StatusMessage::from_json(&published.payload).unwrap();
                let told = (status.online, status.boot.count);
                self.retained.insert(self.by_id[id], told);
            }
            if !self.alive || !self.connected {
                continue;
            }
            let now = self.now();
            match topic {
                Topic::Status(id) => {
                    let (online, boot) = self.retained[&self.by_id[&id]];
                    self.delivery.status(&id, online, boot, now);
                    self.poll_one(self.by_id[&id]);
                }
                Topic::Heartbeat(id) => {
                    self.delivery.heard(&id, now);
                    let robot = self.by_id[&id];
                    if let Some((.., back)) = &mut self.returning
                        && published.at > Instant::from_millis(0)
                    {
                        back.insert(robot);
                    }
                }
                Topic::Response(_) => {
                    let response = Response::from_json(&published.payload).unwrap();
                    self.answer(&response);
                    if self.chance(TWICE) {
                        self.answer(&response);
                    }
                }
                _ => {}
            }
        }
        assert_eq!(
            self.simulation.network().unwrap().statistics().unrecorded,
            0
        );
    }

    fn answer(&mut self, response: &Response) {
        let (seq, status) = (response.seq, response.status);
        let answered = self.delivery.answered(&response.robot, seq);
        let Some(&id) = self.table.numbers.get(&seq) else {
            panic!("nobody gave {seq}");
        };
        if answered.is_some() {
            self.table.journal.remove(&id);
        }
        self.poll_one(self.by_id[&response.robot]);
        let given = self.table.given.get_mut(&id).unwrap();
        given.answered = Some(status);
        let refused = matches!(
            response.reason,
            Some(Reason::Busy | Reason::NoClock | Reason::OutOfRange)
        );
        let did = match status {
            ResponseStatus::Accepted | ResponseStatus::Completed | ResponseStatus::Failed => true,
            ResponseStatus::Rejected => !refused,
            ResponseStatus::Expired | ResponseStatus::Stale => false,
        };
        if did {
            given.ran.insert(seq);
        }
    }

    fn watch(&mut self) {
        let now = self.simulation.now();
        for robot in 0..self.ids.len() {
            if self.simulation.observe(robot).unwrap().duty == [0, 0] {
                continue;
            }
            let steered = self.simulation.robot(robot).unwrap().tally().motion;
            let alone = steered.map_or(now - Instant::BOOT, |at| now - at);
            self.report.longest_alone_ms = self.report.longest_alone_ms.max(alone.as_millis());
            if alone > LEASE {
                self.report.runaways += 1;
            }
        }
    }
}
