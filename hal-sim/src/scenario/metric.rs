//! What can be measured of a run, by the names that criteria and tables use.
//!
//! `docs/scenarios.md` defines every metric.

use serde::{Deserialize, Serialize};

/// Something measured of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Metric {
    /// 1 when all criteria of the scenario hold, else 0.
    Success,
    /// Share of the goals that were reached in time.
    Reached,
    /// Mean time from being sent to a goal to reaching it, seconds.
    TimeToGoalS,
    /// Shortest way to the goals that were reached, divided by the way driven there.
    PathOptimality,
    /// Drawn from the batteries, joules for each robot.
    EnergyJ,
    /// Contacts for each robot.
    Collisions,
    /// Least distance between a robot's rim and anything else, metres.
    MinClearanceM,
    /// Mean time from the end of a fault until the robot is back at work, seconds.
    RecoveryS,
    /// Messages through the broker for each goal reached, or for each command completed where
    /// there are no goals.
    MessagesPerTask,
    /// Share of the time in which robots can take commands.
    Uptime,
    /// Share of the commands that ended as completed.
    CommandSuccess,
    /// Way driven, metres for each robot.
    DistanceM,
    /// Robots that stand at the end although they were sent to a behaviour and nobody has ended it.
    Stranded,
    /// How often a robot fell out of its behaviour by itself, in 100 hours of robots.
    Dropouts,
    /// Contacts for each robot and minute.
    ContactsPerMinute,
    /// How much alike robots head, 0 to 1: the length of the mean of their directions.
    Order,
    /// Groups of robots that are near to each other.
    Clusters,
    /// Share of the robots that the largest group has.
    LargestCluster,
    /// Least distance between the middles of two robots, metres.
    PairDistanceM,
    /// Share of the free floor that has a robot near.
    Coverage,
    /// How evenly robots are spread over the free floor: 1 is the best that there can be.
    Evenness,
    /// Neighbours at the spacing of the lattice, for each robot.
    LatticeDegree,
    /// How far neighbours in the lattice are from its spacing, metres.
    SpacingErrorM,
    /// How far robots are from the places of the shape that they form, metres.
    ShapeErrorM,
    /// From when on the swarm is as the scenario wants it, seconds.
    SettleS,
    /// Share of the coloured things that robots have found with their cameras.
    Found,
    /// Largest share of the robots at a consensus that have one value.
    Agreement,
    /// Share of the tasks at which a robot is.
    Served,
    /// Share of the robots sent to follow that follow their leader, over others or not.
    Following,
    /// The longest that a place of a patrol was left alone, seconds.
    IdleS,
}

impl Metric {
    /// How many there are.
    pub const COUNT: usize = Self::ALL.len();

    /// All of them, in the order of tables.
    pub const ALL: [Self; 30] = [
        Self::Success,
        Self::Reached,
        Self::TimeToGoalS,
        Self::PathOptimality,
        Self::EnergyJ,
        Self::Collisions,
        Self::MinClearanceM,
        Self::RecoveryS,
        Self::MessagesPerTask,
        Self::Uptime,
        Self::CommandSuccess,
        Self::DistanceM,
        Self::Stranded,
        Self::Dropouts,
        Self::ContactsPerMinute,
        Self::Order,
        Self::Clusters,
        Self::LargestCluster,
        Self::PairDistanceM,
        Self::Coverage,
        Self::Evenness,
        Self::LatticeDegree,
        Self::SpacingErrorM,
        Self::ShapeErrorM,
        Self::SettleS,
        Self::Found,
        Self::Agreement,
        Self::Served,
        Self::Following,
        Self::IdleS,
    ];

