//! What the robot hears beside commands: the time, where it was seen, who is near, and what is to be
//! broken about it.

use crawler_hal::Instant;
use crawler_protocol::Level;
#[cfg(feature = "faults")]
use crawler_protocol::{FaultCommand, FaultSpec};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::context::Robot;
use crate::neighbours::Cell;
use crate::timesync::Observation;
use crate::tracking::Refusal;
use crate::trouble::TIME;

#[cfg(feature = "faults")]
/// Event of the records that tell what became of `inject` and `heal`.
const INJECTED: &str = "injected";

impl<M: RawMutex> Robot<M> {
    /// Tells the robot that Unix time was `unix_ms` milliseconds, or a little more, at `now`.
    ///
    /// The link does so with every time message; without a link it is up to whoever runs the
    /// robot. How much it is believed, see [`timesync`](crate::timesync).
    ///
    /// A jump of that time is logged: when it is first doubted, and when it is believed.
    pub fn observe_time(&self, unix_ms: u64, now: Instant) -> Observation {
        let before = self.unix_ms(now);
        let observation = self.time.observe(unix_ms, now);
        let off = |time: u64| time as i64 - before.unwrap_or(time) as i64;
        match observation {
            Observation::Adopted | Observation::Confirmed => {}
            Observation::Stepped => {
                let by = off(self.unix_ms(now).unwrap_or(unix_ms));
                let text = format_args!("the server's clock was set: moved by {by} ms");
                self.log(Level::Warn, TIME, text, now);
            }
            Observation::Doubted | Observation::Implausible => {
                if self.time.may_warn(now) {
                    let by = off(unix_ms);
                    let text = format_args!("not believed yet: {unix_ms}, {by} ms off");
                    self.log(Level::Warn, TIME, text, now);
                }
            }
        }
        observation
    }

    /// Takes in the payload of a message on the robot's own pose topic.
    ///
    /// # Errors
    /// Why it was refused; that is counted and logged here already.
    // Out of line: inlined into the state machine of the link it costs 230 bytes of flash.
    #[inline(never)]
    pub fn observe_fix(&self, payload: &[u8], now: Instant) -> Result<(), Refusal> {
        let heard = self.link_handle();
        let result = heard.take_fix(payload, now);
        if let Err(refusal) = result
            && let Some(count) = heard.refusals_to_tell(now)
        {
            let text = format_args!("{count} refused, the last one {}", refusal.name());
            self.log(Level::Warn, "pose-fix", text, now);
        }
        result
    }

    /// Takes in the payload of a message on the topic of `cell`, and tells whether it was of use.
    // Out of line: inlined into the state machine of the link it costs 640 bytes of flash.
    #[inline(never)]
    pub fn observe_cell(&self, cell: Cell, payload: &[u8], now: Instant) -> bool {
        self.link_handle().take_cell(cell, payload, now)
    }

    /// Obeys a word on `simulator/command`, if it is for this robot: faults alone, and only on a
    /// robot that takes them. A record says what became of it. What a simulator is told is not judged.
    #[cfg(feature = "faults")]
    // Out of line: the command in between is free again when it is carried out.
    #[inline(never)]
    pub fn obey_simulator(&self, payload: &[u8], now: Instant) {
        if !self.config.takes_faults() {
            return;
        }
        match FaultCommand::from_json(payload) {
            Ok(Some(FaultCommand::Inject {
                robot,
                fault,
                lasting_ms,
            })) if robot == self.config.id => {
                let name = fault.name();
                let done = if let FaultSpec::ClockStep { ms } = fault {
                    self.step_clock(ms);
                    Ok(())
                } else {
                    self.injected.inject(fault, lasting_ms, now)
                };
                match (done, lasting_ms) {
                    (Err(reason), _) => {
                        let text = format_args!("{name} refused: {reason}");
                        self.log(Level::Warn, INJECTED, text, now);
                    }
                    (Ok(()), Some(ms)) => {
                        let text = format_args!("{name} for {ms} ms");
                        self.log(Level::Warn, INJECTED, text, now);
                    }
                    (Ok(()), None) => {
                        self.log(Level::Warn, INJECTED, format_args!("{name}"), now);
                    }
                }
            }
            Ok(Some(FaultCommand::Heal { robot })) if robot == self.config.id => {
                self.injected.heal(now);
                self.log(Level::Info, INJECTED, format_args!("healed"), now);
            }
            // What controls a world, or names another robot.
            Ok(_) => {}
            Err(error) => {
                let text = format_args!("not a command to a simulator: {error}");
                self.log(Level::Warn, INJECTED, text, now);
            }
        }
    }
}
