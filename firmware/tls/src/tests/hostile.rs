//! Servers that are broken, or mean it no good.

use std::boxed::Box;
use std::vec;
use std::vec::Vec;

use proptest::prelude::*;

use super::interop::Made;
use super::server::{Flight, Scripted};
use super::{Canned, HOST, TestRng, expected, record, talk};
use crate::name::Name;
use crate::record::{ALERT, CHANGE_CIPHER_SPEC, DATA, HANDSHAKE};
use crate::{Authority, Buffers, Connection, INPUT, Step, TlsError};

/// What comes of a handshake in which the server says this.
pub(super) fn said(
    script: impl FnMut(&mut Flight) -> Vec<u8> + 'static,
) -> Result<Vec<u8>, TlsError> {
    let root = Made::root();
    let mut peer = Scripted {
        root: &root,
        script: Some(Box::new(script)),
    };
    let expected = expected(root.pin());
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1))?;
    let heard = talk(&mut client, &expected, &mut peer, usize::MAX)?;
    // What has not led to an error either opened the connection or waits for more.
    if client.is_open() {
        Ok(heard)
    } else {
        Err(TlsError::Closed)
    }
}

/// The same after a good handshake.
pub(super) fn then(
    mut script: impl FnMut(&mut Flight) -> Vec<u8> + 'static,
) -> Result<Vec<u8>, TlsError> {
    said(move |flight| {
        let mut all = flight.clear_hello();
        all.extend(flight.sealed_rest());
        flight.open();
        all.extend(script(flight));
        all
    })
}

/// A `NewSessionTicket` with a ticket of that many bytes.
fn ticket(length: u16) -> Vec<u8> {
    let mut message = vec![4, 0];
    message.extend((length + 13).to_be_bytes());
    // Lifetime and addend, no nonce, the ticket, no extensions.
    message.extend([0; 9]);
    message.extend(length.to_be_bytes());
    message.extend((0..length).map(|_| 7));
    message.extend([0; 2]);
    message
}

#[test]
fn the_script_itself_is_understood() {
    let heard = then(|flight| {
        let mut all = flight.seal(DATA, b"hello ");
        all.extend(flight.seal(DATA, b""));
        all.extend(flight.seal(DATA, b"world"));
        all
    });
    assert_eq!(heard.unwrap(), b"hello world");
    // In pieces of any size, with what middleboxes want to see between them.
    for size in [1, 5, 100] {
        let heard = said(move |flight| {
            let hello = flight.hello();
            let mut all = Vec::new();
            for part in hello.chunks(size) {
                all.extend(record(HANDSHAKE, part));
            }
            all.extend(record(CHANGE_CIPHER_SPEC, &[1]));
            for part in flight.rest().chunks(size) {
                all.extend(flight.seal(HANDSHAKE, part));
            }
            flight.open();
            all.extend(flight.seal(DATA, b"hello"));
            all
        });
        assert_eq!(heard.unwrap(), b"hello", "{size}");
    }
}

