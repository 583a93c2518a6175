//! Texts of the settings, and what can be wrong with what a person enters.

use core::fmt;

use crawler_app::Credentials;
use crawler_protocol::IdError;
use heapless::String;
use rand_core::Rng;

/// What is wrong with a value. Each variant is a different sentence to the person who entered it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Flaw {
    /// Nothing was entered where something is needed.
    Missing,
    /// More bytes than the field holds.
    TooLong,
    /// A Wi-Fi password of fewer than 8 characters.
    TooShort,
    /// A character that this field does not take.
    Character,
    /// Neither a host name nor an IPv4 address.
    Host,
    /// Not a TCP port.
    Port,
    /// Not the key of an authority.
    Authority,
    /// None of the choices.
    Choice,
    /// A password without a user name.
    NoUser,
    /// A new name without its password.
    NoPassword,
    /// A password for a network that is said to be open.
    Contradiction,
}

impl fmt::Display for Flaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Missing => "Please fill this in.",
            Self::TooLong => "This is too long.",
            Self::TooShort => "A Wi-Fi password has at least 8 characters.",
            Self::Character => "This contains a character that is not allowed here.",
            Self::Host => "This is neither a host name nor an IPv4 address.",
            Self::Port => "The port must be a number from 1 to 65535.",
            Self::Authority => "This is not the key of an authority: a digit is missing or wrong.",
            Self::Choice => "Please choose one of the options.",
            Self::NoUser => "A password needs a user name.",
            Self::NoPassword => "Please enter the password. A stored one is kept only for the same network, or the same user at the same broker.",
            Self::Contradiction => "Please either enter a password or tick that there is none.",
        })
    }
}

impl core::error::Error for Flaw {}

impl From<IdError> for Flaw {
    fn from(error: IdError) -> Self {
        match error {
            IdError::Empty => Self::Missing,
            IdError::TooLong => Self::TooLong,
            _ => Self::Character,
        }
    }
}

/// Copies `text` when it is neither empty nor longer than `N` bytes and holds no control
/// character: those are never meant, and do harm in logs and in the C strings of radio drivers.
fn plain<const N: usize>(text: &str) -> Result<String<N>, Flaw> {
    if text.is_empty() {
        return Err(Flaw::Missing);
    }
    if text.chars().any(char::is_control) {
        return Err(Flaw::Character);
    }
    String::try_from(text).map_err(|_| Flaw::TooLong)
}

/// Name of a Wi-Fi network: 1 to 32 bytes of UTF-8 without control characters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ssid(String<32>);

impl Ssid {
    /// Checks `text` and takes a copy of it.
    ///
    /// # Errors
    /// The [`Flaw`] of the text.
    pub fn new(text: &str) -> Result<Self, Flaw> {
        plain(text).map(Self)
    }

    /// The name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Password of a Wi-Fi network: 8 to 63 printable ASCII characters, or 64 hexadecimal digits for
/// the key itself (IEEE 802.11-2020, annex J.4.1). `Debug` hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct Passphrase(String<64>);

impl Passphrase {
    /// Checks `text` and takes a copy of it.
    ///
    /// # Errors
    /// The [`Flaw`] of the text.
    pub fn new(text: &str) -> Result<Self, Flaw> {
        if text.is_empty() {
            return Err(Flaw::Missing);
        }
        if !text.bytes().all(|byte| matches!(byte, b' '..=b'~')) {
            return Err(Flaw::Character);
        }
        match text.len() {
            0..8 => Err(Flaw::TooShort),
            64 if !text.bytes().all(|byte| byte.is_ascii_hexdigit()) => Err(Flaw::TooLong),
            _ => String::try_from(text).map(Self).map_err(|_| Flaw::TooLong),
        }
    }

    /// The password, for the radio.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

impl fmt::Debug for Passphrase {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Passphrase(…)")
    }
}

/// Checks a user name (1 to 32 bytes) and a password (1 to 64 bytes) for the broker.
///
/// # Errors
/// The [`Flaw`] of the name, or of the password, whichever is met first.
pub fn credentials(username: &str, password: &str) -> Result<Credentials, Flaw> {
    Ok(Credentials {
        username: plain(username)?,
        password: plain(password)?,
    })
}

/// Letters and digits that cannot be taken for each other on a label: no `0`, `1`, `i`, `l`, `o`.
const READABLE: &[u8; 31] = b"23456789abcdefghjkmnpqrstuvwxyz";
/// Three groups of four with a dash between them.
const ACCESS_POINT_PASSWORD: usize = 14;

/// Password of the robot's own access point, drawn at random once per device: 12 of 31 readable
/// characters, 59 bits, as `abcd-efgh-jkmn`.
///
/// `Debug` hides it: it is meant for the serial line and the label, nothing else.
#[derive(Clone, PartialEq, Eq)]
pub struct AccessPointPassword(String<ACCESS_POINT_PASSWORD>);

impl AccessPointPassword {
    /// Draws one. `rng` has to be the chip's true random generator.
    pub fn draw(rng: &mut impl Rng) -> Self {
        let mut text = String::new();
        for place in 0..ACCESS_POINT_PASSWORD {
            let letter = if place % 5 == 4 { b'-' } else { draw(rng) };
            // As many pushes as there is room for.
            let _ = text.push(char::from(letter));
        }
        Self(text)
    }

    /// Takes a stored one.
    ///
    /// # Errors
    /// [`Flaw::Character`] when it is not of the form that [`Self::draw`] makes.
    pub fn new(text: &str) -> Result<Self, Flaw> {
        let fits = |(place, letter): (usize, u8)| {
            if place % 5 == 4 {
                letter == b'-'
            } else {
                READABLE.contains(&letter)
            }
        };
        if text.len() != ACCESS_POINT_PASSWORD || !text.bytes().enumerate().all(fits) {
            return Err(Flaw::Character);
        }
        String::try_from(text).map(Self).map_err(|_| Flaw::TooLong)
    }

    /// The password, for the radio, the serial line and the label.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }
}

/// One readable character, each as likely as any other.
fn draw(rng: &mut impl Rng) -> u8 {
    loop {
        // Five bits at a time; one value of 32 has no character.
        let index = rng.next_u32() >> 27;
        if let Some(letter) = READABLE.get(index as usize) {
            return *letter;
        }
    }
}

impl fmt::Debug for AccessPointPassword {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("AccessPointPassword(…)")
    }
}
