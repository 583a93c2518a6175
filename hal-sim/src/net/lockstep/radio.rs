//! The radio under the network, moved on by whoever knows where robots are.

use super::VirtualNetwork;
use super::state::Link;
use crate::net::radio::LOOK_PERIOD_US;

impl VirtualNetwork {
    /// Whether there is a radio that wants to know where robots are.
    #[must_use]
    pub fn has_radio(&self) -> bool {
        self.state.borrow().radio.is_some()
    }

    /// Tells where the robot of a link begins.
    pub(crate) fn begin(&self, link: usize, place: (f32, f32)) {
        let state = &mut *self.state.borrow_mut();
        if let Some(radio) = &mut state.radio {
            radio.begin(link, place);
            state.links[link].reach = radio.reach(link);
            state.links[link].settle();
        }
    }

    /// Lets the radios look around when it is time; `place` tells where the robot of a link is.
    pub(crate) fn look(&self, place: impl FnMut(usize) -> Option<(f32, f32)>) {
        let now = self.now();
        if !now.is_multiple_of(LOOK_PERIOD_US) {
            return;
        }
        let state = &mut *self.state.borrow_mut();
        let Some(radio) = &mut state.radio else {
            return;
        };
        let links = &mut state.links;
        let mut changed = Vec::new();
        radio.look(now, place, |link, reach| {
            links[link].reach = reach;
            changed.push(link);
        });
        if !changed.is_empty() {
            state.relink(now);
            for link in changed {
                state.links[link].settle();
            }
        }
    }
}

impl Link {
    /// Its connections have felt what is wrong with it; whoever waits for it may look.
    pub(super) fn settle(&mut self) {
        self.applied = self.state();
        if let Some(waker) = self.waiting.take() {
            waker.wake();
        }
    }
}