#[test]
fn a_lie_in_the_handshake_ends_it() {
    let sealed = |make: fn(&mut Flight) -> Vec<u8>| {
        said(move |flight| {
            let mut all = flight.clear_hello();
            let rest = make(flight);
            all.extend(flight.seal(HANDSHAKE, &rest));
            all
        })
        .unwrap_err()
    };
    let wrong_signature = sealed(|flight| {
        let parts = [
            flight.encrypted(&[]),
            flight.certificate(),
            flight.verify(0x0403, true),
        ];
        parts.concat()
    });
    assert_eq!(wrong_signature, TlsError::Signature);
    let other_scheme = sealed(|flight| {
        let parts = [
            flight.encrypted(&[]),
            flight.certificate(),
            flight.verify(0x0804, false),
        ];
        parts.concat()
    });
    assert_eq!(other_scheme, TlsError::Algorithm);
    let wrong_finished = sealed(|flight| {
        let parts = [
            flight.encrypted(&[]),
            flight.certificate(),
            flight.verify(0x0403, false),
            flight.finished(true),
        ];
        parts.concat()
    });
    assert_eq!(wrong_finished, TlsError::Finished);
    // Leaving out who it is, or the proof of it.
    let nobody = sealed(|flight| [flight.encrypted(&[]), flight.finished(false)].concat());
    assert_eq!(nobody, TlsError::Unexpected);
    let unproven = sealed(|flight| {
        let parts = [
            flight.encrypted(&[]),
            flight.certificate(),
            flight.finished(false),
        ];
        parts.concat()
    });
    assert_eq!(unproven, TlsError::Unexpected);
    let reordered = sealed(|flight| [flight.certificate(), flight.encrypted(&[])].concat());
    assert_eq!(reordered, TlsError::Unexpected);
    let twice = sealed(|flight| [flight.encrypted(&[]), flight.encrypted(&[])].concat());
    assert_eq!(twice, TlsError::Unexpected);
    let behind = sealed(|flight| [flight.rest(), vec![4, 0, 0, 0]].concat());
    assert_eq!(behind, TlsError::Unexpected, "keys change there");
    // Extensions that were not asked for, that come twice, or make no sense.
    for list in [
        &[(16_u16, &b"\0\x05\x04mqtt"[..])][..],
        &[(1, &[4][..])],
        &[(28, &[0, 63][..])],
        &[(0, &[][..]), (0, &[][..])],
        &[(0, &[1][..])],
    ] {
        let list: Vec<(u16, Vec<u8>)> = list.iter().map(|(n, c)| (*n, c.to_vec())).collect();
        let result = said(move |flight| {
            let mut all = flight.clear_hello();
            let list: Vec<(u16, &[u8])> = list.iter().map(|(n, c)| (*n, &c[..])).collect();
            let message = flight.encrypted(&list);
            all.extend(flight.seal(HANDSHAKE, &message));
            all
        });
        let refused = matches!(
            result,
            Err(TlsError::Choice | TlsError::Extension | TlsError::Malformed)
        );
        assert!(refused, "{result:?}");
    }
}

#[test]
fn a_hello_must_be_of_what_was_offered() {
    const RETRY: [u8; 32] = [
        0xCF, 0x21, 0xAD, 0x74, 0xE5, 0x9A, 0x61, 0x11, 0xBE, 0x1D, 0x8C, 0x02, 0x1E, 0x65, 0xB8,
        0x91, 0xC2, 0xA2, 0x11, 0x16, 0x7A, 0xBB, 0x8C, 0x5E, 0x07, 0x9E, 0x09, 0xE2, 0xC8, 0xA8,
        0x33, 0x9C,
    ];
    const V13: (u16, &[u8]) = (43, &[3, 4]);
    let hello = |random, suite, list: &'static [(u16, &'static [u8])]| {
        said(move |flight| record(HANDSHAKE, &flight.hello_with(random, suite, list))).unwrap_err()
    };
    let infinity: &'static [u8] = {
        const POINT: [u8; 69] = {
            let mut point = [0; 69];
            (point[1], point[3], point[4]) = (23, 65, 4);
            point
        };
        &POINT
    };
    assert_eq!(
        hello([9; 32], 0x1303, &[V13]),
        TlsError::Closed,
        "the good one"
    );
    assert_eq!(hello([9; 32], 0x1301, &[V13]), TlsError::Choice);
    assert_eq!(hello(RETRY, 0x1303, &[V13]), TlsError::Choice);
    assert_eq!(
        hello(RETRY, 0x1303, &[V13, (51, &[0, 29])]),
        TlsError::Choice
    );
    // Downgrades: no version, another, and the mark of a server that knows better.
    assert_eq!(hello([9; 32], 0xC02B, &[]), TlsError::Version);
    assert_eq!(hello([9; 32], 0x1303, &[(43, &[3, 3])]), TlsError::Version);
    assert_eq!(
        hello(*b"012345678901234567890123DOWNGRD\x01", 0xC02B, &[]),
        TlsError::Version
    );
    assert_eq!(hello([9; 32], 0x1303, &[V13, V13]), TlsError::Malformed);
    assert_eq!(
        hello([9; 32], 0x1303, &[(41, &[0, 0]), V13]),
        TlsError::Extension,
        "no secret was shared"
    );
    assert_eq!(
        hello([9; 32], 0x1303, &[V13, (51, &[0, 29, 0, 1, 1])]),
        TlsError::Choice
    );
    let off = said(move |flight| {
        record(
            HANDSHAKE,
            &flight.hello_with([9; 32], 0x1303, &[V13, (51, infinity)]),
        )
    });
    assert_eq!(off, Err(TlsError::Choice), "not on the curve");
}

