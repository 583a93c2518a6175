//! What is asked for at every scrape rather than counted along the way.

use std::fmt::Write as _;
use std::path::Path;

use crawler_protocol::RobotState;
use crawler_records::DatabaseStats;

use super::experiments;
use crate::broker::Load;
use crate::experiments::ExperimentNumbers;
use crate::fleet::{FleetState, Presence};
use crate::history::History;
use crate::process;
use crate::recorder;

/// The state of robots that have not told theirs.
const UNTOLD: &str = "unknown";

/// What is asked for at every scrape.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Observed {
    pub(crate) robots: Robots,
    pub(crate) open_commands: usize,
    /// Tasks that have not ended, of each runtime of this process.
    pub(crate) tasks: Tasks,
    pub(crate) simulation: Option<Simulated>,
    pub(crate) experiments: ExperimentNumbers,
}

/// Tasks that have not ended.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Tasks {
    pub(crate) server: usize,
    /// Of the embedded broker, where there is one.
    pub(crate) broker: Option<usize>,
}

/// The robots of the fleet, counted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Robots {
    pub(crate) online: usize,
    pub(crate) stale: usize,
    pub(crate) offline: usize,
    /// Those not offline, by the order of [`RobotState::ALL`]; the last place is for those that have
    /// told no state.
    states: [usize; RobotState::ALL.len() + 1],
    /// Ids that two robots seem to share.
    doubles: usize,
}

impl Robots {
    /// Counts `fleet`.
    pub(crate) fn count(fleet: &FleetState) -> Self {
        let mut count = Self::default();
        for robot in fleet.robots() {
            match robot.presence {
                Presence::Online => count.online += 1,
                Presence::Stale => count.stale += 1,
                Presence::Offline => count.offline += 1,
            }
            count.doubles += usize::from(robot.has_double());
            // What an absent robot did last says nothing about now.
            if robot.presence != Presence::Offline {
                let place = robot
                    .state()
                    .and_then(|state| RobotState::ALL.iter().position(|known| *known == state));
                if let Some(slot) = count.states.get_mut(place.unwrap_or(RobotState::ALL.len())) {
                    *slot += 1;
                }
            }
        }
        count
    }

    fn write(&self, out: &mut String) {
        family(
            out,
            "terracrawler_robots",
            "Robots known, by presence",
            "status",
            [
                ("online", self.online),
                ("stale", self.stale),
                ("offline", self.offline),
            ],
        );
        let names = RobotState::ALL
            .iter()
            .map(|state| state.name())
            .chain([UNTOLD]);
        family(
            out,
            "terracrawler_robots_by_state",
            "Robots that are not offline, by the state they told last",
            "state",
            names.zip(self.states),
        );
        gauge(
            out,
            "terracrawler_robots_sharing_an_id",
            "Ids under which two robots seem to speak",
            self.doubles as f64,
        );
    }
}

/// How the simulation in this process is doing.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Simulated {
    /// Simulated seconds per second.
    pub(crate) real_time_factor: f64,
    /// Physics steps so far.
    pub(crate) steps: u64,
    /// Robots in the world.
    pub(crate) robots: u64,
    /// Robots whose connection to the broker is up.
    pub(crate) connected: u64,
}

impl Simulated {
    fn write(&self, out: &mut String) {
        gauge(
            out,
            "terracrawler_simulation_real_time_factor",
            "Simulated seconds per second",
            self.real_time_factor,
        );
        gauge(
            out,
            "terracrawler_simulation_robots",
            "Robots in the simulated world",
            self.robots as f64,
        );
        gauge(
            out,
            "terracrawler_simulation_connected",
            "Robots of the simulated world that are connected to the broker",
            self.connected as f64,
        );
        counter(
            out,
            "terracrawler_simulation_steps",
            "Physics steps of the simulated world",
            self.steps as f64,
        );
    }
}

impl Observed {
    pub(super) fn write(&self, out: &mut String) {
        self.robots.write(out);
        gauge(
            out,
            "terracrawler_commands_open",
            "Commands some robot has not answered for good",
            self.open_commands as f64,
        );
        let of_broker = self.tasks.broker.map(|count| ("broker", count));
        family(
            out,
            "terracrawler_tasks",
            "Tasks that have not ended, by runtime",
            "runtime",
            std::iter::once(("server", self.tasks.server)).chain(of_broker),
        );
        if let Some(simulation) = self.simulation {
            simulation.write(out);
        }
        experiments::write(out, self.experiments);
    }
}

/// How full the embedded broker is.
pub(super) fn write_broker(out: &mut String, load: Load) {
    for (name, help, value) in [
        ("connections", "Open connections", load.connections),
        (
            "sessions",
            "Sessions, also of clients that are away and may return",
            load.sessions,
        ),
        (
            "subscriptions",
            "Subscriptions of all sessions",
            load.subscriptions,
        ),
        (
            "queued",
            "Messages waiting for their session to take them",
            load.queued,
        ),
        (
            "unacknowledged",
            "QoS 1 messages that were sent and not acknowledged",
            load.unacknowledged,
        ),
    ] {
        gauge(
            out,
            &format!("terracrawler_embedded_broker_{name}"),
            help,
            value as f64,
        );
    }
}

