//! What the process costs, and how full its disk is.

use std::path::Path;

use crawler_system::process;

use crate::Exposition;

/// What this process costs and what program it is.
pub fn write_process(out: &mut Exposition) {
    out.info(
        "terracrawler_build_info",
        "The program that answers",
        "version",
        env!("CARGO_PKG_VERSION"),
    );
    let Some(usage) = process::usage() else {
        return;
    };
    out.counter(
        "process_cpu_seconds",
        "User and system time of this process",
        usage.cpu_seconds,
    );
    out.gauge(
        "process_resident_memory_bytes",
        "Resident memory of this process",
        usage.resident_bytes as f64,
    );
    out.gauge(
        "process_threads",
        "Threads of this process",
        usage.threads as f64,
    );
    out.gauge(
        "process_open_fds",
        "Open descriptors of this process",
        usage.descriptors as f64,
    );
}

/// How full the disk of the data directory is, and with what.
pub fn write_data(out: &mut Exposition, data: &Path) {
    if let Ok(found) = rustix::fs::statvfs(data) {
        out.gauge(
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
        out.gauge(
            "terracrawler_data_size_bytes",
            "Size of the databases in the data directory",
            bytes as f64,
        );
    }
}
