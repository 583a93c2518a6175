//! What is kept of messages for later: retained ones, and last wills.
//!
//! Every robot of a fleet leaves the same, but for its name, which is also where its topics end.
//! So the name is taken out of what is kept, and the rest is there once for all who left it.

use std::collections::BTreeSet;
use std::sync::Arc;

use super::routing::Message;
use crate::net::lockstep::packet::Publication;

/// Names shorter than this stay where they are: to note their places takes more than they do.
const SHORTEST_NAME: usize = size_of::<u32>();

/// A message without its topic, and without the name in which the topic ends.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Shape {
    payload: Box<[u8]>,
    /// Where in the payload the name was, in order.
    gaps: Box<[u32]>,
    at_least_once: bool,
    retain: bool,
}

/// A message that is kept. Its topic is kept by whoever has it.
#[derive(Debug, Clone)]
#[must_use = "a message that is not kept any more is to be given back"]
pub(super) struct Kept(Arc<Shape>);

/// A last will.
#[derive(Debug)]
pub(super) struct Will {
    pub(super) topic: Box<str>,
    pub(super) kept: Kept,
}

/// What all messages that are kept come to without their names.
#[derive(Debug, Default)]
pub(super) struct Shapes(BTreeSet<Arc<Shape>>);

impl Shapes {
    pub(super) fn keep(&mut self, message: &Publication<'_>) -> Kept {
        let mut payload = Vec::with_capacity(message.payload.len());
        let mut gaps = Vec::new();
        let mut rest = message.payload;
        if let Some(name) = name(message.topic) {
            while let Some(at) = rest.windows(name.len()).position(|part| part == name) {
                payload.extend_from_slice(&rest[..at]);
                // A packet is far shorter than 4 GiB.
                gaps.push(payload.len() as u32);
                rest = &rest[at + name.len()..];
            }
        }
        payload.extend_from_slice(rest);
        let shape = Shape {
            payload: payload.into(),
            gaps: gaps.into(),
            at_least_once: message.at_least_once,
            retain: message.retain,
        };
        if let Some(known) = self.0.get(&shape) {
            return Kept(Arc::clone(known));
        }
        let shape = Arc::new(shape);
        self.0.insert(Arc::clone(&shape));
        Kept(shape)
    }

    /// Takes back what is not kept any more.
    pub(super) fn release(&mut self, Kept(shape): Kept) {
        // This one and the one in the set.
        if Arc::strong_count(&shape) == 2 {
            self.0.remove(&shape);
        }
    }

    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.0.len()
    }
}

impl Kept {
    /// The message as it was, for the topic that it was kept for.
    pub(super) fn message(&self, topic: &str) -> Message {
        let shape = &*self.0;
        let name = name(topic).unwrap_or_default();
        let mut payload = Vec::with_capacity(shape.payload.len() + shape.gaps.len() * name.len());
        let mut from = 0;
        for &gap in &shape.gaps {
            let gap = gap as usize;
            payload.extend_from_slice(&shape.payload[from..gap]);
            payload.extend_from_slice(name);
            from = gap;
        }
        payload.extend_from_slice(&shape.payload[from..]);
        Message::of(&Publication {
            topic,
            payload: &payload,
            at_least_once: shape.at_least_once,
            retain: shape.retain,
        })
    }
}

/// The last level of a topic, where it is long enough for a name.
fn name(topic: &str) -> Option<&[u8]> {
    let name = topic.rsplit('/').next()?;
    (name.len() >= SHORTEST_NAME).then_some(name.as_bytes())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn publication<'a>(topic: &'a str, payload: &'a [u8]) -> Publication<'a> {
        Publication {
            topic,
            payload,
            at_least_once: true,
            retain: true,
        }
    }

    #[test]
    fn what_differs_in_the_name_alone_is_kept_once() {
        let mut shapes = Shapes::default();
        let mut all = Vec::new();
        for robot in 0..100 {
            let topic = format!("swarm/status/sim-{robot:04}");
            let payload = format!(r#"{{"robot":"sim-{robot:04}","online":true}}"#);
            let kept = shapes.keep(&publication(&topic, payload.as_bytes()));
            let message = kept.message(&topic);
            assert_eq!(message.publication(true, true).payload, payload.as_bytes());
            all.push(kept);
        }
        assert_eq!(shapes.len(), 1);
        let other = shapes.keep(&publication("swarm/status/sim-0001", b"sim-0002"));
        assert_eq!(shapes.len(), 2);
        shapes.release(other);
        for kept in all {
            assert_eq!(shapes.len(), 1);
            shapes.release(kept);
        }
        assert_eq!(shapes.len(), 0);
    }

    proptest! {
        #[test]
        fn a_message_comes_back_as_it_was(
            topic in "[ab/]{1,12}",
            payload in proptest::collection::vec(97_u8..99, 0..60),
            at_least_once: bool,
            retain: bool,
        ) {
            let mut shapes = Shapes::default();
            let message = Publication { topic: &topic, payload: &payload, at_least_once, retain };
            let kept = shapes.keep(&message);
            let back = kept.message(&topic);
            prop_assert_eq!(back.publication(at_least_once, retain), message);
            shapes.release(kept);
            prop_assert_eq!(shapes.len(), 0);
        }
    }
}
