//! What a robot is told about itself in one line of text: `id=virt-01 broker=10.0.2.2:1883`.
//!
//! | word | default | meaning |
//! |---|---|---|
//! | `id=` | `virt-01` | name of the robot |
//! | `fleet=` | `swarm` | its fleet |
//! | `broker=` | `10.0.2.2:1883` | host name or IPv4 address of the broker, and its port |
//! | `authority=` | none | who has signed the broker's certificate: with it everything is said over TLS |
//! | `user=`, `password=` | none | credentials for the broker; either alone is an error |
//! | `fault=` | none | comma-separated faults of the body, see [`Faults`] |
//! | `provision=` | `0` | `1` asks for set-up before anything else |
//! | `bench=` | `0` | `1` takes faults from the network as well |
//!
//! Words are separated by blanks. A word that is unknown, comes twice or makes no sense is an
//! error: a robot that started as somebody else would be worse than one that does not start.

use core::fmt;

use crawler_app::Credentials;
use crawler_protocol::{Fleet, RobotId};
use crawler_tls::Authority;
use heapless::String;

/// Port of a broker that none is said of.
pub const MQTT_PORT: u16 = 1_883;
/// Longest time after which a fault may strike, in seconds.
pub const LATEST_FAULT_S: u16 = 3_600;

/// What was understood.
#[derive(Debug, Clone, PartialEq)]
pub struct Arguments {
    /// Name of the robot.
    pub id: RobotId,
    /// Its fleet.
    pub fleet: Fleet,
    /// Host name or address of the broker.
    pub broker_host: String<64>,
    /// Its port.
    pub broker_port: u16,
    /// Who has signed the broker's certificate; without it nothing is encrypted.
    pub authority: Option<Authority>,
    /// What the broker asks for.
    pub credentials: Option<Credentials>,
    /// What is wrong with the body.
    pub faults: Faults,
    /// Whether set-up is asked for.
    pub provision: bool,
    /// Whether faults are taken from the network.
    pub bench: bool,
}

/// What is wrong with a body in software. Everything works by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
// Each is a switch of its own; any of them go together.
#[allow(clippy::struct_excessive_bools)]
pub struct Faults {
    /// `ranger-dead`: nothing answers on the ranger's line.
    pub ranger_dead: bool,
    /// `line-stuck`: the ranger's line is low: bytes of zero arrive without end.
    pub line_stuck: bool,
    /// `flash-noise`: the parameter region is full of noise when the program starts.
    pub flash_noise: bool,
    /// `flash-refuses`: the flash reports an error for each write and erasure.
    pub flash_refuses: bool,
    /// `hang@S`: S seconds after power-on the program stops turning.
    pub hang_s: Option<u16>,
    /// `panic@S`: S seconds after power-on the program panics.
    pub panic_s: Option<u16>,
    /// `trial-panic@S`: S seconds after each start of a program on trial it panics.
    pub trial_panic_s: Option<u16>,
}

/// Why a line is not understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ArgumentError {
    /// A word without `=`.
    NotAPair,
    /// A key nobody knows.
    UnknownKey,
    /// A key that was there before.
    Twice(&'static str),
    /// A value that its key does not take.
    Value(&'static str),
    /// A user name without a password, or the other way round.
    HalfACredential,
}

impl fmt::Display for ArgumentError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotAPair => f.write_str("a word is not of the form key=value"),
            Self::UnknownKey => f.write_str(
                "a key is unknown: there are id, fleet, broker, authority, user, password, fault, \
                 provision, bench",
            ),
            Self::Twice(key) => write!(f, "{key} is there twice"),
            Self::Value(key) => write!(f, "the value of {key} makes no sense"),
            Self::HalfACredential => f.write_str("user and password go together"),
        }
    }
}

impl core::error::Error for ArgumentError {}

/// Words as they stand in the line.
#[derive(Default)]
struct Words<'a> {
    id: Option<&'a str>,
    fleet: Option<&'a str>,
    broker: Option<&'a str>,
    authority: Option<&'a str>,
    user: Option<&'a str>,
    password: Option<&'a str>,
    fault: Option<&'a str>,
    provision: Option<&'a str>,
    bench: Option<&'a str>,
}

