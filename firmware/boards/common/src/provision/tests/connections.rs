//! Connections that drip, stall, break off or send noise.

use std::string::String;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::*;
use super::harness::{Board, GOOD, post};
use crate::settings::testing::settings;

const PAGE: &[u8] = b"GET / HTTP/1.1\r\nHost: 192.168.4.1\r\n\r\n";

/// Most seconds a connection can take, whoever is at the other end.
const LONGEST_S: f64 = 5.0 + 6.0 + 8.0;

#[test]
fn a_request_that_drips_is_cut_off() {
    let mut board = Board::new();
    let drops = PAGE.iter().enumerate();
    let script = drops.map(|(at, byte)| (at as u64 * 1_000_000, std::vec![*byte]));
    let mut peer = board.peer(script.collect()).stays();
    assert_eq!(board.converse(&mut peer), Outcome::Answered);
    assert!(peer.heard.starts_with(b"HTTP/1.1 408 "));
    assert!((4.9..5.1).contains(&board.clock.seconds()));
}

#[test]
fn a_body_that_does_not_come_is_not_waited_for() {
    let mut board = Board::new();
    let mut request = post(&GOOD);
    request.truncate(request.len() - 1);
    let mut peer = board.peer(std::vec![(0, request.clone())]).stays();
    assert_eq!(board.converse(&mut peer), Outcome::Answered);
    assert!(peer.heard.starts_with(b"HTTP/1.1 408 "));
    let mut peer = board.peer(std::vec![(0, request)]);
    assert_eq!(board.converse(&mut peer), Outcome::Abandoned);
    assert!(peer.heard.is_empty());
}

#[test]
fn a_connection_opened_in_advance_is_let_go_soon() {
    let mut board = Board::new();
    let mut peer = board.peer(Vec::new()).stays();
    assert_eq!(board.converse(&mut peer), Outcome::Abandoned);
    assert!(peer.heard.is_empty() && (1.9..2.1).contains(&board.clock.seconds()));
}

#[test]
fn a_peer_that_takes_nothing_is_let_go() {
    for takes in [0, 1, 150, 2_000] {
        let mut board = Board::new();
        let mut peer = board.peer(std::vec![(0, PAGE.to_vec())]).takes(takes);
        assert_eq!(board.converse(&mut peer), Outcome::Abandoned);
        assert!((7.9..8.1).contains(&board.clock.seconds()), "{takes}");
    }
}

#[test]
fn settings_are_saved_even_when_the_answer_is_not_heard() {
    let mut board = Board::new();
    let token = String::from(board.portal.token.as_str());
    let mut fields = std::vec![("token", token.as_str())];
    fields.extend_from_slice(&GOOD);
    let mut peer = board.peer(std::vec![(0, post(&fields))]).takes(0);
    assert!(matches!(board.converse(&mut peer), Outcome::Saved(_)));
    assert_eq!(board.kept().settings, Some(settings()));
}

#[test]
fn a_flash_that_fails_is_said_and_the_old_settings_stay() {
    let mut board = Board::told(settings());
    board.flash.power = Some(100);
    let (outcome, reply) = board.post(&super::harness::good_but(&[("id", "new")]));
    assert_eq!((outcome, reply.status), (Outcome::Answered, 500));
    assert!(reply.body.contains("could not store"));
    board.flash.power = None;
    assert_eq!(board.kept().settings, Some(settings()));
}

#[test]
fn a_scan_a_moment_ago_is_not_done_again() {
    let mut board = Board::new();
    let ask = b"GET /networks HTTP/1.1\r\nHost: 192.168.4.1\r\n\r\n";
    {
        let server = super::harness::TestServer::new(
            board.portal.clone(),
            crate::settings::Vault::new(&mut board.flash),
            &mut board.radio,
            board.clock.clone(),
        );
        let clock = board.clock.clone();
        let mut buffer = [0; BUFFER];
        for at in [0, 1, 2, 3, 6, 7] {
            // Waits for its moment before it speaks.
            let at = at * 1_000_000;
            clock.run(crawler_hal::Clock::sleep_until(
                &clock,
                crawler_hal::Instant::from_micros(at),
            ));
            let mut peer = super::harness::peer(&clock, std::vec![(at, ask.to_vec())]);
            let outcome = clock.run(server.converse(&mut peer, &mut buffer));
            assert_eq!(outcome, Outcome::Answered);
            assert!(peer.heard.starts_with(b"HTTP/1.1 200"));
        }
    }
    assert_eq!(board.radio.scans, 2);
}

proptest! {
    /// Noise, and requests with noise in them.
    #[test]
    fn whatever_arrives_ends_in_time_and_changes_nothing(
        mut bytes in prop_oneof![
            prop::collection::vec(any::<u8>(), 0..4_000),
            Just(post(&GOOD)),
            Just(PAGE.to_vec()),
        ],
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
        stays in any::<bool>(),
    ) {
        for (place, byte) in damage {
            if !bytes.is_empty() {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
        }
        let mut board = Board::told(settings());
        let mut peer = board.peer(std::vec![(0, bytes)]);
        if stays {
            peer = peer.stays();
        }
        let outcome = board.converse(&mut peer);
        prop_assert!(!matches!(outcome, Outcome::Saved(_)));
        prop_assert!(board.clock.seconds() <= LONGEST_S);
        prop_assert!(peer.heard.is_empty() || peer.heard.starts_with(b"HTTP/1.1 "));
        prop_assert_eq!(board.kept().settings, Some(settings()));
    }

    /// However the network cuts a request into pieces, the answer is the same.
    #[test]
    fn pieces_do_not_matter(cuts in prop::collection::btree_set(1_usize..400, 0..40), good in any::<bool>()) {
        let mut board = Board::new();
        let token = String::from(board.portal.token.as_str());
        let mut fields = std::vec![("token", token.as_str())];
        fields.extend_from_slice(if good { &GOOD } else { &GOOD[1..] });
        let request = post(&fields);
        let whole = board.ask(&request);
        let mut script = Vec::new();
        let mut from = 0;
        for (at, cut) in cuts.into_iter().chain([usize::MAX]).enumerate() {
            let cut = cut.min(request.len());
            if cut > from {
                script.push((at as u64 * 50_000, request[from..cut].to_vec()));
            }
            from = from.max(cut);
        }
        let mut board = Board::new();
        let mut peer = board.peer(script);
        let outcome = board.converse(&mut peer);
        prop_assert_eq!(outcome, whole.0);
        let heard = String::from_utf8(peer.heard).unwrap();
        prop_assert!(heard.ends_with(&whole.1.body) && heard.starts_with(&whole.1.head));
    }
}
