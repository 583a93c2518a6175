//! Which message goes to whom: subscriptions, retained messages and queues.

use std::rc::Rc;
use std::sync::Arc;

use crawler_hal::Instant;

use super::retained::Kept;
use super::sessions::Session;
use super::{Client, Origin, Output, Peer, PeerFault, Published};
use super::{MAX_FILTERS, MAX_QUEUED, MAX_RETAINED};
use crate::net::lockstep::packet::{self, Publication};
use crate::world::Fingerprint;
use crate::world::uniform;

/// Reason code of MQTT 5, section 2.4.
const QUOTA_EXCEEDED: u8 = 0x97;

/// A message that is kept or under way.
#[derive(Debug)]
pub(super) struct Message {
    topic: String,
    payload: Vec<u8>,
    at_least_once: bool,
    pub(super) retain: bool,
}

/// Who published a message.
#[derive(Debug)]
pub(super) struct Author {
    pub(super) client: Rc<str>,
    pub(super) link: usize,
}

/// A subscription.
#[derive(Debug)]
pub(super) struct Filter {
    pub(super) text: Rc<str>,
    /// Whether it grants QoS 1.
    pub(super) at_least_once: bool,
    /// The window in which it began.
    since: u64,
}

impl Session {
    /// Whether it is subscribed to a topic.
    pub(super) fn wants(&self, topic: &str) -> bool {
        let mut filters = self.filters.iter();
        filters.any(|filter| packet::matches(&filter.text, topic))
    }

    /// Whether it was subscribed to a topic when `window` began.
    pub(super) fn wanted_before(&self, topic: &str, window: u64) -> bool {
        let mut filters = self.filters.iter().filter(|filter| filter.since < window);
        filters.any(|filter| packet::matches(&filter.text, topic))
    }
}

impl Message {
    pub(super) fn topic(&self) -> &str {
        &self.topic
    }

    pub(super) fn of(publication: &Publication<'_>) -> Self {
        Self {
            topic: publication.topic.to_owned(),
            payload: publication.payload.to_owned(),
            at_least_once: publication.at_least_once,
            retain: publication.retain,
        }
    }

    pub(super) fn publication(&self, at_least_once: bool, retain: bool) -> Publication<'_> {
        Publication {
            topic: &self.topic,
            payload: &self.payload,
            at_least_once: at_least_once && self.at_least_once,
            retain,
        }
    }
}

/// A message on its way to those who listen. It is copied when the first of them has to wait for it.
#[derive(Debug)]
pub(super) struct Letter<'a> {
    message: Publication<'a>,
    kept: Option<Arc<Message>>,
}

impl<'a> Letter<'a> {
    fn new(message: Publication<'a>) -> Self {
        Self {
            message,
            kept: None,
        }
    }

    pub(super) fn of(kept: &'a Arc<Message>) -> Self {
        Self {
            message: kept.publication(true, kept.retain),
            kept: Some(Arc::clone(kept)),
        }
    }

    fn kept(&mut self) -> Arc<Message> {
        let message = &self.message;
        let kept = self
            .kept
            .get_or_insert_with(|| Arc::new(Message::of(message)));
        Arc::clone(kept)
    }
}

impl Peer {
    pub(super) fn forget_filter(&mut self, session: usize, filter: &str) {
        self.tell_abroad(filter, false);
        if filter.contains(['+', '#']) {
            let still = self.sessions[session]
                .as_ref()
                .is_some_and(|s| s.filters.iter().any(|f| f.text.contains(['+', '#'])));
            if !still {
                self.wild.retain(|&s| s != session);
            }
        } else if let Some(subscribers) = self.exact.get_mut(filter) {
            subscribers.retain(|&s| s != session);
            if subscribers.is_empty() {
                self.exact.remove(filter);
            }
        }
    }

    pub(super) fn subscribe(
        &mut self,
        client: &Client,
        connection: usize,
        id: u16,
        filters: &[(&str, u8)],
        out: &mut Output,
    ) -> Result<(), PeerFault> {
        let mut codes = Vec::new();
        let mut welcome = Vec::new();
        for &(filter, options) in filters {
            let Some(session) = &mut self.sessions[client.session] else {
                return Err(PeerFault::Order);
            };
            let at_least_once = options & 3 > 0;
            let known = session.filters.iter().position(|f| *f.text == *filter);
            let is_new = known.is_none();
            match known {
                Some(place) => session.filters[place].at_least_once = at_least_once,
                None if session.filters.len() == MAX_FILTERS => {
                    packet::write_disconnect(out.to(connection), QUOTA_EXCEEDED);
                    return Err(PeerFault::Quota);
                }
                None => {
                    // Most filters are those of others too.
                    let known = self.exact.get_key_value(filter);
                    let text = known.map_or_else(|| Rc::from(filter), |(text, _)| Rc::clone(text));
                    // There are as many robots as there are few filters of each.
                    session.filters.reserve_exact(1);
                    session.filters.push(Filter {
                        text: Rc::clone(&text),
                        at_least_once,
                        since: self.window,
                    });
                    self.note_filter(client.session, &text);
                }
            }
            codes.push(u8::from(at_least_once));
            // Retain handling: 0 always, 1 when the subscription is new, 2 never.
            let handling = options >> 4 & 3;
            if handling == 0 || (handling == 1 && is_new) {
                welcome.extend(
                    self.retained
                        .iter()
                        .filter(|(topic, _)| packet::matches(filter, topic))
                        .map(|(topic, kept)| Arc::new(kept.message(topic))),
                );
            }
        }
        packet::write_sub_ack(out.to(connection), 0x90, id, &codes);
        for message in welcome {
            self.deliver(client.session, &mut Letter::of(&message), true, out);
        }
        Ok(())
    }

