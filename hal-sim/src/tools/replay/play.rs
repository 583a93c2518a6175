//! Running the programs of a recording.

use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::rc::Rc;

use crawler_app::vision::DetectorError;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{ParameterValues, Reason};

use super::compare::{Difference, Except, compare};
use super::read::{Boot, Recording};
use crate::run::event_log::playback::{Playback, Script, Word};
use crate::run::event_log::{Event, played};
use crate::run::eyes::DetectorInstance;
use crate::run::machine;
use crate::sched::{Scheduler, SimClock};

/// What the replay of one robot came to.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// Its name.
    pub robot: String,
    /// Boots that were run.
    pub boots: u32,
    /// Things that it did now as it had done them.
    pub agreed: u64,
    /// Where it parts from what was recorded, and in which boot.
    pub difference: Option<(u32, Difference)>,
    /// Why its program could not go on.
    pub failure: Option<String>,
}

impl Report {
    /// Whether it did everything as it had done it.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.difference.is_none() && self.failure.is_none()
    }
}

/// Why a recording cannot be replayed.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ReplayError {
    /// So many device events were lost when it was made.
    Lost(u64),
    /// A parameter cannot be set so.
    Parameters(Reason),
    /// A robot of it cannot be one of this build.
    Robot(String),
    /// This robot sees, and there is no detector for it.
    Blind(String),
    /// What was given is no detector.
    Detector(DetectorError),
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Lost(count) => write!(
                f,
                "{count} events of devices were lost when this was recorded: it can be looked at, \
                 not replayed"
            ),
            Self::Parameters(reason) => write!(f, "parameters: {}", reason.name()),
            Self::Robot(name) => write!(f, "robot `{name}` cannot be one of this build"),
            Self::Blind(name) => write!(f, "robot `{name}` sees, and there is no detector for it"),
            Self::Detector(error) => write!(f, "the detector: {error}"),
        }
    }
}

impl std::error::Error for ReplayError {}

/// Runs the inputs of each robot through the program of this build, with `parameters` in place of
/// those it had; robots that saw see with `detector`. Calls `done` with each robot as it is
/// finished.
///
/// # Errors
/// See [`ReplayError`].
pub fn replay(
    recording: &Recording,
    parameters: &ParameterValues,
    detector: Option<&'static [u8]>,
    mut done: impl FnMut(&Report),
) -> Result<Vec<Report>, ReplayError> {
    if recording.lost > 0 {
        return Err(ReplayError::Lost(recording.lost));
    }
    crawler_app::parameters::Parameters::default()
        .with(parameters)
        .map_err(ReplayError::Parameters)?;
    let instance = detector.map(DetectorInstance::new).transpose();
    let instance = instance.map_err(ReplayError::Detector)?;
    let mut except = Except::default();
    if !parameters.is_empty() {
        except.topics.push("/parameters/");
    }
    if recording.words.get("version").map(String::as_str) != Some(crate::VERSION) {
        except.fields.push("firmware");
    }
    let mut reports = Vec::new();
    for (name, boots) in &recording.robots {
        let mut report = Report {
            robot: name.clone(),
            boots: 0,
            agreed: 0,
            difference: None,
            failure: None,
        };
        for (&number, boot) in boots {
            if boot.life.config.config().is_none() {
                return Err(ReplayError::Robot(name.clone()));
            }
            if boot.life.config.eyes.is_some() && instance.is_none() {
                return Err(ReplayError::Blind(name.clone()));
            }
            let end = boot.ended.unwrap_or(recording.end);
            report.boots += 1;
            // A defect of the program of now is a finding, and no end of the replay.
            let events = match catch_unwind(AssertUnwindSafe(|| {
                play(boot, end, parameters, instance.as_ref())
            })) {
                Ok(events) => events,
                Err(panic) => {
                    let text = panic.downcast_ref::<String>().map(String::as_str);
                    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
                    report.failure = Some(text.unwrap_or("it panicked").to_owned());
                    break;
                }
            };
            let (difference, agreed) = compare(&boot.events, &events, end, &except);
            report.agreed += agreed;
            if let Some(difference) = difference {
                report.difference = Some((number, difference));
                break;
            }
        }
        done(&report);
        reports.push(report);
    }
    Ok(reports)
}

/// Runs one boot and returns what the program did.
fn play(
    boot: &Boot,
    end: u64,
    parameters: &ParameterValues,
    instance: Option<&Rc<DetectorInstance>>,
) -> Vec<Event> {
    let Some(config) = boot.life.config.config() else {
        return Vec::new();
    };
    let clock = SimClock::new();
    let mut sched = Scheduler::new(&clock);
    sched.advance_to(Instant::from_micros(boot.begun));
    let playback = Rc::new(Playback::new(Script::of(&boot.events), &clock));
    let robot = machine::context(config);
    playback.event_log.watch(&robot);
    let parts = played::parts(&boot.life, &playback, &clock);
    let ranger_after = Duration::from_micros(boot.life.ranger_after_us);
    let program = machine::launch(
        &mut sched,
        &robot,
        parts,
        ranger_after,
        instance,
        machine::Extras::default(),
    );
    let end = Instant::from_micros(end);
    let mut version = None;
    let mut events = Vec::new();
    loop {
        sched.run();
        let now = sched.now().as_micros();
        match playback.word(now) {
            Some(Word::Command(payload)) => {
                program.tell(&robot, &payload);
                continue;
            }
            Some(Word::Time(unix_ms)) => {
                program.tell_time(&robot, unix_ms);
                continue;
            }
            Some(Word::ClockStep(ms)) => {
                program.step_clock(&robot, ms);
                continue;
            }
            None => {}
        }
        // Those of the flash come first, and a `set` changes what is not ours alone.
        let present = robot.with_parameters(crawler_app::parameters::Parameters::version);
        if !parameters.is_empty() && robot.is_loaded() && version != Some(present) {
            let _ = robot.adjust(parameters);
            version = Some(robot.with_parameters(crawler_app::parameters::Parameters::version));
            continue;
        }
        events.extend(playback.event_log.take().0);
        let due = sched.next_due().unwrap_or(Instant::FAR_FUTURE);
        let due = due.min(Instant::from_micros(playback.next_word()));
        if due > end {
            return events;
        }
        sched.advance_to(due);
    }
}
