//! The truth about a picture, with what is hidden and what is cut off.

use std::collections::BTreeMap;

use super::frame::{Frame, Seen, Spot};
use super::rays::Optics;

/// What is to be known about a thing in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    /// Where it shows.
    pub spot: Spot,
    /// The pixels that show it over those that would with nothing before it.
    pub visible: f32,
    /// The pixels that would show it, with nothing before it, over those of a picture with as much
    /// again on every side.
    pub inside: f32,
}

impl Frame {
    /// The truth about everything that shows, in the order of [`Frame::spots`].
    ///
    /// Takes as long as some pictures: each thing is drawn once more, alone.
    pub fn truths(&self) -> Vec<Truth> {
        let margin = i32::from(self.width().max(self.height()));
        let optics = Optics::new(&self.scene.lens, self.width(), self.height());
        let eye_m = self.scene.lens.height;
        // Pixels alone: within the picture, and in all.
        let mut alone: BTreeMap<Seen, [u32; 2]> = BTreeMap::new();
        for shape in &self.scene.shapes {
            let Some(window) = optics.window_of(shape, margin) else {
                continue;
            };
            let count = alone.entry(shape.of).or_default();
            for row in window.rows.0..window.rows.1 {
                for column in window.columns.0..window.columns.1 {
                    if shape.hit(eye_m, optics.ray(column, row)).is_some() {
                        let inside = (0..i32::from(self.width())).contains(&column)
                            && (0..i32::from(self.height())).contains(&row);
                        count[0] += u32::from(inside);
                        count[1] += 1;
                    }
                }
            }
        }
        self.spots()
            .into_iter()
            .map(|spot| {
                let [inside, all] = alone.get(&spot.of).copied().unwrap_or_default();
                let share = |part: u32, of: u32| part as f32 / of.max(1) as f32;
                Truth {
                    spot,
                    visible: share(spot.pixels, inside),
                    inside: share(inside, all),
                }
            })
            .collect()
    }
}
