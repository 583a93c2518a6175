//! From the bus to fleet, commands and events.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crawler_cluster::ClusterMembership;
use crawler_cluster::frame::{Message, OutgoingMessage};
use crawler_protocol::open::Telemetry;
use crawler_protocol::{Fleet, RobotId, Topic};

use super::outcome_log::OutcomeLog;
use crawler_calibrations::Calibrations;
use crawler_commands::CommandCenter;
use crawler_fleet::bus::Receiver;
use crawler_fleet::enforcement::Stops;
use crawler_fleet::maps::Maps;
use crawler_fleet::{FleetState, Incoming, Level, Received, SharedFleet};
use crawler_history::{HistoryStore, Sample};
use crawler_metrics::{Dropped, Metrics};
use crawler_system::clock;
use crawler_twins::Twins;

/// What a sample may be older than the newest one of its message, in milliseconds. Robots send
/// nothing older than 2 s, unless their link is busy.
const OLDEST: u64 = 10_000;

/// Takes what the bus receives.
pub(super) struct Ingest {
    /// Whose topics are taken.
    pub(super) name: Fleet,
    pub(super) fleet: Arc<SharedFleet>,
    pub(super) commands: Arc<CommandCenter>,
    pub(super) maps: Arc<Maps>,
    pub(super) twins: Arc<Twins>,
    pub(super) calibrations: Arc<Calibrations>,
    pub(super) history: HistoryStore,
    pub(super) metrics: Arc<Metrics>,
    pub(super) membership: Option<Arc<ClusterMembership>>,
    pub(super) stops: Arc<Stops>,
    pub(super) outcomes: OutcomeLog,
    /// Set when a robot has come online since the time last went out.
    pub(super) time_wanted: Arc<AtomicBool>,
}

impl Ingest {
    /// Takes in what another server has heard and told. It has written it to the history, and
    /// counted it.
    pub(super) fn relayed(&self, message: &Message) {
        let text = std::str::from_utf8(&message.topic).unwrap_or_default();
        let topic = Topic::parse(&self.name, text);
        if !topic.as_ref().is_ok_and(is_shared) {
            return;
        }
        let now = Instant::now();
        let incoming = Incoming {
            topic: &message.topic,
            payload: &message.payload,
            retained: message.retained,
            content_type: message.content_type.as_deref(),
            properties: &message.properties,
        };
        let received = {
            let mut fleet = self.fleet.lock();
            let received = fleet.receive(&incoming, now);
            if let Ok((Topic::Telemetry(robot), Received::Telemetry { earlier, overtaken })) =
                &received
                && let Some(newest) = newest(&fleet, robot, overtaken.as_deref())
            {
                self.follow(earlier, newest, now);
            }
            received
        };
        if let Ok((topic, _)) = received {
            self.note(&topic, now);
        }
    }

    /// Hands samples of a message to the twins, who take them from there. Those that waited in the robot for the newest
    /// one have not been on their way for so long.
    fn follow(&self, earlier: &[Telemetry], newest: &Telemetry, now: Instant) {
        for sample in earlier.iter().chain([newest]) {
            let waited = Duration::from_millis(age(sample, newest) as u64);
            let arrived = now.checked_sub(waited).unwrap_or(now);
            if self.twins.telemetry(sample, arrived).is_err() {
                self.metrics.dropped(Dropped::TwinsFull);
            }
        }
    }

    /// Tells the commands which robots are there: some wait for theirs.
    fn note(&self, topic: &Topic, now: Instant) {
        match topic {
            Topic::Status(robot) => {
                let told = {
                    let fleet = self.fleet.lock();
                    let status = fleet.get(robot).and_then(|known| known.status.as_ref());
                    status.map(|status| (status.online, status.boot.count))
                };
                if let Some((online, boot)) = told {
                    self.commands.status(robot, online, boot, now);
                }
            }
            Topic::Heartbeat(robot) => self.commands.heard(robot, now),
            _ => {}
        }
    }
}

