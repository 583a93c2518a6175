//! What the robot says, read by the protocol's own readers, and what was wrong with it. A robot may be newer
//! than the bench: what it says beyond what the bench knows is counted, and no finding.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use crawler_protocol::open::{
    self, Heartbeat, LogRecord, Read, Response, StatusMessage, Telemetry, Unknown,
};
use crawler_protocol::{
    DecodeError, Detections, Fleet, MAX_MESSAGE, MapSegment, ParametersMessage, RobotId,
    TimeMessage, Topic,
};
use tokio::time::Instant;

/// Answers remembered; a suite sends far fewer commands between two looks at them.
const ANSWERS: usize = 1_024;
/// Findings told in full; the rest is counted.
const FINDINGS: usize = 20;
/// Robots of the fleet remembered by name.
const OTHERS: usize = 1_000;

/// One message that could be read.
#[derive(Debug, Clone, PartialEq)]
pub enum Word {
    /// `status/{id}` of the robot.
    Status(Box<StatusMessage>),
    /// `heartbeat/{id}`.
    Heartbeat(Heartbeat),
    /// `telemetry/{id}`.
    Telemetry(Telemetry),
    /// `response/robot/{id}`.
    Response(Response),
    /// `parameters/{id}`.
    Parameters(Box<ParametersMessage>),
    /// `logs/{id}`.
    Log(LogRecord),
    /// `map/{id}`.
    Map(Box<MapSegment>),
    /// `vision/{id}`.
    Detections(Detections),
    /// `image/{id}`: the bytes.
    Image(Vec<u8>),
    /// `time`.
    Time(TimeMessage),
}

/// A message, and how it came.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// When it arrived.
    pub at: Instant,
    /// Whether the broker had kept it from before we asked.
    pub retained: bool,
    /// What it says.
    pub word: Word,
}

/// Everything heard so far that later questions need.
#[derive(Debug, Default)]
pub(super) struct Book {
    pub(super) status: Option<StatusMessage>,
    pub(super) parameters: Option<ParametersMessage>,
    pub(super) telemetry: Option<Telemetry>,
    pub(super) heartbeat: Option<Heartbeat>,
    /// Whether status and parameters were there before we asked.
    pub(super) status_retained: bool,
    pub(super) parameters_retained: bool,
    /// Answers nobody has asked for yet, oldest first.
    pub(super) answers: VecDeque<Response>,
    /// Messages of the robot.
    pub(super) messages: u64,
    /// What was wrong with some of them.
    pub(super) findings: Vec<String>,
    pub(super) wrong: u64,
    /// What it says beyond what is known here.
    pub(super) unknown: Unknown,
    /// Whether each robot of the fleet is online.
    pub(super) fleet: BTreeMap<String, bool>,
    /// Messages of ours that the broker would not pass on.
    pub(super) refused: u64,
}

impl Book {
    fn find(&mut self, text: String) {
        self.wrong += 1;
        if self.findings.len() < FINDINGS {
            self.findings.push(text);
        }
    }

    /// Takes in one message; none where it is not about `robot`, or cannot be read.
    pub(super) fn hear(
        &mut self,
        fleet: &Fleet,
        robot: &RobotId,
        topic: &str,
        payload: &[u8],
        retained: bool,
    ) -> Option<Word> {
        let Ok(parsed) = Topic::parse(fleet, topic) else {
            return None;
        };
        if parsed == Topic::Time {
            return TimeMessage::from_json(payload).ok().map(Word::Time);
        }
        let id = parsed.robot()?.clone();
        if let Topic::Status(_) = parsed
            && let Ok(Read {
                message: status, ..
            }) = open::read::<StatusMessage>(payload)
            && (self.fleet.len() < OTHERS || self.fleet.contains_key(id.as_str()))
        {
            self.fleet.insert(id.as_str().to_owned(), status.online);
        }
        if id != *robot {
            return None;
        }
        self.messages += 1;
        let word = match read(&parsed, payload, &mut self.unknown) {
            Ok(word) => word?,
            Err(error) => {
                let shown = String::from_utf8_lossy(&payload[..payload.len().min(120)]);
                self.find(format!("{topic}: {error}: {shown}"));
                return None;
            }
        };
        if retained && !parsed.retained() {
            self.find(format!("{topic} is retained and must not be"));
        }
        if let Some(other) = speaker(&word).filter(|other| *other != robot) {
            self.find(format!("{topic} says it is from {other}"));
        }
        self.check_order(topic, &word);
        self.note(&word, retained);
        Some(word)
    }

