//! The server's part in an update, played on a real broker: offers, and what the robot asks for.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crawler_image_format::header::Header;
use crawler_image_format::keys::KEY;
use crawler_image_format::pem;
use crawler_protocol::ReleaseId;
use crawler_release::chunk::{CHUNK_MAX, Chunk, PAYLOAD, Part};
use crawler_release::{Kind, Requires, Signed, Want};
use crawler_updates::release::{SecretKey, SignOptions};
use rumqttc::{Client, Connection, Event, MqttOptions, Packet, QoS};
use serde_json::{Value, json};

/// Messages that wait on their way to the broker: two windows.
const QUEUE: usize = 64;
/// Chunks of the image until the power is cut; so many that it never is.
const NEVER: u32 = u32::MAX;

/// How long a robot is silent before it is offered a release again.
const OFFER_AFTER: Duration = Duration::from_secs(3);
/// How long it is left alone at least between two offers.
const DEFERRED: Duration = Duration::from_millis(500);

/// A release as a server has it.
#[derive(Clone)]
pub(crate) struct Release {
    pub(crate) id: String,
    /// Build id of the program in it.
    pub(crate) build: String,
    pub(crate) image: Arc<[u8]>,
    envelope: Arc<[u8]>,
    tag: u32,
    /// What makes it out of the program of a build.
    patch: Option<(String, Arc<[u8]>)>,
}

impl Release {
    /// Signs `image` as a release for the emulated board. One that is no image goes by its length.
    pub(crate) fn sign(image: &[u8], sequence: u32, key: &SecretKey) -> Self {
        let header = image.first_chunk().and_then(Header::parse);
        let build = header.map_or_else(
            || format!("none-{}", image.len()),
            |header| header.build().escape_ascii().to_string(),
        );
        let options = SignOptions {
            kind: Kind::Program,
            name: None,
            board: "virt",
            chip: None,
            version: "0.0.1",
            build: Some(&build),
            sequence,
            floor: 0,
            expires: None,
            requires: Requires::default(),
        };
        let envelope = options.sign(image, key).expect("a release");
        let id = ReleaseId::new(Signed::parse(&envelope).expect("an envelope").id());
        Self {
            id: id.to_string(),
            build,
            image: image.into(),
            envelope: envelope.into(),
            tag: id.tag(),
            patch: None,
        }
    }

    /// The same with what makes it out of `base`.
    pub(crate) fn after(mut self, base: &Self) -> Self {
        let patch = crawler_updates::delta::make(&base.image, &self.image);
        self.patch = Some((base.build.clone(), patch.into()));
        self
    }

    /// The bytes of a part's chunk.
    fn piece(&self, part: Part, index: u32) -> Option<&[u8]> {
        let whole = match part {
            Part::Manifest => &self.envelope,
            Part::Image => &self.image,
            Part::Delta => &self.patch.as_ref()?.1,
        };
        let from = index as usize * PAYLOAD;
        let to = whole.len().min(from + PAYLOAD);
        whole.get(from..to).filter(|piece| !piece.is_empty())
    }
}

/// The point of the public half of `key`, as a program holds it.
pub(crate) fn point(key: &SecretKey) -> [u8; KEY] {
    let keys = pem::public_keys(&key.public_pem()).expect("a key in PEM");
    keys[0]
}

/// What reaches the test.
#[derive(Debug)]
pub(crate) enum News {
    /// A report of the robot, other than `want`.
    Report(Value),
    /// So many chunks as were asked for were sent: nothing more is, until they are counted anew.
    Sent,
}

/// A server with one release, and one robot.
pub(crate) struct UpdateServer {
    topic: String,
    client: Client,
    news: Receiver<News>,
    /// Chunks of the image that may still be sent.
    left: Arc<AtomicU32>,
    release: Arc<Mutex<Option<Release>>>,
    thread: Option<JoinHandle<()>>,
}

impl UpdateServer {
    pub(crate) fn start(robot: &str, port: u16) -> Self {
        let mut options = MqttOptions::new("updates", "127.0.0.1", port);
        options.set_max_packet_size(16 * 1024, 16 * 1024);
        let (client, connection) = Client::new(options, QUEUE);
        let topic = format!("swarm/ota/{robot}");
        let (to, news) = channel();
        let left = Arc::new(AtomicU32::new(NEVER));
        let release = Arc::new(Mutex::new(None));
        let serving = Serving {
            topic: topic.clone(),
            client: client.clone(),
            to,
            left: Arc::clone(&left),
            release: Arc::clone(&release),
        };
        let thread = thread::spawn(move || serving.run(connection));
        Self {
            topic,
            client,
            news,
            left,
            release,
            thread: Some(thread),
        }
    }

    /// Has this release handed out from now on, and `chunks` of its image at most.
    pub(crate) fn hand_out(&self, release: &Release, chunks: Option<u32>) {
        *self.release.lock().expect("not poisoned") = Some(release.clone());
        self.left.store(chunks.unwrap_or(NEVER), Ordering::SeqCst);
    }

