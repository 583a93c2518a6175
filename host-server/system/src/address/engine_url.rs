//! The addresses of engines that take over what is built in: database, time series, cache.

use std::fmt;
use std::marker::PhantomData;
use std::str::FromStr;

/// A kind of engine: what its addresses begin with.
pub trait Engine {
    /// Without and with TLS.
    const SCHEMES: [&'static str; 2];
    /// An address as an example.
    const EXAMPLE: &'static str;
}

/// Keeps the records: accounts, credentials, audit log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Postgres {}
/// Keeps the history: whatever takes `InfluxDB`'s line protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Influx {}
/// Holds what several servers must agree on quickly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Redis {}

impl Engine for Postgres {
    const SCHEMES: [&'static str; 2] = ["postgres", "postgresql"];
    const EXAMPLE: &'static str = "postgres://user:password@host/database";
}
impl Engine for Influx {
    const SCHEMES: [&'static str; 2] = ["influx", "influxs"];
    const EXAMPLE: &'static str = "influx://host:8086/database";
}
impl Engine for Redis {
    const SCHEMES: [&'static str; 2] = ["redis", "rediss"];
    const EXAMPLE: &'static str = "redis://host:6379";
}

/// The address of an engine. What follows the scheme is for the engine's client to read.
///
/// Shown without user name, password and parameters, since addresses are printed and logged.
pub struct EngineUrl<E> {
    text: String,
    engine: PhantomData<E>,
}

/// The text does not begin as addresses of this engine do, or names no host.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoEngineUrl(&'static str);

impl fmt::Display for NoEngineUrl {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "must be an address like {}", self.0)
    }
}

impl std::error::Error for NoEngineUrl {}

impl<E> EngineUrl<E> {
    /// The whole address, with the password: not for showing.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.text
    }

    /// What the address begins with.
    #[must_use]
    pub fn scheme(&self) -> &str {
        self.text.split("://").next().unwrap_or_default()
    }
}

impl<E: Engine> FromStr for EngineUrl<E> {
    type Err = NoEngineUrl;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let known = text
            .split_once("://")
            .filter(|(scheme, _)| E::SCHEMES.contains(scheme))
            .filter(|(_, rest)| !place(rest).is_empty())
            .filter(|_| !text.contains(|c: char| c.is_control() || c.is_whitespace()));
        match known {
            Some(_) => Ok(Self {
                text: text.to_owned(),
                engine: PhantomData,
            }),
            None => Err(NoEngineUrl(E::EXAMPLE)),
        }
    }
}

/// Host, port and name of the database, of what follows the scheme.
fn place(rest: &str) -> &str {
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    rest.rsplit_once('@').map_or(rest, |(_, place)| place)
}

impl<E> fmt::Display for EngineUrl<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scheme, rest) = self.text.split_once("://").unwrap_or(("", &self.text));
        write!(f, "{scheme}://{}", place(rest))
    }
}

impl<E> fmt::Debug for EngineUrl<E> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl<E> Clone for EngineUrl<E> {
    fn clone(&self) -> Self {
        Self {
            text: self.text.clone(),
            engine: PhantomData,
        }
    }
}

impl<E> PartialEq for EngineUrl<E> {
    fn eq(&self, other: &Self) -> bool {
        self.text == other.text
    }
}

impl<E> Eq for EngineUrl<E> {}

impl<'de, E: Engine> serde::Deserialize<'de> for EngineUrl<E> {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        text.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shown_has_no_password() {
        let url: EngineUrl<Postgres> = "postgres://ada:p@ss@db.example:5432/fleet?sslmode=require"
            .parse()
            .expect("an address");
        assert_eq!(url.to_string(), "postgres://db.example:5432/fleet");
        assert_eq!(format!("{url:?}"), url.to_string());
        assert!(url.reveal().contains("p@ss"));
    }

    #[test]
    fn another_engine_is_refused() {
        for text in [
            "",
            "redis://",
            "redis://?x",
            "http://host",
            "redis:/host",
            "redis://ho st",
        ] {
            assert!(text.parse::<EngineUrl<Redis>>().is_err(), "{text}");
        }
        assert!("influxs://host/x".parse::<EngineUrl<Influx>>().is_ok());
    }
}
