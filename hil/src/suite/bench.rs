//! A robot on the bench: say something to it, and hear what comes of it.

use std::time::Duration;

use crawler_protocol::open::{Response, StatusMessage, Telemetry};
use crawler_protocol::{
    Action, Command, MAX_MESSAGE, ParametersMessage, RobotState, Source, Topic,
};
use rumqttc::v5::mqttbytes::QoS;
use serde_json::{Value, json};
use tokio::time::Instant;

use super::clock::FleetClock;
use super::connection::{Arrival, Connection};
use super::hearing::{Book, Message, Word};
use super::{BenchError, Failure, Target};

/// For an answer, or anything else that takes a robot one turn: most are there within 50 ms.
pub const ANSWER: Duration = Duration::from_secs(10);
/// For a robot to come to rest.
pub const REST: Duration = Duration::from_secs(6);
/// Messages kept of one stretch of listening.
const HEARD: usize = 10_000;

/// A robot, and a session with its broker.
pub struct Bench {
    pub(super) target: Target,
    connection: Connection,
    pub(super) book: Book,
    pub(super) clock: FleetClock,
    source: Source,
    seq: u64,
}

/// Who a client is: brokers end the older one of two with one name.
fn name(purpose: &str, robot: &str) -> String {
    format!("hil-{purpose}-{robot}-{}", std::process::id())
}

impl Bench {
    /// Connects to the broker and asks for everything the robot says. Does not yet know whether
    /// there is such a robot.
    ///
    /// # Errors
    /// [`BenchError`] says in one line what is wrong with the broker.
    pub async fn open(target: Target) -> Result<Self, BenchError> {
        let id = target.robot.clone();
        let filters = [
            Topic::Heartbeat(id.clone()),
            Topic::Telemetry(id.clone()),
            Topic::Response(id.clone()),
            Topic::Parameters(id.clone()),
            Topic::Logs(id.clone()),
            Topic::Map(id.clone()),
            Topic::Vision(id.clone()),
            Topic::Image(id.clone()),
            Topic::Time,
        ];
        let mut filters: Vec<(String, QoS)> = filters
            .iter()
            .map(|topic| (topic.render(&target.fleet).to_string(), quality(topic)))
            .collect();
        let everyone = crawler_protocol::TopicFilter::Status.render(&target.fleet);
        filters.push((everyone.to_string(), QoS::AtLeastOnce));
        let client = name("suite", id.as_str());
        let connection = Connection::open(&target.broker, &client, filters).await?;
        // 44 bytes at most, of the 48 that a source may have.
        let source = format!("hil:{id}:{}", std::process::id());
        let clock = FleetClock::new(Instant::now());
        Ok(Self {
            source: Source::new(&source).map_err(|_| BenchError::Source(source))?,
            // Rises from run to run, and meets no other controller's: answers name no source.
            seq: clock.now_ms().saturating_mul(1_000),
            target,
            connection,
            book: Book::default(),
            clock,
        })
    }

    /// The robot and its broker.
    pub const fn target(&self) -> &Target {
        &self.target
    }

    /// The robot's newest status.
    pub const fn status(&self) -> Option<&StatusMessage> {
        self.book.status.as_ref()
    }

    /// The robot's newest parameters.
    pub const fn parameters(&self) -> Option<&ParametersMessage> {
        self.book.parameters.as_ref()
    }

    /// The next message of the robot, or of whoever publishes the time; none when `until` passes
    /// first.
    ///
    /// # Errors
    /// [`Failure::Lost`] when the session with the broker is over.
    pub async fn next(&mut self, until: Instant) -> Result<Option<Message>, Failure> {
        loop {
            let now = Instant::now();
            if let Some(timestamp) = self.clock.take(now) {
                let payload = json!({"timestamp": timestamp}).to_string().into_bytes();
                self.publish(&Topic::Time, payload)?;
            }
            let wake = self.clock.due().map_or(until, |due| due.min(until));
            match self.connection.next(wake).await {
                Some(arrival) => {
                    if let Some(message) = self.take_in(arrival)? {
                        return Ok(Some(message));
                    }
                }
                None if wake >= until => return Ok(None),
                None => {}
            }
        }
    }

    fn take_in(&mut self, arrival: Arrival) -> Result<Option<Message>, Failure> {
        match arrival {
            Arrival::Message {
                topic,
                payload,
                retained,
                at,
            } => {
                let (fleet, robot) = (&self.target.fleet, &self.target.robot);
                let word = self.book.hear(fleet, robot, &topic, &payload, retained);
                if let Some(Word::Time(time)) = &word {
                    self.clock.heard(time.timestamp, at);
                }
                Ok(word.map(|word| Message { at, retained, word }))
            }
            Arrival::Refused => {
                self.book.refused += 1;
                Ok(None)
            }
            Arrival::Lost(text) => Err(Failure::Lost(text)),
        }
    }

