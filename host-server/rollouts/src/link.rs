//! The session with the broker over which robots are updated.
//!
//! There is one only while there are rollouts, so other servers of the fleet carry nothing of it. What comes under
//! `ota/+` is what robots say: with No Local (MQTT 5, 3.8.3.1) our own chunks do not come back, and what other
//! servers send is passed over. A lost session is replaced by an entirely new client, as that of commands is.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::{Fleet, ReleaseId, RobotId, Topic, TopicFilter};
use crawler_release::chunk::Part;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Filter, Packet, Publish, SubscribeReasonCode};
use rumqttc::v5::{AsyncClient, ClientError, ConnectionError, Event, EventLoop, MqttOptions};
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
    /// A robot asks for a patch of the release of that tag, and was offered none here.
    NoPatch(RobotId, u32),
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
                let mut session = Session {
                    rollouts: &rollouts,
                    events,
                    heard: &heard,
                };
                let reason = tokio::select! {
                    biased;
                    () = stop.cancelled() => None,
                    _ = wanted.wait_for(|wanted| !*wanted) => None,
                    reason = session.serve() => Some(reason),
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
            Ok(Err(error)) => error.to_string(),
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

/// Why there is no session with the broker.
enum SessionError {
    /// The broker cannot be reached, or lets nobody in.
    Connection(Box<ConnectionError>),
    /// The client takes no requests.
    Client(Box<ClientError>),
    /// The broker refuses what we subscribe to.
    Subscription,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Connection(error) => error.fmt(f),
            Self::Client(error) => error.fmt(f),
            Self::Subscription => f.write_str("the broker refuses our subscription"),
        }
    }
}

async fn connect(
    options: &MqttOptions,
    fleet: &Fleet,
) -> Result<(AsyncClient, EventLoop), SessionError> {
    let lost = |error| SessionError::Connection(Box::new(error));
    let refused = |error| SessionError::Client(Box::new(error));
    let mut options = options.clone();
    let mut network = rumqttc::NetworkOptions::new();
    network.set_tcp_nodelay(true);
    options.set_network_options(network);
    let (client, mut events) = AsyncClient::new(options, OUTGOING);
    let topics = TopicFilter::Ota.render(fleet);
    let mut filter = Filter::new(topics.as_str(), QoS::AtLeastOnce);
    filter.nolocal = true;
    loop {
        match events.poll().await.map_err(lost)? {
            Event::Incoming(Packet::ConnAck(_)) => client
                .try_subscribe_many([filter.clone()])
                .map_err(refused)?,
            Event::Incoming(Packet::SubAck(ack)) => {
                let taken = |code| matches!(code, &SubscribeReasonCode::Success(_));
                if ack.return_codes.iter().all(taken) {
                    return Ok((client, events));
                }
                return Err(SessionError::Subscription);
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
    /// Tells that the session stands, serves it to its end, and says why it ended.
    async fn serve(&mut self) -> String {
        // The runner takes what comes in whatever else it waits for, but while it stores something.
        if self.heard.send(Heard::Connected).await.is_err() {
            return "nobody carries rollouts out any more".to_owned();
        }
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

    /// Sees to what it means that a robot asks for a part.
    fn note_part(&self, robot: &RobotId, part: Part, tag: u32) {
        let mut patches = self.rollouts.patches();
        match part {
            Part::Image if patches.give_up(robot, tag) => self.rollouts.numbers.gave_patch_up(),
            Part::Delta if !patches.has(robot, tag) => {
                // A server that is gone has offered it. The robot asks again, and if it is in vain for the image.
                let _ = self.heard.try_send(Heard::NoPatch(robot.clone(), tag));
            }
            Part::Manifest | Part::Image | Part::Delta => {}
        }
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
                self.note_part(&robot, want.part, want.tag);
                let pull = self.rollouts.active().source(&robot, want.tag);
                pull.is_some_and(|(rollout, release)| {
                    let pull = Pull {
                        rollout,
                        release,
                        want,
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

#[cfg(test)]
mod tests {
    use std::io::{Read, Write};
    use std::net::TcpListener;

    use crawler_records::Records;
    use tokio::time::timeout;

    use super::*;
    use crate::robots::{RobotView, Robots};
    use crate::{Parts, Rollouts};

    /// A wait that is in vain ends then.
    const LIMIT: Duration = Duration::from_mins(1);

    struct Nobody;

    impl Robots for Nobody {
        fn each(&self, _: &mut dyn FnMut(RobotView<'_>)) {}
    }

    /// A broker that takes one session with one subscription (MQTT 5, 3.2 and 3.9), and says nothing more. It ends
    /// with the session.
    fn broker(listener: &TcpListener) -> std::io::Result<()> {
        let (mut stream, _) = listener.accept()?;
        // First byte, remaining length, and the rest; none here has 128 bytes or more.
        let mut packet = || {
            let mut head = [0; 2];
            stream.read_exact(&mut head)?;
            let mut rest = vec![0; head[1].into()];
            stream.read_exact(&mut rest)?;
            let answer = match head[0] >> 4 {
                1 => vec![0x20, 3, 0, 0, 0],
                8 => vec![0x90, 4, rest[0], rest[1], 0, 1],
                _ => Vec::new(),
            };
            stream.write_all(&answer)
        };
        while packet().is_ok() {}
        Ok(())
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_session_ends_on_stop_whatever_the_runner_does() {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let broker = std::thread::spawn(move || broker(&listener));
        let options = MqttOptions::new("updates", "127.0.0.1", port);
        let parts = Parts {
            records: Records::in_memory().await.expect("records"),
            server: "one".to_owned(),
            fleet: "swarm".parse().expect("a fleet"),
            robots: Arc::new(Nobody),
            session: options.clone(),
            lease: crate::LEASE,
            gates: crate::GateDemand::default(),
            tell: Box::new(|_, _, _| {}),
        };
        let (rollouts, _runner) = Rollouts::new(parts).expect("a name");
        let (_wanted, watch) = watch::channel(true);
        // The runner is not there to take anything: it waits for the session to end.
        let (tell, mut heard) = mpsc::channel(1);
        tell.try_send(Heard::Connected).expect("there is room");
        let stop = CancellationToken::new();
        let session = keep(Arc::clone(&rollouts), options, watch, tell, stop.clone());
        let session = tokio::spawn(session);
        let connected = async {
            while rollouts.client().is_none() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        timeout(LIMIT, connected).await.expect("a session");
        stop.cancel();
        let ended = timeout(LIMIT, session).await;
        ended.expect("it ends").expect("in order");
        assert!(heard.try_recv().is_ok());
        assert!(rollouts.client().is_none());
        broker.join().expect("a broker").expect("a session");
    }
}