    /// Numbers of one boot rise.
    fn check_order(&mut self, topic: &str, word: &Word) {
        let text = match (word, &self.heartbeat, &self.telemetry) {
            (Word::Heartbeat(new), Some(old), _)
                if new.uptime_ms >= old.uptime_ms && new.seq <= old.seq =>
            {
                format!("{topic}: seq {} came after {}", new.seq, old.seq)
            }
            // A lower one is a new boot, which a heartbeat tells apart.
            (Word::Telemetry(new), _, Some(old)) if new.seq == old.seq => {
                format!("{topic}: seq {} came twice", new.seq)
            }
            _ => return,
        };
        self.find(text);
    }

    fn note(&mut self, word: &Word, retained: bool) {
        match word {
            Word::Status(status) => {
                if self.status.is_none() {
                    self.status_retained = retained;
                }
                self.status = Some((**status).clone());
            }
            Word::Parameters(parameters) => {
                if self.parameters.is_none() {
                    self.parameters_retained = retained;
                }
                self.parameters = Some(*parameters.clone());
            }
            Word::Telemetry(telemetry) => self.telemetry = Some(telemetry.clone()),
            Word::Heartbeat(heartbeat) => self.heartbeat = Some(heartbeat.clone()),
            Word::Response(response) => {
                if self.answers.len() == ANSWERS {
                    self.answers.pop_front();
                }
                self.answers.push_back(response.clone());
            }
            Word::Log(_) | Word::Map(_) | Word::Detections(_) | Word::Image(_) | Word::Time(_) => {}
        }
    }
}

/// Why a message says nothing.
enum Unreadable {
    /// It has more bytes than a message may have.
    TooLong(usize),
    /// It is not what belongs to its topic.
    Decode(DecodeError),
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong(bytes) => write!(f, "{bytes} bytes"),
            Self::Decode(error) => write!(f, "cannot be read ({error})"),
        }
    }
}

/// Reads a message of the robot; none for topics it only listens to.
fn read(topic: &Topic, payload: &[u8], unknown: &mut Unknown) -> Result<Option<Word>, Unreadable> {
    if !matches!(topic, Topic::Image(_)) && payload.len() > MAX_MESSAGE {
        return Err(Unreadable::TooLong(payload.len()));
    }
    let word = match topic {
        Topic::Status(_) => told(payload, unknown).map(Box::new).map(Word::Status),
        Topic::Heartbeat(_) => told(payload, unknown).map(Word::Heartbeat),
        Topic::Telemetry(_) => told(payload, unknown).map(Word::Telemetry),
        Topic::Response(_) => told(payload, unknown).map(Word::Response),
        Topic::Parameters(_) => told(payload, unknown).map(Box::new).map(Word::Parameters),
        Topic::Logs(_) => told(payload, unknown).map(Word::Log),
        Topic::Map(_) => told(payload, unknown).map(Box::new).map(Word::Map),
        Topic::Vision(_) => told(payload, unknown).map(Word::Detections),
        Topic::Image(_) => Ok(Word::Image(payload.to_vec())),
        _ => return Ok(None),
    };
    word.map(Some).map_err(Unreadable::Decode)
}

/// Reads a message of a robot that may be newer than the bench.
fn told<T: open::Report>(payload: &[u8], unknown: &mut Unknown) -> Result<T, DecodeError> {
    let read = open::read(payload)?;
    unknown.add(read.unknown);
    Ok(read.message)
}

