//! The control socket of QEMU: one JSON object a line, each way.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};

use super::EmulatorError;

/// For one answer.
const PATIENCE: Duration = Duration::from_mins(1);
/// Events that may stand before an answer.
const EVENTS: usize = 1_000;
/// Longest line.
const LONGEST: u64 = 1024 * 1024;

/// A session on the control socket.
pub(super) struct Qmp {
    stream: BufReader<UnixStream>,
}

fn failed(error: impl std::fmt::Display) -> EmulatorError {
    EmulatorError::Control(error.to_string())
}

impl Qmp {
    /// Connects and agrees on capabilities.
    pub(super) fn connect(socket: &Path) -> Result<Self, EmulatorError> {
        let stream = UnixStream::connect(socket).map_err(failed)?;
        stream.set_read_timeout(Some(PATIENCE)).map_err(failed)?;
        stream.set_write_timeout(Some(PATIENCE)).map_err(failed)?;
        let mut session = Self {
            stream: BufReader::new(stream),
        };
        let greeting = session.line()?;
        if greeting.get("QMP").is_none() {
            return Err(failed("no greeting"));
        }
        session.execute("qmp_capabilities", &json!({}))?;
        Ok(session)
    }

    /// Has one command carried out.
    pub(super) fn execute(
        &mut self,
        command: &str,
        arguments: &Value,
    ) -> Result<(), EmulatorError> {
        let request = json!({"execute": command, "arguments": arguments});
        self.stream
            .get_mut()
            .write_all(format!("{request}\n").as_bytes())
            .map_err(failed)?;
        for _ in 0..EVENTS {
            let answer = self.line()?;
            if answer.get("return").is_some() {
                return Ok(());
            }
            if let Some(error) = answer.get("error") {
                let text = error["desc"].as_str().unwrap_or("an error without words");
                return Err(failed(format!("{command}: {text}")));
            }
            // Everything else is an event.
        }
        Err(failed(format!(
            "{command}: no answer among {EVENTS} events"
        )))
    }

    fn line(&mut self) -> Result<Value, EmulatorError> {
        let mut line = String::new();
        let read = (&mut self.stream)
            .take(LONGEST)
            .read_line(&mut line)
            .map_err(failed)?;
        if read == 0 {
            return Err(failed("closed"));
        }
        serde_json::from_str(&line).map_err(failed)
    }
}
