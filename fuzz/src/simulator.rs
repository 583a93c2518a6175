//! Fuzz target of what a simulated world is told. The fuzzer and the replay of its corpus in the tests of
//! `crawler-sim-protocol` include this file.

use crawler_protocol::{DecodeError, EncodeError, FaultCommand, MAX_MESSAGE};
use crawler_sim_protocol::SimulatorCommand;

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 1] = [("simulator_command", simulator_command)];

/// What is read survives being written and read again; what is no JSON is none to another parser; and a
/// robot takes from it what a simulator takes as a fault.
fn simulator_command(data: &[u8]) {
    let result = SimulatorCommand::from_json(data);
    if !matches!(result, Err(DecodeError::Malformed | DecodeError::TooLarge)) {
        let theirs = serde_json::from_slice::<serde::de::IgnoredAny>(data);
        assert!(theirs.is_ok(), "accepted what is not JSON");
    }
    let Ok(read) = result else {
        return;
    };
    let fault = match &read {
        SimulatorCommand::Fault(fault) => Some(fault.clone()),
        _ => None,
    };
    assert_eq!(FaultCommand::from_json(data), Ok(fault));
    let mut buf = [0; MAX_MESSAGE];
    match read.to_json(&mut buf) {
        Ok(length) => assert_eq!(SimulatorCommand::from_json(&buf[..length]), Ok(read)),
        // Numbers may have come in a shorter spelling than ours.
        Err(error) => assert_eq!(error, EncodeError::TooLarge),
    }
}
