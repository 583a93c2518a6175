//! Topics of federated learning.

use std::fmt;
use std::str::FromStr;

use crawler_access::LearnTopic;
use crawler_protocol::{Fleet, RobotId};

/// The name of a node, as it stands in its topic: of the same letters as that of a robot.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeName(RobotId);

/// A text is no name of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NodeNameError;

impl fmt::Display for NodeNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a name of a node: 1 to 32 of a-z, 0-9, - and _")
    }
}

impl std::error::Error for NodeNameError {}

impl NodeName {
    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        self.0.as_str()
    }
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for NodeName {
    type Err = NodeNameError;

    fn from_str(text: &str) -> Result<Self, NodeNameError> {
        RobotId::new(text).map(Self).map_err(|_| NodeNameError)
    }
}

/// Rounds of all runs.
pub(crate) fn all_rounds(fleet: &Fleet) -> String {
    format!("{}/learn/+/round", fleet.as_str())
}

/// Rounds of a run.
pub(crate) fn round(fleet: &Fleet, run: u64) -> String {
    format!("{}/learn/{run}/round", fleet.as_str())
}

/// Answers of all nodes of a run.
pub(crate) fn updates(fleet: &Fleet, run: u64) -> String {
    format!("{}/learn/{run}/update/+", fleet.as_str())
}

/// Answers of a node.
pub(crate) fn update(fleet: &Fleet, run: u64, node: &NodeName) -> String {
    format!("{}/learn/{run}/update/{node}", fleet.as_str())
}

/// The run that a topic of a round is of.
pub(crate) fn run_of(fleet: &Fleet, topic: &str) -> Option<u64> {
    match LearnTopic::parse(fleet, topic)? {
        LearnTopic::Round { run } => Some(run),
        LearnTopic::Update { .. } => None,
    }
}

/// The node that a topic of an update of `run` is of.
pub(crate) fn node_of(fleet: &Fleet, run: u64, topic: &str) -> Option<NodeName> {
    match LearnTopic::parse(fleet, topic)? {
        LearnTopic::Update { run: of, node } if of == run => Some(NodeName(node)),
        LearnTopic::Update { .. } | LearnTopic::Round { .. } => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_are_read_as_they_are_written() {
        let fleet = Fleet::new("swarm").expect("a fleet");
        let node: NodeName = "hall-2".parse().expect("a name");
        assert_eq!(round(&fleet, 7), "swarm/learn/7/round");
        assert_eq!(update(&fleet, 7, &node), "swarm/learn/7/update/hall-2");
        assert_eq!(run_of(&fleet, &round(&fleet, 7)), Some(7));
        assert_eq!(
            node_of(&fleet, 7, &update(&fleet, 7, &node)),
            Some(node.clone())
        );
        for other in [
            "swarm/learn/+7/round",
            "swarm/learn/x/round",
            "swarm/learn//round",
            "other/learn/7/round",
            "swarm/learn/7/update/hall-2",
        ] {
            assert_eq!(run_of(&fleet, other), None, "{other}");
        }
        for other in ["swarm/learn/8/update/hall-2", "swarm/learn/7/round"] {
            assert_eq!(node_of(&fleet, 7, other), None, "{other}");
        }
    }

    #[test]
    fn names_are_those_of_topics() {
        for text in ["", "a/b", "+", "#", "Hall", &"n".repeat(65)] {
            assert_eq!(text.parse::<NodeName>(), Err(NodeNameError), "{text}");
        }
    }
}
