//! What a robot is to do.

use crawler_hal::Instant;
use crawler_protocol::BehaviourName;

use crate::motion::Twist;

/// What a robot in motion is about.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Goal {
    /// `move` and `drive`: a person's hand on the stick.
    Manual {
        /// Wanted motion.
        twist: Twist,
        /// When it ends unless renewed.
        until: Instant,
        /// Whether `until` is the end that was asked for, and not the failsafe.
        bounded: bool,
    },
    /// `wander`.
    Wander {
        /// Share of the permitted speed, 0 to 1.
        speed: f32,
    },
    /// `goto`.
    Goto {
        /// Metres along the x axis of odometry.
        x: f32,
        /// Metres along its y axis.
        y: f32,
        /// When to give up.
        deadline: Instant,
    },
    /// `disperse`, `gather`, `flock` and `formation`.
    Swarm(Swarm),
}

impl Goal {
    /// Whether the robot finds its own way, and may turn aside.
    pub const fn is_autonomous(&self) -> bool {
        match self {
            Self::Manual { .. } => false,
            Self::Wander { .. } | Self::Goto { .. } | Self::Swarm(_) => true,
        }
    }

    /// Whether it needs a word again and again: the failsafe ends it.
    pub const fn is_continuous(&self) -> bool {
        matches!(self, Self::Manual { bounded: false, .. })
    }

    /// Whether it goes on until somebody ends it.
    pub const fn is_behaviour(&self) -> bool {
        matches!(self, Self::Wander { .. } | Self::Swarm(_))
    }

    /// The behaviour as reported.
    pub const fn behaviour(&self) -> BehaviourName {
        match self {
            Self::Manual { .. } => BehaviourName::Manual,
            Self::Wander { .. } => BehaviourName::Wander,
            Self::Goto { .. } => BehaviourName::Goto,
            Self::Swarm(swarm) => swarm.behaviour(),
        }
    }
}

/// Moving by where others are.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Swarm {
    /// Keep away from others.
    Disperse,
    /// Join others at a place.
    Gather {
        /// Metres along the x axis of position references.
        x: f32,
        /// Metres along their y axis.
        y: f32,
    },
    /// Move along with others.
    Flock,
    /// Keep a place among others.
    Formation,
}

impl Swarm {
    /// The behaviour as reported.
    pub const fn behaviour(self) -> BehaviourName {
        match self {
            Self::Disperse => BehaviourName::Disperse,
            Self::Gather { .. } => BehaviourName::Gather,
            Self::Flock => BehaviourName::Flock,
            Self::Formation => BehaviourName::Formation,
        }
    }
}
