//! The messages of a recording: what robots published, and what reached them.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;

use mcap::records::Record;
use serde::Deserialize;

use super::read::{ReadError, check_format, check_profile, scan, wrong};
use crate::run::journal::Payload;
use crate::tools::recording::{START, topics};

/// A message that a robot published, or that reached it.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct Message {
    /// Microseconds since the beginning of the world.
    pub at_us: u64,
    /// The robot.
    pub robot: String,
    /// Which boot of it.
    pub boot: u32,
    /// Whether it reached the robot; else the robot published it.
    #[serde(rename = "direction", deserialize_with = "delivered")]
    pub delivered: bool,
    /// Its topic.
    pub topic: String,
    /// What it says.
    pub payload: Payload,
}

fn delivered<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<bool, D::Error> {
    let word = String::deserialize(deserializer)?;
    match word.as_str() {
        "delivered" => Ok(true),
        "published" => Ok(false),
        _ => Err(serde::de::Error::custom("no direction of a message")),
    }
}

/// Hands out the messages of a recording in the order of the file; returns what it says of itself. One
/// that was cut off is good up to the last chunk that is whole.
///
/// # Errors
/// [`ReadError`] with what is wrong.
pub fn messages(
    source: impl Read,
    mut each: impl FnMut(Message),
) -> Result<BTreeMap<String, String>, ReadError> {
    let (mut words, mut channels) = (BTreeMap::new(), BTreeSet::new());
    scan(source, |record| match record {
        Record::Header(header) => check_profile(&header.profile),
        Record::Channel(channel) if channel.topic == topics::MESSAGES => {
            channels.insert(channel.id);
            Ok(())
        }
        Record::Metadata(metadata) if metadata.name == START => {
            words.clone_from(&metadata.metadata);
            check_format(&words)
        }
        Record::Message { header, data } if channels.contains(&header.channel_id) => {
            let read = serde_json::from_slice(data);
            each(read.map_err(|error| wrong(format!("a message of a robot: {error}")))?);
            Ok(())
        }
        _ => Ok(()),
    })?;
    if words.is_empty() {
        return Err(wrong("it does not say what it is a recording of"));
    }
    Ok(words)
}
