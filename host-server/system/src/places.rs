//! A bounded number of places, and of those a bounded number for each address.
//!
//! One machine that takes all it can get does not keep out the others.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

use crate::neighbourhood;

/// The places there are.
#[derive(Debug)]
pub struct Places {
    most: usize,
    most_of_one: usize,
    taken: Mutex<HashMap<IpAddr, usize>>,
}

impl Places {
    /// `most` places, of which one address may have `most_of_one`.
    pub fn new(most: usize, most_of_one: usize) -> Arc<Self> {
        Arc::new(Self {
            most,
            most_of_one,
            taken: Mutex::default(),
        })
    }

    /// A place for somebody from this address; `None` when there is none left.
    pub fn take(self: &Arc<Self>, from: IpAddr) -> Option<Place> {
        let of = neighbourhood(from);
        let mut taken = self.taken.lock().unwrap_or_else(PoisonError::into_inner);
        // The number of addresses is at most that of places.
        if taken.values().sum::<usize>() >= self.most {
            return None;
        }
        let places = taken.entry(of).or_default();
        if *places >= self.most_of_one {
            return None;
        }
        *places += 1;
        drop(taken);
        Some(Place {
            places: Arc::clone(self),
            of,
        })
    }
}

/// A place, until it is dropped.
#[derive(Debug)]
pub struct Place {
    places: Arc<Places>,
    of: IpAddr,
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut taken = self
            .places
            .taken
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        if let Some(places) = taken.get_mut(&self.of) {
            *places -= 1;
            if *places == 0 {
                taken.remove(&self.of);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_does_not_take_everything() {
        let all = Places::new(100, 10);
        let hostile: IpAddr = "2001:db8::1".parse().expect("address");
        let neighbour: IpAddr = "2001:db8::2".parse().expect("address");
        let other: IpAddr = "192.0.2.1".parse().expect("address");
        let mut places: Vec<_> = (0..10).map(|_| all.take(hostile).expect("room")).collect();
        assert!(all.take(hostile).is_none());
        assert!(all.take(neighbour).is_none());
        places.push(all.take(other).expect("room for others"));
        places.remove(0);
        assert!(all.take(neighbour).is_some());
        drop(places);
        assert!(all.taken.lock().expect("whole").is_empty());
    }

    #[test]
    fn there_is_an_end() {
        let all = Places::new(100, 10);
        let places: Vec<_> = (0..100_u32)
            .map(|number| {
                let from = std::net::Ipv4Addr::from_bits(number);
                all.take(from.into()).expect("room")
            })
            .collect();
        let late = "192.0.2.1".parse().expect("address");
        assert!(all.take(late).is_none());
        drop(places);
        assert!(all.take(late).is_some());
    }
}
