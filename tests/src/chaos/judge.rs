//! From what was given and what robots did to what went wrong.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};

use super::observed::{Answer, Duty, Observations, Observed};
use super::report::{Counts, Report};

/// So long after the last word of `drive` the wheels stand, microseconds.
const LEASE_US: u64 = 500_000;
/// From the end of a `move` until the wheels stand, microseconds: the control period in which the word
/// was read, the one in which its end is, and the ramp down of 80 ms.
const RAMP_US: u64 = 120_000;

/// Kinds of commands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A behaviour, which stands still here.
    Behave,
    /// For as long as the next one comes soon.
    Drive,
    /// Blinks.
    Identify,
    /// For a time.
    Move,
    /// A parameter.
    Set,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::Behave,
        Self::Drive,
        Self::Identify,
        Self::Move,
        Self::Set,
    ];

    /// As the contract names it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Behave => "behave",
            Self::Drive => "drive",
            Self::Identify => "identify",
            Self::Move => "move",
            Self::Set => "set",
        }
    }

    fn named(name: &str) -> Option<Self> {
        [
            Self::Behave,
            Self::Drive,
            Self::Identify,
            Self::Move,
            Self::Set,
        ]
        .into_iter()
        .find(|kind| kind.name() == name)
    }

    /// What makes the `number`th of them for a robot unlike all others of its kind; `None` where
    /// nothing can.
    pub fn mark(self, number: u64) -> Option<u64> {
        matches!(self, Self::Drive | Self::Move | Self::Set).then_some(number)
    }

    /// The parameters of the one with this mark.
    pub fn parameters(self, number: u64) -> Value {
        match self {
            // Kept below what a robot takes, and unlike each other in what a robot can tell apart.
            Self::Set => json!({ "safe_distance_mm": 300 + number % 2_700 }),
            Self::Move => {
                json!({ "direction": "left", "speed": 50, "duration": 200 + number % 2_000 })
            }
            Self::Drive => json!({ "v": 0.0, "w": 0.5 + (number % 20_000) as f64 * 1e-4 }),
            Self::Behave => json!({ "behaviour": "manual" }),
            Self::Identify => Value::Null,
        }
    }

    /// Reads the mark back.
    fn read(self, parameters: &Value) -> Option<u64> {
        match self {
            Self::Set => Some(parameters["safe_distance_mm"].as_f64()? as u64 - 300),
            Self::Move => Some(parameters["duration"].as_u64()? - 200),
            Self::Drive => Some(((parameters["w"].as_f64()? - 0.5) * 1e4).round() as u64),
            Self::Behave | Self::Identify => None,
        }
    }

    /// Whether it may come to nothing because it came too late.
    const fn is_motion(self) -> bool {
        matches!(self, Self::Behave | Self::Drive | Self::Move)
    }
}

/// A command that somebody gave, or tried to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Given {
    /// For which robot.
    pub robot: String,
    /// What.
    pub kind: Kind,
    /// What makes it unlike the others; see [`Kind::mark`].
    pub mark: Option<u64>,
    /// Its id, when it was acknowledged.
    pub id: Option<String>,
    /// Whether the server said no. With neither, it said nothing.
    pub refused: bool,
}

/// What a robot made of the commands of one name and mark.
#[derive(Default)]
struct Done {
    /// Numbers under which they ran.
    ran: BTreeSet<u64>,
    /// Numbers under which they were refused.
    refused: BTreeSet<u64>,
}

/// Fills in what the recording tells of commands and wheels.
pub fn judge(given: &[Given], observations: &Observations, report: &mut Report) {
    report.unrecorded = observations.lost;
    let mut by_robot: BTreeMap<&str, Vec<&Given>> = BTreeMap::new();
    for one in given {
        by_robot.entry(&one.robot).or_default().push(one);
    }
    for (id, observed) in &observations.robots {
        let theirs = by_robot.remove(id.as_str()).unwrap_or_default();
        commands(id, &theirs, observed, report);
        wheels(observed, observations.end_us, report);
        report.reboots += observed.boots.saturating_sub(1);
    }
    // A robot that is not in the recording did nothing.
    for (id, theirs) in by_robot {
        commands(id, &theirs, &Observed::default(), report);
    }
}

/// Whether the robot took the command up, and so counted it. What it rejects then, for instance because
/// something stands in the way, it has looked at; what it rejects at the door it has not.
fn did(answers: &[Answer]) -> bool {
    let at_the_door =
        |reason: Option<&str>| matches!(reason, None | Some("busy" | "no_clock" | "out_of_range"));
    answers.iter().any(|answer| match answer.status.as_str() {
        "accepted" | "completed" | "failed" => true,
        "rejected" => !at_the_door(answer.reason.as_deref()),
        _ => false,
    })
}

