//! A report with its signature.

use std::fmt;

use crawler_release::{KeyId, PublicKey, SIGNATURE, image_hash};

use super::report::{GATE_FORMAT, GateReport, ReportFault};
use crate::release::SecretKey;

/// Most bytes of a file with a report.
pub const GATE_MAX: usize = 32 * 1024;

/// What is signed before the report, so that nothing else that is signed can be taken for one.
pub const DOMAIN: &[u8] = b"terracrawler gate 1\0";

/// How a file begins; the last byte is the version of its format.
const MAGIC: [u8; 4] = *b"TCG\x01";

/// Why a report is not believed, or does not say enough.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum GateFault {
    /// More than [`GATE_MAX`] bytes.
    Oversize,
    /// It does not begin as one does, or is cut off.
    NoReport,
    /// Nobody is believed: no public key was given.
    NoKey,
    /// It is signed with a key that is not believed.
    UnknownKey(KeyId),
    /// It was changed, or its signature belongs to another.
    BadSignature,
    /// It is signed, and cannot be read: what is wrong with it.
    Malformed(String),
    /// Its parts are outside of their limits, or contradict each other.
    Contradiction(ReportFault),
    /// It is about another release: this one.
    OtherRelease(String),
    /// It says that the release did not pass.
    Failed,
}

impl GateFault {
    /// A stable name.
    #[must_use]
    pub const fn code(&self) -> &'static str {
        match self {
            Self::Oversize => "gate_too_large",
            Self::NoReport => "no_report",
            Self::NoKey => "gate_no_key",
            Self::UnknownKey(_) => "gate_unknown_key",
            Self::BadSignature => "gate_bad_signature",
            Self::Malformed(_) | Self::Contradiction(_) => "gate_malformed",
            Self::OtherRelease(_) => "gate_other_release",
            Self::Failed => "gate_failed",
        }
    }
}

impl fmt::Display for GateFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Oversize => write!(f, "a report has at most {GATE_MAX} bytes"),
            Self::NoReport => f.write_str("not a report of `release gate`, or cut off"),
            Self::NoKey => f.write_str("the report was not verified: no public key was given"),
            Self::UnknownKey(key) => write!(
                f,
                "the report is signed with key {key}, which is not believed"
            ),
            Self::BadSignature => f.write_str("the report was changed after it was signed"),
            Self::Malformed(what) => write!(f, "the report cannot be read: {what}"),
            Self::Contradiction(fault) => write!(f, "the report cannot be: {fault}"),
            Self::OtherRelease(release) => write!(f, "the report is about release {release}"),
            Self::Failed => f.write_str("the release did not pass what it was tried on"),
        }
    }
}

impl std::error::Error for GateFault {}

fn hash(body: &[u8]) -> [u8; 32] {
    image_hash(&[DOMAIN, body].concat())
}

fn encoded(report: &GateReport) -> Result<Vec<u8>, GateFault> {
    serde_json::to_vec(report).map_err(|error| GateFault::Malformed(error.to_string()))
}

/// A report in one file, signed. The same report and key give the same bytes.
///
/// # Errors
/// [`GateFault::Contradiction`] for a report that nobody would believe, [`GateFault::Oversize`].
pub fn sign(report: &GateReport, key: &SecretKey) -> Result<Vec<u8>, GateFault> {
    report.validate().map_err(GateFault::Contradiction)?;
    let body = encoded(report)?;
    let signature = key.sign(&hash(&body));
    let parts: [&[u8]; 4] = [&MAGIC, &key.public().id().0, &signature, &body];
    let file = parts.concat();
    if file.len() > GATE_MAX {
        return Err(GateFault::Oversize);
    }
    Ok(file)
}

/// The parts of a file: key, signature, report.
fn split(file: &[u8]) -> Result<(KeyId, &[u8; SIGNATURE], &[u8]), GateFault> {
    if file.len() > GATE_MAX {
        return Err(GateFault::Oversize);
    }
    let rest = match file.split_first_chunk() {
        Some((magic, rest)) if *magic == MAGIC => rest,
        _ => return Err(GateFault::NoReport),
    };
    let (key, rest) = rest.split_first_chunk().ok_or(GateFault::NoReport)?;
    let (signature, body) = rest.split_first_chunk().ok_or(GateFault::NoReport)?;
    Ok((KeyId(*key), signature, body))
}

/// The report of somebody, to be shown and not to be acted on: whoever has kept it has verified it, or nobody has.
///
/// # Errors
/// [`GateFault`] says why it cannot be read.
pub fn unverified(file: &[u8]) -> Result<GateReport, GateFault> {
    read(split(file)?.2)
}

/// The key that a report says it is signed with.
///
/// # Errors
/// [`GateFault::Oversize`], [`GateFault::NoReport`].
pub fn signer(file: &[u8]) -> Result<KeyId, GateFault> {
    split(file).map(|(key, ..)| key)
}

/// The report in a file, if one of `keys` has signed it. Whether it is about the right release, and says that this
/// passed, is for [`check`].
///
/// # Errors
/// [`GateFault`] says why it is not believed.
pub fn open(file: &[u8], keys: &[PublicKey]) -> Result<GateReport, GateFault> {
    let (id, signature, body) = split(file)?;
    if keys.is_empty() {
        return Err(GateFault::NoKey);
    }
    let key = keys.iter().find(|key| key.id() == id);
    let key = key.ok_or(GateFault::UnknownKey(id))?;
    if !key.signed(&hash(body), signature) {
        return Err(GateFault::BadSignature);
    }
    read(body)
}

/// The report in a file that is about `release`, if one of `keys` has signed it. It may say that the release failed.
///
/// # Errors
/// [`GateFault`] says why it is not believed.
pub fn check(file: &[u8], keys: &[PublicKey], release: &str) -> Result<GateReport, GateFault> {
    let report = open(file, keys)?;
    if report.release != release {
        return Err(GateFault::OtherRelease(report.release));
    }
    Ok(report)
}

/// Reads what was signed. A report has one spelling, so that what was signed and what is believed are the same.
fn read(body: &[u8]) -> Result<GateReport, GateFault> {
    let report: GateReport =
        serde_json::from_slice(body).map_err(|error| GateFault::Malformed(error.to_string()))?;
    if report.format != GATE_FORMAT {
        let what = format!("format {} is not known, only {GATE_FORMAT}", report.format);
        return Err(GateFault::Malformed(what));
    }
    report.validate().map_err(GateFault::Contradiction)?;
    if encoded(&report)? == body {
        Ok(report)
    } else {
        Err(GateFault::Malformed("another spelling of it".to_owned()))
    }
}
