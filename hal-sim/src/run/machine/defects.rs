//! What is wrong with a program from the slots, and what it overrides.

#[cfg(test)]
mod tests;

use std::cell::{Cell, RefCell};
use std::fmt;
use std::pin::Pin;
use std::rc::Rc;
use std::task::{Context, Poll, Waker};

use crawler_bundle::{Bundle, Defect, DefectKind};
use crawler_hal::{Clock as _, Duration};
use crawler_protocol::{ParameterValue, ParameterValues, Reason};

use super::{SimRobot, SimUpdates};
use crate::devices::{Resetter, Started};
use crate::scenario::Trained;
use crate::sched::{Scheduler, SimClock, TaskId};

/// How long control stands still that misses its periods: three of them, and within what the watchdog allows.
const MISSED: Duration = Duration::from_millis(60);
/// How often it is looked whether the stored parameters have been read.
const LOOK: Duration = Duration::from_millis(10);

/// What keeps activities from going on.
#[derive(Debug, Default)]
struct Stall {
    holds: Cell<bool>,
    waiting: RefCell<Vec<Waker>>,
}

impl Stall {
    fn release(&self) {
        self.holds.set(false);
        for waker in self.waiting.take() {
            waker.wake();
        }
    }
}

/// An activity that can be kept from going on, as by a processor that is busy with something else.
struct Stalled<F> {
    activity: Pin<Box<F>>,
    stall: Rc<Stall>,
}

impl<F: Future> Future for Stalled<F> {
    type Output = F::Output;

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<F::Output> {
        if self.stall.holds.get() {
            self.stall.waiting.borrow_mut().push(cx.waker().clone());
            return Poll::Pending;
        }
        self.activity.as_mut().poll(cx)
    }
}

/// A program that has defects, or overrides parameters.
#[derive(Debug)]
pub(crate) struct Faulty {
    bundle: Rc<Bundle>,
    defects: Vec<Defect>,
    resetter: Resetter,
    /// What holds control up, and what all others.
    control: Rc<Stall>,
    others: Rc<Stall>,
}

impl Faulty {
    /// What is wrong with the program that was started; `None` when nothing is.
    pub(super) fn of(started: &Started, resetter: Resetter) -> Option<Self> {
        let bundle = started.bundle.as_ref()?;
        if started.defects.is_empty() && bundle.parameters.is_empty() {
            return None;
        }
        Some(Self {
            bundle: Rc::clone(bundle),
            defects: started.defects.clone(),
            resetter,
            control: Rc::default(),
            others: Rc::default(),
        })
    }

    /// Runs what makes the defects show.
    pub(super) fn spawn(
        &self,
        sched: &mut Scheduler,
        robot: &Rc<SimRobot>,
        clock: &SimClock,
    ) -> Vec<TaskId> {
        let mut tasks = Vec::new();
        for &defect in &self.defects {
            let after = Duration::from_millis(u64::from(defect.value));
            let (clock, resetter) = (clock.clone(), self.resetter.clone());
            let (control, others) = (Rc::clone(&self.control), Rc::clone(&self.others));
            tasks.push(match defect.kind {
                DefectKind::Panic => sched.spawn(async move {
                    clock.sleep(after).await;
                    resetter.panic(&format!("the defect {defect} of the bundle"));
                    std::future::pending::<()>().await;
                }),
                DefectKind::Restart => sched.spawn(async move {
                    clock.sleep(after).await;
                    resetter.restart();
                    std::future::pending::<()>().await;
                }),
                DefectKind::Hang => sched.spawn(async move {
                    clock.sleep(after).await;
                    control.holds.set(true);
                    others.holds.set(true);
                    std::future::pending::<()>().await;
                }),
                DefectKind::MissControl => sched.spawn(async move {
                    loop {
                        clock.sleep(after).await;
                        control.holds.set(true);
                        clock.sleep(MISSED).await;
                        // What hangs does not go on.
                        if !others.holds.get() {
                            control.release();
                        }
                    }
                }),
                // These are not of the program's own doing.
                DefectKind::NeverLink | DefectKind::RangerDead | DefectKind::RangerNoisy => {
                    continue;
                }
            });
        }
        if !self.bundle.parameters.is_empty() {
            let (bundle, robot) = (Rc::clone(&self.bundle), Rc::clone(robot));
            let (clock, resetter) = (clock.clone(), self.resetter.clone());
            tasks.push(sched.spawn(async move {
                while !robot.is_loaded() {
                    clock.sleep(LOOK).await;
                }
                if let Err(error) = override_parameters(&robot, &bundle) {
                    resetter.panic(&error.to_string());
                }
                std::future::pending::<()>().await;
            }));
        }
        tasks
    }
}

/// Why a bundle cannot override parameters.
enum BadOverride {
    /// It names one that there is not.
    Unknown(String),
    /// The robot refuses the values.
    Refused(Reason),
}

impl fmt::Display for BadOverride {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(name) => {
                write!(f, "the bundle overrides {name}, which is no parameter")
            }
            Self::Refused(reason) => write!(
                f,
                "the bundle overrides parameters with what is refused: {reason:?}"
            ),
        }
    }
}

/// Puts the parameters of the bundle over what is stored. A program that overrides what it does not know
/// cannot work.
fn override_parameters(robot: &SimRobot, bundle: &Bundle) -> Result<(), BadOverride> {
    let mut values = ParameterValues::new();
    for (name, value) in &bundle.parameters {
        let unknown = || BadOverride::Unknown(name.clone());
        let name = name.as_str().try_into().map_err(|_| unknown())?;
        let pair = (name, ParameterValue::Number(*value));
        values.push(pair).map_err(|_| unknown())?;
    }
    robot.adjust(&values).map_err(BadOverride::Refused)
}

/// What not every program has.
#[derive(Default)]
pub(crate) struct Extras<'a> {
    /// What is wrong with it.
    pub(super) faulty: Option<&'a Faulty>,
    /// By what it takes updates.
    pub(super) updates: Option<Rc<SimUpdates>>,
    /// By what it can drive in place of what comes with the program.
    pub(super) policy: Option<Trained>,
}

/// Runs the activities of a program, under what is wrong with it.
pub(super) struct Launcher<'a> {
    pub(super) sched: &'a mut Scheduler,
    pub(super) faulty: Option<&'a Faulty>,
    pub(super) updates: Option<Rc<SimUpdates>>,
}

impl Launcher<'_> {
    /// Runs control.
    pub(super) fn control<F: Future + 'static>(&mut self, activity: F) -> TaskId {
        let stall = self.faulty.map(|faulty| &faulty.control);
        spawn(self.sched, stall, activity)
    }

    /// Runs another activity.
    pub(super) fn other<F: Future + 'static>(&mut self, activity: F) -> TaskId {
        let stall = self.faulty.map(|faulty| &faulty.others);
        spawn(self.sched, stall, activity)
    }
}

fn spawn<F: Future + 'static>(
    sched: &mut Scheduler,
    stall: Option<&Rc<Stall>>,
    activity: F,
) -> TaskId {
    match stall {
        None => sched.spawn(activity),
        Some(stall) => sched.spawn(Stalled {
            activity: Box::pin(activity),
            stall: Rc::clone(stall),
        }),
    }
}
