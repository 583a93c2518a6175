//! Telling the map: the hand-over between the activity that keeps it and the link, some rows at a time.
//!
//! There is one map, and it is the sense activity's. For a `report_map` that activity copies as many rows as fit a
//! message, after a look of the ranger; the link sends them, and asks for the next ones. So a map takes half a second and five
//! messages, and a robot has memory for one of them. A window that moves meanwhile begins again with
//! its lowest rows.
//!
//! | step | answer |
//! |---|---|
//! | another report is not finished | `rejected`, `busy` |
//! | the robot has no map: it was not on its way to a place for half a minute | `failed`, `no_map` |
//! | the last rows were sent | `completed` |

use core::cell::RefCell;

use crawler_protocol::Reason;
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use crate::navigation::{Cell, Excerpt};
use crate::order::Sender;

/// One report at a time.
pub(crate) struct MapReports<M: RawMutex>(Mutex<M, RefCell<State>>);

struct State {
    /// Who asked, until the report is finished.
    sender: Option<Sender>,
    /// The next row to copy; `None` while the excerpt waits to be sent.
    wanted: Option<u8>,
    excerpt: Excerpt,
}

impl<M: RawMutex> MapReports<M> {
    pub(crate) const fn new() -> Self {
        Self(Mutex::new(RefCell::new(State {
            sender: None,
            wanted: None,
            excerpt: Excerpt::BLANK,
        })))
    }

    fn with<T>(&self, act: impl FnOnce(&mut State) -> T) -> T {
        self.0.lock(|state| act(&mut state.borrow_mut()))
    }

    /// Begins a report.
    ///
    /// # Errors
    /// [`Reason::Busy`] while another one is not finished.
    pub(crate) fn request(&self, sender: Sender) -> Result<(), Reason> {
        self.with(|state| {
            if state.sender.is_some() {
                return Err(Reason::Busy);
            }
            state.sender = Some(sender);
            state.wanted = Some(0);
            Ok(())
        })
    }

    /// The row to copy from, of a map whose lowest left cell is `origin`; `None` while none is wanted.
    pub(crate) fn wanted(&self, origin: Option<Cell>) -> Option<u8> {
        self.with(|state| {
            let row = state.wanted?;
            // What was sent before lies elsewhere in a window that has moved.
            Some(if origin == Some(state.excerpt.origin) {
                row
            } else {
                0
            })
        })
    }

    /// Hands the link an excerpt.
    pub(crate) fn show(&self, excerpt: &Excerpt) {
        self.with(|state| {
            state.excerpt.clone_from(excerpt);
            state.wanted = None;
        });
    }

    /// Gives the report up; who asked for it.
    pub(crate) fn give_up(&self) -> Option<Sender> {
        self.with(|state| {
            state.wanted = None;
            state.sender.take()
        })
    }

    /// Whether an excerpt waits to be sent.
    pub(crate) fn waits(&self) -> bool {
        self.with(|state| state.sender.is_some() && state.wanted.is_none())
    }

    /// The excerpt that waits, and the number of the command.
    pub(crate) fn excerpt(&self) -> Option<(u64, Excerpt)> {
        self.with(|state| {
            let sender = state.sender.as_ref().filter(|_| state.wanted.is_none())?;
            Some((sender.seq, state.excerpt.clone()))
        })
    }

    /// Notes that the excerpt was sent; who asked for the report when that was the last one.
    pub(crate) fn sent(&self) -> Option<Sender> {
        self.with(|state| {
            state.wanted = state.excerpt.row_after();
            if state.wanted.is_some() {
                return None;
            }
            state.sender.take()
        })
    }
}

#[cfg(test)]
mod tests {
    use embassy_sync::blocking_mutex::raw::NoopRawMutex;

    use super::*;
    use crate::navigation::Navigator;
    use crate::testing::source;

    fn sender(seq: u64) -> Sender {
        Sender {
            source: source("map"),
            seq,
        }
    }

    #[test]
    fn a_report_is_one_excerpt_after_the_other() {
        let reports = MapReports::<NoopRawMutex>::new();
        let navigator = Navigator::BLANK;
        let origin = Some(navigator.map().origin());
        assert_eq!((reports.wanted(origin), reports.waits()), (None, false));
        reports.request(sender(7)).expect("free");
        assert_eq!(reports.request(sender(8)), Err(Reason::Busy));
        for row in [0, 16, 32, 48, 64] {
            assert_eq!(reports.wanted(origin), Some(row));
            assert_eq!(reports.excerpt(), None, "not copied yet");
            reports.show(&navigator.excerpt(row, false));
            assert_eq!((reports.wanted(origin), reports.waits()), (None, true));
            let (seq, excerpt) = reports.excerpt().expect("copied");
            assert_eq!((seq, excerpt.row), (7, row));
            let end = reports.sent();
            assert_eq!(end, (row == 64).then(|| sender(7)));
        }
        assert_eq!((reports.wanted(origin), reports.waits()), (None, false));
        reports.request(sender(9)).expect("free again");
        assert_eq!(reports.wanted(origin), Some(0));
        assert_eq!(reports.give_up(), Some(sender(9)));
        assert!(!reports.waits());
    }

    #[test]
    fn a_window_that_has_moved_is_told_anew() {
        let reports = MapReports::<NoopRawMutex>::new();
        let navigator = Navigator::BLANK;
        let [x, y] = navigator.map().origin();
        reports.request(sender(7)).expect("free");
        reports.show(&navigator.excerpt(0, false));
        assert_eq!(reports.sent(), None);
        assert_eq!(reports.wanted(Some([x, y])), Some(16));
        assert_eq!(reports.wanted(Some([x, y + 1])), Some(0));
    }
}
