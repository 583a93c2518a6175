//! What can be wrong, for programs: one list of all codes.

use axum::http::StatusCode;
use crawler_protocol::Reason;
use serde::{Serialize, Serializer};

/// One line for each: its name here, its status, and what it is called in problem documents and in the
/// audit log. These names are stable.
macro_rules! codes {
    ($($code:ident $status:ident $name:literal,)*) => {
        /// What is wrong.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub(crate) enum Code {
            $($code,)*
            /// What the protocol has against a command, or against a fault.
            Command(Reason),
        }

        impl Code {
            /// The status of an answer that says so.
            pub(crate) const fn status(self) -> StatusCode {
                match self {
                    $(Self::$code => StatusCode::$status,)*
                    Self::Command(Reason::Malformed) => StatusCode::BAD_REQUEST,
                    Self::Command(_) => StatusCode::UNPROCESSABLE_ENTITY,
                }
            }

            /// Its name.
            pub(crate) const fn name(self) -> &'static str {
                match self {
                    $(Self::$code => $name,)*
                    Self::Command(reason) => reason.name(),
                }
            }
        }

        #[cfg(test)]
        const ALL: &[Code] = &[$(Code::$code,)*];
    };
}

codes! {
    // The request itself.
    BadRequest BAD_REQUEST "bad_request",
    BadHost BAD_REQUEST "bad_host",
    BadQuery BAD_REQUEST "bad_query",
    TooMuch BAD_REQUEST "too_much",
    Malformed BAD_REQUEST "malformed",
    NotAWebsocket BAD_REQUEST "not_a_websocket",
    NotMqtt BAD_REQUEST "not_mqtt",
    NotFound NOT_FOUND "not_found",
    MethodNotAllowed METHOD_NOT_ALLOWED "method_not_allowed",
    NotAcceptable NOT_ACCEPTABLE "not_acceptable",
    Timeout REQUEST_TIMEOUT "timeout",
    TooLarge PAYLOAD_TOO_LARGE "too_large",
    UnsupportedMediaType UNSUPPORTED_MEDIA_TYPE "unsupported_media_type",
    InvalidBody UNPROCESSABLE_ENTITY "invalid_body",
    RateLimited TOO_MANY_REQUESTS "rate_limited",

    // Who makes it.
    Unauthenticated UNAUTHORIZED "unauthenticated",
    ExpiredToken UNAUTHORIZED "expired_token",
    BadCredentials UNAUTHORIZED "bad_credentials",
    BadInvitation UNAUTHORIZED "bad_invitation",
    NoSession UNAUTHORIZED "no_session",
    Forbidden FORBIDDEN "forbidden",
    ForeignHost FORBIDDEN "foreign_host",
    ForeignOrigin FORBIDDEN "foreign_origin",
    OpenServer CONFLICT "open_server",
    TooManyAttempts TOO_MANY_REQUESTS "too_many_attempts",

    // What it is about.
    UnknownRelease NOT_FOUND "unknown_release",
    UnknownRobot NOT_FOUND "unknown_robot",
    UnknownCalibration NOT_FOUND "unknown_calibration",
    UnknownCommandId NOT_FOUND "unknown_command_id",
    UnknownCounterfactual NOT_FOUND "unknown_counterfactual",
    UnknownCredential NOT_FOUND "unknown_credential",
    UnknownExperiment NOT_FOUND "unknown_experiment",
    UnknownFence NOT_FOUND "unknown_fence",
    UnknownPolicy NOT_FOUND "unknown_policy",
    UnknownRollout NOT_FOUND "unknown_rollout",
    UnknownMessage NOT_FOUND "unknown_message",
    UnknownScenario NOT_FOUND "unknown_scenario",
    UnknownSession NOT_FOUND "unknown_session",
    UnknownUser NOT_FOUND "unknown_user",
    NoGate NOT_FOUND "no_gate",
    NoImage NOT_FOUND "no_image",
    NoMap NOT_FOUND "no_map",
    NoParameters NOT_FOUND "no_parameters",
    NoSimulator NOT_FOUND "no_simulator",
    NoTwin NOT_FOUND "no_twin",
    NotRecorded NOT_FOUND "not_recorded",

    // What it asks for.
    BadName UNPROCESSABLE_ENTITY "bad_name",
    WeakPassword UNPROCESSABLE_ENTITY "weak_password",
    InvalidCalibration UNPROCESSABLE_ENTITY "invalid_calibration",
    InvalidCommand UNPROCESSABLE_ENTITY "invalid_command",
    InvalidCounterfactual UNPROCESSABLE_ENTITY "invalid_counterfactual",
    InvalidExperiment UNPROCESSABLE_ENTITY "invalid_experiment",
    InvalidFence UNPROCESSABLE_ENTITY "invalid_fence",
    GateMissing UNPROCESSABLE_ENTITY "gate_missing",
    InvalidGate UNPROCESSABLE_ENTITY "invalid_gate",
    InvalidRelease UNPROCESSABLE_ENTITY "invalid_release",
    InvalidRollout UNPROCESSABLE_ENTITY "invalid_rollout",
    InvalidShadow UNPROCESSABLE_ENTITY "invalid_shadow",
    Exists CONFLICT "exists",
    UserExists CONFLICT "user_exists",
    LastAdmin CONFLICT "last_admin",
    TooMany CONFLICT "too_many",
    NoReleaseKeys CONFLICT "no_release_keys",
    NoRobots CONFLICT "no_robots",
    RobotOffline CONFLICT "robot_offline",
    TakesNoFaults CONFLICT "takes_no_faults",
    TellsNoMap CONFLICT "tells_no_map",
    WrongState CONFLICT "wrong_state",
    OtherBuild CONFLICT "other_build",
    NotPermitted CONFLICT "not_permitted",
    Refused CONFLICT "refused",

    // Whether it can be done.
    Internal INTERNAL_SERVER_ERROR "internal",
    OutsideBroker NOT_IMPLEMENTED "outside_broker",
    HistoryNotReadable NOT_IMPLEMENTED "history_not_readable",
    HistoryUnavailable SERVICE_UNAVAILABLE "history_unavailable",
    RecordsUnavailable SERVICE_UNAVAILABLE "records_unavailable",
    BrokerUnavailable SERVICE_UNAVAILABLE "broker_unavailable",
    Busy SERVICE_UNAVAILABLE "busy",
    Overloaded SERVICE_UNAVAILABLE "overloaded",
    SimulatorEnded SERVICE_UNAVAILABLE "simulator_ended",
    Stopping SERVICE_UNAVAILABLE "stopping",
    NotAudited SERVICE_UNAVAILABLE "not_audited",
    NotShared SERVICE_UNAVAILABLE "not_shared",
    NotWritten SERVICE_UNAVAILABLE "not_written",
    SentNotShared SERVICE_UNAVAILABLE "sent_not_shared",
    SentNotWritten SERVICE_UNAVAILABLE "sent_not_written",
    TooManyClients SERVICE_UNAVAILABLE "too_many_clients",
    TooManyReaders SERVICE_UNAVAILABLE "too_many_readers",
    NoAnswer GATEWAY_TIMEOUT "no_answer",
}

impl Serialize for Code {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn no_two_codes_have_one_name() {
        let names: BTreeSet<_> = ALL.iter().map(|code| code.name()).collect();
        assert_eq!(names.len(), ALL.len());
    }

    #[test]
    fn every_code_is_that_of_an_error() {
        for code in ALL {
            let status = code.status();
            assert!(
                status.is_client_error() || status.is_server_error(),
                "{code:?}"
            );
        }
    }
}
