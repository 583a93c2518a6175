//! The camera activity: stills on request, and looks while somebody wants to know what is there.
//!
//! # Stills
//! A `capture` is carried out one at a time:
//!
//! | step | answer |
//! |---|---|
//! | the body has no camera | `rejected`, `unsupported` |
//! | another capture is not finished | `rejected`, `busy` |
//! | begun | `accepted` |
//! | the broker has the image (its PUBACK arrived) | `completed` |
//! | no picture within [`STILL_WITHIN`], or the sensor stalls | `failed`, `timeout` |
//! | the JPEG does not fit the buffer, or the broker's largest packet | `failed`, `too_large` |
//! | no sensor, or what it sent is no JPEG, or the broker refuses the image | `failed`, `fault` |
//!
//! A lost link does not end a capture: the bytes are kept, and sent again, until the broker has
//! acknowledged them. A broken camera costs captures and nothing else: the robot's state and lamp
//! stay as they are, and a log record `camera` tells of it once, and once more when it works
//! again. The first still is taken at boot and shown to nobody, so that a dead camera is known
//! before anyone needs it.
//!
//! # Looks
//! A look is a frame in which a detector finds things (see [`vision`](crate::vision)): the first
//! one as soon as looking is wanted, the others `vision_period_ms` apart, in a scan at most
//! [`SCAN_PERIOD`]. Looks give way to captures that were asked for before, and go on while an image
//! waits for the broker. A camera that fails is tried again [`ILL_PERIOD`] later. What a look needs
//! of memory it has from [`Eyes::open`] until it is over.
//!
//! The still's buffer is the board's: a body without a camera has none, and runs
//! [`link()`](crate::link()) instead of [`link_with_images()`](crate::link_with_images()).

mod looks;
mod slot;

#[cfg(test)]
mod tests;

use core::convert::Infallible;

use crawler_hal::{Camera, CameraError, CameraErrorKind, Clock, Duration, with_deadline};
use crawler_protocol::{Level, Reason, ResponseStatus};
use embassy_futures::select::{Either, select};
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::context::Robot;
use crate::context::handles::CameraHandle;
use crate::order::Sender;
use crate::vision::{Eyes, NoEyes};

use looks::Looks;
pub use looks::{FRAME_WITHIN, ILL_PERIOD, SCAN_PERIOD};
pub use slot::{Image, ImageSlot, Outcome};

/// Longest time for one still. The OV2640 driver needs up to half a second to change its mode and
/// let exposure settle, and gives up by itself after two.
pub const STILL_WITHIN: Duration = Duration::from_secs(3);

/// Start of image and the marker after it; end of image (ISO/IEC 10918-1, table B.1).
const SOI: [u8; 3] = [0xFF, 0xD8, 0xFF];
const EOI: [u8; 2] = [0xFF, 0xD9];

/// Takes stills on request. Never returns.
///
/// # Cancellation Safety
/// As the camera's own calls; an open capture gets no further answer.
pub fn camera<M, K, B, C>(
    robot: &Robot<M>,
    camera: K,
    images: &ImageSlot<M, B>,
    clock: C,
) -> impl Future<Output = Infallible>
where
    M: RawMutex,
    K: Camera,
    B: AsRef<[u8]> + AsMut<[u8]>,
    C: Clock,
{
    camera_with_eyes(robot, camera, images, None::<NoEyes>, clock)
}

/// As [`camera()`], and looks through the camera with `eyes`, where there are some and
/// [`Config::eyes`](crate::Config::eyes) says how they see. Never returns.
///
/// # Cancellation Safety
/// As [`camera()`]; a look under way is lost, and its memory free.
pub async fn camera_with_eyes<M, K, B, E, C>(
    robot: &Robot<M>,
    mut camera: K,
    images: &ImageSlot<M, B>,
    eyes: Option<E>,
    clock: C,
) -> Infallible
where
    M: RawMutex,
    K: Camera,
    B: AsRef<[u8]> + AsMut<[u8]>,
    E: Eyes,
    C: Clock,
{
    let robot = robot.camera_handle();
    let mut health = Health::default();
    let mut stills = Stills::default();
    let mut looks = Looks::new(eyes.zip(robot.config.eyes));
    if let Some(mut buffer) = images.lend() {
        let first = still(&mut camera, buffer.as_mut(), &clock).await;
        images.give_back(buffer);
        health.note(&robot, first.err(), &clock);
    }
    loop {
        // Both may be dropped while they wait.
        let next = select(
            stills.next(robot, images),
            looks.due(robot, health.ill, &clock),
        );
        match next.await {
            Either::First(Turn::Asked(sender)) => {
                let taken = stills
                    .take(robot, &mut camera, images, sender, &clock)
                    .await;
                if let Some(trouble) = taken {
                    health.note(&robot, trouble.err(), &clock);
                }
            }
            Either::First(Turn::Settled(outcome)) => stills.settled(robot, outcome, &clock),
            Either::Second(()) => {
                let looked = looks.look(robot, &mut camera, &clock).await;
                health.note(&robot, looked.err(), &clock);
            }
        }
    }
}

/// What there is to do about stills.
enum Turn {
    /// Someone asks for one.
    Asked(Sender),
    /// This became of the one on its way to the broker.
    Settled(Outcome),
}

/// Captures, one at a time.
#[derive(Default)]
struct Stills {
    /// Counts images of this boot.
    frame: u32,
    /// Whose image is on its way to the broker.
    open: Option<Sender>,
}

