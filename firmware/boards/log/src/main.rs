//! Turns the serial log of a board into lines of text: `crawler-log ELF < serial`.
//!
//! Each record becomes one line on standard output, three fields apart by tabs: the time by the
//! board's own clock, the level (empty where a record has none), and the text with its line breaks,
//! tabs and backslashes escaped. `crawler-log --check ELF` only tells whether the file describes a
//! log. Exit code 2, with one line on standard error, when it does not.

use std::error::Error;
use std::io::{self, Read, Write};
use std::path::Path;
use std::process::ExitCode;

use defmt_decoder::{DecodeError, Frame, Table};

/// Bytes without the end of a record, after which they are given up.
const LONGEST: usize = 64 * 1024;

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let outcome = match arguments.as_slice() {
        [check, elf] if check == "--check" => table(elf.as_ref()).map(drop),
        [elf] => table(elf.as_ref()).and_then(|table| {
            decode(&table, io::stdin().lock(), io::stdout().lock()).map_err(Into::into)
        }),
        _ => Err("crawler-log [--check] ELF".into()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::from(2)
        }
    }
}

/// What the records of the program in `elf` mean.
fn table(elf: &Path) -> Result<Table, Box<dyn Error>> {
    let bytes = std::fs::read(elf)?;
    let table = Table::parse(&bytes).map_err(|error| format!("{error:#}"))?;
    table.ok_or_else(|| "it has no log records".into())
}

/// Reads records to the end of `serial`. What cannot be read is skipped.
fn decode(table: &Table, mut serial: impl Read, mut out: impl Write) -> io::Result<()> {
    let mut decoder = table.new_stream_decoder();
    let mut buffer = [0; 4_096];
    let mut since = 0;
    loop {
        let len = match serial.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(len) => len,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        decoder.received(&buffer[..len]);
        since += len;
        loop {
            match decoder.decode() {
                Ok(frame) => {
                    since = 0;
                    out.write_all(line(&frame).as_bytes())?;
                }
                // A record that a reset cut off; the next one is whole again.
                Err(DecodeError::Malformed) => since = 0,
                Err(DecodeError::UnexpectedEof) => break,
            }
        }
        out.flush()?;
        if since > LONGEST {
            decoder = table.new_stream_decoder();
            since = 0;
        }
    }
}

fn line(frame: &Frame<'_>) -> String {
    let time = frame
        .display_timestamp()
        .map(|time| time.to_string())
        .unwrap_or_default();
    let level = frame.level().map_or("", |level| level.as_str());
    let text = escaped(&frame.display_message().to_string());
    format!("{}\t{level}\t{text}\n", escaped(&time))
}

/// One line without tabs, whatever `text` is.
fn escaped(text: &str) -> String {
    text.replace('\\', "\\\\")
        .replace('\n', "\\n")
        .replace('\r', "\\r")
        .replace('\t', "\\t")
}

#[cfg(test)]
mod tests {
    use super::{escaped, table};

    #[test]
    fn a_record_stays_on_its_line() {
        assert_eq!(escaped("a\tb\r\nc\\n"), "a\\tb\\r\\nc\\\\n");
    }

    #[test]
    fn a_program_without_a_log_is_told_from_none_at_all() {
        let own = std::env::current_exe().expect("a program");
        let Err(error) = table(&own) else {
            panic!("it logs nothing");
        };
        assert_eq!(error.to_string(), "it has no log records");
        let manifest = concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml");
        assert!(table(manifest.as_ref()).is_err());
        assert!(table("/nowhere".as_ref()).is_err());
    }
}
