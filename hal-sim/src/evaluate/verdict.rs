//! What of its scenario a run did not come to.

use std::fmt;

/// A criterion of [`Success`](crate::scenario::Success).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[non_exhaustive]
pub enum Criterion {
    /// The world could not be built.
    SetUp,
    /// The simulator or the program panicked.
    Panic,
    /// Goals were not reached.
    Reach,
    /// Too many contacts.
    Collisions,
    /// A contact at speed.
    Impact,
    /// Robots without power, or that stand with a fault.
    Alive,
    /// Robots that stand although they are to do something.
    Stranded,
    /// Commands that did not complete.
    CommandSuccess,
    /// A command without an answer.
    Answer,
    /// Too near to something.
    Clearance,
    /// Too short a way.
    Distance,
    /// Not back at work after a fault.
    Recovery,
    /// Too long unable to take commands.
    Uptime,
    /// Motion after a stop.
    Still,
    /// Too many contacts in a minute.
    ContactsPerMinute,
    /// Robots that head in different directions.
    Order,
    /// Too many groups of robots.
    Clusters,
    /// Too few robots in the largest group.
    LargestCluster,
    /// Two robots too close together.
    PairDistance,
    /// Too much of the floor without a robot near.
    Coverage,
    /// Robots spread unevenly.
    Evenness,
    /// Too few neighbours in the lattice.
    LatticeDegree,
    /// Neighbours too far from the spacing of the lattice.
    SpacingError,
    /// Robots too far from the places of their shape.
    ShapeError,
    /// A swarm that is not in time as it should be.
    Settle,
    /// Things that no camera has found.
    Found,
    /// Robots that do not agree.
    Agreement,
    /// Tasks that nobody is at.
    Served,
    /// Robots that do not follow.
    Following,
    /// Places that were left alone for too long.
    Idle,
}

impl Criterion {
    /// All of them.
    pub const ALL: [Self; 30] = [
        Self::SetUp,
        Self::Panic,
        Self::Reach,
        Self::Collisions,
        Self::Impact,
        Self::Alive,
        Self::Stranded,
        Self::CommandSuccess,
        Self::Answer,
        Self::Clearance,
        Self::Distance,
        Self::Recovery,
        Self::Uptime,
        Self::Still,
        Self::ContactsPerMinute,
        Self::Order,
        Self::Clusters,
        Self::LargestCluster,
        Self::PairDistance,
        Self::Coverage,
        Self::Evenness,
        Self::LatticeDegree,
        Self::SpacingError,
        Self::ShapeError,
        Self::Settle,
        Self::Found,
        Self::Agreement,
        Self::Served,
        Self::Following,
        Self::Idle,
    ];

    /// The criterion of this name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|criterion| criterion.name() == name)
    }

    /// The key of the scenario's success that it stands for, where there is one.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SetUp => "set_up",
            Self::Panic => "panic",
            Self::Reach => "reach",
            Self::Collisions => "collisions",
            Self::Impact => "impact_mps",
            Self::Alive => "alive",
            Self::Stranded => "stranded",
            Self::CommandSuccess => "command_success",
            Self::Answer => "answer_s",
            Self::Clearance => "clearance_m",
            Self::Distance => "distance_m",
            Self::Recovery => "recovery_s",
            Self::Uptime => "uptime",
            Self::Still => "still_s",
            Self::ContactsPerMinute => "contacts_per_minute",
            Self::Order => "order",
            Self::Clusters => "clusters",
            Self::LargestCluster => "largest_cluster",
            Self::PairDistance => "pair_distance_m",
            Self::Coverage => "coverage",
            Self::Evenness => "evenness",
            Self::LatticeDegree => "lattice_degree",
            Self::SpacingError => "spacing_error_m",
            Self::ShapeError => "shape_error_m",
            Self::Settle => "settle_s",
            Self::Found => "found",
            Self::Agreement => "agreement",
            Self::Served => "served",
            Self::Following => "following",
            Self::Idle => "idle_s",
        }
    }
}

/// A criterion that does not hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failure {
    /// Which.
    pub criterion: Criterion,
    /// What happened instead.
    pub what: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.criterion.name(), self.what)
    }
}
