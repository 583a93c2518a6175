//! What a server does about updates, without one: it offers, and answers what robots ask for.

use crawler_bundle::Bundle;
use crawler_hal::{Duration, Instant};
use crawler_protocol::ReleaseId;
use crawler_release::chunk::{CHUNK_MAX, Chunk, PAYLOAD, Part};
use crawler_release::{PublicKeys, Requires, Signed, Want};
use crawler_updates::release::{SecretKey, SignOptions};
use serde_json::{Value, json};

use crate::run::Simulation;

/// Where both sides speak.
const TOPIC: &str = "swarm/ota/sim-0001";
/// Where the robot says who it is.
const STATUS: &str = "swarm/status/sim-0001";
/// Where the robot answers commands.
const RESPONSE: &str = "swarm/response/robot/sim-0001";
/// How long the server takes to answer.
const TURN: Duration = Duration::from_millis(20);
/// How long a robot may be silent before it is offered the release again.
const OFFER_AGAIN: Duration = Duration::from_secs(60);
/// What a robot says that it has is an answer to an offer that is not older than this.
const ANSWERED: Duration = Duration::from_secs(2);
/// Bytes around a message in the stream: fixed header of MQTT with a length of two bytes, the topic with its own
/// length, no properties.
const AROUND: usize = 3 + 2 + TOPIC.len() + 1;
/// What a segment of TCP carries at most over Ethernet.
const SEGMENT: usize = 1_460;
/// Bytes around a segment, without options; also a whole acknowledgement, of which every second segment has one.
const SEGMENT_AROUND: usize = 20 + 20;

/// A release as the server has it.
#[derive(Clone)]
pub(crate) struct Release {
    envelope: Vec<u8>,
    image: Vec<u8>,
    /// What makes it out of the program of a build.
    patch: Option<(String, Vec<u8>)>,
}

/// A key for all releases of a test.
pub(crate) struct Signer(SecretKey);

impl Signer {
    pub(crate) fn new() -> Self {
        Self(SecretKey::generate().expect("random numbers"))
    }

    pub(crate) fn keys(&self) -> PublicKeys {
        PublicKeys {
            current: self.0.public(),
            next: None,
        }
    }

    /// A release of a bundle of so many bytes.
    pub(crate) fn release(&self, bundle: &Bundle, sequence: u32, size: u32) -> Release {
        let image = bundle.image(size, 0).expect("a bundle");
        let options = SignOptions {
            kind: crawler_release::Kind::Program,
            name: None,
            board: "sim",
            chip: None,
            version: &bundle.version,
            build: Some(&bundle.build),
            sequence,
            floor: 0,
            expires: None,
            requires: Requires::default(),
        };
        let envelope = options.sign(&image, &self.0).expect("a release");
        Release {
            envelope,
            image,
            patch: None,
        }
    }

    /// A release of a model.
    pub(crate) fn model(&self, name: &str, blob: &[u8], sequence: u32, floor: u32) -> Release {
        self.sign(
            crawler_release::Kind::Model,
            "sim",
            (name, blob),
            sequence,
            floor,
        )
    }

    /// A release of a policy.
    pub(crate) fn policy(&self, name: &str, blob: &[u8], sequence: u32, floor: u32) -> Release {
        self.sign(
            crawler_release::Kind::Policy,
            "sim",
            (name, blob),
            sequence,
            floor,
        )
    }

    /// A release of a policy for another board.
    pub(crate) fn policy_for(
        &self,
        board: &str,
        name: &str,
        blob: &[u8],
        sequence: u32,
    ) -> Release {
        self.sign(
            crawler_release::Kind::Policy,
            board,
            (name, blob),
            sequence,
            0,
        )
    }

    fn sign(
        &self,
        kind: crawler_release::Kind,
        board: &str,
        (name, blob): (&str, &[u8]),
        sequence: u32,
        floor: u32,
    ) -> Release {
        let options = SignOptions {
            kind,
            name: Some(name),
            board,
            chip: None,
            version: "1",
            build: None,
            sequence,
            floor,
            expires: None,
            requires: Requires::default(),
        };
        let envelope = options.sign(blob, &self.0).expect("a release");
        Release {
            envelope,
            image: blob.to_vec(),
            patch: None,
        }
    }
}

