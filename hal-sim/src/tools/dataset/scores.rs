//! F1 of centroids: what a detector found against what there was. The same rules, step by step, as
//! `models/detector/training/scores.py`; the detector's README tells them in words.

use crawler_app::vision::{Class, Spots};

use super::class;
use crate::render::Truth;

/// Width and height of a frame, in pixels.
const SIDE: f64 = 96.0;
/// Width and height of a cell, in pixels.
const CELL: f64 = 8.0;
/// A detection is right when its class is, and it is this near to the middle of the thing, in
/// pixels, or within the radius of a disc of as many pixels as the thing has.
const NEAR: f64 = 1.5 * CELL;
/// The scale that is judged: a thing that covers two cells.
const JUDGED_PIXELS: u32 = (2.0 * CELL * CELL) as u32;
/// Things of which less than this share is to be seen, because something stands before them or the
/// picture ends, need not be found, and finding them is no false alarm.
const JUDGED_SHARE: f32 = 0.5;

/// Hits, misses and false alarms of each class.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    hits: [u32; 3],
    misses: [u32; 3],
    alarms: [u32; 3],
}

impl Tally {
    /// Judges what was found in one frame of 96 × 96 pixels.
    pub fn add(&mut self, truths: &[Truth], found: &Spots) {
        let mut things: Vec<(Class, &Truth)> = truths
            .iter()
            .filter_map(|truth| Some((of(truth)?, truth)))
            .collect();
        things.sort_by_key(|(_, thing)| core::cmp::Reverse(thing.spot.pixels));
        // Clearest first.
        let mut left: Vec<_> = found.iter().map(|spot| (spot, false)).collect();
        left.sort_by_key(|(spot, _)| core::cmp::Reverse(spot.margin));
        // Larger ones choose first; those that are not judged excuse what was found of them.
        for &(kind, thing) in &things {
            let judged = thing.spot.pixels >= JUDGED_PIXELS
                && thing.visible >= JUDGED_SHARE
                && thing.inside >= JUDGED_SHARE;
            let disc = (f64::from(thing.spot.pixels) / core::f64::consts::PI).sqrt();
            let mut nearest = NEAR.max(disc);
            let mut best = None;
            for (at, (spot, used)) in left.iter().enumerate() {
                let away = distance(spot, thing);
                if !used && spot.class == kind && away <= nearest {
                    (best, nearest) = (Some(at), away);
                }
            }
            if let Some(at) = best {
                left[at].1 = true;
            }
            if judged && best.is_some() {
                self.hits[kind as usize] += 1;
            } else if judged {
                self.misses[kind as usize] += 1;
            }
        }
        for (spot, used) in left {
            let near_small = things.iter().any(|&(kind, thing)| {
                kind == spot.class
                    && thing.spot.pixels < JUDGED_PIXELS
                    && distance(spot, thing) <= NEAR
            });
            if !used && !near_small {
                self.alarms[spot.class as usize] += 1;
            }
        }
    }

    /// F1 of a class.
    pub fn of(&self, kind: Class) -> f64 {
        let at = kind as usize;
        f1(self.hits[at], self.misses[at], self.alarms[at])
    }

    /// F1 of all classes together.
    pub fn all(&self) -> f64 {
        let sum = |counts: [u32; 3]| counts.iter().sum();
        f1(sum(self.hits), sum(self.misses), sum(self.alarms))
    }

    /// Things of a class that were judged.
    pub fn judged(&self, kind: Class) -> u32 {
        self.hits[kind as usize] + self.misses[kind as usize]
    }
}

fn f1(hits: u32, misses: u32, alarms: u32) -> f64 {
    f64::from(2 * hits) / f64::from((2 * hits + misses + alarms).max(1))
}

/// The class that a thing should be found as.
fn of(truth: &Truth) -> Option<Class> {
    let name = class(truth.spot.of)?;
    Class::ALL.into_iter().find(|class| class.name() == name)
}

/// In pixels.
fn distance(spot: &crawler_app::vision::Spot, thing: &Truth) -> f64 {
    let x = f64::from(spot.x) * SIDE - f64::from(thing.spot.x);
    let y = f64::from(spot.y) * SIDE - f64::from(thing.spot.y);
    (x * x + y * y).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{Seen, Spot};

    fn thing(of: Seen, x: f32, pixels: u32) -> Truth {
        Truth {
            spot: Spot {
                of,
                x,
                y: 48.0,
                pixels,
            },
            visible: 1.0,
            inside: 1.0,
        }
    }

    fn found(spots: &[(Class, f32, u8)]) -> Spots {
        let spot = |&(class, x, margin)| crawler_app::vision::Spot {
            class,
            x: x / 96.0,
            y: 0.5,
            margin,
        };
        spots.iter().map(spot).collect()
    }

    fn tally(truths: &[Truth], spots: &[(Class, f32, u8)]) -> Tally {
        let mut tally = Tally::default();
        tally.add(truths, &found(spots));
        tally
    }

    #[test]
    fn what_is_near_and_of_its_class_is_right() {
        let truths = [thing(Seen::Object(0), 40.0, 200)];
        let right = tally(&truths, &[(Class::Object, 51.9, 9)]);
        assert_eq!((right.of(Class::Object), right.all()), (1.0, 1.0));
        let far = tally(&truths, &[(Class::Object, 52.1, 9)]);
        assert_eq!((far.misses, far.alarms), ([0, 1, 0], [0, 1, 0]));
        let other = tally(&truths, &[(Class::Robot, 40.0, 9)]);
        assert_eq!((other.misses, other.alarms), ([0, 1, 0], [0, 0, 1]));
        assert_eq!(other.all(), 0.0);
        // A disc of 2,000 pixels has a radius of 25.
        let large = tally(
            &[thing(Seen::Mover(1), 40.0, 2_000)],
            &[(Class::Obstacle, 65.0, 9)],
        );
        assert_eq!(large.hits, [1, 0, 0]);
    }

    #[test]
    fn one_thing_is_found_once() {
        let truths = [thing(Seen::Robot(0), 40.0, 200)];
        let twice = tally(&truths, &[(Class::Robot, 46.0, 9), (Class::Robot, 41.0, 5)]);
        assert_eq!((twice.hits, twice.alarms), ([0, 0, 1], [0, 0, 1]));
        assert_eq!(twice.of(Class::Robot), 2.0 / 3.0);
    }

    #[test]
    fn what_is_not_judged_need_not_be_found_and_may_be() {
        let small = [thing(Seen::Object(0), 40.0, JUDGED_PIXELS - 1)];
        assert_eq!(tally(&small, &[]), Tally::default());
        assert_eq!(tally(&small, &[(Class::Object, 40.0, 9)]), Tally::default());
        // As often as one likes.
        let twice = [(Class::Object, 40.0, 9), (Class::Object, 44.0, 9)];
        assert_eq!(tally(&small, &twice), Tally::default());
        for (visible, inside) in [(0.4, 1.0), (1.0, 0.4)] {
            let hidden = Truth {
                visible,
                inside,
                ..thing(Seen::Object(0), 40.0, 500)
            };
            let found = [(Class::Object, 40.0, 9)];
            assert_eq!(tally(&[hidden], &found), Tally::default());
            assert_eq!(tally(&[hidden], &twice).alarms, [0, 1, 0]);
        }
        let wall = [thing(Seen::Wall, 40.0, 5_000)];
        let alarm = tally(&wall, &[(Class::Obstacle, 40.0, 9)]);
        assert_eq!(
            (alarm.judged(Class::Obstacle), alarm.alarms),
            (0, [1, 0, 0])
        );
    }
}
