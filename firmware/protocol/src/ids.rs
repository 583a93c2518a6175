//! Names of robots, fleets and controllers. A value of one of these types is a valid name.

use core::fmt;

use heapless::String;

/// Longest robot id or fleet name, in bytes.
pub const MAX_ID: usize = 32;
/// Longest name of a controller, in bytes.
pub const MAX_SOURCE: usize = 48;

/// Why a text is not a name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum IdError {
    /// Nothing between the quotes.
    Empty,
    /// More bytes than a name of this kind may have.
    TooLong,
    /// A character outside the alphabet of this kind of name.
    Alphabet,
}

impl fmt::Display for IdError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Empty => "the name is empty",
            Self::TooLong => "the name is too long",
            Self::Alphabet => "the name has a character that is not allowed",
        })
    }
}

impl core::error::Error for IdError {}

/// Whether a byte may be part of the name of a robot or a fleet: `a-z`, `0-9` and `-`.
#[must_use]
pub const fn is_id_byte(byte: u8) -> bool {
    matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-')
}

/// Printable ASCII that needs no escape in JSON.
const fn is_source_byte(byte: u8) -> bool {
    matches!(byte, b' '..=b'~') && byte != b'"' && byte != b'\\'
}

/// Takes a copy of `text`, when every byte of it is `allowed`.
///
/// # Errors
/// [`IdError`] when `text` is empty, longer than `N` bytes or leaves the alphabet.
pub fn checked<const N: usize>(
    text: &str,
    allowed: fn(u8) -> bool,
) -> Result<String<N, u8>, IdError> {
    if text.is_empty() {
        return Err(IdError::Empty);
    }
    if text.len() > N {
        return Err(IdError::TooLong);
    }
    if !text.bytes().all(allowed) {
        return Err(IdError::Alphabet);
    }
    String::try_from(text).map_err(|_| IdError::TooLong)
}

/// Declares a type of names: at most so many bytes of an alphabet, of which a function decides; what one
/// is, for people, and the same as a regular expression.
///
/// The crate depends on `heapless` and `serde`, and has a feature `schema` that brings `schemars` and
/// `std`.
#[macro_export]
macro_rules! identifier {
    ($(#[$doc:meta])* $name:ident, $max:expr, $allowed:expr, $expecting:literal, $pattern:literal) => {
        $(#[$doc])*
        #[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(::heapless::String<$max, u8>);

        impl $name {
            /// Checks `text` and takes a copy of it.
            ///
            /// # Errors
            /// [`IdError`]($crate::IdError) when `text` is empty, too long or leaves the alphabet.
            pub fn new(text: &str) -> Result<Self, $crate::IdError> {
                $crate::ids::checked(text, $allowed).map(Self)
            }

            /// The name as text.
            #[must_use]
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl AsRef<str> for $name {
            fn as_ref(&self) -> &str {
                &self.0
            }
        }

        impl core::fmt::Display for $name {
            fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                f.write_str(&self.0)
            }
        }

        impl core::str::FromStr for $name {
            type Err = $crate::IdError;

            fn from_str(text: &str) -> Result<Self, $crate::IdError> {
                Self::new(text)
            }
        }

        impl TryFrom<&str> for $name {
            type Error = $crate::IdError;

            fn try_from(text: &str) -> Result<Self, $crate::IdError> {
                Self::new(text)
            }
        }

        impl ::serde::Serialize for $name {
            fn serialize<S: ::serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&self.0)
            }
        }

        impl<'de> ::serde::Deserialize<'de> for $name {
            fn deserialize<D: ::serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct NameVisitor;

                impl ::serde::de::Visitor<'_> for NameVisitor {
                    type Value = $name;

                    fn expecting(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                        f.write_str($expecting)
                    }

                    fn visit_str<E: ::serde::de::Error>(self, text: &str) -> Result<$name, E> {
                        $name::new(text)
                            .map_err(|_| E::invalid_value(::serde::de::Unexpected::Str(text), &self))
                    }
                }

                deserializer.deserialize_str(NameVisitor)
            }
        }

        #[cfg(feature = "schema")]
        impl schemars::JsonSchema for $name {
            fn schema_name() -> std::borrow::Cow<'static, str> {
                stringify!($name).into()
            }

            fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
                schemars::json_schema!({
                    "description": $expecting,
                    "type": "string",
                    "minLength": 1,
                    "maxLength": $max,
                    "pattern": $pattern,
                })
            }
        }
    };
}

identifier!(
    /// The name of a robot: 1 to 32 characters of `a-z`, `0-9` and `-`.
    RobotId, MAX_ID, is_id_byte, "a robot id: 1 to 32 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);
identifier!(
    /// The root topic of a fleet: same alphabet as [`RobotId`]. The default is `swarm`.
    Fleet, MAX_ID, is_id_byte, "a fleet name: 1 to 32 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);
identifier!(
    /// The name of a policy: same alphabet as [`RobotId`].
    PolicyName, MAX_ID, is_id_byte, "the name of a policy: 1 to 32 characters of a-z, 0-9 and -", "^[a-z0-9-]+$"
);
identifier!(
    /// Who sent a command, such as `operator:ada`: 1 to 48 characters of printable ASCII
    /// without quotation mark and backslash.
    Source, MAX_SOURCE, is_source_byte,
    "a controller: 1 to 48 characters of printable ASCII without quotation mark and backslash",
    r"^[ !#-\[\]-~]+$"
);

impl Default for Fleet {
    fn default() -> Self {
        let mut name = String::new();
        // Five bytes always fit in 32.
        let _ = name.push_str("swarm");
        Self(name)
    }
}
