//! Addresses and names on the board's own access point.

use core::net::Ipv4Addr;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::vec::Vec;

use edge_dhcp::{DhcpOption, MessageType, Options, Packet};
use proptest::prelude::*;

use super::super::access_point::{ADDRESS, DATAGRAM, LEASES, Lender, answer_name};

/// A client's request.
fn request(mac: u8, options: &[DhcpOption<'_>], from: Ipv4Addr) -> Vec<u8> {
    let mut buffer = [0; DATAGRAM];
    let packet = Packet::new_request(
        [2, 0, 0, 0, 0, mac],
        77,
        0,
        Some(from),
        true,
        Options::new(options),
    );
    packet.encode(&mut buffer).unwrap().to_vec()
}

fn discover(mac: u8) -> Vec<u8> {
    request(
        mac,
        &[DhcpOption::MessageType(MessageType::Discover)],
        Ipv4Addr::UNSPECIFIED,
    )
}

fn ask_for(mac: u8, address: Ipv4Addr) -> Vec<u8> {
    let options = [
        DhcpOption::MessageType(MessageType::Request),
        DhcpOption::RequestedIpAddress(address),
    ];
    request(mac, &options, Ipv4Addr::UNSPECIFIED)
}

/// What a lender answers: kind, address, and to whom it is said.
fn told<F: FnMut() -> u64>(
    lender: &mut Lender<F>,
    request: &[u8],
) -> Option<(MessageType, Ipv4Addr, Ipv4Addr)> {
    let mut out = [0; DATAGRAM];
    let (answer, to) = lender.answer(request, &mut out)?;
    let answer = Packet::decode(answer).unwrap();
    assert!(answer.reply && answer.xid == 77);
    let kind = answer.options.iter().find_map(|option| match option {
        DhcpOption::MessageType(kind) => Some(kind),
        _ => None,
    });
    Some((kind.unwrap(), answer.yiaddr, to))
}

#[test]
fn a_guest_gets_an_address_and_keeps_it() {
    let mut lender = Lender::new(|| 0);
    let (kind, offered, to) = told(&mut lender, &discover(1)).unwrap();
    assert_eq!((kind, to), (MessageType::Offer, Ipv4Addr::BROADCAST));
    assert_eq!(offered.octets()[..3], ADDRESS.octets()[..3]);
    let answer = told(&mut lender, &ask_for(1, offered)).unwrap();
    assert_eq!((answer.0, answer.1), (MessageType::Ack, offered));
    assert_eq!(told(&mut lender, &discover(1)).unwrap().1, offered);
    // Another guest does not get the same one, nor one of elsewhere.
    assert_ne!(told(&mut lender, &discover(2)).unwrap().1, offered);
    assert_eq!(
        told(&mut lender, &ask_for(2, offered)).unwrap().0,
        MessageType::Nak
    );
    let elsewhere = Ipv4Addr::new(10, 0, 0, 7);
    assert_eq!(
        told(&mut lender, &ask_for(2, elsewhere)).unwrap().0,
        MessageType::Nak
    );
}

#[test]
fn guests_are_bounded_and_places_become_free_again() {
    let now = Cell::new(0);
    let mut lender = Lender::new(|| now.get());
    let mut seen = BTreeMap::new();
    for mac in 0..LEASES as u8 {
        let (_, offered, _) = told(&mut lender, &discover(mac)).unwrap();
        assert_eq!(
            told(&mut lender, &ask_for(mac, offered)).unwrap().0,
            MessageType::Ack
        );
        assert_eq!(seen.insert(offered, mac), None, "{offered} twice");
    }
    for mac in 100..=255 {
        assert_eq!(told(&mut lender, &discover(mac)), None);
    }
    assert_eq!(lender.lent(), LEASES);
    now.set(601);
    let (_, offered, _) = told(&mut lender, &discover(100)).unwrap();
    assert_eq!(
        told(&mut lender, &ask_for(100, offered)).unwrap().0,
        MessageType::Ack
    );
    assert!(lender.lent() <= LEASES);
}

/// A query for `name`, of a type, in the class of the internet.
fn query(name: &[&str], kind: u16) -> Vec<u8> {
    let mut bytes = std::vec![0x12, 0x34, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0];
    for label in name {
        bytes.push(label.len() as u8);
        bytes.extend_from_slice(label.as_bytes());
    }
    bytes.push(0);
    bytes.extend_from_slice(&kind.to_be_bytes());
    bytes.extend_from_slice(&[0, 1]);
    bytes
}

fn answered(query: &[u8]) -> Option<Vec<u8>> {
    let mut out = [0; DATAGRAM];
    answer_name(query, ADDRESS, &mut out).map(|length| out[..length].to_vec())
}

#[test]
fn every_name_is_here() {
    let asked = query(&["captive", "apple", "com"], 1);
    let answer = answered(&asked).unwrap();
    assert_eq!(answer[..12], [0x12, 0x34, 0x85, 0, 0, 1, 0, 1, 0, 0, 0, 0]);
    assert_eq!(answer[12..asked.len()], asked[12..]);
    assert_eq!(
        answer[asked.len()..],
        [0xC0, 12, 0, 1, 0, 1, 0, 0, 0, 5, 0, 4, 192, 168, 4, 1]
    );
    // No other kind of address.
    let answer = answered(&query(&["example", "com"], 28)).unwrap();
    assert_eq!(answer[2..8], [0x85, 0, 0, 1, 0, 0]);
    // What follows the question, such as EDNS, does not matter.
    let mut extended = asked.clone();
    extended[11] = 1;
    extended.extend_from_slice(&[0, 0, 41, 4, 0, 0, 0, 0, 0, 0, 0]);
    assert_eq!(answered(&extended).unwrap().len(), asked.len() + 16);
}

#[test]
fn other_messages_are_refused_or_left_unanswered() {
    let asked = query(&["a"], 1);
    assert_eq!(answered(&asked[..11]), None);
    let mut answer = asked.clone();
    answer[2] |= 0x80;
    assert_eq!(answered(&answer), None, "two of us would talk for ever");
    let code = |query: &[u8]| answered(query).unwrap()[3] & 15;
    let mut status = asked.clone();
    status[2] |= 0x10;
    assert_eq!(code(&status), 4);
    assert_eq!(code(&asked[..asked.len() - 1]), 1);
    let mut none = asked.clone();
    none[5] = 0;
    assert_eq!(code(&none), 1);
    let mut pointer = asked;
    pointer[12] = 0xC0;
    assert_eq!(code(&pointer), 1);
    let long = [
        "a".repeat(63),
        "b".repeat(63),
        "c".repeat(63),
        "d".repeat(63),
        "e".repeat(9),
    ];
    let long: Vec<&str> = long.iter().map(|label| &**label).collect();
    assert_eq!(code(&query(&long, 1)), 1);
}

proptest! {
    #[test]
    fn noise_is_survived(
        bytes in prop::collection::vec(any::<u8>(), 0..DATAGRAM),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..5),
    ) {
        let _ = answered(&bytes);
        let mut lender = Lender::new(|| 0);
        let mut out = [0; DATAGRAM];
        let _ = lender.answer(&bytes, &mut out);
        for whole in [discover(3), query(&["example", "com"], 1)] {
            let mut damaged = whole;
            for (place, byte) in &damage {
                let place = place.index(damaged.len());
                damaged[place] = *byte;
            }
            let _ = answered(&damaged);
            let _ = lender.answer(&damaged, &mut out);
            // Longer options than there are.
            damaged.truncate(damaged.len() - 1);
            let _ = lender.answer(&damaged, &mut out);
        }
    }

    /// Whoever asks for whatever: no address has two guests, and there are never more than places.
    #[test]
    fn no_address_has_two_guests(
        steps in prop::collection::vec((any::<u8>(), 0_u8..24, 0_u64..300, any::<bool>()), 0..80),
    ) {
        let now = Cell::new(0);
        let mut lender = Lender::new(|| now.get());
        let mut guests: BTreeMap<Ipv4Addr, (u8, u64)> = BTreeMap::new();
        for (mac, last, seconds, asks) in steps {
            now.set(now.get() + seconds);
            let [a, b, c, _] = ADDRESS.octets();
            let wanted = Ipv4Addr::new(a, b, c, last);
            let asked = if asks { ask_for(mac, wanted) } else { discover(mac) };
            if let Some((MessageType::Ack, address, _)) = told(&mut lender, &asked) {
                prop_assert!(address != ADDRESS);
                if let Some((guest, until)) = guests.get(&address) {
                    prop_assert!(*guest == mac || *until < now.get());
                }
                guests.retain(|_, (guest, _)| *guest != mac);
                guests.insert(address, (mac, now.get() + 600));
            }
            prop_assert!(lender.lent() <= LEASES);
        }
    }
}
