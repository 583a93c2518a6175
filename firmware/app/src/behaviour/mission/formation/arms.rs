//! The two arms of a line or a wedge, which are to be as long as each other.

/// How long the arms of a line or a wedge are, as far as a robot knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Arms {
    /// Robots beyond this one.
    pub(super) beyond: u8,
    /// Robots of the arms on the side of place 1 and on that of place −1.
    pub(super) both: [u8; 2],
    /// Whether one may go over.
    pub(super) settled: bool,
}

impl Arms {
    /// As it is said.
    pub(super) const fn word(self) -> i32 {
        let [left, right] = self.both;
        (self.settled as i32) << 24 | (left as i32) << 16 | (right as i32) << 8 | self.beyond as i32
    }

    pub(super) const fn of_word(word: i32) -> Self {
        let [settled, left, right, beyond] = word.to_be_bytes();
        Self {
            beyond,
            both: [left, right],
            settled: settled == 1,
        }
    }

    /// The side to which the robot in place `number` goes over, if it is at the end of the longer arm.
    pub(super) const fn other_side(self, number: i32) -> Option<i8> {
        let side = if number > 0 { 1 } else { -1 };
        let [own, other] = if side > 0 {
            self.both
        } else {
            [self.both[1], self.both[0]]
        };
        // Who moves up to the end is none as long as the news is of another one.
        let is_last = self.beyond == 0 && number.unsigned_abs() == own as u32;
        if self.settled && is_last && own > other.saturating_add(1) {
            Some(-side)
        } else {
            None
        }
    }

    /// The side of the arm to which somebody goes who has no place, and is at that of this number: the other one, if that
    /// is shorter.
    pub(super) const fn shorter(self, number: i32) -> Option<i8> {
        let [left, right] = self.both;
        if number >= 0 && right < left {
            Some(-1)
        } else if number <= 0 && left < right {
            Some(1)
        } else {
            None
        }
    }
}