#[test]
fn records_have_their_place() {
    let refused = |script: fn(&mut Flight) -> Vec<u8>| said(script).unwrap_err();
    assert_eq!(
        refused(|_| b"HTTP/1.1 400 Bad Request\r\n".to_vec()),
        TlsError::Unexpected
    );
    assert_eq!(refused(|_| record(DATA, b"hello")), TlsError::Unexpected);
    assert_eq!(refused(|_| record(HANDSHAKE, b"")), TlsError::Unexpected);
    assert_eq!(
        refused(|_| record(CHANGE_CIPHER_SPEC, &[1])),
        TlsError::Unexpected
    );
    assert_eq!(refused(|_| record(ALERT, &[2, 40])), TlsError::Alert(40));
    assert_eq!(refused(|_| record(ALERT, &[2])), TlsError::Unexpected);
    assert_eq!(refused(|_| record(ALERT, &[1, 0])), TlsError::Alert(0));
    assert_eq!(refused(|_| vec![22, 3, 3, 0xFF, 0xFF]), TlsError::TooBig);
    assert_eq!(
        refused(|_| record(HANDSHAKE, &[2, 0xFF, 0xFF, 0xFF])),
        TlsError::TooBig
    );
    assert_eq!(
        refused(|_| record(HANDSHAKE, &[2, 0, 0x20, 0])),
        TlsError::TooBig
    );
    let after = |script: fn(&mut Flight) -> Vec<u8>| {
        said(move |flight| {
            let mut all = flight.clear_hello();
            all.extend(script(flight));
            all
        })
        .unwrap_err()
    };
    assert_eq!(
        after(|flight| record(HANDSHAKE, &flight.rest())),
        TlsError::Unexpected
    );
    assert_eq!(
        after(|flight| flight.seal(DATA, b"hello")),
        TlsError::Unexpected
    );
    assert_eq!(
        after(|flight| flight.seal(ALERT, &[1, 0])),
        TlsError::Closed
    );
    assert_eq!(
        after(|flight| flight.seal(0, b"")),
        TlsError::Unexpected,
        "zeros alone"
    );
    assert_eq!(after(|_| record(DATA, &[0; 16])), TlsError::BadRecord);
    assert_eq!(after(|_| record(DATA, &[0; 3])), TlsError::BadRecord);
    assert_eq!(
        after(|_| record(CHANGE_CIPHER_SPEC, &[1]).repeat(40)),
        TlsError::Flood
    );
    assert_eq!(
        after(|_| record(CHANGE_CIPHER_SPEC, &[2])),
        TlsError::Unexpected
    );
    let between = after(|flight| {
        let message = flight.encrypted(&[]);
        [
            flight.seal(HANDSHAKE, &message[..3]),
            flight.seal(ALERT, &[1, 90]),
        ]
        .concat()
    });
    assert_eq!(between, TlsError::Unexpected);
    let in_hello = said(|flight| {
        let mut hello = flight.hello();
        hello.push(8);
        record(HANDSHAKE, &hello)
    });
    assert_eq!(in_hello, Err(TlsError::Unexpected), "keys change there");
}

#[test]
fn an_open_connection_takes_what_it_should() {
    let refused = |script: fn(&mut Flight) -> Vec<u8>| then(script).unwrap_err();
    assert_eq!(
        then(|flight| flight.seal(HANDSHAKE, &ticket(1))),
        Ok(vec![])
    );
    assert_eq!(
        refused(|flight| flight.seal(HANDSHAKE, &[1, 0, 0, 0])),
        TlsError::Unexpected
    );
    assert_eq!(
        refused(|flight| flight.seal(HANDSHAKE, &[24, 0, 0, 1, 2])),
        TlsError::Malformed
    );
    let update = [24, 0, 0, 1, 0];
    let mixed = then(move |flight| flight.seal(HANDSHAKE, &[update, update].concat()));
    assert_eq!(mixed, Err(TlsError::Unexpected));
    let idle = |flight: &mut Flight| (0..40).flat_map(|_| flight.seal(DATA, b"")).collect();
    assert_eq!(refused(idle), TlsError::Flood);
    assert_eq!(
        refused(|_| record(CHANGE_CIPHER_SPEC, &[1])),
        TlsError::Unexpected
    );
    assert_eq!(
        refused(|flight| flight.seal(ALERT, &[2, 80])),
        TlsError::Alert(80)
    );
    let replayed = then(|flight| flight.seal(DATA, b"stop").repeat(2));
    assert_eq!(replayed, Err(TlsError::BadRecord));
    let inside = then(|flight| [flight.seal(HANDSHAKE, &[4, 0]), flight.seal(DATA, b"x")].concat());
    assert_eq!(inside, Err(TlsError::Unexpected));
    // As big as fits, and one more.
    let most = INPUT - 22;
    let heard = then(move |flight| flight.seal(DATA, &vec![7; most]));
    assert_eq!(heard.unwrap().len(), most);
    let more = then(move |flight| flight.seal(DATA, &vec![7; most + 1]));
    assert_eq!(more, Err(TlsError::TooBig));
    let bye = then(|flight| [flight.seal(ALERT, &[1, 0]), record(DATA, b"late")].concat());
    assert_eq!(bye, Ok(vec![]));
}

