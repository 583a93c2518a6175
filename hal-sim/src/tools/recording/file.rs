//! The file of a recording: channels, and lines of JSON in them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use serde::Serialize;

use super::{RecordError, schema};
use crate::run::EPOCH_MS;

/// Time of the file at the beginning of the world: Unix time, nanoseconds.
pub(crate) const EPOCH_NS: u64 = EPOCH_MS * 1_000_000;
/// Name of the metadata with which a recording begins.
pub(crate) const START: &str = "terracrawler";
/// Name of the metadata with which it ends.
pub(crate) const END: &str = "terracrawler.end";
/// Bytes of a chunk. A recording that is cut off loses at most one, or two seconds.
const CHUNK: u64 = 1024 * 1024;

/// Names of channels.
pub(crate) mod topics {
    pub(crate) const ARENA: &str = "/arena";
    pub(crate) const SCENE: &str = "/scene";
    pub(crate) const TRUTH: &str = "/truth";
    pub(crate) const READINGS: &str = "/readings";
    pub(crate) const DECISIONS: &str = "/decisions";
    pub(crate) const MESSAGES: &str = "/messages";
    pub(crate) const FAULTS: &str = "/faults";
    pub(crate) const INPUTS: &str = "/inputs";
    pub(crate) const BOOTS: &str = "/boots";
    pub(crate) const ENDS: &str = "/ends";
    pub(crate) const DEVICES: &str = "/devices";
    pub(crate) const HASH: &str = "/hash";
    pub(crate) const MARK: &str = "/mark";

    /// Each with the kind of its messages.
    pub(crate) const ALL: [(&str, &str); 13] = [
        (ARENA, "foxglove.SceneUpdate"),
        (SCENE, "foxglove.SceneUpdate"),
        (TRUTH, "terracrawler.Truth"),
        (READINGS, "terracrawler.Readings"),
        (DECISIONS, "terracrawler.Decisions"),
        (MESSAGES, "terracrawler.Message"),
        (FAULTS, "terracrawler.Input"),
        (INPUTS, "terracrawler.Input"),
        (BOOTS, "terracrawler.Boot"),
        (ENDS, "terracrawler.End"),
        (DEVICES, "terracrawler.Devices"),
        (HASH, "terracrawler.Hash"),
        (MARK, "terracrawler.Mark"),
    ];
}

/// An open recording.
pub(super) struct RecordFile {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<File>>,
    channels: BTreeMap<&'static str, (u16, u32)>,
    messages: u64,
}

impl RecordFile {
    pub(super) fn create(path: &Path) -> Result<Self, RecordError> {
        Self::open(path).map_err(|cause| RecordError {
            path: path.to_owned(),
            cause,
        })
    }

    fn open(path: &Path) -> mcap::McapResult<Self> {
        let file = BufWriter::new(File::create(path)?);
        let mut writer = mcap::WriteOptions::new()
            .profile("terracrawler")
            .library(concat!("terracrawler ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            .chunk_size(Some(CHUNK))
            .create(file)?;
        let mut schemas = BTreeMap::new();
        for (name, text) in schema::all() {
            schemas.insert(name, writer.add_schema(name, "jsonschema", &text)?);
        }
        let mut channels = BTreeMap::new();
        for (topic, kind) in topics::ALL {
            let schema = schemas.get(kind).copied().unwrap_or_default();
            let id = writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
            channels.insert(topic, (id, 0));
        }
        Ok(Self {
            path: path.to_owned(),
            writer,
            channels,
            messages: 0,
        })
    }

    pub(super) fn messages(&self) -> u64 {
        self.messages
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    fn failed(&self, cause: mcap::McapError) -> RecordError {
        RecordError {
            path: self.path.clone(),
            cause,
        }
    }

    /// Adds a message to a channel.
    pub(super) fn add(
        &mut self,
        topic: &'static str,
        at_us: u64,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        let text = serde_json::to_vec(message)
            .map_err(|error| self.failed(std::io::Error::other(error).into()))?;
        let Some((id, sequence)) = self.channels.get_mut(topic) else {
            return Ok(());
        };
        let time = EPOCH_NS.saturating_add(at_us.saturating_mul(1_000));
        let header = MessageHeader {
            channel_id: *id,
            sequence: *sequence,
            log_time: time,
            publish_time: time,
        };
        *sequence = sequence.wrapping_add(1);
        self.messages += 1;
        let written = self.writer.write_to_known_channel(&header, &text);
        written.map_err(|cause| self.failed(cause))
    }

    fn describe(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), RecordError> {
        let metadata = Metadata {
            name: name.to_owned(),
            metadata,
        };
        let written = self.writer.write_metadata(&metadata);
        written.map_err(|cause| self.failed(cause))
    }

    pub(super) fn start(&mut self, words: BTreeMap<String, String>) -> Result<(), RecordError> {
        self.describe(START, words)
    }

    /// Ends a chunk: what was added so far survives whatever comes.
    pub(super) fn flush(&mut self) -> Result<(), RecordError> {
        let flushed = self.writer.flush();
        flushed.map_err(|cause| self.failed(cause))
    }

    pub(super) fn finish(mut self, words: BTreeMap<String, String>) -> Result<(), RecordError> {
        self.describe(END, words)?;
        if let Err(cause) = self.writer.finish() {
            return Err(self.failed(cause));
        }
        let path = self.path;
        let file = self.writer.into_inner();
        let synced = file
            .into_inner()
            .map_err(std::io::IntoInnerError::into_error)
            .and_then(|file| file.sync_all());
        synced.map_err(|error| RecordError {
            path,
            cause: error.into(),
        })
    }
}
