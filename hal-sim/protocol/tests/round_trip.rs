//! Whatever can be told can be written, and is read as it was told: by us and by others.

use crawler_protocol::{FaultCommand, MAX_MESSAGE};
use crawler_sim_protocol::SimulatorCommand;
use proptest::prelude::*;

proptest! {
    #[test]
    fn simulator_command(command in crate::common::simulator_command(), seed: u64) {
        let mut buf = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buf).expect("every command fits");
        let json = &buf[..length];
        prop_assert_eq!(&SimulatorCommand::from_json(json), &Ok(command.clone()));
        let theirs: SimulatorCommand = serde_json::from_slice(json).expect("others read ours");
        prop_assert_eq!(&theirs, &command);
        let fault = match &command {
            SimulatorCommand::Fault(fault) => Some(fault.clone()),
            _ => None,
        };
        prop_assert_eq!(FaultCommand::from_json(json), Ok(fault));
        let written = serde_json::to_vec(&command).expect("others write ours");
        prop_assert_eq!(&SimulatorCommand::from_json(&written), &Ok(command.clone()));
        let respelled = crate::respell::respell(json, seed);
        if respelled.len() <= MAX_MESSAGE {
            prop_assert_eq!(SimulatorCommand::from_json(respelled.as_bytes()), Ok(command));
        }
    }

    /// What is not a command is refused, and nothing that arrives makes the reader panic.
    #[test]
    fn damaged_commands(
        command in crate::common::simulator_command(),
        cut in any::<(u16, u8)>(),
        patch in proptest::collection::vec(any::<u8>(), 0..6),
    ) {
        let mut buf = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buf).expect("every command fits");
        let mut data = buf[..length].to_vec();
        let from = usize::from(cut.0) % length;
        let to = (from + usize::from(cut.1 % 24)).min(length);
        data.splice(from..to, patch);
        for (_, body) in crate::corpus::simulator::TARGETS {
            body(&data);
        }
    }
}