impl Receiver for Ingest {
    fn message(&self, message: &Incoming<'_>) {
        let now = Instant::now();
        let (received, known, crossings, unknown) = {
            let mut fleet = self.fleet.lock();
            let received = fleet.receive(message, now);
            let crossings = fleet.take_crossings();
            // A retained one is of long ago.
            if let Ok((Topic::Telemetry(robot), Received::Telemetry { earlier, overtaken })) =
                &received
                && !message.retained
                && let Some(newest) = newest(&fleet, robot, overtaken.as_deref())
            {
                self.follow(earlier, newest, now);
                let now = clock::now_ms();
                for telemetry in earlier.iter().chain([newest]) {
                    let sample = Sample::of(telemetry, now - age(telemetry, newest));
                    if self.history.push(sample).is_err() {
                        self.metrics.dropped(Dropped::HistoryFull);
                    }
                }
            }
            let known = match &received {
                Ok((_, Received::Response(response))) => fleet.get(&response.robot).is_some(),
                _ => false,
            };
            (received, known, crossings, fleet.last_unknown())
        };
        // What another server has heard is its own to count, and to act upon.
        for crossing in &crossings {
            if !crossing.back {
                let fence = &crossing.fence;
                let (kind, action) = (fence.kind.name(), fence.action.name());
                self.metrics.fence_crossing(kind, action);
            }
            self.stops.note(crossing);
        }
        match received {
            Ok((topic, received)) => {
                self.metrics.message_in(&topic);
                self.metrics.unknown(&topic, unknown);
                if let Some(membership) = &self.membership
                    && is_shared(&topic)
                {
                    membership.queue.push(OutgoingMessage {
                        topic: message.topic,
                        payload: message.payload,
                        retained: message.retained,
                        content_type: message.content_type,
                        properties: message.properties,
                    });
                }
                // A robot subscribes before it tells its status, so the time will reach it.
                if matches!(topic, Topic::Status(_)) && !message.retained {
                    self.time_wanted.store(true, Ordering::Relaxed);
                }
                self.note(&topic, now);
                match received {
                    Received::Response(response) => {
                        self.maps.answer(&response);
                        self.calibrations.answer(&response);
                        if let Some(over) = self.commands.answer(&response, known, now) {
                            self.outcomes.tell(&over);
                        }
                    }
                    Received::Map(segment) => self.maps.segment(&segment),
                    Received::Fix(fix) => {
                        if self.twins.fix(&fix, now).is_err() {
                            self.metrics.dropped(Dropped::TwinsFull);
                        }
                    }
                    Received::Noted | Received::Telemetry { .. } => {}
                }
            }
            Err(rejection) => self.metrics.message_rejected(rejection.name()),
        }
    }

    fn connection(&self, up: bool, text: &str) {
        self.commands.connection(up, Instant::now());
        let level = if up { Level::Info } else { Level::Error };
        let text = if up {
            text.to_owned()
        } else {
            format!("lost the broker: {text}")
        };
        self.fleet.lock().events.push(level, None, text);
    }
}

/// The newest sample of a message that was taken in.
fn newest<'a>(
    fleet: &'a FleetState,
    robot: &RobotId,
    overtaken: Option<&'a Telemetry>,
) -> Option<&'a Telemetry> {
    overtaken.or_else(|| fleet.get(robot)?.telemetry.as_ref())
}

/// How many milliseconds a sample is older than the newest one of its message. The clock of a robot may
/// be wrong, or set in between; what passes on it is good for so short a time.
fn age(sample: &Telemetry, newest: &Telemetry) -> i64 {
    let age = newest.timestamp.saturating_sub(sample.timestamp);
    age.min(OLDEST) as i64
}

/// Whether a message goes to one server alone, which tells the others: what robots say all the time.
/// What everybody has to hear for itself is delivered to everybody.
const fn is_shared(topic: &Topic) -> bool {
    matches!(
        topic,
        Topic::Telemetry(_)
            | Topic::Heartbeat(_)
            | Topic::Vision(_)
            | Topic::Logs(_)
            | Topic::Image(_)
    )
}
