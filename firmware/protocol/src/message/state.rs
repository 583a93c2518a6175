//! Words that several messages share.

use crate::words::words;

words! {
    /// What a robot is doing, as it reports it. The order is that of the live feed, and of
    /// telemetry in CBOR.
    RobotState {
        /// Starting up.
        Initializing = "INITIALIZING",
        /// Standing, ready.
        Idle = "IDLE",
        /// Moving freely.
        Moving = "MOVING",
        /// Turning once around to look.
        Scanning = "SCANNING",
        /// Moving slowly, for a reason: something near, or a low battery.
        Caution = "CAUTION",
        /// Turning away from something.
        Avoiding = "AVOIDING",
        /// Taking a firmware update.
        Updating = "UPDATING",
        /// Standing until somebody sees to it.
        Error = "ERROR",
    }
}

words! {
    /// What kind of body a robot has.
    Kind {
        /// A body in the simulator.
        Simulated = "simulated",
        /// Firmware on an emulated microcontroller.
        Emulated = "emulated",
        /// A robot one can trip over.
        Physical = "physical",
    }
}

words! {
    /// What a robot can do besides talking.
    Capability {
        /// It moves.
        Drive = "drive",
        /// It measures the distance ahead.
        Range = "range",
        /// It takes pictures.
        Camera = "camera",
        /// It recognises what they show.
        Vision = "vision",
        /// It stands on a bench and takes faults from the network.
        Faults = "faults",
        /// It knows behaviours that neighbours talk for, and what they say in a digest.
        Missions = "missions",
        /// It tells its map when it is asked to.
        Map = "map",
        /// It has room for a policy that a release brings.
        Policies = "policies",
    }
}

words! {
    /// Why the program of a robot started.
    BootCause {
        /// Power was switched on.
        PowerOn = "power-on",
        /// The program asked for it.
        Software = "software",
        /// The watchdog was not fed.
        Watchdog = "watchdog",
        /// The supply voltage fell too low.
        BrownOut = "brown-out",
        /// The program panicked.
        Panic = "panic",
        /// The reset pin, or a cause the chip does not name.
        External = "external",
    }
}

words! {
    /// The behaviours a robot knows by name. The order is that of telemetry in CBOR.
    BehaviourName {
        /// Does what it is told.
        Manual = "manual",
        /// Moves about and avoids what is in the way.
        Wander = "wander",
        /// Goes to a place.
        Goto = "goto",
        /// Keeps away from other robots.
        Disperse = "disperse",
        /// Joins other robots.
        Gather = "gather",
        /// Moves along with other robots.
        Flock = "flock",
        /// Keeps a place among other robots.
        Formation = "formation",
        /// Follows a trained policy.
        Policy = "policy",
        /// Keeps behind a leader.
        Follow = "follow",
        /// Goes round by a list of places.
        Patrol = "patrol",
        /// Agrees on a number with others.
        Consensus = "consensus",
        /// Shares tasks out among others and itself, and goes to its own.
        Allocate = "allocate",
        /// Covers its part of an area.
        Cover = "cover",
    }
}