#[test]
fn a_message_may_lie_anywhere_in_the_records() {
    // The certificate ends in a record as big as they come, behind which there is little room.
    let heard = said(|flight| {
        let mut all = flight.clear_hello();
        let rest = flight.rest();
        let (first, second) = rest.split_at(7);
        all.extend(flight.seal(HANDSHAKE, first));
        all.extend(flight.seal(HANDSHAKE, second));
        flight.open();
        // A ticket that is nearly too long, behind one that is short.
        let tickets = [ticket(1), ticket(0x0EF3)].concat();
        for part in tickets.chunks(2_000) {
            all.extend(flight.seal(HANDSHAKE, part));
        }
        all.extend(flight.seal(DATA, b"hello"));
        all
    });
    assert_eq!(heard.unwrap(), b"hello");
}

#[test]
fn the_end_comes_once() {
    let root = Made::root();
    let expected = expected(root.pin());
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1)).unwrap();
    let mut peer = Canned(record(ALERT, &[2, 40]));
    let result = talk(&mut client, &expected, &mut peer, 1);
    assert_eq!(result, Err(TlsError::Alert(40)));
    assert_eq!(client.pending(), [0_u8; 0], "nobody is there to be told");
    assert_eq!(client.shake(&expected), Ok(Step::Ended));
    assert_eq!(client.plaintext(), [0_u8; 0]);
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1)).unwrap();
    let result = talk(&mut client, &expected, &mut Canned(record(DATA, b"")), 1);
    assert_eq!(result, Err(TlsError::Unexpected));
    assert_eq!(client.pending(), record(ALERT, &[2, 10]));
}

proptest! {
    #[test]
    fn no_server_makes_it_panic(
        records in prop::collection::vec((20_u8..24, prop::collection::vec(any::<u8>(), 0..200)), 0..6),
        rest in prop::collection::vec(any::<u8>(), 0..50),
    ) {
        let mut wire: Vec<u8> = records.iter().flat_map(|(kind, body)| record(*kind, body)).collect();
        wire.extend(rest);
        let authority = Authority::new([2; 33]).or_else(|_| Authority::new([3; 33]));
        let authority = authority.unwrap_or_else(|_| Made::root().pin());
        let expected = expected(authority);
        let mut buffers = Buffers::new();
        let mut client = Connection::start(&mut buffers, &expected, &mut TestRng(1)).unwrap();
        let result = talk(&mut client, &expected, &mut Canned(wire), usize::MAX);
        prop_assert!(!client.is_open(), "nobody has proved anything");
        prop_assert_eq!(client.plaintext(), [0_u8; 0]);
        match result {
            Ok(heard) => {
                prop_assert_eq!(heard, [0_u8; 0], "from whom?");
                prop_assert_eq!(client.pending(), [0_u8; 0], "it waits, and has nothing to say");
                prop_assert_eq!(client.shake(&expected), Ok(Step::Hungry));
            }
            Err(error) => {
                // The server is told what was wrong, and that was the end.
                let alert = error.alert().map(|code| record(ALERT, &[2, code]));
                prop_assert_eq!(client.pending(), alert.unwrap_or_default());
                prop_assert_eq!(client.shake(&expected), Ok(Step::Ended));
            }
        }
    }

    #[test]
    fn no_hello_makes_it_panic(body in prop::collection::vec(any::<u8>(), 0..200)) {
        for host in [HOST, "10.0.2.2"] {
            let name = Name::new(host).expect("legal");
            let _ = crate::hello::read(&body, name);
            let _ = crate::hello::read_encrypted(&body, name);
        }
    }
}
