//! Whether a server is as it was after all that time.

use super::Reading;

/// Growth of resident memory from rest to rest that counts as none, MiB: the allocator's own ways.
const MEMORY_MIB: f64 = 1.0;
/// Descriptors and tasks come and go by so many: connections of clients that ask, files of databases.
const SPREAD: u64 = 16;
/// Bytes of history for a sample, and of records for a command with its lines in journal and audit log.
const SAMPLE_BYTES: f64 = 16.0;
const COMMAND_BYTES: f64 = 1_024.0;

/// A rule, what was found, and whether it holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// What is to be so.
    pub rule: &'static str,
    /// What it is.
    pub found: String,
    /// Whether that is so.
    pub holds: bool,
}

/// Holds readings to the rules. What begins anew with the server is judged by the cycles since it was
/// started last; memory by the second half of those, when all that is made once is there.
pub fn judge(readings: &[Reading]) -> Vec<Finding> {
    let since = readings.iter().rposition(|reading| reading.restarted);
    let since = readings
        .get(since.map_or(0, |at| at + 1)..)
        .unwrap_or_default();
    let late = since.get(since.len() / 2..).unwrap_or_default();
    let mut findings = Vec::new();
    let mut find = |rule, found, holds| findings.push(Finding { rule, found, holds });

    let rows = late.iter().map(|reading| reading.memory_mib);
    match slope(&rows.collect::<Vec<_>>()) {
        Some(slope) => find(
            "memory grows by no more than 1 MiB a cycle in the second half",
            format!("{slope:.2} MiB"),
            slope <= MEMORY_MIB,
        ),
        None => find(
            "memory grows by no more than 1 MiB a cycle in the second half",
            "too few cycles".to_owned(),
            false,
        ),
    }
    let spread = |of: &dyn Fn(&Reading) -> u64| {
        let values = since.iter().map(of);
        (values.clone().min().unwrap_or(0), values.max().unwrap_or(0))
    };
    for (rule, of) in [
        (
            "descriptors at rest stay within 16",
            &(|reading: &Reading| reading.descriptors) as &dyn Fn(&Reading) -> u64,
        ),
        ("tasks of the server at rest stay within 16", &|reading| {
            reading.tasks[0]
        }),
        ("tasks of the broker at rest stay within 16", &|reading| {
            reading.tasks[1]
        }),
    ] {
        let (least, most) = spread(of);
        find(
            rule,
            format!("{least} to {most}"),
            most > 0 && most - least <= SPREAD,
        );
    }
    let sum = |of: &dyn Fn(&Reading) -> u64| readings.iter().map(of).sum::<u64>();
    let queued = readings.iter().map(|reading| reading.queued).max();
    find(
        "what waits at rest is less than a second of telemetry",
        format!("{} at most", queued.unwrap_or(0)),
        // Robots go on telling where they are.
        queued.is_some_and(|queued| queued < MOST_QUEUED),
    );
    let (ended, forgotten) = (
        sum(&|reading| reading.ended),
        sum(&|reading| reading.forgotten),
    );
    let lost = sum(&|reading| reading.lost.len() as u64);
    find(
        "no acknowledged command is lost",
        format!("{lost} of {}", ended + forgotten + lost),
        lost == 0 && ended > 0,
    );
    let let_go = sum(&|reading| reading.let_go);
    find("nothing is let go", let_go.to_string(), let_go == 0);
    if let ([first, rest @ ..], Some(last)) = (since, since.last()) {
        let each = |bytes: u64, count: u64| bytes as f64 / count.max(1) as f64;
        let samples = last.samples.saturating_sub(first.samples);
        let history = each(
            last.history_bytes.saturating_sub(first.history_bytes),
            samples,
        );
        find(
            "a sample takes no more than 16 bytes of disk",
            format!("{history:.1} of {samples}"),
            samples > 0 && history <= SAMPLE_BYTES,
        );
        let commands: u64 = rest.iter().map(|reading| reading.acknowledged).sum();
        let records = each(
            last.records_bytes.saturating_sub(first.records_bytes),
            commands,
        );
        find(
            "a command takes no more than 1,024 bytes of disk",
            format!("{records:.0} of {commands}"),
            commands > 0 && records <= COMMAND_BYTES,
        );
    }
    findings
}

/// Samples of 1,000 robots in half a second, which is what the history waits for at most.
const MOST_QUEUED: u64 = 2_500;