    pub(crate) fn offer(&self, release: &Release) {
        let mut offer = json!({"update": "offer", "release": release.id});
        if let Some((base, patch)) = &release.patch {
            offer["delta"] = json!({"base": base, "bytes": patch.len()});
        }
        self.say(&offer);
    }

    fn say(&self, words: &Value) {
        let sent = self
            .client
            .publish(&self.topic, QoS::AtLeastOnce, false, words.to_string());
        sent.expect("the broker is there");
    }

    /// The next news before `until`.
    pub(crate) fn next(&self, until: Instant) -> Option<News> {
        let left = until.saturating_duration_since(Instant::now());
        self.news.recv_timeout(left).ok()
    }

    /// Offers `release` as a server does, until `done` makes something of the news: when the robot shows up, when
    /// it has put the update off, and when nothing is heard of it.
    pub(crate) fn pursue<T>(
        &self,
        what: &str,
        release: &Release,
        limit: Duration,
        mut done: impl FnMut(&News) -> Option<T>,
    ) -> T {
        let until = Instant::now() + limit;
        let mut heard = Vec::new();
        let mut offered = Instant::now();
        self.offer(release);
        while Instant::now() < until {
            let news = self.next(until.min(Instant::now() + OFFER_AFTER));
            let again = match &news {
                None => true,
                Some(News::Report(report)) if report["state"] == "deferred" => {
                    // It says why not, and not when it could.
                    thread::sleep(DEFERRED);
                    true
                }
                Some(News::Report(report)) => {
                    report["update"] == "have"
                        && report["build"] != release.build
                        && offered.elapsed() > DEFERRED
                }
                Some(News::Sent) => false,
            };
            if let Some(news) = news {
                if let Some(result) = done(&news) {
                    return result;
                }
                heard.push(news);
            }
            if again {
                offered = Instant::now();
                self.offer(release);
            }
        }
        panic!("{what}: not within {limit:?}; heard {heard:#?}");
    }
}

impl Drop for UpdateServer {
    fn drop(&mut self) {
        // Where the broker is gone the thread has ended by itself.
        let _ = self.client.disconnect();
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the connection does.
struct Serving {
    topic: String,
    client: Client,
    to: Sender<News>,
    left: Arc<AtomicU32>,
    release: Arc<Mutex<Option<Release>>>,
}

impl Serving {
    fn run(self, mut connection: Connection) {
        for event in connection.iter() {
            match event {
                Ok(Event::Incoming(Packet::ConnAck(_))) => {
                    let subscribed = self.client.try_subscribe(&self.topic, QoS::AtLeastOnce);
                    subscribed.expect("room in the queue");
                }
                Ok(Event::Incoming(Packet::Publish(message))) => self.hear(&message.payload),
                Ok(_) => {}
                Err(_) => return,
            }
        }
    }

    fn hear(&self, payload: &[u8]) {
        // Chunks and commands are our own.
        let Ok(report) = serde_json::from_slice::<Value>(payload) else {
            return;
        };
        match report["update"].as_str() {
            Some("want") => self.serve(&report),
            Some("have" | "progress" | "outcome") => {
                // The test may be over.
                let _ = self.to.send(News::Report(report));
            }
            _ => {}
        }
    }

    /// Sends what a `want` asks for.
    fn serve(&self, report: &Value) {
        let release = self.release.lock().expect("not poisoned").clone();
        let Some((release, want)) = release.zip(want(report)) else {
            return;
        };
        if want.tag != release.tag {
            return;
        }
        for index in want.indices() {
            let Some(payload) = release.piece(want.part, index) else {
                continue;
            };
            if want.part == Part::Image && !self.may_send() {
                return;
            }
            let chunk = Chunk {
                part: want.part,
                tag: want.tag,
                index,
                payload,
            };
            let mut bytes = [0; CHUNK_MAX];
            let length = chunk.encode(&mut bytes).expect("it fits");
            let sent =
                self.client
                    .try_publish(&self.topic, QoS::AtMostOnce, false, &bytes[..length]);
            // As on any network: what is lost is asked for again.
            drop(sent);
        }
    }

    /// Counts a chunk of the image, and says when it was the last one for now.
    fn may_send(&self) -> bool {
        let counted =
            self.left
                .fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| match left {
                    NEVER => Some(NEVER),
                    left => left.checked_sub(1),
                });
        if counted == Ok(1) {
            let _ = self.to.send(News::Sent);
        }
        counted.is_ok()
    }
}

fn want(report: &Value) -> Option<Want> {
    let part = report["part"].as_str()?;
    Some(Want {
        tag: report["tag"].as_u64()?.try_into().ok()?,
        part: Part::ALL.into_iter().find(|known| known.name() == part)?,
        first: report["first"].as_u64()?.try_into().ok()?,
        missing: report["missing"].as_u64()?.try_into().ok()?,
    })
}