impl Stills {
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    async fn next<M: RawMutex, B>(
        &self,
        robot: CameraHandle<'_, M>,
        images: &ImageSlot<M, B>,
    ) -> Turn {
        if self.open.is_some() {
            Turn::Settled(images.settled().await)
        } else {
            Turn::Asked(robot.next_capture().await)
        }
    }

    /// Takes a still and hands it to the link. How the camera did, if it was asked.
    async fn take<M, K, B, C>(
        &mut self,
        robot: CameraHandle<'_, M>,
        camera: &mut K,
        images: &ImageSlot<M, B>,
        sender: Sender,
        clock: &C,
    ) -> Option<Result<(), Trouble>>
    where
        M: RawMutex,
        K: Camera,
        B: AsRef<[u8]> + AsMut<[u8]>,
        C: Clock,
    {
        let (source, seq) = (&sender.source, sender.seq);
        robot.respond(source, seq, ResponseStatus::Accepted, None, clock.now());
        let Some(mut buffer) = images.lend() else {
            // Not reached: the slot is free while no capture is open.
            close(robot, &sender, Err(Reason::Busy), clock);
            return None;
        };
        Some(match still(camera, buffer.as_mut(), clock).await {
            Ok(len) => {
                self.frame = self.frame.wrapping_add(1);
                let timestamp = robot.unix_ms(clock.now()).unwrap_or(0);
                images.hand_over(Image::new(buffer, len, self.frame, timestamp));
                robot.outbox.nudge();
                self.open = Some(sender);
                Ok(())
            }
            Err(trouble) => {
                images.give_back(buffer);
                close(robot, &sender, Err(trouble.reason()), clock);
                Err(trouble)
            }
        })
    }

    /// Answers the capture whose image is settled.
    fn settled<M: RawMutex, C: Clock>(
        &mut self,
        robot: CameraHandle<'_, M>,
        outcome: Outcome,
        clock: &C,
    ) {
        if let Some(sender) = self.open.take() {
            let outcome = match outcome {
                Outcome::Delivered => Ok(()),
                Outcome::TooLarge => Err(Reason::TooLarge),
                Outcome::Refused => Err(Reason::Fault),
            };
            close(robot, &sender, outcome, clock);
        }
    }
}

/// Ends a capture.
fn close<M: RawMutex, C: Clock>(
    robot: CameraHandle<'_, M>,
    sender: &Sender,
    outcome: Result<(), Reason>,
    clock: &C,
) {
    // Closed first: whoever has the answer may ask again.
    robot.close_capture();
    let (status, reason) = match outcome {
        Ok(()) => (ResponseStatus::Completed, None),
        Err(reason) => (ResponseStatus::Failed, Some(reason)),
    };
    robot.respond(&sender.source, sender.seq, status, reason, clock.now());
}

/// Why there is no picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Trouble {
    /// The camera gave an error.
    Camera(CameraErrorKind),
    /// The camera gave nothing at all.
    Silent,
    /// Frames of this camera are not for these eyes.
    Unfit,
    /// There is no memory for a frame.
    NoMemory,
}

impl Trouble {
    const fn reason(self) -> Reason {
        match self {
            Self::Silent | Self::Camera(CameraErrorKind::Stalled) => Reason::Timeout,
            Self::Camera(CameraErrorKind::TooLarge) => Reason::TooLarge,
            Self::Camera(_) | Self::Unfit | Self::NoMemory => Reason::Fault,
        }
    }

    /// What a person should know; `None` for what is no fault of the camera.
    const fn text(self) -> Option<&'static str> {
        Some(match self {
            Self::Silent => "the camera does not answer",
            Self::Unfit => "the camera's frames cannot be looked at",
            Self::NoMemory => "no memory for a frame",
            Self::Camera(CameraErrorKind::Absent) => "no camera sensor found",
            Self::Camera(CameraErrorKind::Stalled) => "the camera sends no picture",
            Self::Camera(CameraErrorKind::Garbled) => "the camera sends what is no picture",
            Self::Camera(CameraErrorKind::TooLarge) => return None,
            Self::Camera(_) => "the camera fails",
        })
    }
}

/// Length of a still in `jpeg`.
async fn still<K: Camera, C: Clock>(
    camera: &mut K,
    jpeg: &mut [u8],
    clock: &C,
) -> Result<usize, Trouble> {
    let deadline = clock.now() + STILL_WITHIN;
    let len = with_deadline(clock, deadline, camera.still(jpeg))
        .await
        .map_err(|_| Trouble::Silent)?
        .map_err(|error| Trouble::Camera(error.kind()))?;
    match jpeg.get(..len) {
        Some(jpeg) if jpeg.starts_with(&SOI) && jpeg.ends_with(&EOI) => Ok(len),
        Some(_) | None => Err(Trouble::Camera(CameraErrorKind::Garbled)),
    }
}

/// What has been told of the camera.
#[derive(Debug, Default)]
struct Health {
    ill: bool,
}

impl Health {
    /// Logs a change for the worse or the better.
    fn note<M: RawMutex, C: Clock>(
        &mut self,
        robot: &Robot<M>,
        trouble: Option<Trouble>,
        clock: &C,
    ) {
        let text = trouble.and_then(Trouble::text);
        if text.is_some() == self.ill {
            return;
        }
        self.ill = text.is_some();
        let level = if self.ill { Level::Warn } else { Level::Info };
        let text = text.unwrap_or("the camera works again");
        robot.log(level, "camera", format_args!("{text}"), clock.now());
    }
}
