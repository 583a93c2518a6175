//! The form, as a browser sends it: `application/x-www-form-urlencoded`.

use core::fmt;

use heapless::{String, Vec};

/// Longest value that is kept, in bytes: longer than any field may be, so that a person sees
/// what was entered beside the word that it is too long.
pub(super) const VALUE_MAX: usize = 80;

/// A body that is not this form. No browser sends it from the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum FormError {
    /// A percent sign without two hexadecimal digits, a byte that has to be escaped, or bytes
    /// that are not UTF-8.
    Encoding,
    /// A field that the form does not have.
    Unknown,
    /// A field twice.
    Twice,
}

/// What was entered in one field.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Value {
    text: String<VALUE_MAX>,
    cut: bool,
}

impl Value {
    /// What is shown in a field; a longer text is cut.
    pub(super) fn shown(text: &str) -> Self {
        let mut value = Self::default();
        for letter in text.chars() {
            if value.text.push(letter).is_err() {
                value.cut = true;
                break;
            }
        }
        value
    }

    /// The text, or its first part when it is too long.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.text
    }

    /// Whether more was entered than any field takes.
    #[must_use]
    pub const fn is_cut(&self) -> bool {
        self.cut
    }

    /// Whether nothing was entered.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.text.is_empty()
    }
}

/// Names of the fields, in the order of the page.
pub(super) const NAMES: [&str; 11] = [
    "token",
    "ssid",
    "wifi_password",
    "wifi_open",
    "broker",
    "authority",
    "id",
    "fleet",
    "username",
    "password",
    "ranger",
];

/// What was entered in all fields. `Debug` tells neither passwords nor the token.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct Form {
    /// Proof that the sender has read the page.
    pub token: Value,
    /// Name of the Wi-Fi network.
    pub ssid: Value,
    /// Password of the Wi-Fi network; empty keeps the stored one.
    pub wifi_password: Value,
    /// `1` for an open network.
    pub wifi_open: Value,
    /// Broker, as `host` or `host:port`.
    pub broker: Value,
    /// Key of the authority that has signed the broker's certificate; empty without TLS.
    pub authority: Value,
    /// Name of the robot.
    pub id: Value,
    /// Name of the fleet.
    pub fleet: Value,
    /// User name for the broker.
    pub username: Value,
    /// Password for the broker; empty keeps the stored one.
    pub password: Value,
    /// `uart` or `pulse`.
    pub ranger: Value,
}

impl fmt::Debug for Form {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Form")
            .field("ssid", &self.ssid)
            .field("wifi_open", &self.wifi_open)
            .field("broker", &self.broker)
            .field("authority", &self.authority)
            .field("id", &self.id)
            .field("fleet", &self.fleet)
            .field("username", &self.username)
            .field("ranger", &self.ranger)
            .finish_non_exhaustive()
    }
}

impl Form {
    /// Reads a body. A field that is not there is empty.
    ///
    /// # Errors
    /// [`FormError`].
    pub fn parse(body: &[u8]) -> Result<Self, FormError> {
        let mut form = Self::default();
        let mut seen = [false; NAMES.len()];
        for pair in body.split(|byte| *byte == b'&') {
            if pair.is_empty() {
                continue;
            }
            let split = pair.iter().position(|byte| *byte == b'=');
            let (name, value) = split.map_or((pair, &[][..]), |at| (&pair[..at], &pair[at + 1..]));
            let index = NAMES
                .iter()
                .position(|known| known.as_bytes() == name)
                .ok_or(FormError::Unknown)?;
            if core::mem::replace(&mut seen[index], true) {
                return Err(FormError::Twice);
            }
            *form.field(index) = decode(value)?;
        }
        Ok(form)
    }

    fn field(&mut self, index: usize) -> &mut Value {
        match index {
            0 => &mut self.token,
            1 => &mut self.ssid,
            2 => &mut self.wifi_password,
            3 => &mut self.wifi_open,
            4 => &mut self.broker,
            5 => &mut self.authority,
            6 => &mut self.id,
            7 => &mut self.fleet,
            8 => &mut self.username,
            9 => &mut self.password,
            _ => &mut self.ranger,
        }
    }
}

/// Undoes the encoding of one value.
fn decode(raw: &[u8]) -> Result<Value, FormError> {
    let mut bytes: Vec<u8, VALUE_MAX> = Vec::new();
    let mut value = Value::default();
    let mut rest = raw.iter();
    while let Some(byte) = rest.next() {
        let byte = match byte {
            b'+' => b' ',
            b'%' => {
                let mut digit = || rest.next().and_then(|digit| hex(*digit));
                match (digit(), digit()) {
                    (Some(high), Some(low)) => high << 4 | low,
                    _ => return Err(FormError::Encoding),
                }
            }
            b'!'..=b'~' => *byte,
            _ => return Err(FormError::Encoding),
        };
        value.cut |= bytes.push(byte).is_err();
    }
    let text = match core::str::from_utf8(&bytes) {
        Ok(text) => text,
        // The cut may have gone through a character.
        Err(error) if value.cut && error.error_len().is_none() => bytes
            .get(..error.valid_up_to())
            .and_then(|whole| core::str::from_utf8(whole).ok())
            .unwrap_or_default(),
        Err(_) => return Err(FormError::Encoding),
    };
    // As long as the bytes it is made from.
    value.text = String::try_from(text).unwrap_or_default();
    Ok(value)
}

const fn hex(digit: u8) -> Option<u8> {
    match digit {
        b'0'..=b'9' => Some(digit - b'0'),
        b'a'..=b'f' => Some(digit - b'a' + 10),
        b'A'..=b'F' => Some(digit - b'A' + 10),
        _ => None,
    }
}