/// How full the disk of the data directory is, and with what.
pub(super) fn write_data(out: &mut String, data: &Path) {
    if let Ok(found) = rustix::fs::statvfs(data) {
        gauge(
            out,
            "terracrawler_data_free_bytes",
            "Free space where the data directory is",
            found.f_bavail.saturating_mul(found.f_frsize) as f64,
        );
    }
    let databases = std::fs::read_dir(data).map(|entries| {
        entries
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().contains(".sqlite"))
            .filter_map(|entry| Some(entry.metadata().ok()?.len()))
            .sum::<u64>()
    });
    if let Ok(bytes) = databases {
        gauge(
            out,
            "terracrawler_data_size_bytes",
            "Size of the databases in the data directory",
            bytes as f64,
        );
    }
}

/// How the history of telemetry is doing, in this process or outside.
pub(super) fn write_history(out: &mut String, history: &History) {
    let (counters, queued) = match history {
        History::Local(local) => {
            let stats = local.stats();
            gauge(
                out,
                "terracrawler_history_kept",
                "1 while this process writes the history",
                f64::from(u8::from(stats.keeper)),
            );
            let damaged = ("damaged", "Blocks that could not be read", stats.damaged);
            let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
            ((taken, damaged), stats.queued)
        }
        History::Remote(remote) => {
            let stats = remote.stats();
            gauge(
                out,
                "terracrawler_history_engine_up",
                "1 while the engine outside takes samples",
                f64::from(u8::from(stats.up)),
            );
            let refused = ("refused", "Samples that the engine refused", stats.refused);
            let taken = [stats.accepted, stats.written, stats.dropped, stats.failures];
            ((taken, refused), stats.queued)
        }
    };
    let ([accepted, written, dropped, failures], own) = counters;
    for (name, help, value) in [
        (
            "accepted",
            "Telemetry samples taken for the history",
            accepted,
        ),
        (
            "written",
            "Samples that are on disk, or with the engine outside",
            written,
        ),
        (
            "dropped",
            "Samples let go because too many were waiting",
            dropped,
        ),
        (
            "failures",
            "Writes that failed and were tried again",
            failures,
        ),
        own,
    ] {
        counter(
            out,
            &format!("terracrawler_history_{name}"),
            help,
            value as f64,
        );
    }
    gauge(
        out,
        "terracrawler_history_queued",
        "Samples waiting to be written",
        queued as f64,
    );
}

/// How events get into the records.
pub(super) fn write_events(out: &mut String, stats: recorder::Stats) {
    for (name, help, value) in [
        ("written", "Events in the records", stats.written),
        (
            "dropped",
            "Events let go because too many were waiting, or the records refused them",
            stats.dropped,
        ),
        ("failures", "Writes of events that failed", stats.failures),
    ] {
        counter(
            out,
            &format!("terracrawler_events_{name}"),
            help,
            value as f64,
        );
    }
    gauge(
        out,
        "terracrawler_events_queued",
        "Events waiting to be written",
        stats.queued as f64,
    );
}

/// How the database of the records is doing, where they are in one.
pub(super) fn write_database(out: &mut String, stats: &DatabaseStats) {
    gauge(
        out,
        "terracrawler_database_up",
        "1 while the database of the records answers",
        f64::from(u8::from(stats.up)),
    );
    gauge(
        out,
        "terracrawler_database_queued",
        "Changes waiting to be written to it",
        stats.queued as f64,
    );
    for (name, help, value) in [
        (
            "transactions",
            "Transactions that it committed for this server",
            stats.transactions as f64,
        ),
        (
            "transaction_seconds",
            "Time that those took, with the wait for other servers",
            stats.waited.as_secs_f64(),
        ),
        (
            "failures",
            "Calls that failed because it was not available",
            stats.failures as f64,
        ),
    ] {
        counter(out, &format!("terracrawler_database_{name}"), help, value);
    }
}

/// What this process costs and what program it is.
pub(super) fn write_process(out: &mut String) {
    // An info metric: always 1, and the version is the label.
    let _ = write!(
        out,
        "# HELP terracrawler_build_info The program that answers.\n\
         # TYPE terracrawler_build_info gauge\n\
         terracrawler_build_info{{version=\"{}\"}} 1\n",
        env!("CARGO_PKG_VERSION")
    );
    let Some(usage) = process::usage() else {
        return;
    };
    counter(
        out,
        "process_cpu_seconds",
        "User and system time of this process",
        usage.cpu_seconds,
    );
    gauge(
        out,
        "process_resident_memory_bytes",
        "Resident memory of this process",
        usage.resident_bytes as f64,
    );
    gauge(
        out,
        "process_threads",
        "Threads of this process",
        usage.threads as f64,
    );
    gauge(
        out,
        "process_open_fds",
        "Open descriptors of this process",
        usage.descriptors as f64,
    );
}

/// Gauges that differ in one label.
pub(super) fn family<'a>(
    out: &mut String,
    name: &str,
    help: &str,
    label: &str,
    values: impl IntoIterator<Item = (&'a str, usize)>,
) {
    let _ = write!(out, "# HELP {name} {help}.\n# TYPE {name} gauge\n");
    for (value, count) in values {
        let _ = writeln!(out, "{name}{{{label}=\"{value}\"}} {count}");
    }
}

pub(super) fn counter(out: &mut String, name: &str, help: &str, value: f64) {
    let _ = write!(
        out,
        "# HELP {name} {help}.\n# TYPE {name} counter\n{name}_total {value}\n"
    );
}

pub(super) fn gauge(out: &mut String, name: &str, help: &str, value: f64) {
    let _ = write!(
        out,
        "# HELP {name} {help}.\n# TYPE {name} gauge\n{name} {value}\n"
    );
}