    /// Takes in what has arrived meanwhile, so that what comes next is new.
    ///
    /// # Errors
    /// As [`Bench::next`].
    pub fn catch_up(&mut self) -> Result<(), Failure> {
        while let Some(arrival) = self.connection.waiting() {
            self.take_in(arrival)?;
        }
        Ok(())
    }

    /// What arrives within `span`.
    ///
    /// # Errors
    /// As [`Bench::next`].
    pub async fn listen(&mut self, span: Duration) -> Result<Vec<Message>, Failure> {
        self.catch_up()?;
        let until = Instant::now() + span;
        let mut heard = Vec::new();
        while let Some(message) = self.next(until).await? {
            if heard.len() < HEARD {
                heard.push(message);
            }
        }
        Ok(heard)
    }

    /// Waits until `found` finds something in a message that arrives from now on.
    ///
    /// # Errors
    /// [`Failure::Failed`] with `what` when `limit` passes first; as [`Bench::next`].
    pub async fn wait<T>(
        &mut self,
        what: &str,
        limit: Duration,
        mut found: impl FnMut(&Message) -> Option<T>,
    ) -> Result<T, Failure> {
        let until = Instant::now() + limit;
        while let Some(message) = self.next(until).await? {
            if let Some(value) = found(&message) {
                return Ok(value);
            }
        }
        Err(self.too_late(what, limit))
    }

    /// `what` did not happen within `limit`.
    pub(super) fn too_late(&self, what: &str, limit: Duration) -> Failure {
        let last = match &self.book.telemetry {
            Some(last) => format!(
                "; last telemetry: {}, {}, wheels {:.2} {:.2}",
                last.state.name(),
                last.behaviour.name(),
                last.wheels.left,
                last.wheels.right
            ),
            None => String::new(),
        };
        Failure::Failed(format!("not within {} s: {what}{last}", limit.as_secs()))
    }

    /// A number for the next command. Every second one stays free, for what comes out of order.
    pub fn next_seq(&mut self) -> u64 {
        self.seq += 2;
        self.seq
    }

    /// The source of this run's commands.
    pub const fn source(&self) -> &Source {
        &self.source
    }

    /// `body` (`command` and `parameters`) with what makes it a command, and its number.
    pub fn envelope(&mut self, mut body: Value) -> (u64, Value) {
        let seq = self.next_seq();
        body["timestamp"] = self.clock.now_ms().into();
        body["seq"] = seq.into();
        body["source"] = self.source.as_str().into();
        (seq, body)
    }

    fn publish(&self, topic: &Topic, payload: Vec<u8>) -> Result<(), Failure> {
        let at_least_once = topic.qos() == crawler_protocol::Qos::AtLeastOnce;
        let topic = topic.render(&self.target.fleet);
        self.connection
            .publish(&topic, at_least_once, payload)
            .map_err(|error| Failure::Lost(error.to_string()))
    }

    /// Sends bytes on a topic of the fleet.
    ///
    /// # Errors
    /// [`Failure::Lost`] when there is no session.
    pub(super) fn send_on(&mut self, topic: &Topic, payload: Vec<u8>) -> Result<(), Failure> {
        self.publish(topic, payload)
    }

    /// Sends bytes to the robot's command topic.
    ///
    /// # Errors
    /// [`Failure::Lost`] when there is no session.
    pub fn send_bytes(&mut self, payload: Vec<u8>) -> Result<(), Failure> {
        self.publish(&Topic::CommandRobot(self.target.robot.clone()), payload)
    }

    /// Sends a command to the robot, and gives its number.
    ///
    /// # Errors
    /// As [`Bench::send_bytes`].
    pub fn send(&mut self, action: Action) -> Result<u64, Failure> {
        let topic = Topic::CommandRobot(self.target.robot.clone());
        self.send_to(&topic, action)
    }

    /// Sends a command to every robot of the fleet, and gives its number.
    ///
    /// # Errors
    /// As [`Bench::send_bytes`].
    pub fn send_swarm(&mut self, action: Action) -> Result<u64, Failure> {
        self.send_to(&Topic::CommandSwarm, action)
    }

    fn send_to(&mut self, topic: &Topic, action: Action) -> Result<u64, Failure> {
        let command = Command {
            action,
            timestamp: self.clock.now_ms(),
            seq: self.next_seq(),
            source: self.source.clone(),
        };
        let mut buffer = [0; MAX_MESSAGE];
        let len = command
            .to_json(&mut buffer)
            .map_err(|error| Failure::Failed(format!("a command of ours: {error}")))?;
        self.publish(topic, buffer[..len].to_vec())?;
        Ok(command.seq)
    }

    /// The next answer to command `seq` that was not yet given out.
    ///
    /// # Errors
    /// [`Failure::Failed`] when `limit` passes first; as [`Bench::next`].
    pub async fn answer(&mut self, seq: u64, limit: Duration) -> Result<Response, Failure> {
        let until = Instant::now() + limit;
        loop {
            let answers = &mut self.book.answers;
            if let Some(index) = answers.iter().position(|answer| answer.seq == seq) {
                return Ok(answers.remove(index).unwrap_or_else(|| unreachable!()));
            }
            if self.next(until).await?.is_none() {
                return Err(self.too_late("an answer", limit));
            }
        }
    }

