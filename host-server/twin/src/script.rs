//! The drive that a robot is calibrated on.
//!
//! A baseline to identify on (standing, straights and turns at several speeds both ways, arcs,
//! creeping), then legs in no order to validate on. All of it is within about a metre of where it
//! begins: what goes one way comes back.

use std::fmt::Write as _;

/// A stretch of a drive at one wanted speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// How long, seconds.
    pub seconds: f64,
    /// Ahead, metres per second.
    pub v: f64,
    /// Anticlockwise, radians per second.
    pub w: f64,
}

/// Time between two legs, in which the robot comes to rest.
const REST_S: f64 = 0.6;
/// Time in which a robot boots, hears the time and is told how to report.
const BEFORE_S: f64 = 6.0;
/// Time between two words of a controller that drives: well within the failsafe of 500 ms.
const WORD_S: f64 = 0.2;

/// What is identified on.
#[must_use]
pub fn baseline() -> Vec<Leg> {
    let mut legs = vec![Leg {
        seconds: 2.0,
        v: 0.0,
        w: 0.0,
    }];
    let mut both = |seconds: f64, v: f64, w: f64| {
        legs.push(Leg { seconds, v, w });
        legs.push(Leg {
            seconds: REST_S,
            v: 0.0,
            w: 0.0,
        });
        legs.push(Leg {
            seconds,
            v: -v,
            w: -w,
        });
        legs.push(Leg {
            seconds: REST_S,
            v: 0.0,
            w: 0.0,
        });
    };
    for (seconds, v) in [
        (3.0, 0.12),
        (2.5, 0.22),
        (2.0, 0.32),
        (1.8, 0.45),
        (1.6, 0.55),
    ] {
        both(seconds, v, 0.0);
    }
    for (seconds, w) in [(2.0, 1.0), (1.8, 2.0), (1.6, 3.2), (1.4, 4.5)] {
        both(seconds, 0.0, w);
    }
    for (v, w) in [(0.25, 0.8), (0.25, -0.8), (0.4, 1.2), (0.4, -1.2)] {
        both(1.8, v, w);
    }
    legs
}

/// What is validated on: so many pairs of legs, ahead and back by other curves.
#[must_use]
pub fn validation(pairs: usize) -> Vec<Leg> {
    let mut legs = Vec::new();
    // Any numbers will do that are always the same: a generator of Lehmer.
    let mut state = 48_271_u64;
    let mut share = || {
        state = state * 48_271 % 2_147_483_647;
        state as f64 / 2_147_483_647.0
    };
    for _ in 0..pairs {
        let (seconds, v) = (1.2 + share(), 0.2 + 0.3 * share());
        for v in [v, -v] {
            let w = 2.4 * share() - 1.2;
            legs.push(Leg { seconds, v, w });
        }
    }
    legs
}

/// Seconds that a drive takes.
#[must_use]
pub fn seconds(legs: &[Leg]) -> f64 {
    legs.iter().map(|leg| leg.seconds).sum()
}

/// Calibration and validation as a scenario of the simulator: one robot in the middle of an empty room
/// under a camera of 10 Hz, telling of itself 20 times a second.
#[must_use]
pub fn scenario() -> String {
    let legs = [baseline(), validation(14)].concat();
    let mut text = String::from(
        "# Drives a robot as a twin wants to see it: record it, and let `terracrawler twin calibrate` read it.\n\
         name = \"calibration\"\n\
         about = \"A robot drives to and fro in an empty room, so that its body can be identified.\"\n\
         robots = 1\n",
    );
    // Writing to a String does not fail.
    let _ = write!(
        text,
        "duration_s = {:.0}\n\n[arena]\nwidth = 6.0\nheight = 6.0\n\n\
         [spawn]\nposes = [{{ x = 0.0, y = 0.0, theta = 0.0 }}]\n\n\
         [tracker]\nrate_hz = 10.0\n\n\
         [[commands]]\nat_s = 3.0\ncommand = \"set\"\n\
         parameters = {{ telemetry_hz = 20, max_speed = 0.8, max_turn = 8 }}\n",
        (BEFORE_S + seconds(&legs) + 1.0).ceil()
    );
    let mut at_s = BEFORE_S;
    for leg in &legs {
        if leg.v == 0.0 && leg.w == 0.0 {
            let _ = write!(
                text,
                "\n[[commands]]\nat_s = {at_s:.2}\ncommand = \"stop\"\n"
            );
        } else {
            let _ = write!(
                text,
                "\n[[commands]]\nat_s = {at_s:.2}\nevery_s = {WORD_S}\nuntil_s = {:.2}\n\
                 command = \"drive\"\nparameters = {{ v = {:.3}, w = {:.3} }}\n",
                at_s + leg.seconds - 0.5 * WORD_S,
                leg.v,
                leg.w
            );
        }
        at_s += leg.seconds;
    }
    let _ = write!(
        text,
        "\n[[commands]]\nat_s = {at_s:.2}\ncommand = \"stop\"\n"
    );
    text
}
