//! What this process costs, from `/proc`, and what of it gives way. Other systems have no such files and report nothing.

/// CPU time, memory and open files of this process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usage {
    /// User and system time of all threads, in seconds.
    pub cpu_seconds: f64,
    /// Resident memory, in bytes.
    pub resident_bytes: u64,
    /// Threads.
    pub threads: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

/// Ticks per second of `/proc/self/stat`. The kernel scales them to 100 for programs on every
/// architecture we run on (`USER_HZ`, see proc(5)).
const TICKS_PER_SECOND: f64 = 100.0;

/// Leaves the processor to every other thread that has something to do; threads that this one starts do as well. Does nothing
/// where a priority is that of a whole process.
///
/// # Errors
/// What the system says.
#[cfg_attr(
    not(target_os = "linux"),
    expect(clippy::unnecessary_wraps, reason = "systems differ")
)]
pub fn give_way() -> std::io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        // There, a priority is that of a thread.
        const LOWEST: i32 = 19;
        rustix::process::setpriority_process(None, LOWEST)?;
    }
    Ok(())
}

/// Reads the current usage.
pub fn usage() -> Option<Usage> {
    let open = std::fs::read_dir("/proc/self/fd").ok()?.count() as u64;
    parse(
        &std::fs::read_to_string("/proc/self/stat").ok()?,
        &std::fs::read_to_string("/proc/self/status").ok()?,
        // Without the one that reads the list.
        open.saturating_sub(1),
    )
}

fn parse(stat: &str, status: &str, descriptors: u64) -> Option<Usage> {
    // The name in parentheses may hold spaces; fields are counted from behind it. Field 3 is the
    // first, so utime (14) and stime (15) are the 12th and 13th.
    let mut fields = stat.rsplit_once(')')?.1.split_ascii_whitespace();
    let user: u64 = fields.nth(11)?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    let line = |name: &str| -> Option<u64> {
        status
            .lines()
            .find_map(|line| line.strip_prefix(name))?
            .split_ascii_whitespace()
            .next()?
            .parse()
            .ok()
    };
    Some(Usage {
        cpu_seconds: (user + system) as f64 / TICKS_PER_SECOND,
        resident_bytes: line("VmRSS:")? * 1024,
        threads: line("Threads:")?,
        descriptors,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_with_spaces_and_parentheses_do_not_shift_the_fields() {
        let stat =
            "42 (a ) name) S 1 42 42 0 -1 4194304 100 0 0 0 250 50 0 0 20 0 8 0 100 1000 200";
        let status = "Name:\ta\nVmRSS:\t    2048 kB\nThreads:\t8\n";
        assert_eq!(
            parse(stat, status, 12),
            Some(Usage {
                cpu_seconds: 3.0,
                resident_bytes: 2 * 1024 * 1024,
                threads: 8,
                descriptors: 12,
            })
        );
    }

    #[test]
    fn nonsense_is_no_usage() {
        assert_eq!(parse("", "", 0), None);
        assert_eq!(parse("1 (x) S", "VmRSS: 1 kB", 0), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_uses_memory() {
        let usage = usage().expect("/proc");
        assert!(usage.resident_bytes > 1024 * 1024, "{usage:?}");
        assert!(usage.threads >= 1);
        let files: Vec<_> = (0..100)
            .map(|_| std::fs::File::open("/proc/self/stat"))
            .collect();
        let more = super::usage().expect("/proc").descriptors;
        drop(files);
        assert!(more >= 100, "{more}");
    }
}
