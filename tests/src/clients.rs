//! The clients that come with Mosquitto: tools that nobody here wrote.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::engines::{PATIENCE, program};

/// What stands in front of messages, so that they are told from what the tool says itself.
const MARK: &str = "> ";

/// Publishes with `mosquitto_pub` at QoS 1.
///
/// # Panics
/// When the tool is missing or reports a failure.
pub fn publish(port: u16, topic: &str, payload: &str) {
    let output = Command::new(program("mosquitto_pub"))
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", topic, "-m", payload])
        .output()
        .expect("mosquitto_pub");
    assert!(
        output.status.success(),
        "mosquitto_pub: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// A topic and what was published there.
pub type Heard = (String, String);

/// `mosquitto_sub` at work: everything that is published after [`Subscription::start`] reaches it.
#[derive(Debug)]
pub struct Subscription {
    child: Child,
    lines: Receiver<String>,
    reader: Option<JoinHandle<()>>,
    filter: String,
    /// The newest lines, for whoever waits in vain.
    last: Vec<String>,
}

impl Subscription {
    /// Subscribes to `filter` at QoS 1 and waits until the broker has confirmed it.
    ///
    /// # Panics
    /// When the tool is missing, or the broker does not confirm.
    pub fn start(port: u16, filter: &str) -> Self {
        Self::start_with(port, &[], filter)
    }

    /// The same with further `arguments`, such as `-u` and `-P`.
    ///
    /// # Panics
    /// As [`Subscription::start`].
    pub fn start_with(port: u16, arguments: &[&str], filter: &str) -> Self {
        // What it says about itself would wait in a buffer for the first message.
        let mut child = Command::new(program("stdbuf"))
            .arg("-oL")
            .arg(program("mosquitto_sub"))
            .args(["-d", "-V", "mqttv5", "-h", "127.0.0.1"])
            .args(["-p", &port.to_string()])
            .args(["-q", "1", "-t", filter, "-F", &format!("{MARK}%t %p")])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("mosquitto_sub");
        let output = child.stdout.take().expect("it was asked for");
        let (sender, lines) = channel();
        let reader = std::thread::spawn(move || {
            for line in BufReader::new(output).split(b'\n') {
                let Ok(line) = line else { return };
                // Nobody listens any more: the rest is read so that the tool is not held up.
                let _ = sender.send(String::from_utf8_lossy(&line).into_owned());
            }
        });
        let mut subscription = Self {
            child,
            lines,
            reader: Some(reader),
            filter: filter.to_owned(),
            last: Vec::new(),
        };
        subscription.line("the broker confirms the subscription", |line| {
            line.contains("received SUBACK").then_some(())
        });
        subscription
    }

    /// Waits for a message that `found` finds something in; those before it are passed over.
    ///
    /// # Panics
    /// With `what` and what came last, when there is none within [`PATIENCE`].
    pub fn wait<T>(&mut self, what: &str, mut found: impl FnMut(&str, &str) -> Option<T>) -> T {
        self.line(what, |line| {
            let (topic, payload) = message(line)?;
            found(topic, payload)
        })
    }

    /// Waits for the next message.
    ///
    /// # Panics
    /// As [`Subscription::wait`].
    pub fn next(&mut self, what: &str) -> Heard {
        self.wait(what, |topic, payload| {
            Some((topic.to_owned(), payload.to_owned()))
        })
    }

    fn line<T>(&mut self, what: &str, mut found: impl FnMut(&str) -> Option<T>) -> T {
        let until = Instant::now() + PATIENCE;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) => {
                    if self.last.len() == 20 {
                        self.last.remove(0);
                    }
                    self.last.push(line);
                    if let Some(value) = self.last.last().and_then(|line| found(line)) {
                        return value;
                    }
                }
                Err(error) => {
                    let why = match error {
                        RecvTimeoutError::Timeout => format!("gave up after {PATIENCE:?}"),
                        RecvTimeoutError::Disconnected => "mosquitto_sub has ended".to_owned(),
                    };
                    let (filter, last) = (&self.filter, self.last.join("\n"));
                    panic!("{why}: {what}, at {filter}; it said last:\n{last}");
                }
            }
        }
    }

    /// Whether it has ended by itself.
    ///
    /// # Panics
    /// When the operating system does not know.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().expect("our own process").is_some()
    }

    /// Ends it, and gives the messages that nobody has waited for.
    ///
    /// # Panics
    /// When the operating system refuses.
    pub fn end(mut self) -> Vec<Heard> {
        self.child.kill().expect("our own process");
        self.child.wait().expect("our own process");
        let reader = self.reader.take().expect("it ends once");
        reader.join().expect("a reader");
        let owned = |line: String| {
            let (topic, payload) = message(&line)?;
            Some((topic.to_owned(), payload.to_owned()))
        };
        self.lines.try_iter().filter_map(owned).collect()
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn message(line: &str) -> Option<(&str, &str)> {
    line.strip_prefix(MARK)?.split_once(' ')
}

/// Collects with `mosquitto_sub` what is on `filter` until there are `count` messages, or `limit` has
/// passed, as `(topic, payload)`; retained messages count.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe(port: u16, filter: &str, count: usize, limit: Duration) -> Vec<Heard> {
    subscribe_with(port, &[], filter, count, limit)
}

/// The same with further `arguments`, such as `-u` and `-P`.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe_with(
    port: u16,
    arguments: &[&str],
    filter: &str,
    count: usize,
    limit: Duration,
) -> Vec<Heard> {
    let seconds = limit.as_secs().max(1).to_string();
    let output = Command::new(program("mosquitto_sub"))
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", filter, "-F", "%t %p"])
        .args(arguments)
        .args(["-C", &count.to_string(), "-W", &seconds])
        .output()
        .expect("mosquitto_sub");
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| line.split_once(' '))
        .map(|(topic, payload)| (topic.to_owned(), payload.to_owned()))
        .collect()
}
