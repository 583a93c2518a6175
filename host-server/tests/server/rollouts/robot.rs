//! Robots that take updates, made of MQTT clients: they speak the protocol and nothing else.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use crawler_protocol::{ReleaseId, UpdateCommand};
use crawler_release::chunk::{Chunk, PAYLOAD, Part};
use crawler_release::{Want, image_hash};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{LastWill, Packet, Publish};
use rumqttc::v5::{AsyncClient, Event, EventLoop};
use serde_json::{Value, json};
use tokio_util::task::AbortOnDropHandle;

use crate::support::mqtt_options;

/// Before a robot asks again for what has not come.
const AGAIN: Duration = Duration::from_millis(700);
const BEAT: Duration = Duration::from_secs(1);

/// What becomes of a robot that starts the new program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Program {
    /// It runs.
    Good,
    /// It panics, and the robot goes back; a model is too slow.
    Panics,
    /// It runs, on a robot that does not see.
    Blind,
}

/// What the release is that robots are to take.
#[derive(Debug, Clone)]
pub(super) struct Release {
    pub(super) id: String,
    pub(super) build: String,
    /// The model that it brings; a program without one.
    pub(super) model: Option<&'static str>,
    pub(super) image: Arc<Vec<u8>>,
}

/// A robot, until it is dropped.
pub(super) struct Robot {
    /// Chunks that it has got.
    pub(super) chunks: Arc<AtomicU32>,
    /// Chunks that it has asked for, counted each time.
    pub(super) asked: Arc<AtomicU32>,
    /// Once it has got so many it asks for no more, and waits.
    pub(super) enough: Arc<AtomicU32>,
    _task: AbortOnDropHandle<()>,
}

impl Robot {
    /// A robot at the broker of that port, which loses every `loss`th chunk, if any.
    pub(super) fn start(
        port: u16,
        id: &str,
        release: Release,
        program: Program,
        loss: u32,
    ) -> Self {
        let chunks = Arc::new(AtomicU32::new(0));
        let asked = Arc::new(AtomicU32::new(0));
        let enough = Arc::new(AtomicU32::new(u32::MAX));
        let body = Body {
            id: id.to_owned(),
            port,
            release,
            program,
            loss,
            chunks: Arc::clone(&chunks),
            asked: Arc::clone(&asked),
            enough: Arc::clone(&enough),
            build: "old".to_owned(),
            model: None,
            boot: 1,
            transfer: None,
            trial: false,
        };
        Self {
            chunks,
            asked,
            enough,
            _task: AbortOnDropHandle::new(tokio::spawn(body.live())),
        }
    }
}

struct Transfer {
    want: Want,
    count: u32,
    image: Vec<u8>,
}

struct Body {
    id: String,
    port: u16,
    release: Release,
    program: Program,
    loss: u32,
    chunks: Arc<AtomicU32>,
    asked: Arc<AtomicU32>,
    enough: Arc<AtomicU32>,
    build: String,
    /// The build of the model that is in use, where that came as a release.
    model: Option<String>,
    boot: u32,
    transfer: Option<Transfer>,
    trial: bool,
}

