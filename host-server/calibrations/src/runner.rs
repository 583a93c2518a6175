//! Carries one calibration out, from its permit to what came of it.

use std::sync::Arc;
use std::time::Duration;

use crawler_twin::certificate::{About, Certificate, Refused, certify_on};
use crawler_twins::Recording;
use tokio::time::{Instant, MissedTickBehavior};

use crate::calibrations::{Calibrations, Cut};
use crate::course::{Driving, LOOK_BACK_S, Next, Seen};
use crate::record::{BrokenOff, Calibration, Errors, Reason, State};

/// How often it is looked at the robot, and decided.
const TICK: Duration = Duration::from_millis(50);
/// How often a robot tells of itself meanwhile.
const RATE_HZ: f32 = 20.0;

/// One that goes on.
pub(crate) struct Run {
    pub(crate) calibrations: Arc<Calibrations>,
    pub(crate) driving: Driving,
    pub(crate) recording: Recording,
    pub(crate) cut: Arc<Cut>,
    pub(crate) calibration: Calibration,
    pub(crate) firmware: String,
}

impl Run {
    pub(crate) async fn carry_out(mut self) {
        let fleet = Arc::clone(&self.calibrations.fleet);
        let robot = self.calibration.robot.clone();
        fleet.set_rate(&robot, RATE_HZ);
        let driven = self.drive().await;
        // Whoever told it something else has it now.
        if !matches!(driven, Err(BrokenOff::OtherCommand(_))) {
            fleet.stop(&robot);
        }
        if let Some(hz) = self.calibration.telemetry_hz {
            fleet.set_rate(&robot, hz);
        }
        let broken = match driven {
            Ok(held_s) => self.certify(held_s).await.err(),
            Err(broken) => Some(broken),
        };
        if let Some(broken) = broken {
            self.calibration.state = State::BrokenOff;
            self.calibration.reason = Some(Reason::from(&broken));
        }
        self.calibration.ended = Some((self.calibrations.clock)());
        self.finish().await;
    }

    fn seen(&self) -> Seen {
        let calibrations = &self.calibrations;
        let robot = &self.calibration.robot;
        let now_s = calibrations.twins.seconds(Instant::now().into_std());
        Seen {
            now_s,
            fix: self.recording.fix(),
            told_s: self.recording.told_s(),
            recent: self.recording.since(now_s - LOOK_BACK_S),
            robot: calibrations.fleet.robot(robot),
            others: calibrations.fleet.others(robot, self.driving.home()),
        }
    }

    /// Drives; returns the stamp from which on fixes are held out.
    async fn drive(&mut self) -> Result<f64, BrokenOff> {
        let mut ticks = tokio::time::interval(TICK);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                _ = ticks.tick() => {}
                () = self.cut.woken() => {}
            }
            if let Some(why) = self.cut.why() {
                return Err(why);
            }
            let next = self.driving.step(&self.seen());
            let robot = &self.calibration.robot;
            match next {
                Next::Wait => {}
                Next::Drive { v, w } => {
                    if !self.calibrations.fleet.drive(robot, v, w) {
                        return Err(BrokenOff::LinkLost);
                    }
                }
                Next::Stand => self.calibrations.fleet.stop(robot),
                Next::Driven { held_s } => {
                    self.told();
                    return Ok(held_s);
                }
                Next::Broken(why) => return Err(why),
            }
            self.told();
        }
    }

    /// Shows how far it is, where that is new.
    fn told(&mut self) {
        let now = (self.driving.state, self.driving.legs());
        if now != (self.calibration.state, self.calibration.legs) {
            (self.calibration.state, self.calibration.legs) = now;
            self.calibrations.show(&self.calibration);
        }
    }

    /// Makes a certificate of what was told, if it is worth one.
    async fn certify(&mut self, held_s: f64) -> Result<(), BrokenOff> {
        let calibrations = Arc::clone(&self.calibrations);
        let robot = self.calibration.robot.clone();
        let about = About {
            robot: robot.as_str().to_owned(),
            build: self.firmware.clone(),
            floor: self.calibration.floor.clone(),
            made_ms: self.calibration.begun,
        };
        let evidence = self.recording.evidence();
        let found = calibrations
            .twins
            .certificate(&robot, (calibrations.clock)());
        let found = found.filter(|found| found.refusal.is_none());
        let previous = found.and_then(|found| found.certificate);
        let made = tokio::task::spawn_blocking(move || {
            let begun = std::time::Instant::now();
            let known = evidence.part(f64::MIN, held_s);
            let held = evidence.part(held_s, f64::MAX);
            let made = certify_on(&known, &held, about, previous.as_deref());
            (made, begun.elapsed().as_secs_f64())
        });
        let (made, took_s) = made.await.map_err(|_| BrokenOff::Failed)?;
        self.calibration.took_s = Some(took_s);
        // A person may have stopped it meanwhile.
        if let Some(why) = self.cut.why() {
            return Err(why);
        }
        match made {
            Ok(certificate) => self.keep(certificate).await?,
            Err(refused) => {
                self.calibration.state = State::Refused;
                self.calibration.reason = Some(Reason::from(&refused));
                self.calibration.errors = of_refused(&refused).into_iter().collect();
            }
        }
        Ok(())
    }

    /// Puts a certificate where twins find it.
    async fn keep(&mut self, certificate: Certificate) -> Result<(), BrokenOff> {
        self.calibration.certificate = Some(certificate.id().to_owned());
        self.calibration.errors = certificate.validation.iter().map(errors).collect();
        let twins = Arc::clone(&self.calibrations.twins);
        let kept = tokio::task::spawn_blocking(move || twins.certify(&certificate)).await;
        if let Err(error) = kept.map_err(|_| BrokenOff::Failed)? {
            tracing::error!(%error, robot = %self.calibration.robot, "a certificate cannot be written");
            self.calibration.certificate = None;
            return Err(BrokenOff::Failed);
        }
        self.calibration.state = State::Certified;
        Ok(())
    }

    /// Writes down what came of it, and tells.
    async fn finish(self) {
        let Self {
            calibrations,
            calibration,
            ..
        } = self;
        if let Err(error) = calibrations.write(calibration.clone()).await {
            tracing::error!(%error, id = calibration.id, "what became of a calibration is not written down");
        }
        let (is_bad, text) = match (&calibration.reason, &calibration.certificate) {
            (Some(reason), _) if calibration.state == State::BrokenOff => {
                (true, format!("calibration broken off: {}", reason.detail))
            }
            (Some(reason), _) => (
                true,
                format!("calibrated, no certificate: {}", reason.detail),
            ),
            (None, certificate) => {
                let id = certificate.as_deref().unwrap_or_default();
                (false, format!("calibrated: certificate {id}"))
            }
        };
        calibrations.show(&calibration);
        calibrations.fleet.tell(&calibration.robot, is_bad, text);
    }
}

fn errors(validation: &crawler_twins::Validation) -> Errors {
    let of = |score: &crawler_twin::predict::Score| [score.median_m, score.p90_m];
    Errors {
        ahead_s: validation.own.horizon_s,
        own: of(&validation.own),
        nominal: of(&validation.nominal),
        previous: validation.previous.as_ref().map(of),
    }
}

fn of_refused(refused: &Refused) -> Option<Errors> {
    match refused {
        Refused::NotBetterThanNominal(validation) | Refused::NotBetterThanPrevious(validation) => {
            Some(errors(validation))
        }
        _ => None,
    }
}
