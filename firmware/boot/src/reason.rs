//! Why an update was given up.

/// Why a robot went back to the program or the model before. Codes and numbers are stable: they are on the wire and in
/// flash.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum RollbackReason {
    /// The new program panicked.
    Panic,
    /// The new program let the watchdog run out: it hung.
    Watchdog,
    /// The new program was cut off by its supply or by a person, again and again.
    PowerCycles,
    /// The new program restarted itself, again and again.
    Restarts,
    /// The new program did not prove itself in time, although nothing in particular was wrong.
    Timeout,
    /// The new program did not get through to the server, or heard nothing from it.
    NoLink,
    /// The new program found a fault in itself.
    SelfTest,
    /// Sensors that worked before the update do not work any more.
    UnhealthySensors,
    /// The new program kept missing control periods.
    ControlMissed,
    /// The bootloader found no intact image in the slot.
    BadImage,
    /// It was being given up when the power went, and the reason was lost.
    Interrupted,
    /// The new model takes longer for a picture than a robot that looks around can wait.
    TooSlow,
}

impl RollbackReason {
    /// All of them.
    pub const ALL: [Self; 12] = [
        Self::Panic,
        Self::Watchdog,
        Self::PowerCycles,
        Self::Restarts,
        Self::Timeout,
        Self::NoLink,
        Self::SelfTest,
        Self::UnhealthySensors,
        Self::ControlMissed,
        Self::BadImage,
        Self::Interrupted,
        Self::TooSlow,
    ];

    /// Its code on the wire.
    #[must_use]
    pub const fn code(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::Watchdog => "watchdog",
            Self::PowerCycles => "power_cycles",
            Self::Restarts => "restarts",
            Self::Timeout => "timeout",
            Self::NoLink => "no_link",
            Self::SelfTest => "self_test",
            Self::UnhealthySensors => "unhealthy_sensors",
            Self::ControlMissed => "control_missed",
            Self::BadImage => "bad_image",
            Self::Interrupted => "interrupted",
            Self::TooSlow => "too_slow",
        }
    }

    /// Its number in flash.
    #[must_use]
    pub const fn number(self) -> u8 {
        match self {
            Self::Panic => 1,
            Self::Watchdog => 2,
            Self::PowerCycles => 3,
            Self::Restarts => 4,
            Self::Timeout => 5,
            Self::NoLink => 6,
            Self::SelfTest => 7,
            Self::UnhealthySensors => 8,
            Self::ControlMissed => 9,
            Self::BadImage => 10,
            Self::Interrupted => 11,
            Self::TooSlow => 12,
        }
    }

    /// The reason with this number in flash.
    #[must_use]
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|reason| reason.number() == number)
    }
}

#[cfg(test)]
mod tests {
    use super::RollbackReason;

    #[test]
    fn codes_and_numbers_are_stable() {
        let written = RollbackReason::ALL.map(|reason| (reason.number(), reason.code()));
        let expected = [
            (1, "panic"),
            (2, "watchdog"),
            (3, "power_cycles"),
            (4, "restarts"),
            (5, "timeout"),
            (6, "no_link"),
            (7, "self_test"),
            (8, "unhealthy_sensors"),
            (9, "control_missed"),
            (10, "bad_image"),
            (11, "interrupted"),
            (12, "too_slow"),
        ];
        assert_eq!(written, expected);
        for number in 0..=u8::MAX {
            let reason = RollbackReason::from_number(number);
            assert_eq!(reason.is_some(), (1..=12).contains(&number), "{number}");
            assert!(reason.is_none_or(|reason| reason.number() == number));
        }
    }
}
