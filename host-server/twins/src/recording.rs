//! What is heard of one robot, kept while somebody wants it: the same evidence that its twin gets.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use crawler_twin::evidence::{Evidence, Fix, Row};

/// Rows that are kept: more than ten minutes of a robot that tells 20 times a second.
const MOST_ROWS: usize = 32_768;

#[derive(Debug, Default)]
struct Kept {
    rows: Vec<Row>,
    /// The newest fix, and when the newest duties came, seconds.
    fix: Option<Fix>,
    told_s: Option<f64>,
}

/// Where a twin puts what it hears, as long as somebody keeps it.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tap(Weak<Mutex<Kept>>);

impl Tap {
    pub(crate) fn put(&self, row: Row) {
        let Some(kept) = self.0.upgrade() else {
            return;
        };
        let mut kept = lock(&kept);
        match row {
            Row::Fix(fix) => kept.fix = Some(fix),
            Row::Duty(duty) => kept.told_s = duty.arrived_s,
            Row::Supply(_) => {}
        }
        if kept.rows.len() < MOST_ROWS {
            kept.rows.push(row);
        }
    }
}

/// Evidence of a robot from a moment on. It ends when this is dropped.
#[derive(Debug, Default)]
pub struct Recording(Arc<Mutex<Kept>>);

fn lock(kept: &Mutex<Kept>) -> MutexGuard<'_, Kept> {
    kept.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Recording {
    pub(crate) fn tap(&self) -> Tap {
        Tap(Arc::downgrade(&self.0))
    }

    /// The newest fix.
    pub fn fix(&self) -> Option<Fix> {
        lock(&self.0).fix
    }

    /// When the robot last told what its motors do, by the clock of twins, seconds.
    pub fn told_s(&self) -> Option<f64> {
        lock(&self.0).told_s
    }

    /// Samples of telemetry and fixes that came since a moment by the clock of twins, seconds.
    pub fn since(&self, from_s: f64) -> (usize, usize) {
        let kept = lock(&self.0);
        let came = |row: &&Row| row.arrived_s().is_some_and(|at_s| at_s >= from_s);
        let recent = kept.rows.iter().rev().take_while(came);
        recent.fold((0, 0), |(duties, fixes), row| match row {
            Row::Duty(_) => (duties + 1, fixes),
            Row::Fix(_) => (duties, fixes + 1),
            Row::Supply(_) => (duties, fixes),
        })
    }

    /// All of it; what is refused of it is counted there.
    pub fn evidence(&self) -> Evidence {
        let mut evidence = Evidence::default();
        for row in &lock(&self.0).rows {
            // Whoever certifies looks at the counts.
            let _ = evidence.take(*row);
        }
        evidence
    }
}