/// Who a message says it is from.
fn speaker(word: &Word) -> Option<&RobotId> {
    match word {
        Word::Status(message) => Some(&message.robot),
        Word::Heartbeat(message) => Some(&message.robot),
        Word::Telemetry(message) => Some(&message.robot),
        Word::Response(message) => Some(&message.robot),
        Word::Parameters(message) => Some(&message.robot),
        Word::Log(message) => Some(&message.robot),
        Word::Map(message) => Some(&message.robot),
        Word::Detections(message) => Some(&message.robot),
        Word::Image(_) | Word::Time(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hear(book: &mut Book, topic: &str, payload: &[u8], retained: bool) -> Option<Word> {
        let robot = RobotId::new("r-1").unwrap();
        book.hear(&Fleet::default(), &robot, topic, payload, retained)
    }

    fn heartbeat(seq: u64, uptime: u64) -> Vec<u8> {
        format!(
            r#"{{"robot":"r-1","seq":{seq},"timestamp":0,"uptime_ms":{uptime},"state":"IDLE"}}"#
        )
        .into_bytes()
    }

    #[test]
    fn valid_messages_are_no_finding() {
        let mut book = Book::default();
        for (seq, uptime) in [(0, 1_000), (1, 2_000), (5, 6_000), (0, 900)] {
            let heard = hear(
                &mut book,
                "swarm/heartbeat/r-1",
                &heartbeat(seq, uptime),
                false,
            );
            assert!(heard.is_some());
        }
        assert_eq!((book.messages, book.wrong), (4, 0), "{:?}", book.findings);
    }

    #[test]
    fn what_breaks_the_contract_is_a_finding() {
        let long = [vec![b' '; MAX_MESSAGE], heartbeat(1, 1)].concat();
        let alien = String::from_utf8(heartbeat(1, 1))
            .unwrap()
            .replace("r-1", "r-2");
        let short = String::from_utf8(heartbeat(1, 1))
            .unwrap()
            .replace(r#","state":"IDLE""#, "");
        for (payload, retained, text) in [
            (long, false, "bytes"),
            (alien.into_bytes(), false, "from r-2"),
            (short.into_bytes(), false, "missing_field"),
            (b"\xff".to_vec(), false, "malformed"),
            (heartbeat(1, 1), true, "retained"),
        ] {
            let mut book = Book::default();
            hear(&mut book, "swarm/heartbeat/r-1", &payload, retained);
            assert_eq!(book.wrong, 1, "{text}");
            assert!(book.findings[0].contains(text), "{:?}", book.findings);
        }
    }

    #[test]
    fn what_only_a_newer_robot_says_is_counted() {
        let mut book = Book::default();
        let newer = String::from_utf8(heartbeat(1, 1))
            .unwrap()
            .replace("IDLE", "CHARGING")
            .replace('}', r#","mood":{"is":"fine"}}"#);
        let heard = hear(&mut book, "swarm/heartbeat/r-1", newer.as_bytes(), false);
        assert!(heard.is_some());
        assert_eq!((book.messages, book.wrong), (1, 0), "{:?}", book.findings);
        assert_eq!((book.unknown.fields, book.unknown.words), (1, 1));
    }

    #[test]
    fn a_number_that_does_not_rise_is_a_finding() {
        let mut book = Book::default();
        hear(
            &mut book,
            "swarm/heartbeat/r-1",
            &heartbeat(7, 1_000),
            false,
        );
        hear(
            &mut book,
            "swarm/heartbeat/r-1",
            &heartbeat(7, 2_000),
            false,
        );
        assert_eq!(book.wrong, 1);
    }

    #[test]
    fn findings_and_answers_do_not_pile_up() {
        let mut book = Book::default();
        for seq in 0..5_000 {
            hear(&mut book, "swarm/heartbeat/r-1", b"{", false);
            let answer = format!(
                r#"{{"robot":"r-1","seq":{seq},"status":"completed","reason":null,"timestamp":0}}"#
            );
            hear(
                &mut book,
                "swarm/response/robot/r-1",
                answer.as_bytes(),
                false,
            );
        }
        assert_eq!(book.wrong, 5_000);
        assert_eq!(book.findings.len(), FINDINGS);
        assert_eq!(book.answers.len(), ANSWERS);
    }

    #[test]
    fn other_robots_are_counted_and_not_judged() {
        let mut book = Book::default();
        let status = br#"{"robot":"r-2","online":true,"kind":"simulated","firmware":"1","board":"sim","capabilities":[],"boot":{"count":1,"cause":"power-on"},"protocol":1}"#;
        assert_eq!(hear(&mut book, "swarm/status/r-2", status, true), None);
        assert_eq!(hear(&mut book, "swarm/telemetry/r-2", b"{", false), None);
        assert_eq!(book.fleet.get("r-2"), Some(&true));
        assert_eq!((book.messages, book.wrong), (0, 0));
    }
}
