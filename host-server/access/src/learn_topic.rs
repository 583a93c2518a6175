//! Topics of federated learning. Robots have no part in it, so the contract of the firmware has none of them.

use crawler_protocol::{Fleet, RobotId};

/// Largest payload of a round, in bytes.
pub const MAX_ROUND: usize = 65_536;
/// Largest payload of an update, in bytes.
pub const MAX_UPDATE: usize = 20_000;
/// Most digits of the number of a run. Every such number fits 64 bits.
const MAX_DIGITS: usize = 19;

/// A topic of federated learning: `{fleet}/learn/{run}/…`, where the run is a number of 1 to 19 digits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LearnTopic {
    /// `…/round`: what the server asks all nodes of a run for, retained.
    Round {
        /// Number of the run.
        run: u64,
    },
    /// `…/update/{node}`: what a node learned in a round.
    Update {
        /// Number of the run.
        run: u64,
        /// The learner's name, without `learner-`.
        node: RobotId,
    },
}

impl LearnTopic {
    /// Reads a topic; `None` for every other one.
    #[must_use]
    pub fn parse(fleet: &Fleet, topic: &str) -> Option<Self> {
        let rest = topic.strip_prefix(fleet.as_str())?;
        let (run, rest) = rest.strip_prefix("/learn/")?.split_once('/')?;
        let run = number(run)?;
        if rest == "round" {
            return Some(Self::Round { run });
        }
        let node = RobotId::new(rest.strip_prefix("update/")?).ok()?;
        Some(Self::Update { run, node })
    }

    /// How large a payload may be, in bytes.
    #[must_use]
    pub const fn max_payload(&self) -> usize {
        match self {
            Self::Round { .. } => MAX_ROUND,
            Self::Update { .. } => MAX_UPDATE,
        }
    }
}

fn number(text: &str) -> Option<u64> {
    // `parse` alone would take a sign.
    let digits = text.len() <= MAX_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    digits.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_topic_is_a_round_or_an_update_of_a_numbered_run() {
        let fleet = Fleet::new("barn").expect("a name");
        let parse = |topic: &str| LearnTopic::parse(&fleet, topic);
        let node = RobotId::new("desk-1").expect("a name");
        for (topic, expected) in [
            ("barn/learn/7/round", LearnTopic::Round { run: 7 }),
            (
                "barn/learn/9999999999999999999/round",
                LearnTopic::Round {
                    run: 9_999_999_999_999_999_999,
                },
            ),
            (
                "barn/learn/0/update/desk-1",
                LearnTopic::Update { run: 0, node },
            ),
        ] {
            assert_eq!(parse(topic), Some(expected), "{topic}");
        }
        for topic in [
            "",
            "barn",
            "barn/learn",
            "barn/learn/7",
            "barn/learn/7/",
            "barn/learn//round",
            "barn/learn/+7/round",
            "barn/learn/-7/round",
            "barn/learn/7a/round",
            "barn/learn/\u{0667}/round",
            "barn/learn/10000000000000000000/round",
            "barn/learn/7/round/",
            "barn/learn/7/rounds",
            "barn/learn/7/round/desk-1",
            "barn/learn/7/update",
            "barn/learn/7/update/",
            "barn/learn/7/update/Desk",
            "barn/learn/7/update/desk-1/x",
            "barn/learn/+/update/desk-1",
            "shed/learn/7/round",
            "barnyard/learn/7/round",
            "/barn/learn/7/round",
        ] {
            assert_eq!(parse(topic), None, "{topic}");
        }
    }
}