impl Release {
    /// The same with what makes it out of `base`, which robots know as that build.
    pub(crate) fn after(mut self, base: &Self, build: &str) -> Self {
        let patch = crawler_updates::delta::make(&base.image, &self.image);
        self.patch = Some((build.to_owned(), patch));
        self
    }

    /// Bytes of what makes it out of another.
    pub(crate) fn patch_bytes(&self) -> usize {
        self.part(Part::Delta).len()
    }

    /// The same with another signature.
    pub(crate) fn forged(mut self) -> Self {
        // Behind the key's id.
        self.envelope[4 + 8 + 5] ^= 1;
        self
    }

    /// What names its contents.
    pub(crate) fn build(&self) -> String {
        let signed = Signed::parse(&self.envelope).expect("signed");
        let manifest = signed.unverified().expect("a manifest");
        manifest.build.to_owned()
    }

    /// As messages name it.
    pub(crate) fn id(&self) -> ReleaseId {
        ReleaseId::new(Signed::parse(&self.envelope).expect("signed").id())
    }

    fn part(&self, part: Part) -> &[u8] {
        match part {
            Part::Manifest => &self.envelope,
            Part::Image => &self.image,
            Part::Delta => self.patch.as_ref().map_or(&[], |(_, patch)| patch),
        }
    }
}

/// The server of one robot, `sim-0001`.
pub(crate) struct Server {
    release: Release,
    /// Of how many chunks one is lost, counted; 0 for none.
    lose_every: u32,
    sent: u32,
    /// Of these so many of the image.
    pub(crate) of_image: u32,
    /// The models that the robot told of last.
    pub(crate) models: Option<Value>,
    /// The models that its last wills told of.
    pub(crate) wills: Vec<Value>,
    /// What it told last that it can do.
    pub(crate) capabilities: Option<Value>,
    /// What it has answered to commands.
    pub(crate) answers: Vec<Value>,
    /// What the robot has said about updates.
    pub(crate) heard: Vec<Value>,
    /// Bytes of MQTT in both directions, as far as they belong to updates.
    pub(crate) stream: usize,
    /// The same with what TCP and IP put around them.
    pub(crate) wire: usize,
    /// When the robot said something, or was offered the release.
    heard_at: Instant,
    offered_at: Option<Instant>,
}

impl Server {
    pub(crate) fn new(release: Release) -> Self {
        Self {
            release,
            lose_every: 0,
            sent: 0,
            of_image: 0,
            models: None,
            wills: Vec::new(),
            capabilities: None,
            answers: Vec::new(),
            heard: Vec::new(),
            stream: 0,
            wire: 0,
            heard_at: Instant::BOOT,
            offered_at: None,
        }
    }

    pub(crate) fn losing_every(self, lose_every: u32) -> Self {
        Self { lose_every, ..self }
    }

    pub(crate) fn payload(&self) -> usize {
        self.release.image.len()
    }

    /// Offers the release.
    pub(crate) fn offer(&mut self, simulation: &mut Simulation) {
        let mut offer = json!({"update": "offer", "release": self.release.id()});
        if let Some((base, patch)) = &self.release.patch {
            offer["delta"] = json!({"base": base, "bytes": patch.len()});
        }
        self.heard_at = simulation.now();
        self.offered_at = Some(simulation.now());
        self.count([offer.to_string().len()]);
        simulation.publish(TOPIC, offer.to_string().as_bytes(), true, false);
    }

    /// Counts messages that go one way at once.
    fn count(&mut self, payloads: impl IntoIterator<Item = usize>) {
        let stream: usize = payloads.into_iter().map(|length| AROUND + length).sum();
        let segments = stream.div_ceil(SEGMENT);
        let acknowledgements = segments.div_ceil(2);
        self.stream += stream;
        self.wire += stream + (segments + acknowledgements) * SEGMENT_AROUND;
    }

