//! Connections that have not shown yet what they want: a bounded number of them.
//!
//! Whoever arrives always gets in. When there are too many, from one address or in all, the one that has
//! waited longest is closed, of the address that has the most. So a machine that opens connections and
//! says nothing crowds out its own connections, and nobody else.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::neighbourhood;
use tokio_util::sync::CancellationToken;

/// The connections that wait.
#[derive(Debug)]
pub struct Waiting {
    most: usize,
    most_of_one: usize,
    inner: Mutex<Inner>,
}

#[derive(Debug, Default)]
struct Inner {
    next: u64,
    /// Oldest first.
    all: BTreeMap<u64, (IpAddr, CancellationToken)>,
    /// Those of each address.
    of: HashMap<IpAddr, BTreeSet<u64>>,
}

impl Waiting {
    /// Room for `most`, of which one address may have `most_of_one`. Addresses of one IPv6 /64 count as
    /// one.
    pub fn new(most: usize, most_of_one: usize) -> Arc<Self> {
        Arc::new(Self {
            most: most.max(1),
            most_of_one: most_of_one.max(1),
            inner: Mutex::default(),
        })
    }

    /// Takes somebody from this address in, and closes another connection where there is no room.
    pub fn enter(self: &Arc<Self>, from: IpAddr) -> Slot {
        let slot = Slot {
            waiting: Arc::clone(self),
            of: neighbourhood(from),
            number: Mutex::new(None),
            closed: CancellationToken::new(),
        };
        slot.wait();
        slot
    }

    /// Closes the connection that has waited longest, of the address that has the most. False when none
    /// waits.
    pub fn close_oldest(&self) -> bool {
        self.lock().close_oldest()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    fn close_oldest(&mut self) -> bool {
        let crowd = self.of.iter().max_by_key(|(_, numbers)| numbers.len());
        let oldest = crowd.and_then(|(_, numbers)| numbers.first().copied());
        oldest.is_some_and(|oldest| {
            self.close(oldest);
            true
        })
    }

    fn close(&mut self, number: u64) {
        if let Some(closed) = self.remove(number) {
            closed.cancel();
        }
    }

    fn remove(&mut self, number: u64) -> Option<CancellationToken> {
        let (of, closed) = self.all.remove(&number)?;
        if let Some(numbers) = self.of.get_mut(&of) {
            numbers.remove(&number);
            if numbers.is_empty() {
                self.of.remove(&of);
            }
        }
        Some(closed)
    }
}

/// The place of one connection, until it is dropped.
#[derive(Debug)]
pub struct Slot {
    waiting: Arc<Waiting>,
    of: IpAddr,
    /// Its number in the queue, as long as it waits.
    number: Mutex<Option<u64>>,
    closed: CancellationToken,
}

impl Slot {
    /// Returns when the connection has to make room for others.
    ///
    /// # Cancellation Safety
    /// Nothing is lost.
    pub async fn crowded_out(&self) {
        self.closed.cancelled().await;
    }

    /// From now on the connection waits for its client. If it did already, it has waited for no time.
    pub fn wait(&self) {
        if self.closed.is_cancelled() {
            return;
        }
        let mut number = self.number();
        let mut inner = self.waiting.lock();
        if let Some(number) = number.take() {
            // One that was closed meanwhile stays closed.
            if inner.remove(number).is_none() {
                return;
            }
        }
        let of_one = inner.of.get(&self.of);
        let oldest = of_one.filter(|numbers| numbers.len() >= self.waiting.most_of_one);
        if let Some(oldest) = oldest.and_then(|numbers| numbers.first().copied()) {
            inner.close(oldest);
        } else if inner.all.len() >= self.waiting.most {
            inner.close_oldest();
        }
        let new = inner.next;
        inner.next += 1;
        inner.all.insert(new, (self.of, self.closed.clone()));
        inner.of.entry(self.of).or_default().insert(new);
        *number = Some(new);
    }

    /// The client has shown what it wants: the connection makes room for nobody until it waits again.
    pub fn settle(&self) {
        if let Some(number) = self.number().take() {
            self.waiting.lock().remove(number);
        }
    }

    fn number(&self) -> MutexGuard<'_, Option<u64>> {
        self.number.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.settle();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str) -> IpAddr {
        text.parse().expect("an address")
    }

    fn open(slots: &[Slot]) -> Vec<usize> {
        let open = |(_, slot): &(usize, &Slot)| !slot.closed.is_cancelled();
        let numbered = slots.iter().enumerate();
        numbered.filter(open).map(|(number, _)| number).collect()
    }

    #[test]
    fn an_address_crowds_out_itself_alone() {
        let waiting = Waiting::new(100, 3);
        let robot = waiting.enter(address("192.0.2.7"));
        let hostile = ["2001:db8::1", "2001:db8::2"].map(address);
        let crowd: Vec<_> = (0..10).map(|n| waiting.enter(hostile[n % 2])).collect();
        assert_eq!(open(&crowd), [7, 8, 9]);
        assert!(!robot.closed.is_cancelled());
    }

    #[test]
    fn where_all_is_full_the_largest_crowd_makes_room() {
        let waiting = Waiting::new(5, 4);
        let robot = waiting.enter(address("192.0.2.7"));
        let crowd: Vec<_> = (0..4)
            .map(|_| waiting.enter(address("192.0.2.1")))
            .collect();
        let others = ["192.0.2.2", "192.0.2.3"].map(|from| waiting.enter(address(from)));
        assert_eq!(open(&crowd), [2, 3]);
        assert_eq!(open(&others), [0, 1]);
        assert!(!robot.closed.is_cancelled());
    }

    #[test]
    fn who_has_settled_is_left_alone_until_it_waits_again() {
        let waiting = Waiting::new(2, 2);
        let from = address("192.0.2.1");
        let slots = [waiting.enter(from), waiting.enter(from)];
        slots[0].settle();
        let newcomers = [waiting.enter(from), waiting.enter(from)];
        assert_eq!((open(&slots), open(&newcomers)), (vec![0], vec![0, 1]));
        slots[0].wait();
        assert_eq!((open(&slots), open(&newcomers)), (vec![0], vec![1]));
        // Closed is closed.
        newcomers[0].wait();
        assert_eq!(open(&newcomers), [1]);
    }

    #[test]
    fn whoever_shows_a_sign_of_life_is_not_the_oldest() {
        let waiting = Waiting::new(2, 2);
        let from = address("192.0.2.1");
        let slots = [waiting.enter(from), waiting.enter(from)];
        slots[0].wait();
        let _newcomer = waiting.enter(from);
        assert_eq!(open(&slots), [0]);
    }

    #[test]
    fn nothing_is_left_of_those_that_are_gone() {
        let waiting = Waiting::new(10, 5);
        let slots: Vec<_> = (0..20_u32)
            .map(|n| waiting.enter(std::net::Ipv4Addr::from_bits(n / 2).into()))
            .collect();
        assert_eq!(open(&slots).len(), 10);
        drop(slots);
        let inner = waiting.lock();
        assert!(inner.all.is_empty() && inner.of.is_empty());
        drop(inner);
        assert!(!waiting.close_oldest());
    }
}