    /// Name in tables, files and thresholds.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "success",
            Self::Reached => "reached",
            Self::TimeToGoalS => "time_to_goal_s",
            Self::PathOptimality => "path_optimality",
            Self::EnergyJ => "energy_j",
            Self::Collisions => "collisions",
            Self::MinClearanceM => "min_clearance_m",
            Self::RecoveryS => "recovery_s",
            Self::MessagesPerTask => "messages_per_task",
            Self::Uptime => "uptime",
            Self::CommandSuccess => "command_success",
            Self::DistanceM => "distance_m",
            Self::Stranded => "stranded",
            Self::Dropouts => "dropouts",
            Self::ContactsPerMinute => "contacts_per_minute",
            Self::Order => "order",
            Self::Clusters => "clusters",
            Self::LargestCluster => "largest_cluster",
            Self::PairDistanceM => "pair_distance_m",
            Self::Coverage => "coverage",
            Self::Evenness => "evenness",
            Self::LatticeDegree => "lattice_degree",
            Self::SpacingErrorM => "spacing_error_m",
            Self::ShapeErrorM => "shape_error_m",
            Self::SettleS => "settle_s",
            Self::Found => "found",
            Self::Agreement => "agreement",
            Self::Served => "served",
            Self::Following => "following",
            Self::IdleS => "idle_s",
        }
    }

    /// The metric of this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|metric| metric.name() == name)
    }

    /// What its values are in.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Success
            | Self::Reached
            | Self::PathOptimality
            | Self::Uptime
            | Self::CommandSuccess
            | Self::Order
            | Self::LargestCluster
            | Self::Coverage
            | Self::Evenness
            | Self::Found
            | Self::Agreement
            | Self::Served
            | Self::Following => "share",
            Self::TimeToGoalS | Self::RecoveryS | Self::SettleS | Self::IdleS => "s",
            Self::EnergyJ => "J",
            Self::Collisions => "contacts",
            Self::MinClearanceM
            | Self::DistanceM
            | Self::PairDistanceM
            | Self::SpacingErrorM
            | Self::ShapeErrorM => "m",
            Self::MessagesPerTask => "messages",
            Self::Stranded => "robots",
            Self::Dropouts => "dropouts",
            Self::ContactsPerMinute => "contacts/min",
            Self::Clusters => "clusters",
            Self::LatticeDegree => "neighbours",
        }
    }

    /// Which way is better.
    #[must_use]
    pub const fn better(self) -> Better {
        match self {
            Self::Success
            | Self::Reached
            | Self::PathOptimality
            | Self::MinClearanceM
            | Self::Uptime
            | Self::CommandSuccess
            | Self::Order
            | Self::Coverage
            | Self::Evenness
            | Self::Found
            | Self::Agreement
            | Self::Served
            | Self::Following => Better::More,
            Self::TimeToGoalS
            | Self::EnergyJ
            | Self::Collisions
            | Self::RecoveryS
            | Self::MessagesPerTask
            | Self::Stranded
            | Self::Dropouts
            | Self::ContactsPerMinute
            | Self::SpacingErrorM
            | Self::ShapeErrorM
            | Self::SettleS
            | Self::IdleS => Better::Less,
            // To drive far is the task of one scenario and a detour in another, and so is to stand
            // close together.
            Self::DistanceM
            | Self::Clusters
            | Self::LargestCluster
            | Self::PairDistanceM
            | Self::LatticeDegree => Better::Neither,
        }
    }
}

/// Which way of a metric is better.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Better {
    /// The more the better.
    More,
    /// The less the better.
    Less,
    /// It depends.
    Neither,
}

impl Better {
    /// Its name in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::More => "more",
            Self::Less => "less",
            Self::Neither => "neither",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metrics_are_found_by_their_names_and_stand_in_order() {
        for (index, metric) in Metric::ALL.into_iter().enumerate() {
            assert_eq!(metric as usize, index);
            assert_eq!(Metric::by_name(metric.name()), Some(metric));
            let text = serde_json::to_string(&metric).unwrap();
            assert_eq!(text, format!("\"{}\"", metric.name()));
        }
        assert_eq!(Metric::by_name("luck"), None);
    }
}