impl<'a> Words<'a> {
    fn new(line: &'a str) -> Result<Self, ArgumentError> {
        let mut words = Self::default();
        for word in line.split_ascii_whitespace() {
            let (key, value) = word.split_once('=').ok_or(ArgumentError::NotAPair)?;
            let (name, place) = match key {
                "id" => ("id", &mut words.id),
                "fleet" => ("fleet", &mut words.fleet),
                "broker" => ("broker", &mut words.broker),
                "authority" => ("authority", &mut words.authority),
                "user" => ("user", &mut words.user),
                "password" => ("password", &mut words.password),
                "fault" => ("fault", &mut words.fault),
                "provision" => ("provision", &mut words.provision),
                "bench" => ("bench", &mut words.bench),
                _ => return Err(ArgumentError::UnknownKey),
            };
            if place.replace(value).is_some() {
                return Err(ArgumentError::Twice(name));
            }
        }
        Ok(words)
    }
}

impl Arguments {
    /// Reads a line.
    ///
    /// # Errors
    /// See [`ArgumentError`]; the first thing that is wrong counts.
    pub fn parse(line: &str) -> Result<Self, ArgumentError> {
        let words = Words::new(line)?;
        let (broker_host, broker_port) = broker(words.broker.unwrap_or("10.0.2.2"))?;
        let credentials = match (words.user, words.password) {
            (None, None) => None,
            (Some(user), Some(password)) if !user.is_empty() => Some(Credentials {
                username: text(user, "user")?,
                password: text(password, "password")?,
            }),
            (Some(_), Some(_)) => return Err(ArgumentError::Value("user")),
            _ => return Err(ArgumentError::HalfACredential),
        };
        let authority = words.authority.map(str::parse).transpose();
        let authority = authority.map_err(|_| ArgumentError::Value("authority"))?;
        let id = RobotId::new(words.id.unwrap_or("virt-01"));
        let fleet = Fleet::new(words.fleet.unwrap_or("swarm"));
        Ok(Self {
            id: id.map_err(|_| ArgumentError::Value("id"))?,
            fleet: fleet.map_err(|_| ArgumentError::Value("fleet"))?,
            broker_host,
            broker_port,
            authority,
            credentials,
            faults: words.fault.map_or(Ok(Faults::default()), faults)?,
            provision: switch(words.provision, "provision")?,
            bench: switch(words.bench, "bench")?,
        })
    }
}

fn switch(value: Option<&str>, key: &'static str) -> Result<bool, ArgumentError> {
    match value {
        None | Some("0") => Ok(false),
        Some("1") => Ok(true),
        Some(_) => Err(ArgumentError::Value(key)),
    }
}

fn text<const N: usize>(value: &str, key: &'static str) -> Result<String<N>, ArgumentError> {
    String::try_from(value).map_err(|_| ArgumentError::Value(key))
}

fn broker(value: &str) -> Result<(String<64>, u16), ArgumentError> {
    const WRONG: ArgumentError = ArgumentError::Value("broker");
    let (host, port) = match value.split_once(':') {
        None => (value, MQTT_PORT),
        Some((host, port)) => (host, decimal(port).ok_or(WRONG)?),
    };
    let letters = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b'_');
    if host.is_empty() || !host.bytes().all(letters) || port == 0 {
        return Err(WRONG);
    }
    Ok((text(host, "broker")?, port))
}

fn faults(value: &str) -> Result<Faults, ArgumentError> {
    const WRONG: ArgumentError = ArgumentError::Value("fault");
    let mut faults = Faults::default();
    for name in value.split(',') {
        let (name, after_s) = match name.split_once('@') {
            None => (name, None),
            Some((name, s)) => {
                let s = decimal(s).filter(|s| *s <= LATEST_FAULT_S);
                (name, Some(s.ok_or(WRONG)?))
            }
        };
        match (name, after_s) {
            ("ranger-dead", None) => faults.ranger_dead = true,
            ("line-stuck", None) => faults.line_stuck = true,
            ("flash-noise", None) => faults.flash_noise = true,
            ("flash-refuses", None) => faults.flash_refuses = true,
            ("hang", Some(_)) => faults.hang_s = after_s,
            ("panic", Some(_)) => faults.panic_s = after_s,
            ("trial-panic", Some(_)) => faults.trial_panic_s = after_s,
            _ => return Err(WRONG),
        }
    }
    Ok(faults)
}