    /// Lets a turn pass, and answers what was asked for in it.
    pub(crate) fn turn(&mut self, simulation: &mut Simulation) {
        simulation.run_for(TURN);
        let network = simulation.network().expect("lockstep");
        for published in network.take_record() {
            if published.topic == STATUS {
                let status: Value = serde_json::from_slice(&published.payload).expect("JSON");
                self.models = Some(status["models"].clone());
                self.capabilities = Some(status["capabilities"].clone());
                if status["online"] == false {
                    self.wills.push(status["models"].clone());
                }
            }
            if published.topic == RESPONSE {
                let answer = serde_json::from_slice(&published.payload);
                self.answers.push(answer.expect("JSON"));
            }
            if published.topic != TOPIC || published.payload.first() != Some(&b'{') {
                continue;
            }
            self.count([published.payload.len()]);
            self.heard_at = simulation.now();
            let said: Value = serde_json::from_slice(&published.payload).expect("JSON");
            if said["update"] == "want" {
                self.answer(simulation, &said);
            } else {
                self.heard.push(said);
            }
        }
    }

    fn answer(&mut self, simulation: &mut Simulation, said: &Value) {
        let number =
            |key: &str| u32::try_from(said[key].as_u64().expect("a number")).expect("small");
        let part = Part::ALL
            .into_iter()
            .find(|part| said["part"] == part.name());
        let want = Want {
            tag: number("tag"),
            part: part.expect("a part"),
            first: number("first"),
            missing: u16::try_from(number("missing")).expect("a window"),
        };
        assert_eq!(want.tag, self.release.id().tag());
        let mut lengths = Vec::new();
        for index in want.indices() {
            let from = index as usize * PAYLOAD;
            let bytes = self.release.part(want.part);
            let Some(payload) = bytes.get(from..bytes.len().min(from + PAYLOAD)) else {
                continue;
            };
            let chunk = Chunk {
                part: want.part,
                tag: want.tag,
                index,
                payload,
            };
            let mut buffer = [0; CHUNK_MAX];
            let length = chunk.encode(&mut buffer).expect("a chunk");
            lengths.push(length);
            self.sent += 1;
            self.of_image += u32::from(want.part == Part::Image);
            // One that is lost was on its way too.
            if self.lose_every == 0 || !self.sent.is_multiple_of(self.lose_every) {
                simulation.publish(TOPIC, &buffer[..length], false, false);
            }
        }
        self.count(lengths);
    }

    /// The outcome that the robot told last, with its reason.
    pub(crate) fn outcome(&self) -> Option<(String, Option<String>)> {
        let mut outcomes = self.heard.iter().rev();
        let last = outcomes.find(|said| said["update"] == "outcome")?;
        assert_eq!(last["release"], self.release.id().text().as_str());
        let text = |key: &str| last[key].as_str().map(str::to_owned);
        Some((text("outcome")?, text("reason")))
    }

    /// Goes on until there is an outcome, and offers the release again whenever the robot is silent. Panics
    /// when that takes longer than `limit`.
    #[track_caller]
    pub(crate) fn until_outcome(
        &mut self,
        simulation: &mut Simulation,
        limit: Duration,
    ) -> (String, Option<String>) {
        self.until_outcome_with(simulation, limit, |_| ())
    }

    /// The same, and does something before each turn.
    #[track_caller]
    pub(crate) fn until_outcome_with(
        &mut self,
        simulation: &mut Simulation,
        limit: Duration,
        mut each: impl FnMut(&mut Simulation),
    ) -> (String, Option<String>) {
        let end = simulation.now() + limit;
        while simulation.now() < end {
            each(simulation);
            self.turn(simulation);
            if let Some(outcome) = self.outcome() {
                return outcome;
            }
            let now = simulation.now();
            let silent = now.saturating_since(self.heard_at) > OFFER_AGAIN;
            let greets = self
                .heard
                .last()
                .is_some_and(|said| said["update"] == "have");
            let answers = self
                .offered_at
                .is_some_and(|at| now.saturating_since(at) < ANSWERED);
            if silent || (greets && !answers) {
                self.offer(simulation);
            }
        }
        panic!("no outcome within {limit:?}: {:?}", self.heard.last());
    }
}
