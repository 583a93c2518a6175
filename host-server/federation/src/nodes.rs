//! The coordinator's end: what nodes are told, and what they say.

use std::sync::mpsc::{self, Receiver, RecvTimeoutError, SyncSender, TrySendError};
use std::time::Duration;

use crawler_protocol::Fleet;
use rumqttc::v5::MqttOptions;
use tokio::runtime::Handle;
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;

use crate::session::{self, Saying};
use crate::topics;

/// Updates that wait to be taken: one of each node that there can be, and as many again. What is more is dropped, and said again when the
/// round is announced once more.
const WAITING: usize = 128;
/// For so long the broker has what came of a run, for nodes that are away: as long as a deadline may be.
const OVER_S: u32 = 3_600;
/// For the session to end.
const PATIENCE: Duration = Duration::from_secs(2);

/// Where nodes are met.
#[derive(Debug, Clone)]
pub struct Broker {
    /// A session with the broker that nobody else has.
    pub session: MqttOptions,
    /// Whose topics are taken.
    pub fleet: Fleet,
    /// Where the session runs.
    pub runtime: Handle,
}

/// The nodes of a run, for a thread that waits for them. Dropped, the session ends soon, and what was
/// announced stays with the broker.
#[derive(Debug)]
pub struct Nodes {
    topic: String,
    say: watch::Sender<Option<Saying>>,
    heard: Receiver<(String, Vec<u8>)>,
    ended: Receiver<()>,
    stop: CancellationToken,
}

impl Broker {
    /// Meets the nodes of a run.
    #[must_use]
    pub fn meet(&self, run: u64) -> Nodes {
        let (say, said) = watch::channel(None);
        let (hear, heard) = mpsc::sync_channel(WAITING);
        let (end, ended) = mpsc::sync_channel(1);
        let stop = CancellationToken::new();
        let fleet = self.fleet.clone();
        let topic = topics::round(&fleet, run);
        let filter = topics::updates(&fleet, run);
        let (session, stopped) = (self.session.clone(), stop.clone());
        let hear = move |topic: &str, payload: &[u8]| {
            if let Some(node) = topics::node_of(&fleet, run, topic) {
                take(&hear, node.as_str(), payload);
            }
        };
        self.runtime.spawn(async move {
            session::keep(session, filter, said, hear, stopped).await;
            let _ = end.try_send(());
        });
        Nodes {
            topic,
            say,
            heard,
            ended,
            stop,
        }
    }
}

fn take(hear: &SyncSender<(String, Vec<u8>)>, node: &str, payload: &[u8]) {
    let heard = (node.to_owned(), payload.to_vec());
    if let Err(TrySendError::Full(_)) = hear.try_send(heard) {
        tracing::debug!(node, "an update is dropped: too many wait");
    }
}

impl Nodes {
    /// Tells all nodes of a round, those too that come later, until there is another one.
    pub fn announce(&self, announcement: Vec<u8>) {
        self.say(announcement, None);
    }

    fn say(&self, payload: Vec<u8>, expires_s: Option<u32>) {
        self.say.send_replace(Some(Saying {
            topic: self.topic.clone(),
            payload,
            retain: true,
            expires_s,
        }));
    }

    /// What a node says, by its name; `None` when none says anything for so long. Blocks the thread.
    #[must_use]
    pub fn hear(&self, within: Duration) -> Option<(String, Vec<u8>)> {
        match self.heard.recv_timeout(within) {
            Ok(heard) => Some(heard),
            Err(RecvTimeoutError::Timeout) => None,
            // The runtime is gone. It is waited for all the same: nobody is to spin.
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(within);
                None
            }
        }
    }

    /// Takes back what was announced, so that no node learns for a run that stands. Blocks the thread until the broker knows, two seconds
    /// at most.
    pub fn withdraw(self) {
        if self.say.borrow().is_some() {
            // A retained message without a payload clears it (MQTT 5, 3.3.1.3).
            self.say(Vec::new(), None);
        }
        self.end();
    }

    /// Tells nodes what came of the run, those too that come within an hour, and ends. Blocks the thread as [`withdraw`](Self::withdraw) does.
    pub fn end_with(self, announcement: Vec<u8>) {
        self.say(announcement, Some(OVER_S));
        self.end();
    }

    fn end(self) {
        self.stop.cancel();
        let _ = self.ended.recv_timeout(PATIENCE);
    }
}

impl Drop for Nodes {
    fn drop(&mut self) {
        self.stop.cancel();
    }
}