/// Digits alone: the standard parser would take a sign.
fn decimal(text: &str) -> Option<u16> {
    let digits = text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::testing::AUTHORITY;
    use proptest::prelude::*;
    use std::format;

    #[test]
    fn everything_has_a_default() {
        let arguments = Arguments::parse("").expect("nothing is asked for");
        assert_eq!(arguments.id.as_str(), "virt-01");
        assert_eq!(arguments.fleet.as_str(), "swarm");
        assert_eq!(arguments.broker_host, "10.0.2.2");
        assert_eq!(arguments.broker_port, MQTT_PORT);
        assert_eq!((arguments.credentials, arguments.authority), (None, None));
        assert_eq!(arguments.faults, Faults::default());
        assert!(!arguments.provision && !arguments.bench);
    }

    #[test]
    fn every_word_is_understood() {
        let line = " id=r-7  fleet=lab broker=broker.lan:8883 user=u password=p=q \
                    fault=ranger-dead,panic@5,trial-panic@6 provision=1 bench=1";
        let line = format!("{line} authority={AUTHORITY}");
        let arguments = Arguments::parse(&line).expect("a good line");
        assert_eq!(arguments.id.as_str(), "r-7");
        assert_eq!(arguments.fleet.as_str(), "lab");
        assert_eq!(arguments.broker_host, "broker.lan");
        assert_eq!(arguments.broker_port, 8_883);
        let credentials = arguments.credentials.expect("some");
        assert_eq!(credentials.username, "u");
        assert_eq!(credentials.password, "p=q");
        let authority = arguments.authority.expect("some");
        assert_eq!(format!("{authority}"), AUTHORITY);
        assert!(arguments.faults.ranger_dead && !arguments.faults.line_stuck);
        assert_eq!(arguments.faults.panic_s, Some(5));
        assert_eq!(arguments.faults.trial_panic_s, Some(6));
        assert!(arguments.provision && arguments.bench);
    }

    #[test]
    fn what_makes_no_sense_is_named() {
        use ArgumentError::{HalfACredential, NotAPair, Twice, UnknownKey, Value};
        for (line, error) in [
            ("id", NotAPair),
            ("ID=a", UnknownKey),
            ("colour=red", UnknownKey),
            ("id=a id=b", Twice("id")),
            ("id=", Value("id")),
            ("id=A", Value("id")),
            ("id=ö", Value("id")),
            ("fleet=a/b", Value("fleet")),
            ("broker=", Value("broker")),
            ("broker=:1883", Value("broker")),
            ("broker=h:", Value("broker")),
            ("broker=h:0", Value("broker")),
            ("broker=h:+1", Value("broker")),
            ("broker=h:65536", Value("broker")),
            ("broker=mqtt://h", Value("broker")),
            ("authority=", Value("authority")),
            ("authority=02", Value("authority")),
            ("user=u", HalfACredential),
            ("password=p", HalfACredential),
            ("user= password=p", Value("user")),
            ("fault=", Value("fault")),
            ("fault=ranger-dead,", Value("fault")),
            ("fault=panic", Value("fault")),
            ("fault=panic@3601", Value("fault")),
            ("fault=line-stuck@5", Value("fault")),
            ("provision=yes", Value("provision")),
            ("bench=on", Value("bench")),
        ] {
            assert_eq!(Arguments::parse(line), Err(error), "{line}");
        }
        let long = format!("user=u password={}", "p".repeat(65));
        assert_eq!(Arguments::parse(&long), Err(Value("password")));
        let long = format!("broker={}", "h".repeat(65));
        assert_eq!(Arguments::parse(&long), Err(Value("broker")));
    }

    proptest! {
        #[test]
        fn no_line_makes_it_panic(line in "(id|fault|broker|user|=|:|@|,|[ -~]|\\PC){0,24}") {
            let _ = Arguments::parse(&line);
        }

        #[test]
        fn a_good_line_is_taken_as_it_stands(
            id in "[a-z0-9-]{1,32}", host in "[a-z0-9.-]{1,64}", port in 1_u16..,
        ) {
            let arguments = Arguments::parse(&format!("id={id} broker={host}:{port}"))?;
            prop_assert_eq!(arguments.id.as_str(), id.as_str());
            prop_assert_eq!(arguments.broker_host.as_str(), host.as_str());
            prop_assert_eq!(arguments.broker_port, port);
        }
    }
}
