//! The end of a physics step, for the network: what robots told each other is handed on.

use super::VirtualNetwork;
use super::peer::{Carried, FilterChange, Output, sort_carried};
use super::state::State;
use crate::net::radio::{Airtime, WINDOW_US};

/// What one shard of a world tells the others at the end of a step.
#[derive(Debug, Default)]
pub(crate) struct News {
    messages: Vec<Carried>,
    filters: Vec<FilterChange>,
    /// What each radio channel saw, when a window of airtime has just ended.
    airtime: Option<Vec<Airtime>>,
}

impl VirtualNetwork {
    /// Prepares the network for other shards, before any robot is connected.
    pub(crate) fn share(&self) {
        self.state.borrow_mut().peer.look_abroad();
    }

    /// Writes what happened here since the last time over `news`.
    pub(crate) fn report(&self, news: &mut News) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        state.peer.report(&mut news.messages, &mut news.filters);
        state.close_airtime(now, &mut news.airtime);
    }

    /// Takes in the news of a shard, its own or (`foreign`) another.
    pub(crate) fn hear(&self, news: &News, foreign: bool) {
        let state = &mut *self.state.borrow_mut();
        state.inbox.extend_from_slice(&news.messages);
        state.add_airtime(news.airtime.as_deref());
        if foreign {
            state.peer.heed(&news.filters);
        }
    }

    /// Hands on what was taken in by [`VirtualNetwork::hear`].
    pub(crate) fn hand_on(&self) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        // First, since messages that are handed on take airtime too.
        state.open_airtime();
        if !state.inbox.is_empty() {
            let mut inbox = std::mem::take(&mut state.inbox);
            sort_carried(&mut inbox);
            for carried in inbox.drain(..) {
                // One at a time: two messages at once to one robot would share a segment, or not,
                // depending on who else gets them.
                let mut out = Output::default();
                state.peer.hand_on(carried, &mut out);
                state.carry_out(out, now);
            }
            state.inbox = inbox;
        }
        state.peer.open_window();
    }

    /// The same where there is no other shard.
    pub(crate) fn settle(&self) {
        let now = self.now();
        {
            let state = &mut *self.state.borrow_mut();
            let mut news = std::mem::take(&mut state.news);
            state.peer.report(&mut news.messages, &mut news.filters);
            state.inbox.append(&mut news.messages);
            state.close_airtime(now, &mut news.airtime);
            state.add_airtime(news.airtime.as_deref());
            state.news = news;
        }
        self.hand_on();
    }
}

impl State {
    /// Ends a window of airtime when its time has come.
    fn close_airtime(&mut self, now: u64, sums: &mut Option<Vec<Airtime>>) {
        match &mut self.radio {
            Some(radio) if now.is_multiple_of(WINDOW_US) => {
                radio.close_window(now, sums.get_or_insert_default());
            }
            _ => *sums = None,
        }
    }

    /// Adds what the channels saw in one shard.
    fn add_airtime(&mut self, sums: Option<&[Airtime]>) {
        let Some(sums) = sums else { return };
        self.airtime.resize(sums.len(), Airtime::default());
        for (all, sum) in self.airtime.iter_mut().zip(sums) {
            *all += *sum;
        }
    }

    /// Begins the next window, if one has ended.
    fn open_airtime(&mut self) {
        if let Some(radio) = &mut self.radio
            && !self.airtime.is_empty()
        {
            radio.open_window(&self.airtime);
            self.airtime.clear();
        }
    }
}
