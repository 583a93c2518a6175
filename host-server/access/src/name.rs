//! Names of people's accounts.

use core::fmt;
use core::str::FromStr;

use serde::{Deserialize, Serialize};

/// Longest name of an account, in bytes.
pub const MAX_USER_NAME: usize = 32;

/// First parts of the names that the server, simulators and learners use at the broker.
const RESERVED: [&str; 3] = ["server", "simulator", "learner"];

/// The name of a person's account: `[a-z][a-z0-9._-]{0,31}`, and not one that the server, a
/// simulator or a learner goes by at the broker (`server`, `server-…`, `simulator`, `simulator-…`, `learner`,
/// `learner-…`).
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct UserName(String);

/// Why a text is not the name of an account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum UserNameError {
    /// No character at all.
    Empty,
    /// More than [`MAX_USER_NAME`] bytes.
    TooLong,
    /// The first character is not a small letter.
    First,
    /// A character outside the alphabet.
    Alphabet,
    /// The server, a simulator or a learner goes by it.
    Reserved,
}

impl fmt::Display for UserNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Empty => "the name is empty",
            Self::TooLong => "the name is longer than 32 characters",
            Self::First => "the name must begin with a letter of a-z",
            Self::Alphabet => "the name may have a-z, 0-9, dot, underscore and hyphen only",
            Self::Reserved => "the name is reserved for the server, a simulator or a learner",
        })
    }
}

impl core::error::Error for UserNameError {}

fn check(text: &str) -> Result<(), UserNameError> {
    let bytes = text.as_bytes();
    let first = bytes.first().ok_or(UserNameError::Empty)?;
    if bytes.len() > MAX_USER_NAME {
        return Err(UserNameError::TooLong);
    }
    if !first.is_ascii_lowercase() {
        return Err(UserNameError::First);
    }
    let legal = |byte: &u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'.' | b'_' | b'-');
    if !bytes.iter().all(legal) {
        return Err(UserNameError::Alphabet);
    }
    let reserved = RESERVED.iter().any(|word| {
        text.strip_prefix(word)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
    });
    if reserved {
        return Err(UserNameError::Reserved);
    }
    Ok(())
}

impl UserName {
    /// The name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl AsRef<str> for UserName {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for UserName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

impl FromStr for UserName {
    type Err = UserNameError;

    fn from_str(text: &str) -> Result<Self, UserNameError> {
        check(text)?;
        Ok(Self(text.to_owned()))
    }
}

impl TryFrom<String> for UserName {
    type Error = UserNameError;

    fn try_from(text: String) -> Result<Self, UserNameError> {
        check(&text)?;
        Ok(Self(text))
    }
}

impl From<UserName> for String {
    fn from(name: UserName) -> Self {
        name.0
    }
}
