//! What robots publish for others: it is handed on when a physics step ends, in an order that
//! has nothing to do with which thread runs whom.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::retained::Kept;
use super::routing::{Author, Letter, Message};
use super::{Output, Peer};
use crate::net::lockstep::packet::{self, Publication};
use crate::world::Fingerprint;

/// A message under way from the robot that published it to whoever wants it.
#[derive(Debug, Clone)]
pub(in crate::net::lockstep) struct Carried {
    /// When the broker got it.
    pub(super) at: u64,
    /// The link it came over.
    pub(super) link: usize,
    /// Whether its author listens to it too.
    pub(super) own: bool,
    content: Content,
}

#[derive(Debug, Clone)]
enum Content {
    /// What others are to hear.
    Message(Arc<Message>),
    /// What is to be retained, with its topic, where nobody is known to listen: after a boot all
    /// robots have some of that under way at once.
    Kept(Box<str>, Kept),
}

/// A subscription that began or ended, as other shards hear of it.
#[derive(Debug, Clone)]
pub(in crate::net::lockstep) struct FilterChange {
    began: bool,
    filter: Kind,
}

#[derive(Debug, Clone)]
enum Kind {
    /// Hash of a filter without wildcards. Two filters in one cost a message that nobody takes.
    Exact(u64),
    Wild(String),
}

/// What is subscribed to elsewhere, with the number of subscriptions.
#[derive(Debug, Default)]
pub(super) struct Interest {
    exact: BTreeMap<u64, u32>,
    wild: BTreeMap<String, u32>,
    /// What began and ended here since the last exchange.
    changes: Vec<FilterChange>,
}

impl Interest {
    fn includes(&self, topic: &str) -> bool {
        self.exact.contains_key(&hash(topic))
            || self
                .wild
                .keys()
                .any(|filter| packet::matches(filter, topic))
    }
}

impl Peer {
    /// From now on there are other shards, which want to know who subscribes to what.
    pub(in crate::net::lockstep) fn look_abroad(&mut self) {
        self.abroad.get_or_insert_default();
    }

    /// Notes for other shards that `filter` was subscribed to here, or is not any more.
    pub(super) fn tell_abroad(&mut self, filter: &str, began: bool) {
        if let Some(abroad) = &mut self.abroad {
            let filter = if filter.contains(['+', '#']) {
                Kind::Wild(filter.to_owned())
            } else {
                Kind::Exact(hash(filter))
            };
            abroad.changes.push(FilterChange { began, filter });
        }
    }

    /// Takes over what another shard has told.
    pub(in crate::net::lockstep) fn heed(&mut self, changes: &[FilterChange]) {
        let Some(abroad) = &mut self.abroad else {
            return;
        };
        for FilterChange { began, filter } in changes {
            match filter {
                Kind::Exact(filter) => count(&mut abroad.exact, filter, *began),
                Kind::Wild(filter) => count(&mut abroad.wild, filter, *began),
            }
        }
    }

    /// Moves out what was published, and which subscriptions changed, since the last time.
    pub(in crate::net::lockstep) fn report(
        &mut self,
        messages: &mut Vec<Carried>,
        changes: &mut Vec<FilterChange>,
    ) {
        messages.clear();
        std::mem::swap(messages, &mut self.outbox);
        changes.clear();
        if let Some(abroad) = &mut self.abroad {
            std::mem::swap(changes, &mut abroad.changes);
        }
    }

    /// Keeps a message of a robot for the end of the step, if anybody wants it. Nothing is copied
    /// where nobody does, in this shard or another.
    pub(super) fn carry(&mut self, from: &Author, message: &Publication<'_>, now: u64) {
        let here = self.is_wanted(message.topic);
        let elsewhere = || {
            let abroad = self.abroad.as_ref();
            abroad.is_some_and(|abroad| abroad.includes(message.topic))
        };
        if !(message.retain || here || elsewhere()) {
            return;
        }
        let own = here
            && self.by_client.get(&from.client).is_some_and(|&index| {
                let session = self.sessions[index].as_ref();
                session.is_some_and(|session| session.wants(message.topic))
            });
        let content = if here || self.abroad.is_some() || message.payload.is_empty() {
            Content::Message(Arc::new(Message::of(message)))
        } else {
            Content::Kept(message.topic.into(), self.shapes.keep(message))
        };
        self.outbox.push(Carried {
            at: now,
            link: from.link,
            own,
            content,
        });
    }

    /// Number of messages that are kept for the end of the step.
    #[cfg(test)]
    pub(in crate::net::lockstep) fn waiting(&self) -> usize {
        self.outbox.len()
    }

    fn is_wanted(&self, topic: &str) -> bool {
        self.exact.contains_key(topic)
            || self.wild.iter().any(|&index| {
                let session = self.sessions[index].as_ref();
                session.is_some_and(|session| session.wants(topic))
            })
    }

    /// Begins the time until the next exchange. What was published before it must have been
    /// handed on.
    pub(in crate::net::lockstep) fn open_window(&mut self) {
        self.window += 1;
    }

    /// Sends a message of this window on.
    ///
    /// A subscription takes effect with the next window, as if the broker needed so long to set
    /// it up: another shard cannot know of it earlier. Its own client never notices, since what it
    /// publishes itself is heard at once, and anything that others publish because of it comes a
    /// window later. A message to be retained goes to everyone: whoever has just subscribed did
    /// not find it among those kept.
    pub(in crate::net::lockstep) fn hand_on(&mut self, carried: Carried, out: &mut Output) {
        let Carried {
            link, own, content, ..
        } = carried;
        let message = match content {
            Content::Message(message) => {
                if message.retain {
                    self.keep(&message.publication(true, true));
                }
                message
            }
            Content::Kept(topic, kept) => {
                // Seldom: somebody has subscribed to it just now.
                let message = self.is_wanted(&topic).then(|| kept.message(&topic));
                self.put(topic, kept);
                let Some(message) = message else { return };
                Arc::new(message)
            }
        };
        let mut letter = Letter::of(&message);
        for index in self.listeners(message.topic()) {
            let Some(session) = &self.sessions[index] else {
                continue;
            };
            let heard = message.retain
                || session.wanted_before(message.topic(), self.window)
                || (own && session.link == link);
            if heard {
                self.deliver(index, &mut letter, false, out);
            }
        }
    }
}

/// Sorts messages by time, and those of one moment by link. Each link's own order stays.
pub(in crate::net::lockstep) fn sort(messages: &mut [Carried]) {
    // One link is of one shard, whose messages are in order of time already.
    messages.sort_by_key(|carried| (carried.at, carried.link));
}

fn count<K: Ord + Clone>(counts: &mut BTreeMap<K, u32>, key: &K, more: bool) {
    if more {
        *counts.entry(key.clone()).or_insert(0) += 1;
    } else if let Some(number) = counts.get_mut(key) {
        *number -= 1;
        if *number == 0 {
            counts.remove(key);
        }
    }
}

fn hash(text: &str) -> u64 {
    let mut print = Fingerprint::new();
    print.bytes(text.as_bytes());
    print.value()
}
