//! What a robot has seen, on its way from the camera to control and to the link.

use core::cell::{Cell, RefCell};

use crawler_hal::{Duration, Instant};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use heapless::Vec;

use super::cells::{MAX_SPOTS, Spot, Spots};
use super::lens::Lens;
use crate::motion::wrap;

/// Nothing is told of a view older than this: it waited for a link.
const FRESH_FOR: Duration = Duration::from_secs(2);
/// A view that shows what the last one showed is told this often.
const SAME_EVERY: Duration = Duration::from_secs(2);
/// What moved by less than this share of the picture is where it was: about half a cell.
const SAME_PLACE: f32 = 0.04;
/// The robot turns aside for what stands nearer than this in front of it, by the place where the
/// line of sight meets the floor, in metres: what it drives between two looks, twice.
const NEAR_M: f32 = 0.6;
/// It stands in front of it within this distance from the middle, in metres: half the width of the
/// robot, and half that of the thing.
const BESIDE_M: f32 = 0.18;
/// What was seen this long ago does not count any more for where to drive.
const SEEN_FOR: Duration = Duration::from_millis(1_500);

/// A thing, and where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    /// In the picture.
    pub spot: Spot,
    /// From where the robot headed, in radians, positive to the left.
    pub bearing: f32,
}

/// Something low that stands in the way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct InTheWay {
    /// In which direction of odometry, in radians.
    direction: f32,
    /// How far at most, in metres.
    distance: f32,
    /// When it was seen.
    at: Instant,
}

impl InTheWay {
    /// Whether it is still in front of a robot that heads for `theta`, and if so how much to the
    /// left of it, in radians.
    pub fn ahead(&self, theta: f32, now: Instant) -> Option<f32> {
        let bearing = wrap(self.direction - theta);
        let near = now - self.at <= SEEN_FOR;
        (near && is_in_front(bearing, self.distance)).then_some(bearing)
    }
}

fn is_in_front(bearing: f32, distance: f32) -> bool {
    libm::cosf(bearing) > 0.0 && libm::fabsf(libm::sinf(bearing)) * distance <= BESIDE_M
}

/// What one look has shown.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Counts looks of this boot, from 1.
    pub frame: u32,
    /// When the frame was taken.
    pub at: Instant,
    /// Where the robot headed then, by odometry.
    pub heading: f32,
    /// What there was, clearest first.
    pub things: Vec<Seen, MAX_SPOTS>,
    /// The nearest thing that the robot would run into.
    pub in_the_way: Option<InTheWay>,
}

impl View {
    /// What `spots` are in the world, in a picture that `lens` made and whose height is `aspect`
    /// times its width.
    pub fn new(
        spots: &Spots,
        lens: &Lens,
        aspect: f32,
        (frame, at, heading): (u32, Instant, f32),
    ) -> Self {
        let seen = |spot: &Spot| Seen {
            spot: *spot,
            bearing: lens.bearing(spot.x, spot.y, aspect),
        };
        let mut in_the_way: Option<InTheWay> = None;
        for spot in spots {
            let Some([forward, left]) = lens.floor(spot.x, spot.y, aspect) else {
                continue;
            };
            let distance = libm::hypotf(forward, left);
            let bearing = libm::atan2f(left, forward);
            let nearer = in_the_way.is_none_or(|other| distance < other.distance);
            if distance <= NEAR_M && nearer && is_in_front(bearing, distance) {
                in_the_way = Some(InTheWay {
                    direction: heading + bearing,
                    distance,
                    at,
                });
            }
        }
        Self {
            frame,
            at,
            heading,
            things: spots.iter().map(seen).collect(),
            in_the_way,
        }
    }

    /// Whether it shows the same things in the same places of the picture.
    fn is_like(&self, other: &Self) -> bool {
        let near = |a: f32, b: f32| libm::fabsf(a - b) < SAME_PLACE;
        self.things.len() == other.things.len()
            && self.things.iter().all(|Seen { spot, .. }| {
                other.things.iter().any(|Seen { spot: old, .. }| {
                    old.class == spot.class && near(old.x, spot.x) && near(old.y, spot.y)
                })
            })
    }

    /// Whether this is worth a message after `told`.
    fn is_news(&self, told: Option<&Self>) -> bool {
        match told {
            None => true,
            Some(told) if !self.is_like(told) => true,
            Some(told) => !self.things.is_empty() && self.at - told.at >= SAME_EVERY,
        }
    }
}

/// The newest view, and who has not taken it.
struct Newest {
    view: Option<View>,
    for_control: bool,
    for_link: bool,
}

/// Who wants what of the camera's looks.
pub(crate) struct Sights<M: RawMutex> {
    /// Control → camera: whether to look.
    wanted: Mutex<M, Cell<bool>>,
    /// Update → camera: whether to look in any case, so that a model on trial has something to see.
    tried: Mutex<M, Cell<bool>>,
    changed: Signal<M, ()>,
    /// Camera → control and link.
    newest: Mutex<M, RefCell<Newest>>,
}

impl<M: RawMutex> Sights<M> {
    pub(crate) const fn new() -> Self {
        Self {
            wanted: Mutex::new(Cell::new(false)),
            tried: Mutex::new(Cell::new(false)),
            changed: Signal::new(),
            newest: Mutex::new(RefCell::new(Newest {
                view: None,
                for_control: false,
                for_link: false,
            })),
        }
    }

    /// Begins or ends looking; also has the camera read its parameters anew.
    pub(crate) fn want(&self, wanted: bool) {
        self.wanted.lock(|cell| cell.set(wanted));
        self.changed.signal(());
    }

    /// Begins or ends looking for the sake of a model on trial.
    pub(crate) fn try_out(&self, tried: bool) {
        self.tried.lock(|cell| cell.set(tried));
        self.changed.signal(());
    }

    pub(crate) fn is_wanted(&self) -> bool {
        self.wanted.lock(Cell::get) || self.tried.lock(Cell::get)
    }

    /// Returns when [`Self::want`] or [`Self::try_out`] was called since the last return.
    pub(crate) async fn changed(&self) {
        self.changed.wait().await;
    }

    /// Hands a view to control, and to the link if it is news after `told`. Whether it is.
    pub(crate) fn show(&self, view: &View, told: Option<&View>) -> bool {
        let news = view.is_news(told);
        self.newest.lock(|newest| {
            let mut newest = newest.borrow_mut();
            newest.for_link |= news;
            newest.for_control = true;
            newest.view = Some(view.clone());
        });
        news
    }

    /// The newest view, unless control has taken it.
    pub(crate) fn take(&self) -> Option<View> {
        self.newest.lock(|newest| {
            let mut newest = newest.borrow_mut();
            // Nearly always: looks are rare beside control steps.
            if !newest.for_control {
                return None;
            }
            newest.for_control = false;
            newest.view.clone()
        })
    }

    /// The newest view, unless the link has told it or it has waited for too long.
    pub(crate) fn take_news(&self, now: Instant) -> Option<View> {
        self.newest.lock(|newest| {
            let mut newest = newest.borrow_mut();
            newest.for_link = false;
            let fresh = |view: &&View| now - view.at <= FRESH_FOR;
            newest.view.as_ref().filter(fresh).cloned()
        })
    }

    /// Whether the link has something to tell.
    pub(crate) fn has_news(&self) -> bool {
        self.newest.lock(|newest| newest.borrow().for_link)
    }
}
