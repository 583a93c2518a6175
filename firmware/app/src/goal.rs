//! What a robot is to do.

use crawler_hal::Instant;
use crawler_protocol::{BehaviourName, Formation, Measure, Places};

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
    /// `policy`: the controller has the rest of it.
    Policy {
        /// Stands for the name of the policy.
        name: u32,
    },
    /// `follow`, `patrol`, `consensus`, `allocate`, `cover` and `formation` with a shape: the controller has the rest of it.
    Mission {
        /// Which.
        kind: MissionKind,
        /// Whether it is over some time.
        ends: bool,
    },
}

impl Goal {
    /// Whether the robot finds its own way, and may turn aside.
    pub const fn is_autonomous(&self) -> bool {
        match self {
            Self::Manual { .. } => false,
            Self::Wander { .. }
            | Self::Goto { .. }
            | Self::Swarm(_)
            | Self::Policy { .. }
            | Self::Mission { .. } => true,
        }
    }

    /// Whether it needs a word again and again: the failsafe ends it.
    pub const fn is_continuous(&self) -> bool {
        matches!(self, Self::Manual { bounded: false, .. })
    }

    /// Whether it goes on until somebody ends it.
    pub const fn is_behaviour(&self) -> bool {
        matches!(
            self,
            Self::Wander { .. }
                | Self::Swarm(_)
                | Self::Policy { .. }
                | Self::Mission { ends: false, .. }
        )
    }

    /// The behaviour as reported.
    pub const fn behaviour(&self) -> BehaviourName {
        match self {
            Self::Manual { .. } => BehaviourName::Manual,
            Self::Wander { .. } => BehaviourName::Wander,
            Self::Goto { .. } => BehaviourName::Goto,
            Self::Swarm(swarm) => swarm.behaviour(),
            Self::Policy { .. } => BehaviourName::Policy,
            Self::Mission { kind, .. } => kind.behaviour(),
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

/// What a robot does with a memory of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum MissionKind {
    /// Keep behind a leader.
    Follow,
    /// Go round by places.
    Patrol,
    /// Agree on a number.
    Consensus,
    /// Share tasks out.
    Allocate,
    /// Cover a part of an area.
    Cover,
    /// Keep a place in a shape.
    Shaped,
}

impl MissionKind {
    /// The behaviour as reported.
    pub const fn behaviour(self) -> BehaviourName {
        match self {
            Self::Follow => BehaviourName::Follow,
            Self::Patrol => BehaviourName::Patrol,
            Self::Consensus => BehaviourName::Consensus,
            Self::Allocate => BehaviourName::Allocate,
            Self::Cover => BehaviourName::Cover,
            Self::Shaped => BehaviourName::Formation,
        }
    }
}

/// A mission as it is given.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Mission {
    /// Keep behind a leader.
    Follow {
        /// Which: [`name_of`](crate::neighbours::name_of) its id.
        leader: u32,
        /// Metres to keep.
        distance: f32,
    },
    /// Go round by places.
    Patrol {
        /// Where to go.
        waypoints: Places,
        /// After how many rounds to stop; 0 is never.
        laps: u16,
    },
    /// Agree on a number.
    Consensus {
        /// What to begin with.
        measure: Measure,
        /// Most liars among neighbours.
        f: u8,
    },
    /// Share tasks out, and go to the own one.
    Allocate {
        /// Where they are.
        tasks: Places,
    },
    /// Cover a part of an area.
    Cover {
        /// Its corners.
        area: Places,
    },
    /// Keep a place in a shape.
    Shaped(Formation),
}

impl Mission {
    /// What the state machine has of it.
    pub const fn goal(&self) -> Goal {
        let (kind, ends) = match self {
            Self::Follow { .. } => (MissionKind::Follow, false),
            Self::Patrol { laps, .. } => (MissionKind::Patrol, *laps > 0),
            Self::Consensus { .. } => (MissionKind::Consensus, false),
            Self::Allocate { .. } => (MissionKind::Allocate, false),
            Self::Cover { .. } => (MissionKind::Cover, false),
            Self::Shaped(_) => (MissionKind::Shaped, false),
        };
        Goal::Mission { kind, ends }
    }

    /// The places that the robot may have to go to.
    pub fn places(&self) -> &[[f32; 2]] {
        match self {
            Self::Follow { .. } | Self::Consensus { .. } => &[],
            Self::Patrol { waypoints, .. } => waypoints.as_slice(),
            Self::Allocate { tasks } => tasks.as_slice(),
            Self::Cover { area } => area.as_slice(),
            Self::Shaped(formation) => formation.path.as_slice(),
        }
    }
}