    /// The final answer to command `seq`.
    ///
    /// # Errors
    /// As [`Bench::answer`].
    pub async fn outcome(&mut self, seq: u64, limit: Duration) -> Result<Response, Failure> {
        let until = Instant::now() + limit;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let answer = self.answer(seq, left).await;
            match answer {
                Ok(answer) if answer.status.is_final() => return Ok(answer),
                Ok(_) => {}
                Err(Failure::Failed(_)) => return Err(self.too_late("a final answer", limit)),
                Err(failure) => return Err(failure),
            }
        }
    }

    /// Sends a command and waits for its final answer.
    ///
    /// # Errors
    /// As [`Bench::answer`].
    pub async fn ask(&mut self, action: Action) -> Result<Response, Failure> {
        let seq = self.send(action)?;
        self.outcome(seq, ANSWER).await
    }

    /// The next telemetry.
    ///
    /// # Errors
    /// [`Failure::Failed`] when `limit` passes first; as [`Bench::next`].
    pub async fn telemetry(&mut self, limit: Duration) -> Result<Telemetry, Failure> {
        self.catch_up()?;
        self.until("telemetry", limit, |_| true).await
    }

    /// Waits for telemetry that `is` so.
    ///
    /// # Errors
    /// [`Failure::Failed`] with `what` when `limit` passes first; as [`Bench::next`].
    pub async fn until(
        &mut self,
        what: &str,
        limit: Duration,
        mut is: impl FnMut(&Telemetry) -> bool,
    ) -> Result<Telemetry, Failure> {
        self.wait(what, limit, |message| match &message.word {
            Word::Telemetry(telemetry) if is(telemetry) => Some(telemetry.clone()),
            _ => None,
        })
        .await
    }

    /// Waits until the robot stands ready, and still does in the telemetry after that.
    ///
    /// # Errors
    /// [`Failure::Failed`] when `limit` passes first; as [`Bench::next`].
    pub async fn rests(&mut self, limit: Duration) -> Result<(), Failure> {
        self.catch_up()?;
        let mut in_a_row = 0;
        self.until("the robot stands, IDLE", limit, |telemetry| {
            let rests = is_standing(telemetry) && telemetry.state == RobotState::Idle;
            in_a_row = if rests { in_a_row + 1 } else { 0 };
            in_a_row == 2
        })
        .await
        .map(drop)
    }

    /// Checks that the next `count` telemetry messages are all so.
    ///
    /// # Errors
    /// [`Failure::Failed`] with `what` when one is not, or they do not come; as [`Bench::next`].
    pub async fn stays(
        &mut self,
        what: &str,
        count: usize,
        is: impl Fn(&Telemetry) -> bool,
    ) -> Result<(), Failure> {
        self.catch_up()?;
        for _ in 0..count {
            let telemetry = self.until("telemetry", ANSWER, |_| true).await?;
            if !is(&telemetry) {
                return Err(Failure::Failed(format!(
                    "{what}, but now it is {}, {}, wheels {:.2} {:.2}",
                    telemetry.state.name(),
                    telemetry.behaviour.name(),
                    telemetry.wheels.left,
                    telemetry.wheels.right
                )));
            }
        }
        Ok(())
    }

    /// What the broker keeps on `topic` for whoever asks for it now.
    ///
    /// # Errors
    /// [`Failure`] when it keeps nothing, or a second session cannot be had.
    pub async fn retained(&self, topic: &Topic) -> Result<Vec<u8>, Failure> {
        let filter = topic.render(&self.target.fleet).to_string();
        let client = name("look", self.target.robot.as_str());
        let filters = vec![(filter.clone(), quality(topic))];
        let mut second = Connection::open(&self.target.broker, &client, filters)
            .await
            .map_err(|error| Failure::Lost(error.to_string()))?;
        let until = Instant::now() + ANSWER;
        while let Some(arrival) = second.next(until).await {
            match arrival {
                Arrival::Message {
                    payload,
                    retained: true,
                    ..
                } => {
                    second.close().await;
                    return Ok(payload);
                }
                Arrival::Lost(text) => return Err(Failure::Lost(text)),
                Arrival::Message { .. } | Arrival::Refused => {}
            }
        }
        Err(Failure::Failed(format!("nothing is retained on {filter}")))
    }

    /// Ends the session.
    pub async fn close(self) {
        self.connection.close().await;
    }
}

fn quality(topic: &Topic) -> QoS {
    match topic.qos() {
        crawler_protocol::Qos::AtMostOnce => QoS::AtMostOnce,
        crawler_protocol::Qos::AtLeastOnce => QoS::AtLeastOnce,
    }
}

/// Whether both duties are zero.
pub fn is_standing(telemetry: &Telemetry) -> bool {
    telemetry.wheels.left == 0.0 && telemetry.wheels.right == 0.0
}
