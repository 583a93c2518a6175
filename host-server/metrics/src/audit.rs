//! Whether the audit log can be written.

use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Registry;

/// What is counted of writing to the audit log.
pub struct AuditLog {
    up: Gauge,
    waiting: Gauge,
    failures: Counter,
}

impl AuditLog {
    pub(crate) fn new(registry: &mut Registry) -> Self {
        let log = Self {
            up: Gauge::default(),
            waiting: Gauge::default(),
            failures: Counter::default(),
        };
        registry.register(
            "audit_log_up",
            "1 while the audit log can be written",
            log.up.clone(),
        );
        registry.register(
            "audit_log_waiting",
            "Lines of the audit log that waited in memory after the last attempt to write some",
            log.waiting.clone(),
        );
        registry.register(
            "audit_log_failures",
            "Writes to the audit log that failed",
            log.failures.clone(),
        );
        log
    }

    /// Says whether the log can be written, and how many lines wait.
    pub fn written(&self, up: bool, waiting: usize) {
        self.up.set(i64::from(up));
        self.waiting.set(waiting as i64);
    }

    /// Counts a write that failed.
    pub fn failed(&self) {
        self.failures.inc();
    }
}
