//! Looks through the camera.

use core::future::pending;

use crawler_hal::{Camera, CameraError, Clock, Duration, Instant, with_deadline};
use crawler_protocol::RobotState;
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{STILL_WITHIN, Trouble};
use crate::context::Robot;
use crate::context::handles::CameraHandle;
use crate::parameters::Parameter;
use crate::vision::{Eyes, Lens, Look, View, frame_bytes};

/// Longest time for one frame: as for a still, since the driver may have to change its mode back.
pub const FRAME_WITHIN: Duration = STILL_WITHIN;
/// Longest time between two looks of a scan. The robot turns by 26° meanwhile, less than half of
/// what a camera sees at once, so that the turn is seen whole even if the last look comes too late.
pub const SCAN_PERIOD: Duration = Duration::from_millis(300);
/// Least time from one failure of the camera to the next look.
pub const ILL_PERIOD: Duration = Duration::from_secs(5);

/// Looks of one boot.
pub(super) struct Looks<E> {
    eyes: Option<(E, Lens)>,
    /// Counts them.
    frame: u32,
    /// When the last one began.
    last: Option<Instant>,
    /// The last view that was news, while looking goes on.
    told: Option<View>,
}

impl<E: Eyes> Looks<E> {
    pub(super) const fn new(eyes: Option<(E, Lens)>) -> Self {
        Self {
            eyes,
            frame: 0,
            last: None,
            told: None,
        }
    }

    /// Returns when a look is due; never where there are no eyes.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(super) async fn due<M: RawMutex, C: Clock>(
        &mut self,
        robot: CameraHandle<'_, M>,
        ill: bool,
        clock: &C,
    ) {
        if self.eyes.is_none() {
            pending::<()>().await;
        }
        loop {
            if robot.views_wanted() {
                let at = match self.last {
                    None => Instant::BOOT,
                    Some(last) => last + period(&robot, ill),
                };
                let woken = select(clock.sleep_until(at), robot.wishes_changed()).await;
                if let Either::First(()) = woken {
                    return;
                }
            } else {
                self.told = None;
                robot.wishes_changed().await;
            }
        }
    }

    /// Takes a look, and shows what it saw.
    ///
    /// # Errors
    /// When there is no frame, or none that the eyes can look at.
    pub(super) async fn look<M: RawMutex, K: Camera, C: Clock>(
        &mut self,
        robot: CameraHandle<'_, M>,
        camera: &mut K,
        clock: &C,
    ) -> Result<(), Trouble> {
        let Some((eyes, lens)) = &mut self.eyes else {
            return Ok(());
        };
        let begun = clock.now();
        self.last = Some(begun);
        let (size, format) = (camera.size(), camera.format());
        let bytes = frame_bytes(size, format).map_err(|_| Trouble::Unfit)?;
        let mut look = eyes.open(bytes).ok_or(Trouble::NoMemory)?;
        with_deadline(clock, begun + FRAME_WITHIN, camera.capture(look.frame()))
            .await
            .map_err(|_| Trouble::Silent)?
            .map_err(|error| Trouble::Camera(error.kind()))?;
        let at = clock.now();
        let heading = robot.snapshot().pose.theta;
        let spots = look.find(size, format).await.map_err(|_| Trouble::Unfit)?;
        self.frame = self.frame.wrapping_add(1);
        let aspect = f32::from(size.1) / f32::from(size.0);
        let view = View::new(&spots, lens, aspect, (self.frame, at, heading));
        if robot.show(&view, self.told.as_ref()) {
            self.told = Some(view);
            robot.outbox.nudge();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;

fn period<M: RawMutex>(robot: &Robot<M>, ill: bool) -> Duration {
    let ms = robot.with_parameters(|parameters| parameters.number(Parameter::VisionPeriod));
    // The table keeps it a whole number within its range.
    let asked = Duration::from_millis(ms as u64);
    if ill {
        asked.max(ILL_PERIOD)
    } else if robot.snapshot().state == RobotState::Scanning {
        asked.min(SCAN_PERIOD)
    } else {
        asked
    }
}