impl Body {
    /// Connects, and connects again, for good.
    async fn live(mut self) {
        loop {
            let mut options = mqtt_options(&self.id, self.port);
            options.set_clean_start(true);
            let gone = json!({"robot": self.id, "online": false, "kind": "simulated",
                "firmware": "0.4.0", "build": self.build, "board": "virt", "capabilities": ["drive"],
                "boot": {"count": self.boot, "cause": "power-on"}, "protocol": 1});
            let topic = format!("swarm/status/{}", self.id);
            options.set_last_will(LastWill::new(
                topic,
                gone.to_string(),
                QoS::AtLeastOnce,
                true,
                None,
            ));
            let (client, events) = AsyncClient::new(options, 1_000);
            self.session(client, events).await;
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
    }

    async fn session(&mut self, client: AsyncClient, mut events: EventLoop) {
        let mut beat = tokio::time::interval(BEAT);
        let mut again = tokio::time::interval(AGAIN);
        let topic = format!("swarm/ota/{}", self.id);
        let mut up = false;
        let mut quiet = true;
        loop {
            tokio::select! {
                event = events.poll() => match event {
                    Ok(Event::Incoming(Packet::ConnAck(_))) => {
                        let _ = client.try_subscribe(&topic, QoS::AtLeastOnce);
                    }
                    Ok(Event::Incoming(Packet::SubAck(_))) => {
                        up = true;
                        self.introduce(&client);
                        self.say(&client, &json!({"update": "have", "robot": self.id,
                            "build": self.build, "sequence": 1, "floor": 0}));
                        if self.trial {
                            self.progress(&client, "trial");
                        }
                    }
                    Ok(Event::Incoming(Packet::Publish(publish))) => {
                        quiet = false;
                        self.message(&client, &publish);
                    }
                    Ok(_) => {}
                    Err(_) => return,
                },
                _ = beat.tick(), if up => self.beat(&client),
                _ = again.tick(), if up => {
                    if std::mem::replace(&mut quiet, true) {
                        self.ask(&client);
                    }
                }
            }
        }
    }

    fn say(&self, client: &AsyncClient, message: &Value) {
        let topic = format!("swarm/ota/{}", self.id);
        let _ = client.try_publish(topic, QoS::AtLeastOnce, false, message.to_string());
    }

    /// What it says of itself in a report about its release: the build of the program, or of the model.
    fn tells(&self) -> Option<&str> {
        match self.release.model {
            Some(_) => self.model.as_deref(),
            None => Some(&self.build),
        }
    }

    /// Whether it runs what its release brings.
    fn has_it(&self) -> bool {
        self.tells() == Some(&self.release.build)
    }

    fn introduce(&self, client: &AsyncClient) {
        let capabilities: &[_] = match self.program {
            Program::Blind => &["drive"],
            Program::Good | Program::Panics => &["drive", "camera", "vision", "policies"],
        };
        let mut status = json!({"robot": self.id, "online": true, "kind": "simulated",
            "firmware": "0.4.0", "build": self.build, "board": "virt", "capabilities": capabilities,
            "boot": {"count": self.boot, "cause": "power-on"}, "protocol": 1});
        if let (Some(name), Some(build)) = (self.release.model, &self.model) {
            status["models"] = json!({ name: build });
        }
        let topic = format!("swarm/status/{}", self.id);
        let _ = client.try_publish(topic, QoS::AtLeastOnce, true, status.to_string());
        self.beat(client);
    }

    fn beat(&self, client: &AsyncClient) {
        let topic = format!("swarm/heartbeat/{}", self.id);
        let beat =
            json!({"robot": self.id, "seq": 1, "timestamp": 5, "uptime_ms": 5, "state": "IDLE"});
        let _ = client.try_publish(topic, QoS::AtMostOnce, false, beat.to_string());
    }

    fn progress(&self, client: &AsyncClient, state: &str) {
        let got = self.transfer.as_ref().map_or(0, |one| one.image.len());
        let bytes = if self.trial {
            self.release.image.len()
        } else {
            got
        };
        self.say(
            client,
            &json!({"update": "progress", "robot": self.id, "release": self.release.id,
            "state": state, "reason": null, "bytes": bytes, "build": self.tells()}),
        );
    }

    fn outcome(&self, client: &AsyncClient, outcome: &str, reason: Option<&str>) {
        self.say(
            client,
            &json!({"update": "outcome", "robot": self.id, "release": self.release.id,
            "outcome": outcome, "reason": reason, "build": self.tells()}),
        );
    }

    fn ask(&self, client: &AsyncClient) {
        let Some(Transfer { want, .. }) = &self.transfer else {
            return;
        };
        if self.chunks.load(Ordering::Relaxed) >= self.enough.load(Ordering::Relaxed) {
            return;
        }
        self.asked.fetch_add(want.outstanding(), Ordering::Relaxed);
        self.say(
            client,
            &json!({"update": "want", "robot": self.id, "tag": want.tag,
            "part": want.part.name(), "first": want.first, "missing": want.missing}),
        );
    }

    fn message(&mut self, client: &AsyncClient, publish: &Publish) {
        if publish.payload.first() == Some(&1) {
            let chunk = Chunk::decode(&publish.payload).expect("a chunk");
            return self.chunk(client, chunk);
        }
        let Some(command) = UpdateCommand::from_json(&publish.payload).expect("a message") else {
            // Its own.
            return;
        };
        let release: ReleaseId = self.release.id.parse().expect("an id");
        if command.release() != release {
            // It takes one, and nothing else.
            return;
        }
        match command {
            UpdateCommand::Offer { .. } => {
                self.say(
                    client,
                    &json!({"update": "have", "robot": self.id, "build": self.build,
                    "sequence": 1, "floor": 0}),
                );
                if self.transfer.is_some() || self.trial || self.has_it() {
                    return;
                }
                self.transfer = Some(Transfer {
                    want: Want::window(release.tag(), Part::Manifest, 0, 1),
                    count: 1,
                    image: Vec::new(),
                });
                self.ask(client);
            }
            UpdateCommand::Confirm { .. } if self.has_it() => {
                self.trial = false;
                self.outcome(client, "confirmed", None);
            }
            UpdateCommand::Confirm { .. } => {}
            UpdateCommand::Cancel { .. } => {
                self.transfer = None;
                self.outcome(client, "withdrawn", None);
            }
        }
    }

    fn chunk(&mut self, client: &AsyncClient, chunk: Chunk<'_>) {
        let seen = self.chunks.fetch_add(1, Ordering::Relaxed) + 1;
        if self.loss > 0 && seen.is_multiple_of(self.loss) {
            return;
        }
        let Some(transfer) = &mut self.transfer else {
            return;
        };
        if !transfer.want.take(chunk.tag, chunk.part, chunk.index) {
            return;
        }
        if chunk.part == Part::Manifest {
            let whole = crawler_release::Signed::parse(chunk.payload).expect("an envelope");
            let manifest = whole.unverified().expect("a manifest");
            assert_eq!(manifest.size as usize, self.release.image.len());
            transfer.count = manifest.size.div_ceil(PAYLOAD as u32);
            transfer.image = Vec::new();
            transfer.want = Want::window(chunk.tag, Part::Image, 0, transfer.count);
            self.progress(client, "preparing");
            self.progress(client, "receiving");
            return self.ask(client);
        }
        let at = chunk.index as usize * PAYLOAD;
        if transfer.image.len() < at + chunk.payload.len() {
            transfer.image.resize(at + chunk.payload.len(), 0);
        }
        transfer.image[at..at + chunk.payload.len()].copy_from_slice(chunk.payload);
        if transfer.want.outstanding() > 0 {
            return;
        }
        let next = transfer.want.first + 16;
        transfer.want = Want::window(chunk.tag, Part::Image, next, transfer.count);
        if transfer.want.outstanding() > 0 {
            self.progress(client, "receiving");
            return self.ask(client);
        }
        let image = &transfer.image;
        assert_eq!(
            image_hash(image),
            image_hash(&self.release.image),
            "{}",
            self.id
        );
        self.progress(client, "verifying");
        self.progress(client, "staged");
        self.restart(client);
    }

    /// Starts the new program, and the old one again where that is no good; a model without a restart.
    fn restart(&mut self, client: &AsyncClient) {
        self.transfer = None;
        if self.release.model.is_some() {
            if self.program == Program::Panics {
                return self.outcome(client, "rolled_back", Some("too_slow"));
            }
            self.model = Some(self.release.build.clone());
            self.trial = true;
            self.introduce(client);
            return self.progress(client, "trial");
        }
        self.boot += 1;
        if self.program == Program::Panics {
            self.boot += 1;
            self.introduce(client);
            return self.outcome(client, "rolled_back", Some("panic"));
        }
        self.build.clone_from(&self.release.build);
        self.trial = true;
        self.introduce(client);
        self.progress(client, "trial");
    }
}
