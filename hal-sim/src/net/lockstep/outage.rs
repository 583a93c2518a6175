//! A broker that dies, comes back with an empty memory, and delivers things twice.

use rand_pcg::Pcg32;

use super::VirtualNetwork;

impl VirtualNetwork {
    /// The broker dies: every connection ends, nobody's last will is published, and it forgets
    /// sessions, queues and retained messages. Until [`VirtualNetwork::start_broker`] connections are refused.
    ///
    /// Nothing of it goes into the journal of a recording, and it holds for this shard alone.
    pub fn stop_broker(&self) {
        let now = self.now();
        let state = &mut *self.state.borrow_mut();
        state.stopped = true;
        state.peer.forget();
        state.inbox.clear();
        for index in 0..state.connections.len() {
            if let Some(Some(connection)) = state.connections.get_mut(index) {
                // Without a client it has no will.
                connection.client = None;
                state.close(index, now);
            }
        }
    }

    /// The broker is there again, and knows nothing.
    pub fn start_broker(&self) {
        self.state.borrow_mut().stopped = false;
    }

    /// From now on the broker hands on this share of all QoS 1 messages twice, as the standard
    /// allows it to.
    pub fn repeat(&self, share: f32) {
        let rng = Pcg32::new(self.seed ^ 0x7477_6963, 0);
        self.state.borrow_mut().peer.repeat(share, rng);
    }
}
