//! Why a command of the command line comes to nothing, for the person who typed it.

use std::error::Error;
use std::fmt;
use std::process::ExitCode;

/// Exit code of a command that could not do what it was asked for.
const FAILED: u8 = 1;

/// What is behind an error.
type Source = Box<dyn Error + Send + Sync>;

/// Why a command comes to nothing: a text for a person, the exit code, and what was behind it.
///
/// It is where errors end, so it is none itself: `?` makes one of any error, with the text of that. What needs
/// more words has them from [`OrSay::or_say`], or from [`CliError::at`] where it is a file.
///
/// The text says all there is to know; [`CliError::source`] is for programs.
#[derive(Debug)]
pub struct CliError {
    text: String,
    code: u8,
    source: Option<Source>,
}

impl CliError {
    /// One that says this, with exit code 1.
    #[must_use]
    pub fn new(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            code: FAILED,
            source: None,
        }
    }

    /// One of a file, or of what else has a name: that, and what is wrong with it.
    #[must_use]
    pub fn at(name: impl fmt::Display, what: impl fmt::Display) -> Self {
        Self::new(format!("{name}: {what}"))
    }

    /// The same with this exit code.
    #[must_use]
    pub fn exits(self, code: u8) -> Self {
        Self { code, ..self }
    }

    /// The same text behind a name.
    #[must_use]
    pub fn of(self, name: impl fmt::Display) -> Self {
        Self {
            text: format!("{name}: {}", self.text),
            ..self
        }
    }

    /// What was behind it.
    #[must_use]
    pub fn source(&self) -> Option<&(dyn Error + Send + Sync + 'static)> {
        self.source.as_deref()
    }

    /// Tells the person at the keyboard, on standard error, and returns the exit code.
    #[must_use]
    pub fn tell(&self) -> ExitCode {
        eprintln!("terracrawler: {self}");
        ExitCode::from(self.code)
    }
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl<E: Error + Send + Sync + 'static> From<E> for CliError {
    fn from(error: E) -> Self {
        Self {
            text: error.to_string(),
            code: FAILED,
            source: Some(Box::new(error)),
        }
    }
}

/// What reads options wants errors of the standard library.
impl From<CliError> for Box<dyn Error + Send + Sync> {
    fn from(error: CliError) -> Self {
        error.text.into()
    }
}

/// More words for what went wrong.
pub trait OrSay<T, E> {
    /// What went wrong in the words of `text`, with the error behind it.
    ///
    /// # Errors
    /// [`CliError`], where this is an error.
    fn or_say(self, text: impl FnOnce(&E) -> String) -> Result<T, CliError>;
}

impl<T, E: Error + Send + Sync + 'static> OrSay<T, E> for Result<T, E> {
    fn or_say(self, text: impl FnOnce(&E) -> String) -> Result<T, CliError> {
        self.map_err(|error| CliError {
            text: text(&error),
            code: FAILED,
            source: Some(Box::new(error)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(text: &str) -> Result<u8, CliError> {
        Ok(text.parse::<u8>()?)
    }

    #[test]
    fn it_says_what_the_error_says_and_keeps_it() {
        let error = number("x").expect_err("no number");
        assert_eq!(error.to_string(), "invalid digit found in string");
        let behind = error.source().expect("the error");
        assert!(behind.is::<std::num::ParseIntError>());
        let named = error.of("--threads").exits(2);
        assert_eq!(
            named.to_string(),
            "--threads: invalid digit found in string"
        );
        assert_eq!((named.code, named.source().is_some()), (2, true));
    }

    #[test]
    fn more_words_come_with_what_is_behind_them() {
        let read = std::fs::read("/nowhere/at/all");
        let error = read.or_say(|error| format!("cannot read: {error}"));
        let error = error.expect_err("no file");
        assert!(error.to_string().starts_with("cannot read: "), "{error}");
        let behind = error.source().expect("the error");
        assert!(behind.is::<std::io::Error>());
        let plain = CliError::at("a.toml", "no text");
        assert_eq!(plain.to_string(), "a.toml: no text");
        assert_eq!((plain.code, plain.source().is_none()), (FAILED, true));
        let for_options: Box<dyn Error + Send + Sync> = plain.into();
        assert_eq!(for_options.to_string(), "a.toml: no text");
    }
}
