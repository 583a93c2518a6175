//! The newest image of each robot.
//!
//! Twenty thousand robots with the largest of images would be more than a gigabyte, so all images
//! together have a bound, and the one received longest ago makes room.

use std::collections::HashMap;

use bytes::Bytes;
use crawler_protocol::{IMAGE_FRAME, IMAGE_TIMESTAMP, RobotId};

use super::Incoming;

/// Bytes of all images together.
const MAX_BYTES: usize = 64 * 1024 * 1024;
/// Start of image with the marker that follows, and end of image (ISO/IEC 10918-1, table B.1).
const BEGINNING: [u8; 3] = [0xFF, 0xD8, 0xFF];
const END: [u8; 2] = [0xFF, 0xD9];

/// An image as received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// The JPEG.
    pub jpeg: Bytes,
    /// Counts the robot's images since it started.
    pub frame: u32,
    /// Unix milliseconds when it was taken by the robot's clock; 0 when that was not set.
    pub timestamp: u64,
    /// Unix milliseconds when it arrived, by the server's clock.
    pub received: u64,
}

impl Image {
    /// The image in a message; `None` when it is no JPEG, or does not say which.
    pub(super) fn read(message: &Incoming<'_>, received: u64) -> Option<Self> {
        let jpeg = message.payload;
        if !(jpeg.starts_with(&BEGINNING) && jpeg.ends_with(&END)) {
            return None;
        }
        Some(Self {
            frame: message.property(IMAGE_FRAME)?.parse().ok()?,
            timestamp: message.property(IMAGE_TIMESTAMP)?.parse().ok()?,
            jpeg: Bytes::copy_from_slice(jpeg),
            received,
        })
    }
}

/// See the [module](self).
#[derive(Debug, Default)]
pub(super) struct Images {
    newest: HashMap<RobotId, (u64, Image)>,
    bytes: usize,
    /// Counts images received.
    serial: u64,
}

impl Images {
    pub(super) fn get(&self, id: &RobotId) -> Option<&Image> {
        self.newest.get(id).map(|(_, image)| image)
    }

    pub(super) fn insert(&mut self, id: RobotId, image: Image) {
        self.remove(&id);
        self.bytes += image.jpeg.len();
        self.serial += 1;
        self.newest.insert(id, (self.serial, image));
        while self.bytes > MAX_BYTES {
            let oldest = self.newest.iter().min_by_key(|(_, (serial, _))| *serial);
            let Some(oldest) = oldest.map(|(id, _)| id.clone()) else {
                return;
            };
            self.remove(&oldest);
        }
    }

    pub(super) fn remove(&mut self, id: &RobotId) {
        if let Some((_, image)) = self.newest.remove(id) {
            self.bytes -= image.jpeg.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(bytes: usize) -> Image {
        Image {
            jpeg: vec![0; bytes].into(),
            frame: 1,
            timestamp: 2,
            received: 3,
        }
    }

    fn id(number: usize) -> RobotId {
        RobotId::new(&format!("robot-{number}")).expect("an id")
    }

    #[test]
    fn the_oldest_makes_room_and_each_robot_has_one() {
        let mut images = Images::default();
        let size = MAX_BYTES / 4;
        for _ in 0..10 {
            images.insert(id(0), image(size));
        }
        assert_eq!((images.newest.len(), images.bytes), (1, size));
        for number in 1..4 {
            images.insert(id(number), image(size));
        }
        assert_eq!((images.newest.len(), images.bytes), (4, MAX_BYTES));
        // Received again, the first is the newest.
        images.insert(id(0), image(size));
        images.insert(id(4), image(1));
        assert!(images.get(&id(1)).is_none());
        assert!(images.get(&id(0)).is_some() && images.get(&id(4)).is_some());
        for number in 0..5 {
            images.remove(&id(number));
        }
        assert_eq!((images.newest.len(), images.bytes), (0, 0));
    }

    #[test]
    fn only_a_jpeg_that_says_which_it_is_is_an_image() {
        let jpeg = [0xFF, 0xD8, 0xFF, 0xE0, 0xFF, 0xD9];
        let properties = |frame: &str, timestamp: &str| {
            vec![
                ("frame".to_owned(), frame.to_owned()),
                ("timestamp".to_owned(), timestamp.to_owned()),
            ]
        };
        let read = |payload: &[u8], properties: &[(String, String)]| {
            let message = Incoming {
                topic: b"swarm/image/a",
                payload,
                retained: false,
                content_type: None,
                properties,
            };
            Image::read(&message, 9)
        };
        let good = read(&jpeg, &properties("7", "8")).expect("an image");
        assert_eq!((good.frame, good.timestamp, good.received), (7, 8, 9));
        assert_eq!(good.jpeg, jpeg[..]);
        for payload in [&[][..], &jpeg[1..], &jpeg[..5], &[0xFF, 0xD9], b"GIF89a"] {
            assert!(read(payload, &properties("7", "8")).is_none());
        }
        for wrong in [
            properties("", "8"),
            properties("7", "-1"),
            properties("4294967296", "8"),
            properties("7", "8")[1..].to_vec(),
            [properties("7", "8"), properties("7", "8")].concat(),
            Vec::new(),
        ] {
            assert!(read(&jpeg, &wrong).is_none(), "{wrong:?}");
        }
    }
}
