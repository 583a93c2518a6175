//! The list of cases.

use std::future::Future;
use std::pin::Pin;
use std::time::Duration;

use super::cases::{door, faults, motion, orders, reboot, reports, settings};
use super::{Bench, Failure};

/// What a case gives.
pub(super) type Verdict = Result<(), Failure>;

/// How a case is run.
type Run = for<'b> fn(&'b mut Bench) -> Pin<Box<dyn Future<Output = Verdict> + 'b>>;

/// One thing a robot must do.
pub struct Case {
    /// Its name.
    pub name: &'static str,
    /// What it shows, in one line.
    pub shows: &'static str,
    /// Whether it sets wheels in motion.
    pub motion: bool,
    /// The longest it may take, before the robot is put right.
    pub limit: Duration,
    pub(super) run: Run,
}

const fn still(name: &'static str, shows: &'static str, run: Run) -> Case {
    Case {
        name,
        shows,
        motion: false,
        limit: Duration::from_mins(1),
        run,
    }
}

const fn moving(name: &'static str, shows: &'static str, run: Run) -> Case {
    Case {
        motion: true,
        ..still(name, shows, run)
    }
}

const fn long(name: &'static str, shows: &'static str, run: Run) -> Case {
    Case {
        limit: Duration::from_secs(150),
        ..still(name, shows, run)
    }
}

