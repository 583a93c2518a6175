//! Status lamp: one lamp, one pattern per state and fault.

use core::fmt;

use crawler_hal::{Duration, Instant};
use embedded_hal::digital::{Error as _, ErrorKind, OutputPin};

/// What the lamp tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Pattern {
    /// The program is starting.
    Initializing,
    /// Standing, ready.
    Idle,
    /// Moving freely.
    Moving,
    /// Turning to look around.
    Scanning,
    /// Moving slowly: something is near, or the battery is low.
    Caution,
    /// Turning away from something.
    Avoiding,
    /// Taking a new program in.
    Updating,
    /// Standing, and someone has to come.
    Error,
    /// Someone asked which robot this is.
    Identify,
    /// The battery wants to be charged.
    LowBattery,
    /// No connection to the broker.
    NoLink,
    /// Standing, because the ranger is not to be trusted.
    RangerFault,
    /// Standing, because an output to the motors does not do what it is told.
    MotorFault,
    /// No network is joined.
    NoNetwork,
    /// The network refuses the password.
    NetworkPassword,
    /// The network hands out no address.
    NoAddress,
    /// The broker refuses name and password.
    BrokerRefuses,
    /// The broker has not proved who it is.
    BrokerUntrusted,
}

/// Longest repetition of any pattern: whoever looks this long has seen all of it.
pub const LONGEST_PERIOD: Duration = Duration::from_millis(3_000);

impl Pattern {
    /// Every pattern.
    pub const ALL: [Self; 18] = [
        Self::Initializing,
        Self::Idle,
        Self::Moving,
        Self::Scanning,
        Self::Caution,
        Self::Avoiding,
        Self::Updating,
        Self::Error,
        Self::Identify,
        Self::LowBattery,
        Self::NoLink,
        Self::RangerFault,
        Self::MotorFault,
        Self::NoNetwork,
        Self::NetworkPassword,
        Self::NoAddress,
        Self::BrokerRefuses,
        Self::BrokerUntrusted,
    ];

    /// The pattern as durations in milliseconds: lit, dark, lit, dark…, then again from the start.
    ///
    /// Their number is even and none is zero. Calm states are slow and mostly dark, to spare the
    /// battery; what needs a person is quick, or counted:
    ///
    /// - two flashes are a low battery, three are a lost link;
    /// - three flashes, then long ones, are a robot that stands: one long for the emergency stop,
    ///   two for the ranger, three for the motors;
    /// - one long flash, then short ones, count how far the way to the broker goes: one for no
    ///   network, two for a refused network password, three for no address, four for a broker
    ///   that refuses name and password, five for one that has not proved who it is.
    #[must_use]
    pub const fn table_ms(self) -> &'static [u16] {
        match self {
            Self::Initializing => &[500, 500],
            Self::Idle => &[60, 1_940],
            Self::Moving => &[800, 200],
            Self::Scanning => &[200, 200, 200, 800],
            Self::Caution => &[300, 300],
            Self::Avoiding => &[150, 150],
            Self::Updating => &[900, 100, 100, 100],
            Self::Error => &[100, 100, 100, 100, 100, 100, 700, 300],
            Self::Identify => &[60, 60],
            Self::LowBattery => &[100, 200, 100, 1_600],
            Self::NoLink => &[100, 200, 100, 200, 100, 1_300],
            Self::RangerFault => &[100, 100, 100, 100, 100, 100, 500, 200, 500, 300],
            Self::MotorFault => &[100, 100, 100, 100, 100, 100, 500, 200, 500, 200, 500, 300],
            Self::NoNetwork => &[600, 250, 100, 1_550],
            Self::NetworkPassword => &[600, 250, 100, 250, 100, 1_200],
            Self::NoAddress => &[600, 250, 100, 250, 100, 250, 100, 850],
            Self::BrokerRefuses => &[600, 250, 100, 250, 100, 250, 100, 250, 100, 900],
            Self::BrokerUntrusted => &[600, 250, 100, 250, 100, 250, 100, 250, 100, 250, 100, 650],
        }
    }

    /// How long the pattern takes until it repeats.
    #[must_use]
    pub fn period(self) -> Duration {
        let ms = self.table_ms().iter().map(|&ms| u64::from(ms)).sum();
        Duration::from_millis(ms)
    }
}

/// The lamp `elapsed` after the start of `pattern`: whether it is lit, and the time after the
/// start at which that changes next.
///
/// Pure. The next change is always later than `elapsed`, except at the very end of time, where it
/// saturates.
#[must_use]
pub fn level(pattern: Pattern, elapsed: Duration) -> (bool, Duration) {
    let elapsed_us = elapsed.as_micros();
    // No table is empty; `max` keeps the division safe without having to prove it here.
    let into_us = elapsed_us % pattern.period().as_micros().max(1);
    let mut lit = true;
    let mut end_us = 0;
    for &ms in pattern.table_ms() {
        end_us += u64::from(ms) * 1_000;
        if into_us < end_us {
            break;
        }
        lit = !lit;
    }
    let next = elapsed_us.saturating_add(end_us.saturating_sub(into_us));
    (lit, Duration::from_micros(next))
}

/// The pin of the lamp refused. There is nothing else to try: report it and go on without a lamp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LampError(pub ErrorKind);

impl fmt::Display for LampError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "lamp pin: {}", self.0)
    }
}

impl core::error::Error for LampError {}

/// A lamp on a pin; high is lit.
#[derive(Debug)]
pub struct Lamp<P> {
    pin: P,
    shown: Option<(Pattern, Instant)>,
}

impl<P: OutputPin> Lamp<P> {
    /// A lamp that shows nothing yet. Does no I/O.
    pub const fn new(pin: P) -> Self {
        Self { pin, shown: None }
    }

    /// Shows `pattern` as it is at `now`, and returns when to call again with the same pattern.
    /// A pattern other than the last starts from its beginning, so calling early, or often, is
    /// harmless.
    ///
    /// # Errors
    /// [`LampError`] when the pin refuses; the pattern goes on all the same, so the next call may
    /// succeed.
    pub fn show(&mut self, pattern: Pattern, now: Instant) -> Result<Instant, LampError> {
        let start = match self.shown {
            Some((shown, start)) if shown == pattern => start,
            Some(_) | None => now,
        };
        self.shown = Some((pattern, start));
        let (lit, next) = level(pattern, now - start);
        self.pin
            .set_state(lit.into())
            .map_err(|error| LampError(error.kind()))?;
        Ok(start + next)
    }
}

#[cfg(test)]
mod tests;
