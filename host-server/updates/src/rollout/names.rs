//! Names of rollouts, releases, builds, boards and servers. A value of one of these types is a valid name.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Why a text is not a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum NameError {
    /// Nothing between the quotes.
    Empty,
    /// More bytes than a name of this kind may have, which are so many.
    TooLong(usize),
    /// Something other than letters and digits of ASCII, `-`, `_`, `.` and `+`.
    Alphabet,
}

impl fmt::Display for NameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("the name is empty"),
            Self::TooLong(most) => write!(f, "the name is longer than {most} bytes"),
            Self::Alphabet => {
                f.write_str("a name has letters, digits, '-', '_', '.' and '+', nothing else")
            }
        }
    }
}

impl std::error::Error for NameError {}

fn check(text: &str, most: usize) -> Result<(), NameError> {
    if text.is_empty() {
        return Err(NameError::Empty);
    }
    if text.len() > most {
        return Err(NameError::TooLong(most));
    }
    let fine = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.+".contains(&byte);
    if text.bytes().all(fine) {
        Ok(())
    } else {
        Err(NameError::Alphabet)
    }
}

macro_rules! name {
    ($(#[$doc:meta])* $name:ident, $most:expr) => {
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
        #[serde(try_from = "String", into = "String")]
        $(#[$doc])*
        pub struct $name(String);

        impl $name {
            /// The most bytes that such a name has.
            pub const MOST_BYTES: usize = $most;

            /// Checks `text` and takes a copy of it.
            ///
            /// # Errors
            /// [`NameError`] when `text` is empty, too long or leaves the alphabet.
            pub fn new(text: &str) -> Result<Self, NameError> {
                check(text, Self::MOST_BYTES)?;
                Ok(Self(text.to_owned()))
            }

            /// The name as text.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl FromStr for $name {
            type Err = NameError;

            fn from_str(text: &str) -> Result<Self, NameError> {
                Self::new(text)
            }
        }

        impl TryFrom<String> for $name {
            type Error = NameError;

            fn try_from(text: String) -> Result<Self, NameError> {
                check(&text, Self::MOST_BYTES)?;
                Ok(Self(text))
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> Self {
                name.0
            }
        }
    };
}

name!(
    /// A rollout.
    RolloutId,
    32
);
name!(
    /// A release: one signed image for one board.
    ReleaseId,
    64
);
name!(
    /// What a robot tells of the program, or the model, that it runs: no two builds have the same.
    BuildId,
    64
);
name!(
    /// A board, as robots report theirs.
    BoardName,
    16
);
name!(
    /// The version of a release, for people.
    Version,
    32
);
name!(
    /// A server of the fleet.
    ServerId,
    64
);
name!(
    /// A stable code with which a robot says why.
    #[schema(as = UpdateCode)]
    Code,
    32
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_names_are_names() {
        for (text, want) in [
            ("sim", Ok(())),
            ("esp32-c3", Ok(())),
            ("0.4.0+a_b", Ok(())),
            ("", Err(NameError::Empty)),
            ("a b", Err(NameError::Alphabet)),
            ("ä", Err(NameError::Alphabet)),
            ("a\0", Err(NameError::Alphabet)),
            ("12345678901234567", Err(NameError::TooLong(16))),
        ] {
            assert_eq!(BoardName::new(text).map(|_| ()), want, "{text:?}");
            let stored = serde_json::to_string(text).unwrap();
            let read = serde_json::from_str::<BoardName>(&stored);
            assert_eq!(read.is_ok(), want.is_ok(), "{text:?}");
        }
    }
}