    fn note_filter(&mut self, session: usize, filter: &Rc<str>) {
        self.tell_abroad(filter, true);
        let list = if filter.contains(['+', '#']) {
            &mut self.wild
        } else {
            self.exact.entry(Rc::clone(filter)).or_default()
        };
        if list.is_empty() {
            // Most of what robots are subscribed to is theirs alone.
            list.reserve_exact(1);
        }
        if let Err(place) = list.binary_search(&session) {
            list.insert(place, session);
        }
    }

    pub(super) fn unsubscribe(&mut self, session: usize, filter: &str) -> bool {
        let Some(known) = &mut self.sessions[session] else {
            return false;
        };
        let before = known.filters.len();
        known.filters.retain(|f| *f.text != *filter);
        let removed = known.filters.len() < before;
        if removed {
            self.forget_filter(session, filter);
        }
        removed
    }

    /// A message from a client.
    pub(super) fn published(
        &mut self,
        from: &Author,
        message: &Publication<'_>,
        origin: Origin,
        now: u64,
    ) {
        self.statistics.received += 1;
        if self.prints.len() <= from.link {
            self.prints.resize(from.link + 1, Fingerprint::new());
        }
        let print = &mut self.prints[from.link];
        print.word(now);
        print.bytes(from.client.as_bytes());
        print.bytes(message.topic.as_bytes());
        print.bytes(message.payload);
        if self.record.len() < self.record_limit {
            self.record.push_back(Published {
                at: Instant::from_micros(now),
                client: Rc::clone(&from.client),
                topic: message.topic.to_owned(),
                payload: message.payload.to_owned(),
                at_least_once: message.at_least_once,
                retain: message.retain,
                origin,
            });
        } else {
            self.statistics.unrecorded += 1;
        }
        self.carry(from, message, now);
    }

    /// Sends a message of the server to whoever subscribed to it, and keeps it when it is
    /// retained.
    pub(in crate::net::lockstep) fn route(&mut self, message: &Publication<'_>, out: &mut Output) {
        if message.retain {
            self.keep(message);
        }
        let mut letter = Letter::new(*message);
        for index in self.listeners(message.topic) {
            self.deliver(index, &mut letter, false, out);
        }
    }

    /// Keeps a message for later subscribers; an empty one only ends what was kept.
    pub(super) fn keep(&mut self, message: &Publication<'_>) {
        if !message.payload.is_empty() {
            let kept = self.shapes.keep(message);
            self.put(message.topic.into(), kept);
        } else if let Some(before) = self.retained.remove(message.topic) {
            self.shapes.release(before);
        }
    }

    /// Keeps what is ready to be kept.
    pub(super) fn put(&mut self, topic: Box<str>, kept: Kept) {
        let unwanted = if let Some(known) = self.retained.get_mut(&topic) {
            Some(std::mem::replace(known, kept))
        } else if self.retained.len() < MAX_RETAINED {
            self.retained.insert(topic, kept)
        } else {
            self.statistics.dropped += 1;
            Some(kept)
        };
        if let Some(unwanted) = unwanted {
            self.shapes.release(unwanted);
        }
    }

    /// Sessions subscribed to a topic.
    pub(super) fn listeners(&self, topic: &str) -> Vec<usize> {
        let mut listeners = self.exact.get(topic).cloned().unwrap_or_default();
        for &index in &self.wild {
            let session = self.sessions[index].as_ref();
            if session.is_some_and(|session| session.wants(topic)) && !listeners.contains(&index) {
                listeners.push(index);
            }
        }
        listeners
    }

    /// Sends one message to one session, or queues it.
    pub(super) fn deliver(
        &mut self,
        index: usize,
        letter: &mut Letter<'_>,
        retained: bool,
        out: &mut Output,
    ) {
        let Some(session) = &mut self.sessions[index] else {
            return;
        };
        let message = letter.message;
        let mut filters = session.filters.iter();
        let at_least_once = message.at_least_once
            && filters.any(|f| f.at_least_once && packet::matches(&f.text, message.topic));
        if !at_least_once {
            // QoS 0: now or never.
            let publication = Publication {
                at_least_once,
                retain: retained,
                ..message
            };
            if let Some(connection) = session.connection {
                if packet::publish_len(&publication) > session.largest {
                    self.statistics.dropped += 1;
                } else {
                    self.statistics.sent += 1;
                    packet::write_publish(out.to(connection), &publication, 0, false);
                }
            }
            return;
        }
        if session.queue.len() >= MAX_QUEUED {
            self.statistics.dropped += 1;
            return;
        }
        if let Some((share, rng)) = &mut self.repeats
            && uniform(rng) < *share
        {
            session.queue.push_back((letter.kept(), retained));
        }
        session.queue.push_back((letter.kept(), retained));
        self.pump(index, out);
    }

    /// Sends queued messages while the client allows more to be under way.
    pub(super) fn pump(&mut self, index: usize, out: &mut Output) {
        let Some(session) = &mut self.sessions[index] else {
            return;
        };
        let Some(connection) = session.connection else {
            return;
        };
        while session.in_flight.len() < session.window
            && let Some((message, retained)) = session.queue.pop_front()
        {
            let publication = message.publication(true, retained);
            if packet::publish_len(&publication) > session.largest {
                self.statistics.dropped += 1;
                continue;
            }
            let id = loop {
                let id = session.next_id;
                session.next_id = session.next_id.checked_add(1).unwrap_or(1);
                if !session.in_flight.iter().any(|(flying, ..)| *flying == id) {
                    break id;
                }
            };
            self.statistics.sent += 1;
            packet::write_publish(out.to(connection), &publication, id, false);
            session.in_flight.push_back((id, message, retained));
        }
    }
}