/// Every case, in the order in which they run.
#[rustfmt::skip]
pub const CASES: &[Case] = &[
    still("status", "the status is retained and says who the robot is", |b| Box::pin(reports::status(b))),
    still("parameters", "the parameters are retained, each within its range", |b| Box::pin(reports::parameters(b))),
    still("heartbeat", "a heartbeat comes every second", |b| Box::pin(reports::heartbeat(b))),
    still("telemetry", "telemetry comes at the rate its parameter says", |b| Box::pin(reports::telemetry(b))),
    still("clock", "the robot's clock is the fleet's", |b| Box::pin(reports::clock(b))),
    still("identify", "identify is completed", |b| Box::pin(orders::identify(b))),
    still("stop-at-rest", "a standing robot completes a stop", |b| Box::pin(orders::stop_at_rest(b))),
    still("swarm", "a command to the swarm is answered", |b| Box::pin(orders::swarm(b))),
    still("capture", "capture sends an image, or is unsupported without a camera", |b| Box::pin(orders::capture(b))),
    still("no-policy", "a policy that it has not is rejected: no_policy", |b| Box::pin(orders::no_policy(b))),
    still("unknown-command", "rejected: unknown_command", |b| Box::pin(door::unknown_command(b))),
    still("unknown-field", "a field or parameter too many is rejected: unknown_field", |b| Box::pin(door::unknown_field(b))),
    still("missing-field", "rejected: missing_field", |b| Box::pin(door::missing_field(b))),
    still("duplicate-field", "rejected: duplicate_field", |b| Box::pin(door::duplicate_field(b))),
    still("wrong-type", "rejected: wrong_type", |b| Box::pin(door::wrong_type(b))),
    still("out-of-range", "rejected: out_of_range", |b| Box::pin(door::out_of_range(b))),
    still("unknown-behaviour", "rejected: unknown_behaviour", |b| Box::pin(door::unknown_behaviour(b))),
    still("unknown-parameter", "rejected: unknown_parameter", |b| Box::pin(door::unknown_parameter(b))),
    still("malformed", "cut off, nested too deep, followed by more: rejected as malformed", |b| Box::pin(door::malformed(b))),
    still("not-utf8", "bytes that are no text are rejected as malformed", |b| Box::pin(door::not_utf8(b))),
    still("oversized", "more than 1,024 bytes are rejected, by the robot or before it", |b| Box::pin(door::oversized(b))),
    still("unreadable", "nothing and garbage have no answer and no effect", |b| Box::pin(door::unreadable(b))),
    still("refusals-logged", "a refused command is logged", |b| Box::pin(door::logged(b))),
    still("flood", "forty bad commands at once do not keep a good one from its answer", |b| Box::pin(door::flood(b))),
    still("repeated", "a repeated command is answered from memory and not carried out twice", |b| Box::pin(door::repeated(b))),
    still("stale", "a command older than the last of its source is stale", |b| Box::pin(door::stale(b))),
    still("expired", "a motion command from a minute ago is expired", |b| Box::pin(door::expired(b))),
    still("from-the-future", "a motion command from a minute ahead is rejected: out_of_range", |b| Box::pin(door::from_the_future(b))),
    still("late-stop", "a stop is obeyed however old it is", |b| Box::pin(door::late_stop(b))),
    still("set", "a parameter that is set is retained and in force", |b| Box::pin(settings::set(b))),
    still("set-all-or-none", "one bad parameter keeps the others from being set", |b| Box::pin(settings::all_or_none(b))),
    moving("turn", "move left and right turn the wheels against each other, and end", |b| Box::pin(motion::turn(b))),
    moving("forward-and-back", "move forward and backward go there and come back", |b| Box::pin(motion::forward_and_back(b))),
    moving("stop", "stop ends a move, which is answered failed: interrupted", |b| Box::pin(motion::stop(b))),
    moving("late-stop-moving", "a stop from long ago stops a moving robot", |b| Box::pin(motion::late_stop(b))),
    moving("estop", "an emergency stop latches until reset", |b| Box::pin(motion::estop(b))),
    moving("drive-failsafe", "drive ends by itself when its controller falls silent", |b| Box::pin(motion::drive_failsafe(b))),
    moving("move-failsafe", "so does a move without end", |b| Box::pin(motion::move_failsafe(b))),
    moving("overtaken", "a new move takes over, and the old one is answered failed", |b| Box::pin(motion::overtaken(b))),
    moving("not-again", "a repeated move does not move the robot again", |b| Box::pin(motion::not_again(b))),
    moving("late-move", "expired and stale moves do not move the robot", |b| Box::pin(motion::late_move(b))),
    moving("bad-while-moving", "bad commands do not disturb a robot under way", |b| Box::pin(motion::bad_while_moving(b))),
    moving("swarm-stop", "a stop to the swarm stops the robot", |b| Box::pin(motion::swarm_stop(b))),
    moving("scan", "scan turns the robot around and is completed", |b| Box::pin(motion::scan(b))),
    moving("goto", "goto arrives where it was sent", |b| Box::pin(motion::goto(b))),
    still("map", "the map is told whole, or the robot has none: no_map", |b| Box::pin(orders::map(b))),
    moving("wander", "wander drives, and stop ends it", |b| Box::pin(motion::wander(b))),
    moving("policy", "the policy that comes with the program drives, and stop ends it", |b| Box::pin(motion::policy(b))),
    still("fault", "a ranger that dies on purpose is ERROR for its time; stop is obeyed meanwhile", |b| Box::pin(faults::dead_ranger(b))),
    still("fault-refused", "a fault that a program cannot have is refused, and told", |b| Box::pin(faults::refused(b))),
    long("reboot", "reboot counts a boot by software and keeps the parameters", |b| Box::pin(reboot::reboot(b))),
    long("no-clock", "before the clock is known, motion is rejected: no_clock", |b| Box::pin(reboot::no_clock(b))),
    still("contract", "every message is valid, in order, within 1,024 bytes, and of the version in the status", |b| Box::pin(reports::contract(b))),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_fit_the_table() {
        for (index, case) in CASES.iter().enumerate() {
            assert!(case.name.len() <= 22, "{}", case.name);
            assert!(case.shows.len() <= 90, "{}", case.name);
            let again = CASES[..index].iter().any(|other| other.name == case.name);
            assert!(!again, "{} comes twice", case.name);
        }
    }

    /// The page for people names the same cases.
    #[test]
    fn the_page_lists_every_case() {
        let page = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/bench.md");
        let page = std::fs::read_to_string(page).expect("docs/bench.md");
        let listed: Vec<&str> = page
            .lines()
            .filter(|line| line.starts_with("| `"))
            .collect();
        let listed: Vec<&str> = listed
            .into_iter()
            .filter(|line| !line.starts_with("| `--"))
            .collect();
        let expected: Vec<String> = CASES
            .iter()
            .map(|case| {
                let moves = if case.motion { "| yes |" } else { "| |" };
                format!("| `{}` {moves} {} |", case.name, case.shows)
            })
            .collect();
        assert_eq!(listed, expected);
    }
}
