//! The lamp activity: one pattern per state and fault.

#[cfg(test)]
mod tests;

use core::convert::Infallible;
use core::ops::Deref;

use crawler_drivers::lamp::{Lamp, Pattern};
use crawler_hal::{Clock, Instant};
use crawler_protocol::{Level, RobotState};
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_hal::digital::OutputPin;

use crate::context::Robot;
use crate::perception::{Charge, LinkHealth};
use crate::state::Fault;
use crate::trouble::LinkTrouble;

/// Shows the state of the robot. Sleeps until the next edge of the pattern, or until control
/// says that the pattern may be another.
///
/// # Cancellation Safety
/// Dropping it leaves the lamp as it is.
pub fn lamp<M: RawMutex, O: OutputPin, C: Clock>(
    robot: impl Deref<Target = Robot<M>>,
    pin: O,
    clock: C,
) -> impl Future<Output = Infallible> {
    let mut lamp = Lamp::new(pin);
    async move {
        let mut refused = false;
        loop {
            let now = clock.now();
            let identify_until = robot.lamp_handle().identify_until();
            let snapshot = robot.snapshot();
            let link = robot.link_health();
            let pattern = pattern(&View {
                state: snapshot.state,
                fault: snapshot.fault,
                charge: snapshot.battery.charge,
                link,
                trouble: robot.link_trouble(),
                identify: now < identify_until,
            });
            let next = match lamp.show(pattern, now) {
                Ok(next) => {
                    refused = false;
                    next
                }
                Err(error) => {
                    if !core::mem::replace(&mut refused, true) {
                        robot.log(Level::Warn, "lamp", format_args!("{error}"), now);
                    }
                    // Nothing to try until the pattern changes.
                    Instant::FAR_FUTURE
                }
            };
            let next = if now < identify_until {
                next.min(identify_until)
            } else {
                next
            };
            select(robot.lamp_handle().changed(), clock.sleep_until(next)).await;
        }
    }
}

/// What the lamp can tell of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct View {
    /// State as reported.
    pub state: RobotState,
    /// Why the robot stands, when its state is `ERROR`.
    pub fault: Option<Fault>,
    /// How much is left in the battery.
    pub charge: Charge,
    /// How the session with the broker is.
    pub link: LinkHealth,
    /// What keeps the robot from its broker.
    pub trouble: Option<LinkTrouble>,
    /// Whether someone asked which robot this is.
    pub identify: bool,
}

/// The pattern to show: first what was asked for, then what needs a person, then the state.
pub fn pattern(view: &View) -> Pattern {
    if view.identify {
        return Pattern::Identify;
    }
    match view.state {
        RobotState::Error if view.charge == Charge::Critical => return Pattern::LowBattery,
        RobotState::Error => return view.fault.map_or(Pattern::Error, Fault::pattern),
        RobotState::Updating => return Pattern::Updating,
        RobotState::Initializing
        | RobotState::Idle
        | RobotState::Moving
        | RobotState::Scanning
        | RobotState::Caution
        | RobotState::Avoiding => {}
    }
    if view.charge == Charge::Low {
        return Pattern::LowBattery;
    }
    match (view.link, view.trouble) {
        (LinkHealth::Absent | LinkHealth::Lost, Some(trouble)) => return trouble.pattern(),
        (LinkHealth::Lost, None) => return Pattern::NoLink,
        (LinkHealth::Absent, None) | (LinkHealth::Up, _) => {}
    }
    match view.state {
        RobotState::Initializing => Pattern::Initializing,
        RobotState::Idle => Pattern::Idle,
        RobotState::Moving => Pattern::Moving,
        RobotState::Scanning => Pattern::Scanning,
        RobotState::Caution => Pattern::Caution,
        RobotState::Avoiding => Pattern::Avoiding,
        RobotState::Updating => Pattern::Updating,
        RobotState::Error => Pattern::Error,
    }
}