fn commands(id: &str, given: &[&Given], observed: &Observed, report: &mut Report) {
    let (mut done, mut seen) = (
        BTreeMap::<(Kind, Option<u64>), Done>::new(),
        BTreeSet::new(),
    );
    let (mut ran, mut silent) = (BTreeSet::new(), 0_u64);
    for delivery in &observed.deliveries {
        report.deliveries[0] += 1;
        if !seen.insert(delivery.seq) {
            report.deliveries[1] += 1;
            continue;
        }
        let Some(kind) = Kind::named(&delivery.command) else {
            continue;
        };
        let done = done
            .entry((kind, kind.read(&delivery.parameters)))
            .or_default();
        match observed.answers.get(&delivery.seq) {
            None => silent += 1,
            Some(answers) if did(answers) => {
                ran.insert(delivery.seq);
                done.ran.insert(delivery.seq);
            }
            Some(_) => drop(done.refused.insert(delivery.seq)),
        }
    }
    // Those without a mark cannot be told apart: they are counted.
    let mut asked: BTreeMap<(Kind, Option<u64>), [u64; 2]> = BTreeMap::new();
    for one in given {
        let counts = report.commands.entry(one.kind).or_default();
        let asked = asked.entry((one.kind, one.mark)).or_default();
        if one.id.is_some() {
            counts.acknowledged += 1;
            asked[0] += 1;
        } else if one.refused {
            counts.refused_by_server += 1;
        } else {
            counts.unknown += 1;
            asked[1] += 1;
        }
    }
    for ((kind, mark), [acknowledged, unknown]) in asked {
        let counts = report.commands.entry(kind).or_default();
        let done = done.remove(&(kind, mark)).unwrap_or_default();
        let times = done.ran.len() as u64;
        let beyond = times.saturating_sub(acknowledged + unknown);
        report.twice += beyond;
        if beyond > 0 {
            let name = kind.name();
            let (ran, given) = (&done.ran, acknowledged + unknown);
            let line = format!("{id}: {name} {mark:?}, given {given} times, ran as {ran:?}");
            report.details.push(line);
        }
        missing(counts, kind, acknowledged, &done, &mut report.lost);
    }
    // Whatever else ran was given by nobody.
    for ((kind, mark), done) in done {
        report.twice += done.ran.len() as u64;
        if !done.ran.is_empty() {
            let (name, ran) = (kind.name(), done.ran);
            let line = format!("{id}: {name} {mark:?}, given by nobody, ran as {ran:?}");
            report.details.push(line);
        }
    }

    let (commands, numbers) = observed.carried_out;
    let known = ran.len() as u64;
    let unsaid = commands.saturating_sub(known + silent);
    report.twice += unsaid;
    if unsaid > 0 {
        let line = format!("{id}: carried out {commands}, and told of {known}");
        report.details.push(line);
    }
    report.invented += known.saturating_sub(commands);
    let sum = ran.iter().fold(0_u64, |sum, seq| sum.wrapping_add(*seq));
    if silent == 0 && commands == known && numbers != sum {
        report.invented += 1;
    }
    report.wrong_settings += u64::from(!last_is_held(observed));
}

fn missing(counts: &mut Counts, kind: Kind, acknowledged: u64, done: &Done, lost: &mut u64) {
    let ran = (done.ran.len() as u64).min(acknowledged);
    let refused = (done.refused.len() as u64).min(acknowledged - ran);
    let rest = acknowledged - ran - refused;
    counts.ran += ran;
    counts.refused += refused;
    if kind.is_motion() {
        counts.expired += rest;
    } else {
        *lost += rest;
    }
}

/// Whether the robot says to have the value of the last `set` that ran.
fn last_is_held(observed: &Observed) -> bool {
    let sets = observed.deliveries.iter().rev();
    let mut ran = sets.filter(|delivery| {
        let answers = observed.answers.get(&delivery.seq);
        delivery.command == "set" && answers.is_some_and(|answers| did(answers))
    });
    // The highest number, since what comes again comes out of order.
    let first = ran.next();
    let last = ran.fold(first, |last, one| match last {
        Some(last) if last.seq >= one.seq => Some(last),
        _ => Some(one),
    });
    let Some(last) = last else {
        return true;
    };
    let held = observed.parameters["safe_distance_mm"]["value"].as_f64();
    held == last.parameters["safe_distance_mm"].as_f64()
}

/// Holds every moment in which a wheel is driven against the word that allows it.
fn wheels(observed: &Observed, end_us: u64, report: &mut Report) {
    let mut seen = BTreeSet::new();
    let words = observed.deliveries.iter().filter_map(|delivery| {
        let answers = observed.answers.get(&delivery.seq);
        // What is there again moves nobody.
        if !seen.insert(delivery.seq) || !answers.is_some_and(|answers| did(answers)) {
            return None;
        }
        match Kind::named(&delivery.command)? {
            Kind::Drive => Some((delivery.at_us, delivery.at_us + LEASE_US, 0)),
            Kind::Move => {
                let ms = delivery.parameters["duration"].as_u64()?;
                Some((delivery.at_us, delivery.at_us + ms * 1_000, RAMP_US))
            }
            _ => None,
        }
    });
    let mut words: Vec<(u64, u64, u64)> = words.collect();
    words.sort_unstable();
    let ends = observed.duties.iter().skip(1).map(|duty| duty.0);
    for (duty, end) in observed.duties.iter().zip(ends.chain([end_us])) {
        let Duty(begin, true) = *duty else { continue };
        // Where the words of this span leave gaps.
        // The newer word replaces the older.
        let mut known = words.iter().filter(|(at, ..)| *at <= begin);
        let (mut until, mut ramp) = known.next_back().map_or((0, 0), |word| (word.1, word.2));
        let inside = words.iter().filter(|(at, ..)| begin < *at && *at < end);
        let mut runaway = false;
        for &(at, next, next_ramp) in inside.chain([&(end, 0, 0)]) {
            let beyond = at.saturating_sub(until.max(begin));
            report.longest_beyond_ms = report.longest_beyond_ms.max(beyond / 1_000);
            runaway |= beyond > ramp;
            (until, ramp) = (next, next_ramp);
        }
        report.runaways += u64::from(runaway);
    }
}

#[cfg(test)]
#[path = "judge_tests.rs"]
mod tests;
