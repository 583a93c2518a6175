//! Texts: small files that people write, what others say of themselves, in the log, and bytes.

use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

use tracing_subscriber::field::MakeExt as _;
use tracing_subscriber::fmt::FormatFields;
use tracing_subscriber::fmt::format::debug_fn;

/// Longest file that is read, bytes. A scenario with a thousand obstacles has a tenth of it.
const MOST: u64 = 1024 * 1024;

/// Reads a text of at most a megabyte.
///
/// # Errors
/// What the system says, and [`io::ErrorKind::FileTooLarge`].
pub fn read_text(path: &Path) -> io::Result<String> {
    read_text_up_to(path, MOST)
}

/// Reads a text of at most `most` bytes.
///
/// # Errors
/// As [`read_text`].
pub fn read_text_up_to(path: &Path, most: u64) -> io::Result<String> {
    let mut text = String::new();
    let file = File::open(path)?;
    if file.take(most + 1).read_to_string(&mut text)? as u64 > most {
        let told = format!("it has more than {most} bytes");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, told));
    }
    Ok(text)
}

/// Bytes as text.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Longest text from outside in the log, in characters. Every name and id of the contract fits.
const LONGEST_SHOWN: usize = 128;
/// Longest field of a line of the log.
const LONGEST_FIELD: usize = 1_024;

/// A text from outside, as the log has it: cut, and with nothing that begins a line or steers a terminal.
pub struct Shown<'a>(pub &'a str);

impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        Escaped::new(f, LONGEST_SHOWN).write_str(self.0)
    }
}

/// A text from outside in one line, as [`Shown`] has it, of at most `most` characters.
#[must_use]
pub fn line(text: &str, most: usize) -> String {
    let mut line = String::new();
    // Writing to a String does not fail.
    let _ = Escaped::new(&mut line, most).write_str(text);
    line
}

/// How the fields of a line of the text log are written. Libraries log too, and an error may quote what
/// somebody has sent, so all of them are escaped.
pub fn log_fields() -> impl for<'w> FormatFields<'w> + 'static {
    let fields = debug_fn(|to, field, value| {
        if field.name() != "message" {
            write!(to, "{}=", field.name())?;
        }
        write!(Escaped::new(to, LONGEST_FIELD), "{value:?}")
    });
    fields.delimited(" ")
}

/// Passes a text on without control characters and those that turn the direction of writing, up to a
/// length.
struct Escaped<'a> {
    to: &'a mut dyn fmt::Write,
    left: usize,
}

impl<'a> Escaped<'a> {
    fn new(to: &'a mut dyn fmt::Write, most: usize) -> Self {
        Self { to, left: most }
    }
}

impl fmt::Write for Escaped<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for c in text.chars() {
            match self.left {
                0 => return Ok(()),
                1 => self.to.write_char('…')?,
                _ if is_harmless(c) => self.to.write_char(c)?,
                _ => write!(self.to, "{}", c.escape_default())?,
            }
            self.left -= 1;
        }
        Ok(())
    }
}

const fn is_harmless(c: char) -> bool {
    !matches!(c,
        '\0'..='\x1f' | '\x7f'..='\u{9f}' | '\u{61c}' | '\u{200e}' | '\u{200f}'
        | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_say_is_shown_in_one_short_line() {
        for (text, shown) in [
            ("rover-1", "rover-1"),
            ("Zoë's \"robot\" 🤖", "Zoë's \"robot\" 🤖"),
            ("a\nb\r\t", "a\\nb\\r\\t"),
            ("\u{1b}[2J\0\u{9b}", "\\u{1b}[2J\\u{0}\\u{9b}"),
            ("\u{2028}\u{202e}", "\\u{2028}\\u{202e}"),
        ] {
            assert_eq!(Shown(text).to_string(), shown);
        }
        let long = Shown(&"x".repeat(60_000)).to_string();
        assert_eq!(long, format!("{}…", "x".repeat(LONGEST_SHOWN - 1)));
        assert_eq!(line("a\nb\u{1b}cde", 5), "a\\nb\\u{1b}…");
        // Also where it comes in pieces.
        let mut text = String::new();
        let mut escaped = Escaped::new(&mut text, 4);
        for piece in ["a\n", "b", "cd"] {
            escaped.write_str(piece).expect("a String");
        }
        assert_eq!(text, "a\\nb…");
    }

    #[test]
    fn files_without_an_end_are_refused() {
        let path = std::env::temp_dir().join(format!("crawler-text-{}", std::process::id()));
        std::fs::write(&path, vec![b' '; MOST as usize]).expect("room");
        assert_eq!(read_text(&path).expect("short").len(), MOST as usize);
        std::fs::write(&path, vec![b' '; MOST as usize + 1]).expect("room");
        let error = read_text(&path).expect_err("too long");
        assert_eq!(error.kind(), io::ErrorKind::FileTooLarge);
        std::fs::remove_file(&path).expect("it is ours");
        let endless = Path::new("/dev/zero");
        if endless.exists() {
            assert!(read_text(endless).is_err());
        }
    }
}
