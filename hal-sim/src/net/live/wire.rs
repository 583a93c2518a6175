//! The link of a robot that reaches the broker without a radio.

use std::cell::RefCell;
use std::rc::Rc;

use tokio::net::TcpStream;
use tokio::sync::watch;

use crate::net::lockstep::Cut;
use crate::net::proxy::Signal;

/// A link that is not a radio's. The strength means nothing.
const WIRE: Signal = Signal {
    cut: Cut::None,
    rssi_dbm: 0,
};

/// A link that can be cut.
#[derive(Debug)]
pub(super) struct Wire {
    signal: watch::Sender<Signal>,
    /// What the robot has given up while the link was cut. The broker must not learn of it before
    /// the link heals, so nobody closes it. No connection is opened meanwhile: there is one.
    left: RefCell<Option<Rc<TcpStream>>>,
}

impl Wire {
    pub(super) fn new() -> Self {
        Self {
            signal: watch::Sender::new(WIRE),
            left: RefCell::new(None),
        }
    }

    pub(super) fn subscribe(&self) -> watch::Receiver<Signal> {
        self.signal.subscribe()
    }

    /// Cuts or heals it.
    pub(super) fn cut(&self, cut: Cut) {
        if cut == Cut::None {
            self.left.take();
        }
        self.signal.send_replace(Signal { cut, ..WIRE });
    }
}

/// What stands between a connection and its robot while the link is cut.
#[derive(Debug, Clone)]
pub(super) struct LinkSwitch {
    wire: Rc<Wire>,
    news: watch::Receiver<Signal>,
}

impl LinkSwitch {
    pub(super) fn new(wire: &Rc<Wire>) -> Self {
        Self {
            wire: Rc::clone(wire),
            news: wire.subscribe(),
        }
    }

    /// Waits while the link is cut.
    pub(super) async fn healed(&mut self) {
        // It cannot end: the other half of it is in the wire.
        let _ = self.news.wait_for(|signal| signal.cut == Cut::None).await;
    }

    pub(super) fn is_cut(&self) -> bool {
        self.news.borrow().cut != Cut::None
    }

    /// Keeps the end of a connection from the broker until the link heals.
    pub(super) fn keep(&self, tcp: Rc<TcpStream>) {
        self.wire.left.replace(Some(tcp));
    }
}