/// How much the values grow from one to the next, by least squares; `None` of fewer than three.
fn slope(values: &[f64]) -> Option<f64> {
    if values.len() < 3 {
        return None;
    }
    let count = values.len() as f64;
    let middle = (count - 1.0) / 2.0;
    let mean = values.iter().sum::<f64>() / count;
    let (mut above, mut below) = (0.0, 0.0);
    for (at, value) in values.iter().enumerate() {
        let from = at as f64 - middle;
        above += from * (value - mean);
        below += from * from;
    }
    Some(above / below)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eight cycles of a server that is well, the first two with restarts.
    fn good() -> Vec<Reading> {
        (0..8_u64)
            .map(|cycle| Reading {
                cycle: cycle as usize + 1,
                restarted: cycle < 2,
                memory_mib: 150.0 + [0.0, 3.0, 1.0, 2.0][cycle as usize % 4],
                descriptors: 1_500 + cycle % 3,
                tasks: [15, 1_000 + cycle % 5],
                queued: 40,
                acknowledged: 10_000,
                ended: 5_000,
                forgotten: u64::from(cycle < 2),
                samples: 100_000 * (cycle + 1),
                history_bytes: 900_000 * (cycle + 1),
                records_bytes: 5_000_000 * (cycle + 1),
                ..Reading::default()
            })
            .collect()
    }

    fn broken(readings: &[Reading]) -> Vec<&'static str> {
        let findings = judge(readings);
        let broken = findings.iter().filter(|finding| !finding.holds);
        broken.map(|finding| finding.rule).collect()
    }

    /// The rules that do not hold when something is done to the readings.
    fn changed(change: impl Fn(&mut Reading)) -> Vec<&'static str> {
        let mut readings = good();
        readings.iter_mut().for_each(change);
        broken(&readings)
    }

    #[test]
    fn a_server_that_is_well_keeps_every_rule() {
        assert_eq!(broken(&good()), [""; 0]);
        assert_eq!(judge(&good()).len(), 9);
    }

    #[test]
    fn each_rule_can_be_broken() {
        let grows = changed(|reading| reading.memory_mib += 2.0 * reading.cycle as f64);
        assert_eq!(grows.len(), 1);
        assert!(grows[0].starts_with("memory"));
        let late = changed(|reading| reading.descriptors += 10 * (reading.cycle as u64));
        assert_eq!(late, ["descriptors at rest stay within 16"]);
        let tasks = changed(|reading| reading.tasks[0] += 10 * (reading.cycle as u64));
        assert_eq!(tasks, ["tasks of the server at rest stay within 16"]);
        let tasks = changed(|reading| reading.tasks[1] += 10 * (reading.cycle as u64));
        assert_eq!(tasks, ["tasks of the broker at rest stay within 16"]);
        let queued = changed(|reading| reading.queued = 10_000);
        assert_eq!(queued.len(), 1);
        let lost = changed(|reading| {
            if reading.cycle == 1 {
                reading.lost.push("an id: unknown".to_owned());
            }
        });
        assert_eq!(lost, ["no acknowledged command is lost"]);
        assert_eq!(changed(|reading| reading.let_go = 1), ["nothing is let go"]);
        let history = changed(|reading| reading.history_bytes *= 2);
        assert_eq!(history, ["a sample takes no more than 16 bytes of disk"]);
        let records = changed(|reading| reading.records_bytes *= 3);
        assert_eq!(
            records,
            ["a command takes no more than 1,024 bytes of disk"]
        );
    }

    #[test]
    fn what_happened_before_the_last_restart_is_another_server() {
        let mut readings = good();
        readings[0].memory_mib = 5.0;
        readings[1].descriptors = 9_000;
        assert_eq!(broken(&readings), [""; 0]);
    }

    #[test]
    fn without_cycles_nothing_holds() {
        assert!(judge(&[]).iter().all(|finding| {
            // Nothing was let go, indeed.
            !finding.holds || finding.rule == "nothing is let go"
        }));
    }

    #[test]
    fn a_slope_is_that_of_the_line() {
        assert_eq!(slope(&[1.0, 2.0]), None);
        assert_eq!(slope(&[1.0, 3.0, 5.0, 7.0]), Some(2.0));
        assert_eq!(slope(&[4.0, 4.0, 4.0]), Some(0.0));
    }
}
