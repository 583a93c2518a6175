//! Gates: what a release was tried on before it goes to robots, as a signed report in a file beside the release.
//!
//! A [`GateReport`] says which program was run on which scenarios and recordings, what came of it, and whether that is
//! enough. Whoever has the key that releases are signed with signs it too ([`sign`]); [`open`] believes nothing before
//! the signature has been verified, and then reads strictly.
//!
//! | offset | bytes | what |
//! |---|---|---|
//! | 0 | 4 | `TCG` and the version of this format, 1 |
//! | 4 | 8 | id of the key |
//! | 12 | 64 | signature: ECDSA with P-256 and SHA-256, r and s, over [`DOMAIN`] and the report |
//! | 76 | behind it | the report: one JSON object, in the one spelling that it has |
//!
//! A signature over a report is none over a manifest, and the other way round: no manifest begins as [`DOMAIN`] does.

mod envelope;
mod report;

pub use envelope::{DOMAIN, GATE_MAX, GateFault, check, open, sign, signer, unverified};
pub use report::{
    Bound, Digest, Estimate, Evaluated, Evaluator, Finding, GATE_FORMAT, GateReport, MAX_ITEMS,
    MAX_NAME, MAX_REASON, PANIC, Parted, Replayed, ReportFault, Threshold, rounded,
};
