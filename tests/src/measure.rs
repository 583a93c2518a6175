//! What a process costs, as Linux tells it, and what a list of times says.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::Terracrawler;

/// User and system time of a process so far, from `/proc/<id>/stat` (proc(5): fields 14 and 15 in
/// clock ticks of 1/100 s).
///
/// # Panics
/// When there is no such process, or no Linux.
pub fn cpu_seconds(id: u32) -> f64 {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).expect("/proc");
    let (_, after_name) = stat.rsplit_once(") ").expect("a process name");
    let fields: Vec<&str> = after_name.split(' ').collect();
    let ticks = |index: usize| fields[index].parse::<f64>().expect("a number");
    (ticks(11) + ticks(12)) / 100.0
}

/// Resident memory of a process, from `/proc/<id>/status`.
///
/// # Panics
/// As [`cpu_seconds`].
pub fn resident_mib(id: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).expect("/proc");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB"));
    kib.expect("VmRSS").parse::<f64>().expect("a number") / 1024.0
}

/// Nearest-rank percentile of a sorted list; `None` of an empty one.
pub fn percentile<T: Copy>(sorted: &[T], percent: usize) -> Option<T> {
    let rank = (sorted.len() * percent).div_ceil(100).max(1);
    sorted.get(rank - 1).copied()
}

/// A span in milliseconds.
pub fn milliseconds(span: Duration) -> f64 {
    span.as_secs_f64() * 1e3
}

/// Unix time in milliseconds.
///
/// # Panics
/// When the clock of this machine stands before 1970.
pub fn unix_ms() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.expect("a clock after 1970").as_millis() as u64
}

/// The text of `/metrics`.
///
/// # Panics
/// When the server does not answer.
pub fn metrics(server: &Terracrawler) -> String {
    let (_, text) = server.get("/metrics");
    text.as_str().expect("Prometheus text").to_owned()
}

/// The sum of all series in `text` whose line begins with `name`.
pub fn sum(text: &str, name: &str) -> f64 {
    let sum: f64 = text
        .lines()
        .filter(|line| line.strip_prefix(name).is_some_and(is_whole))
        .filter_map(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok())
        .sum();
    // The sum of nothing is -0.
    sum + 0.0
}

/// Whether what stands before this is all of a name, and not only its beginning.
fn is_whole(rest: &str) -> bool {
    rest.starts_with(['{', ' '])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_of_the_nearest_rank() {
        let hundred: Vec<u32> = (1..=100).collect();
        assert_eq!(percentile(&hundred, 50), Some(50));
        assert_eq!(percentile(&hundred, 99), Some(99));
        assert_eq!(percentile(&hundred, 100), Some(100));
        assert_eq!(percentile(&[7], 1), Some(7));
        assert_eq!(percentile::<u32>(&[], 50), None);
    }

    #[test]
    fn series_of_one_name_are_added_up() {
        let text = "# HELP a\na_total{kind=\"x\"} 2\na_total{kind=\"y\"} 3\na_total_b 5\nc 7\n";
        assert_eq!(sum(text, "a_total"), 5.0);
        assert_eq!(sum(text, "a_total{kind=\"x\"}"), 2.0);
        assert_eq!(sum(text, "c"), 7.0);
        assert_eq!(sum(text, "d"), 0.0);
    }
}
