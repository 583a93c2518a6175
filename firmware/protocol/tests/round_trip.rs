//! Whatever can be said can be written, and is read as it was said: by us and by others.

use crawler_protocol::{
    Action, CellDigest, Command, Detections, Heartbeat, LogRecord, MAX_MESSAGE, MapSegment,
    ParametersMessage, PoseFix, Response, StatusMessage, SwarmResponse, Telemetry, TimeMessage,
};
use proptest::prelude::*;

/// Members of an object have no order, so neither have parameters.
fn sorted(mut command: Command) -> Command {
    if let Action::Set(values) = &mut command.action {
        values.sort_by(|one, two| one.0.cmp(&two.0));
    }
    command
}

trait Sorted {
    /// The same without an order that JSON does not keep.
    fn sorted(self) -> Self;
}

impl Sorted for ParametersMessage {
    fn sorted(mut self) -> Self {
        self.values.sort_by(|one, two| one.name.cmp(&two.name));
        self
    }
}

macro_rules! ordered {
    ($($message:ty)+) => {
        $(impl Sorted for $message {
            fn sorted(self) -> Self {
                self
            }
        })+
    };
}
ordered! {
    Response SwarmResponse StatusMessage Heartbeat Telemetry Detections LogRecord MapSegment CellDigest PoseFix
    TimeMessage
}

proptest! {
    #[test]
    fn command(command in crate::common::command(), seed: u64) {
        let mut buf = [0; MAX_MESSAGE];
        // Eight long texts of escapes are more than a message holds.
        if let Ok(length) = command.to_json(&mut buf) {
            let json = &buf[..length];
            prop_assert_eq!(Command::parse(json), Ok(command.clone()));
            let respelled = crate::common::respell(json, seed);
            if respelled.len() <= MAX_MESSAGE {
                let read = Command::parse(respelled.as_bytes()).map(sorted);
                prop_assert_eq!(read, Ok(sorted(command.clone())));
            }
            let theirs = serde_json::to_vec(&command).unwrap();
            prop_assert_eq!(Command::parse(&theirs), Ok(command));
        } else {
            prop_assert_eq!(command.action.name(), "set");
        }
    }

    #[test]
    fn command_request(action in crate::common::action()) {
        use crawler_protocol::Reason;
        let mut buf = [0; MAX_MESSAGE];
        if let Ok(length) = action.to_json(&mut buf) {
            prop_assert_eq!(Action::parse(&buf[..length]), Ok(action.clone()));
            // It is no command yet, and a command is no request.
            prop_assert_eq!(
                Command::parse(&buf[..length]).unwrap_err().reason,
                Reason::MissingField
            );
        }
    }
}

/// One property per message: our JSON read by us and by others, theirs read by us, and ours in
/// another order.
macro_rules! round_trips {
    ($($name:ident: $message:ty;)+) => {
        proptest! {
            $(#[test]
            fn $name(message in crate::common::$name(), seed: u64) {
                let mut buf = [0; MAX_MESSAGE];
                let length = message.to_json(&mut buf).expect("every message fits");
                let json = &buf[..length];
                prop_assert_eq!(&<$message>::from_json(json), &Ok(message.clone()));
                let theirs: $message = serde_json::from_slice(json).expect("others read ours");
                prop_assert_eq!(&theirs, &message);
                let json = serde_json::to_vec(&message).expect("others write ours");
                prop_assert_eq!(&<$message>::from_json(&json), &Ok(message.clone()));
                let respelled = crate::common::respell(&buf[..length], seed);
                if respelled.len() <= MAX_MESSAGE {
                    let read = <$message>::from_json(respelled.as_bytes()).map(Sorted::sorted);
                    prop_assert_eq!(read, Ok(message.sorted()));
                }
            })+
        }
    };
}

round_trips! {
    response: Response;
    swarm_response: SwarmResponse;
    status: StatusMessage;
    heartbeat: Heartbeat;
    telemetry: Telemetry;
    detections: Detections;
    log_record: LogRecord;
    map_segment: MapSegment;
    parameters: ParametersMessage;
    cell_digest: CellDigest;
    pose_fix: PoseFix;
    time: TimeMessage;
}
