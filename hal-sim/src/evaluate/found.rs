//! Which of the coloured things robots have found with their cameras.

use crawler_protocol::Detections;

use crate::scenario::apart;
use crate::world::{Pose, wrap_any};

/// What the detector calls such a thing.
const OBJECT: &str = "object";
/// Things farther away than this are not told apart, metres.
const REACH_M: f32 = 2.0;
/// A report points to a thing when it is off by no more than this when it comes, radians.
const OFF_RAD: f32 = 0.15;
/// One look may take a box for a thing that stands behind it; so many that point to it may not.
const REPORTS: u32 = 3;

/// See the [module](self).
#[derive(Debug)]
pub(super) struct Found {
    /// Each thing: where it is, and how many reports have pointed to it.
    things: Vec<([f32; 2], u32)>,
}

impl Found {
    /// Things at these places; where there are none there is nothing to find.
    pub(super) fn new(places: impl Iterator<Item = [f32; 2]>) -> Option<Self> {
        let things: Vec<_> = places.map(|place| (place, 0)).collect();
        (!things.is_empty()).then_some(Self { things })
    }

    /// Takes in what a robot at `pose` reports.
    pub(super) fn report(&mut self, pose: Pose, seen: &Detections) {
        let here = [pose.x, pose.y];
        for (place, reports) in &mut self.things {
            let [x, y] = *place;
            let bearing = wrap_any(libm::atan2f(y - here[1], x - here[0]) - pose.theta);
            let points = seen
                .objects
                .iter()
                .any(|one| one.class == OBJECT && wrap_any(one.bearing - bearing).abs() <= OFF_RAD);
            if points && apart(here, *place) <= REACH_M {
                *reports = reports.saturating_add(1);
            }
        }
    }

    /// The share of the things that have been found.
    pub(super) fn share(&self) -> f64 {
        let found = self.things.iter().filter(|thing| thing.1 >= REPORTS);
        found.count() as f64 / self.things.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(class: &str, bearing: f32) -> Detections {
        let text = format!(
            r#"{{"robot":"sim-0001","seq":1,"timestamp":1,"frame":1,"objects":[{{"class":"{class}","x":0.5,"y":0.5,"bearing":{bearing},"margin":9}}]}}"#
        );
        Detections::from_json(text.as_bytes()).unwrap()
    }

    #[test]
    fn what_is_pointed_to_a_few_times_is_found() {
        let places = [[1.0, 1.0], [1.0, -1.0], [3.0, 3.0]];
        let mut found = Found::new(places.into_iter()).unwrap();
        let pose = Pose::new(0.0, 0.0, 0.5);
        let quarter = core::f32::consts::FRAC_PI_4;
        for _ in 0..REPORTS - 1 {
            found.report(pose, &report("object", quarter - 0.5));
            found.report(pose, &report("obstacle", quarter - 0.5));
            found.report(pose, &report("object", quarter - 0.3));
        }
        assert_eq!(found.share(), 0.0);
        found.report(pose, &report("object", quarter - 0.6));
        // The one behind it is too far away.
        assert_eq!(found.share(), 1.0 / 3.0);
        let turned = Pose::new(0.0, 0.0, 3.0);
        for _ in 0..REPORTS {
            found.report(turned, &report("object", -quarter - 3.0));
        }
        assert_eq!(found.share(), 2.0 / 3.0);
        assert!(Found::new([].into_iter()).is_none());
    }
}
