//! Which message goes to whom: subscriptions, retained messages and queues.

use std::rc::Rc;

use crawler_hal::Instant;

use super::{Client, Origin, Output, Peer, PeerFault, Published};
use super::{MAX_FILTERS, MAX_QUEUED, MAX_RETAINED};
use crate::net::lockstep::packet::{self, Publication};

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

impl Message {
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

impl Peer {
    pub(super) fn forget_filter(&mut self, session: usize, filter: &str) {
        if filter.contains(['+', '#']) {
            let still = self.sessions[session]
                .as_ref()
                .is_some_and(|s| s.filters.iter().any(|(f, _)| f.contains(['+', '#'])));
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
            let known = session.filters.iter().position(|(f, _)| f == filter);
            let is_new = known.is_none();
            match known {
                Some(place) => session.filters[place].1 = at_least_once,
                None if session.filters.len() == MAX_FILTERS => {
                    packet::write_disconnect(out.to(connection), QUOTA_EXCEEDED);
                    return Err(PeerFault::Quota);
                }
                None => session.filters.push((filter.to_owned(), at_least_once)),
            }
            if is_new {
                self.note_filter(client.session, filter);
            }
            codes.push(u8::from(at_least_once));
            // Retain handling: 0 always, 1 when the subscription is new, 2 never.
            let handling = options >> 4 & 3;
            if handling == 0 || (handling == 1 && is_new) {
                welcome.extend(
                    self.retained
                        .iter()
                        .filter(|(topic, _)| packet::matches(filter, topic))
                        .map(|(_, message)| Rc::clone(message)),
                );
            }
        }
        packet::write_sub_ack(out.to(connection), 0x90, id, &codes);
        for message in welcome {
            self.deliver(client.session, &message, true, out);
        }
        Ok(())
    }

    fn note_filter(&mut self, session: usize, filter: &str) {
        let list = if filter.contains(['+', '#']) {
            &mut self.wild
        } else {
            self.exact.entry(filter.to_owned()).or_default()
        };
        if let Err(place) = list.binary_search(&session) {
            list.insert(place, session);
        }
    }

    pub(super) fn unsubscribe(&mut self, session: usize, filter: &str) -> bool {
        let Some(known) = &mut self.sessions[session] else {
            return false;
        };
        let before = known.filters.len();
        known.filters.retain(|(f, _)| f != filter);
        let removed = known.filters.len() < before;
        if removed {
            self.forget_filter(session, filter);
        }
        removed
    }

    /// A message from a client.
    pub(super) fn published(
        &mut self,
        from: &Rc<str>,
        message: &Publication<'_>,
        origin: Origin,
        now: u64,
        out: &mut Output,
    ) {
        self.statistics.received += 1;
        self.fingerprint.word(now);
        self.fingerprint.bytes(from.as_bytes());
        self.fingerprint.bytes(message.topic.as_bytes());
        self.fingerprint.bytes(message.payload);
        if self.record.len() < self.record_limit {
            self.record.push_back(Published {
                at: Instant::from_micros(now),
                client: Rc::clone(from),
                topic: message.topic.to_owned(),
                payload: message.payload.to_owned(),
                at_least_once: message.at_least_once,
                retain: message.retain,
                origin,
            });
        } else {
            self.statistics.unrecorded += 1;
        }
        self.route(message, out);
    }

    /// Sends a message to whoever subscribed to it, and keeps it when it is retained.
    pub(in crate::net::lockstep) fn route(&mut self, message: &Publication<'_>, out: &mut Output) {
        let mut shared = None;
        if message.retain {
            if message.payload.is_empty() {
                self.retained.remove(message.topic);
            } else {
                let made = Rc::new(Message::of(message));
                if let Some(known) = self.retained.get_mut(message.topic) {
                    known.clone_from(&made);
                } else if self.retained.len() < MAX_RETAINED {
                    self.retained
                        .insert(message.topic.to_owned(), Rc::clone(&made));
                } else {
                    self.statistics.dropped += 1;
                }
                shared = Some(made);
            }
        }
        let mut listeners = self.exact.get(message.topic).cloned().unwrap_or_default();
        for &index in &self.wild {
            let selected = self.sessions[index].as_ref().is_some_and(|s| {
                s.filters
                    .iter()
                    .any(|(f, _)| packet::matches(f, message.topic))
            });
            if selected && !listeners.contains(&index) {
                listeners.push(index);
            }
        }
        if listeners.is_empty() {
            return;
        }
        let shared = shared.unwrap_or_else(|| Rc::new(Message::of(message)));
        for index in listeners {
            self.deliver(index, &shared, false, out);
        }
    }

    /// Sends one message to one session, or queues it.
    fn deliver(&mut self, index: usize, message: &Rc<Message>, retained: bool, out: &mut Output) {
        let Some(session) = &mut self.sessions[index] else {
            return;
        };
        let granted = session
            .filters
            .iter()
            .any(|(f, at_least_once)| *at_least_once && packet::matches(f, &message.topic));
        let publication = message.publication(granted, retained);
        if !publication.at_least_once {
            // QoS 0: now or never.
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
        session.queue.push_back((Rc::clone(message), retained));
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
