//! Sessions: who is connected, and what is kept for those who are not.

use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::Arc;

use super::retained::Will;
use super::routing::{Author, Filter, Message};
use super::{Client, MAX_IN_FLIGHT, Origin, Output, Peer, PeerFault, Place};
use crate::net::lockstep::packet::{self, Connect, Publication};
use crate::world::Fingerprint;

/// Reason code of MQTT 5, section 2.4.
const SESSION_TAKEN_OVER: u8 = 0x8E;

/// Messages of one client that are remembered, to tell repetitions: more than one that keeps to
/// the window of the robot program has under way.
const MAX_SEEN: usize = 32;

/// What is kept for one client, connected or not.
#[derive(Debug)]
pub(super) struct Session {
    pub(super) client: Rc<str>,
    /// Connection in use.
    pub(super) connection: Option<usize>,
    pub(super) filters: Vec<Filter>,
    pub(super) in_flight: VecDeque<(u16, Arc<Message>, bool)>,
    pub(super) queue: VecDeque<(Arc<Message>, bool)>,
    /// The link its client came over last.
    pub(super) link: usize,
    pub(super) next_id: u16,
    /// QoS 1 messages its client takes at a time.
    pub(super) window: usize,
    /// Longest packet its client takes.
    pub(super) largest: usize,
    pub(super) expiry_s: u32,
    /// When the session ends, while its client is away.
    pub(super) expires: u64,
    /// What arrived last under the newest packet identifiers, to tell repetitions: clients have a
    /// few messages under way at a time.
    seen: VecDeque<(u16, u32)>,
}

impl Peer {
    pub(super) fn client_of(&self, session: usize) -> Rc<str> {
        self.sessions[session]
            .as_ref()
            .map_or_else(|| Rc::from(""), |session| Rc::clone(&session.client))
    }

    pub(super) fn is_repeated(
        &mut self,
        session: usize,
        id: u16,
        duplicate: bool,
        message: &Publication<'_>,
    ) -> bool {
        let mut print = Fingerprint::new();
        print.bytes(message.topic.as_bytes());
        print.bytes(message.payload);
        let Some(session) = &mut self.sessions[session] else {
            return false;
        };
        let print = (print.value() >> 32) as u32;
        let known = session.seen.iter().position(|&(seen, _)| seen == id);
        let before = known.and_then(|place| session.seen.remove(place));
        if session.seen.len() == MAX_SEEN {
            session.seen.pop_front();
        }
        session.seen.push_back((id, print));
        duplicate && before == Some((id, print))
    }

    pub(super) fn connect(
        &mut self,
        Place { connection, link }: Place,
        connect: &Connect<'_>,
        now: u64,
        out: &mut Output,
    ) -> Client {
        let existing = self.by_client.get(connect.client).copied();
        if let Some(index) = existing
            && let Some(session) = &mut self.sessions[index]
            && let Some(old) = session.connection.take()
        {
            packet::write_disconnect(out.to(old), SESSION_TAKEN_OVER);
            out.close.push(old);
            let client = Rc::clone(&session.client);
            self.fault(client, PeerFault::TakenOver);
        }
        let kept = existing.filter(|&index| {
            let session = self.sessions[index].as_ref();
            !connect.clean_start && session.is_some_and(|session| session.expires > now)
        });
        if kept.is_none()
            && let Some(index) = existing
        {
            self.end_session(index);
        }
        let index = kept.unwrap_or_else(|| self.new_session(connect.client));
        if let Some(session) = &mut self.sessions[index] {
            session.connection = Some(connection);
            session.link = link;
            session.window = usize::from(connect.receive_maximum).min(MAX_IN_FLIGHT);
            session.largest = connect.maximum_packet as usize;
            session.expiry_s = connect.session_expiry_s;
            session.expires = u64::MAX;
        }
        packet::write_conn_ack(out.to(connection), kept.is_some(), 0);
        let client = Client {
            session: index,
            link,
            will: connect.will.as_ref().map(|will| Will {
                topic: will.topic.into(),
                kept: self.shapes.keep(will),
            }),
            keep_alive_us: u64::from(connect.keep_alive_s) * 1_000_000,
        };
        // What the client has not acknowledged goes again, under its old number.
        if let Some(session) = &self.sessions[index] {
            for (id, message, retained) in &session.in_flight {
                self.statistics.sent += 1;
                let publication = message.publication(true, *retained);
                packet::write_publish(out.to(connection), &publication, *id, true);
            }
        }
        self.pump(index, out);
        client
    }

    fn new_session(&mut self, client: &str) -> usize {
        let client: Rc<str> = Rc::from(client);
        // Every session is that of one client: where there are as many, no place is vacant.
        let mut index = self.sessions.len();
        if self.by_client.len() < index {
            let vacant = self.sessions.iter().position(Option::is_none);
            index = vacant.unwrap_or(index);
        }
        if index == self.sessions.len() {
            self.sessions.push(None);
        }
        self.sessions[index] = Some(Session {
            client: Rc::clone(&client),
            connection: None,
            filters: Vec::new(),
            in_flight: VecDeque::new(),
            queue: VecDeque::new(),
            link: 0,
            next_id: 1,
            window: MAX_IN_FLIGHT,
            largest: usize::MAX,
            expiry_s: 0,
            expires: u64::MAX,
            seen: VecDeque::new(),
        });
        self.by_client.insert(client, index);
        index
    }

    fn end_session(&mut self, index: usize) {
        let Some(session) = self.sessions[index].take() else {
            return;
        };
        self.by_client.remove(&session.client);
        for filter in session.filters {
            self.forget_filter(index, &filter.text);
        }
    }

    /// A connection is gone: publishes the will, and keeps the session for its time. Returns
    /// when the session is to be ended unless its client comes back, if it has one.
    pub(in crate::net::lockstep) fn lost(
        &mut self,
        connection: usize,
        client: Client,
        now: u64,
    ) -> Option<u64> {
        if let Some(Will { topic, kept }) = client.will {
            let from = Author {
                client: self.client_of(client.session),
                link: client.link,
            };
            let will = kept.message(&topic);
            self.shapes.release(kept);
            let will = will.publication(true, will.retain);
            self.published(&from, &will, Origin::Will, now);
        }
        let session = self.sessions[client.session].as_mut()?;
        if session.connection != Some(connection) {
            return None;
        }
        session.connection = None;
        session.expires = match session.expiry_s {
            u32::MAX => u64::MAX - 1,
            seconds => now + u64::from(seconds) * 1_000_000,
        };
        Some(session.expires)
    }

    /// Ends the sessions whose time has come.
    pub(in crate::net::lockstep) fn expire(&mut self, now: u64) {
        for index in 0..self.sessions.len() {
            if self.sessions[index]
                .as_ref()
                .is_some_and(|session| session.connection.is_none() && session.expires <= now)
            {
                self.end_session(index);
            }
        }
    }
}
