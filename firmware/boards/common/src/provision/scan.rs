//! Networks nearby.

use core::fmt;

use heapless::{String, Vec};

use super::http::Render;

/// Most networks that are shown. The strongest are kept.
pub const MAX_NETWORKS: usize = 16;

/// A network that a scan has found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Nearby {
    /// Its name: UTF-8, as far as it could be read as such.
    pub ssid: String<32>,
    /// Strength of its signal.
    pub rssi_dbm: i8,
    /// Whether it asks for no password.
    pub open: bool,
}

/// What a scan has found: each name once, the strongest first.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Networks(Vec<Nearby, MAX_NETWORKS>);

impl Networks {
    /// Nothing found yet.
    #[must_use]
    pub const fn new() -> Self {
        Self(Vec::new())
    }

    /// Adds a network, at its place. One without a name is not of use to a person, and of a name
    /// that several access points share the strongest counts.
    pub fn add(&mut self, nearby: Nearby) {
        if nearby.ssid.is_empty() {
            return;
        }
        if let Some(known) = self.0.iter().position(|other| other.ssid == nearby.ssid) {
            if self.0[known].rssi_dbm >= nearby.rssi_dbm {
                return;
            }
            self.0.remove(known);
        }
        let weaker = |other: &Nearby| other.rssi_dbm < nearby.rssi_dbm;
        let place = self.0.iter().position(weaker).unwrap_or(self.0.len());
        if self.0.is_full() {
            if place == self.0.len() {
                return;
            }
            self.0.pop();
        }
        // There is room now.
        let _ = self.0.insert(place, nearby);
    }

    /// The networks, the strongest first.
    pub fn iter(&self) -> impl Iterator<Item = &Nearby> {
        self.0.iter()
    }
}

/// A text as a JSON string.
struct Quoted<'a>(&'a str);

impl fmt::Display for Quoted<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        use fmt::Write as _;
        f.write_char('"')?;
        for letter in self.0.chars() {
            match letter {
                '"' | '\\' => write!(f, "\\{letter}")?,
                letter if (letter as u32) < 0x20 => write!(f, "\\u{:04x}", letter as u32)?,
                letter => f.write_char(letter)?,
            }
        }
        f.write_char('"')
    }
}

impl Render for Networks {
    fn render(&self, out: &mut dyn fmt::Write) -> fmt::Result {
        out.write_char('[')?;
        for (place, nearby) in self.0.iter().enumerate() {
            let comma = if place == 0 { "" } else { "," };
            write!(
                out,
                "{comma}{{\"ssid\":{},\"rssi_dbm\":{},\"open\":{}}}",
                Quoted(&nearby.ssid),
                nearby.rssi_dbm,
                nearby.open
            )?;
        }
        out.write_char(']')
    }
}

/// The radio could not look around: it is joining a network, or has failed. Try again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanFailed;

/// A radio that can look around.
pub trait Scanner {
    /// Looks for networks and adds what it finds.
    ///
    /// # Errors
    /// [`ScanFailed`].
    ///
    /// # Cancellation Safety
    /// A dropped call finds nothing; the next one starts anew.
    async fn scan(&mut self, networks: &mut Networks) -> Result<(), ScanFailed>;
}

/// No radio: a board with a cable.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoScanner;

impl Scanner for NoScanner {
    async fn scan(&mut self, _: &mut Networks) -> Result<(), ScanFailed> {
        Err(ScanFailed)
    }
}

impl<S: Scanner> Scanner for &mut S {
    async fn scan(&mut self, networks: &mut Networks) -> Result<(), ScanFailed> {
        S::scan(self, networks).await
    }
}
