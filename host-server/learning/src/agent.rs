//! A robot in a bare world that drives by a policy, as its program would.

use crawler_app::controller::{PERIOD, Tuning};
use crawler_app::motion::Odometry;
use crawler_app::neighbours::Neighbour;
use crawler_app::policy::{Decision, Known, Observation, Pilot};
use crawler_app::tracking::Fix;
use crawler_sim::run::bare::{Drive, Senses};

/// How little sure of its place a robot may be to go by where others are, in metres of sigma: as in the program.
const VAGUE: f32 = 0.5;

/// See the [module](self).
#[derive(Debug, Clone, Default)]
pub(crate) struct Agent {
    pilot: Pilot,
    odometry: Odometry,
    /// Whether it was told to drive by a policy.
    drives: bool,
    /// To be taken in at the next control step.
    pub(crate) fix: Option<Fix>,
    /// To be taken in at the next control step.
    pub(crate) action: Option<u8>,
    /// Who is near.
    pub(crate) near: Vec<Neighbour>,
    /// The newest observation, and its number.
    seen: (Observation, u16),
}

impl Agent {
    /// Tells it to drive by a policy from now on.
    pub(crate) fn begin(&mut self) {
        self.pilot.begin(&self.odometry.pose());
        self.drives = true;
    }

    /// The newest observation.
    pub(crate) const fn observation(&self) -> &Observation {
        &self.seen.0
    }

    /// A control step. `tuning` is what it believes of its drive, nothing ahead is driven to when it is nearer than
    /// `critical_mm`.
    pub(crate) fn control(&mut self, senses: &Senses, tuning: &Tuning, critical_mm: u16) -> Drive {
        let tuning = tuning.at(senses.battery.voltage);
        self.odometry
            .advance(senses.duties, PERIOD, tuning.geometry());
        if let Some(fix) = self.fix.take() {
            let age = senses.now - fix.seen;
            self.odometry.correct(fix.pose, age, tuning.geometry());
        }
        if !self.drives {
            return Drive::Stop;
        }
        let pose = self.odometry.pose();
        let known = Known {
            pose,
            duties: senses.duties,
            reading: &senses.reading,
            critical_mm,
            near: if pose.sigma > VAGUE { &[] } else { &self.near },
            now: senses.now,
        };
        let number = self.seen.1;
        let action = self.action.take();
        let decision = action.map(|action| Decision { action, number });
        self.pilot.step(&known, decision);
        if let Some(asked) = self.pilot.asked() {
            self.seen = (asked.observation, asked.number);
        }
        // No motion without a fresh view of the way ahead, whatever was decided.
        if senses.reading.fresh(senses.now).is_some() {
            Drive::Twist(self.pilot.twist())
        } else {
            Drive::Stop
        }
    }
}
