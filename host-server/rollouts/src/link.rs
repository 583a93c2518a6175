//! The session with the broker over which robots are updated.
//!
//! There is one only while there are rollouts, so other servers of the fleet carry nothing of it. What comes under
//! `ota/+` is what robots say: with No Local (MQTT 5, 3.8.3.1) our own chunks do not come back, and what other
//! servers send is passed over. A lost session is replaced by an entirely new client, as that of commands is.

use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::{Fleet, ReleaseId, RobotId, Topic, TopicFilter};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet, Publish, SubscribeReasonCode};
use rumqttc::v5::{AsyncClient, Event, EventLoop, MqttOptions};
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use crate::Rollouts;
use crate::pulls::Pull;
use crate::report::{self, Said, Told};

/// Messages that wait for the connection: what a chunk, or an offer, waits behind at most.
const OUTGOING: usize = 64;
/// For connecting and subscribing.
const SETUP: Duration = Duration::from_secs(5);
/// A connection with nothing to tell for so long is stuck: pings are due more often.
const STUCK: Duration = Duration::from_secs(16);
const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

/// What the runner is told.
#[derive(Debug)]
pub(crate) enum Heard {
    /// The session stands; what was sent over an earlier one may be lost.
    Connected,
    /// A robot says something about a release.
    Report(RobotId, ReleaseId, Told),
}

/// Keeps a session while one is `wanted`, until `stop`.
pub(crate) async fn keep(
    rollouts: Arc<Rollouts>,
    options: MqttOptions,
    mut wanted: watch::Receiver<bool>,
    heard: mpsc::Sender<Heard>,
    stop: CancellationToken,
) {
    let mut pause = FIRST_PAUSE;
    loop {
        tokio::select! {
            () = stop.cancelled() => return,
            changed = wanted.wait_for(|wanted| *wanted) => if changed.is_err() {
                return;
            },
        }
        let connected = tokio::select! {
            () = stop.cancelled() => return,
            connected = tokio::time::timeout(SETUP, connect(&options, &rollouts.fleet)) => connected,
        };
        let reason = match connected {
            Ok(Ok((client, events))) => {
                pause = FIRST_PAUSE;
                rollouts.set_client(Some(client.clone()));
                rollouts.numbers.connected(true);
                // The runner takes what comes in whatever else it waits for, but while it stores something.
                let told = heard.send(Heard::Connected).await;
                let mut session = Session {
                    rollouts: &rollouts,
                    events,
                    heard: &heard,
                };
                let reason = tokio::select! {
                    () = stop.cancelled() => None,
                    _ = wanted.wait_for(|wanted| !*wanted) => None,
                    reason = session.serve(), if told.is_ok() => Some(reason),
                };
                rollouts.set_client(None);
                rollouts.numbers.connected(false);
                rollouts.pulls().clear();
                if reason.is_none() {
                    session.leave(&client).await;
                    continue;
                }
                reason.unwrap_or_default()
            }
            Ok(Err(reason)) => reason,
            Err(_) => "no answer in time".to_owned(),
        };
        tracing::warn!(
            reason,
            "robots cannot be updated for now: no session with the broker"
        );
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

async fn connect(options: &MqttOptions, fleet: &Fleet) -> Result<(AsyncClient, EventLoop), String> {
    let mut options = options.clone();
    let mut network = rumqttc::NetworkOptions::new();
    network.set_tcp_nodelay(true);
    options.set_network_options(network);
    let (client, mut events) = AsyncClient::new(options, OUTGOING);
    let topics = TopicFilter::Ota.render(fleet);
    let mut filter = Filter::new(topics.as_str(), QoS::AtLeastOnce);
    filter.nolocal = true;
    loop {
        match events.poll().await.map_err(|error| error.to_string())? {
            Event::Incoming(Packet::ConnAck(_)) => client
                .try_subscribe_many([filter.clone()])
                .map_err(|error| error.to_string())?,
            Event::Incoming(Packet::SubAck(ack)) => {
                let taken = |code| matches!(code, &SubscribeReasonCode::Success(_));
                if ack.return_codes.iter().all(taken) {
                    return Ok((client, events));
                }
                return Err("the broker refuses our subscription".to_owned());
            }
            // What comes before that is said again.
            _ => {}
        }
    }
}

struct Session<'a> {
    rollouts: &'a Rollouts,
    events: EventLoop,
    heard: &'a mpsc::Sender<Heard>,
}

impl Session<'_> {
    /// Serves the connection to its end and says why it ended.
    async fn serve(&mut self) -> String {
        loop {
            match tokio::time::timeout(STUCK, self.events.poll()).await {
                Ok(Ok(Event::Incoming(Packet::Publish(publish)))) => self.message(&publish),
                Ok(Ok(Event::Incoming(Packet::Disconnect(packet)))) => {
                    return format!("the broker ended the session: {:?}", packet.reason_code);
                }
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return error.to_string(),
                Err(_) => return "the connection is stuck".to_owned(),
            }
        }
    }

    /// Has what was handed over go out, and says goodbye.
    async fn leave(mut self, client: &AsyncClient) {
        let farewell = async {
            if client.try_disconnect().is_ok() {
                while let Ok(event) = self.events.poll().await {
                    if event == Event::Outgoing(rumqttc::Outgoing::Disconnect) {
                        break;
                    }
                }
            }
        };
        let _ = tokio::time::timeout(Duration::from_secs(1), farewell).await;
    }

    fn message(&self, publish: &Publish) {
        let topic = std::str::from_utf8(&publish.topic);
        let topic = topic
            .ok()
            .map(|text| Topic::parse(&self.rollouts.fleet, text));
        let Some(Ok(Topic::Ota(robot))) = topic else {
            return;
        };
        self.rollouts.numbers.heard();
        let taken = match report::read(&robot, &publish.payload) {
            None => false,
            Some(Said::Have) => true,
            Some(Said::Want(want)) => {
                let pull = self.rollouts.active().source(&robot, want.tag);
                pull.is_some_and(|(rollout, release)| {
                    let pull = Pull {
                        rollout,
                        release,
                        tag: want.tag,
                        part: want.part,
                        first: want.first,
                        missing: want.missing,
                    };
                    let now_ms = self.rollouts.now().monotonic_ms;
                    let taken = self.rollouts.pulls().want(&robot, pull, now_ms);
                    self.rollouts.pulled.notify_one();
                    taken
                })
            }
            Some(Said::Report(release, told)) => {
                let report = Heard::Report(robot, release, told);
                self.heard.try_send(report).is_ok()
            }
        };
        if !taken {
            self.rollouts.numbers.ignored();
        }
    }
}
