//! The bodies of the fuzz targets, by name.
//!
//! `targets` lists them. They stand with what they try: `access`, `board`, `boot`, `bundle`, `delta`, `federated`, `gate`,
//! `models`, `policies`, `release`, `robots`, `simulator`, `tls` and `twins`.

mod access;
mod board;
mod boot;
mod bundle;
mod delta;
mod federated;
mod gate;
mod models;
mod policies;
mod release;
mod robots;
mod simulator;
mod targets;
mod tls;
mod twins;

pub use targets::{TARGETS, Target};

/// Runs the target of this name.
///
/// # Panics
/// When the target finds a fault, and when there is no target of this name.
pub fn run(target: &str, data: &[u8]) {
    let (_, body) = TARGETS
        .iter()
        .chain(&access::TARGETS)
        .chain(&board::TARGETS)
        .chain(&boot::TARGETS)
        .chain(&bundle::TARGETS)
        .chain(&delta::TARGETS)
        .chain(&federated::TARGETS)
        .chain(&gate::TARGETS)
        .chain(&models::TARGETS)
        .chain(&policies::TARGETS)
        .chain(&release::TARGETS)
        .chain(&robots::TARGETS)
        .chain(&simulator::TARGETS)
        .chain(&tls::TARGETS)
        .chain(&twins::TARGETS)
        .find(|(name, _)| *name == target)
        .expect("a target of this name");
    body(data);
}
