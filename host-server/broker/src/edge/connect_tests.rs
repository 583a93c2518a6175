use std::time::Duration;

use tokio::io::{AsyncWriteExt as _, duplex};

use super::*;

const TIMES: Times = Times {
    first_byte: Duration::from_secs(10),
    connect: Duration::from_secs(20),
    answer: Duration::from_secs(30),
};

/// A CONNECT of this protocol name and level with a client id.
fn connect(name: &[u8], level: u8, id: &[u8]) -> Vec<u8> {
    let mut body = vec![0, name.len() as u8];
    body.extend_from_slice(name);
    body.extend_from_slice(&[level, 2, 0, 60]);
    if level >= LEVEL_5 {
        body.push(0);
    }
    body.extend_from_slice(&(id.len() as u16).to_be_bytes());
    body.extend_from_slice(id);
    packet(&body)
}

fn packet(body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![CONNECT];
    let mut length = body.len();
    while length > 0x7f {
        bytes.push((length & 0x7f) as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    bytes.extend_from_slice(body);
    bytes
}

/// What comes of a client that says this and then waits.
async fn said(bytes: &[u8]) -> Result<Connect, NoConnect> {
    let (mut ours, mut theirs) = duplex(2 * LARGEST);
    theirs.write_all(bytes).await.expect("room");
    read(&mut ours, TIMES).await
}

const SILENT: NoConnect = NoConnect::refused(Refusal::Silent);
const MALFORMED: NoConnect = NoConnect::refused(Refusal::Malformed);

#[tokio::test(start_paused = true)]
async fn versions_that_are_spoken_are_taken_and_others_told() {
    let version = |answer| {
        Err(NoConnect::Refused {
            reason: Refusal::Version,
            answer,
        })
    };
    for (name, level, expected) in [
        (&b"MQIsdp"[..], 3, None),
        (b"MQTT", 4, None),
        (b"MQTT", 5, None),
        (b"MQTT", 0, Some(version(&[0x20, 2, 0, 1]))),
        (b"MQTT", 2, Some(version(&[0x20, 2, 0, 1]))),
        (b"MQTT", 3, Some(version(&[0x20, 2, 0, 1]))),
        (b"MQTT", 0x84, Some(version(&[0x20, 3, 0, 0x84, 0]))),
        (b"MQTT", 6, Some(version(&[0x20, 3, 0, 0x84, 0]))),
        (b"MQTT", 255, Some(version(&[0x20, 3, 0, 0x84, 0]))),
        (b"MQIsdp", 4, Some(version(&[0x20, 2, 0, 1]))),
        (b"MQTX", 5, Some(Err(MALFORMED))),
        (b"HTTP/1", 1, Some(Err(MALFORMED))),
    ] {
        let bytes = connect(name, level, b"robot");
        let expected = expected.unwrap_or(Ok(Connect {
            level,
            bytes: bytes.clone(),
        }));
        assert_eq!(said(&bytes).await, expected, "{name:?} level {level}");
    }
}

#[tokio::test(start_paused = true)]
async fn what_is_no_connect_is_refused_as_soon_as_that_shows() {
    for bytes in [
        &b"GET / HTTP/1.1\r\n"[..],
        b"\x16\x03\x01\x02\0",
        b"\xc0\0",
        b"\x11\x20\0\x04MQTT",
        b"\x10\xff\xff\xff\xff\x01",
        b"\x10\x02\0\x04",
        b"\x10\x20\0\x05",
        b"\x10\x20\0\x04MQX",
    ] {
        assert_eq!(said(bytes).await, Err(MALFORMED), "{bytes:?}");
    }
    let large = connect(b"MQTT", 5, &vec![b'a'; LARGEST]);
    let told = NoConnect::Refused {
        reason: Refusal::Malformed,
        answer: TOO_LARGE_5,
    };
    assert_eq!(said(&large).await, Err(told));
    let large = connect(b"MQTT", 4, &vec![b'a'; LARGEST]);
    assert_eq!(said(&large).await, Err(MALFORMED));
}

#[tokio::test(start_paused = true)]
async fn a_client_has_so_long_and_no_longer() {
    let begun = Instant::now();
    assert_eq!(said(b"").await, Err(SILENT));
    assert_eq!(begun.elapsed(), TIMES.first_byte);
    // Half a CONNECT, cut at every place.
    let whole = connect(b"MQTT", 5, b"robot");
    for length in 1..whole.len() {
        let begun = Instant::now();
        let half = whole.get(..length).expect("half");
        assert_eq!(said(half).await, Err(SILENT), "{length} bytes");
        assert_eq!(begun.elapsed(), TIMES.connect, "{length} bytes");
    }
    // A byte a second: a sign of life is no CONNECT.
    let whole = connect(b"MQTT", 5, b"a robot with a long name");
    let (mut ours, mut theirs) = duplex(64);
    let slow = async {
        for byte in &whole {
            tokio::time::sleep(Duration::from_secs(1)).await;
            if theirs.write_all(&[*byte]).await.is_err() {
                return;
            }
        }
    };
    let (read, ()) = tokio::join!(
        async {
            let read = read(&mut ours, TIMES).await;
            drop(ours);
            read
        },
        slow
    );
    assert_eq!(read, Err(SILENT));
}

#[tokio::test(start_paused = true)]
async fn who_goes_away_is_no_case() {
    for bytes in [&b""[..], b"\x10", b"\x10\x20\0\x04MQTT"] {
        let (mut ours, mut theirs) = duplex(64);
        theirs.write_all(bytes).await.expect("room");
        drop(theirs);
        assert_eq!(read(&mut ours, TIMES).await, Err(NoConnect::Gone));
    }
}

#[tokio::test(start_paused = true)]
async fn what_follows_a_connect_is_not_read() {
    let mut bytes = connect(b"MQTT", 5, &[b'x'; 3_000]);
    let length = bytes.len();
    bytes.extend_from_slice(b"\xc0\0");
    let connect = said(&bytes).await.expect("a CONNECT");
    assert_eq!(connect.bytes.len(), length);
}

#[tokio::test(start_paused = true)]
async fn a_will_that_expires_at_once_expires_after_a_second() {
    // Content type `\x02\0\0\0\0`, which is no expiry; then the expiry.
    let properties = |last| {
        let mut bytes = b"\x03\0\x05\x02\0\0\0\0\x02\0\0\0".to_vec();
        bytes.push(last);
        bytes
    };
    let connect = |flags, last| {
        let mut body = b"\0\x04MQTT\x05".to_vec();
        body.extend_from_slice(&[flags, 0, 60, 5, 0x11, 0, 0, 0, 0, 0, 2, b'i', b'd']);
        body.push(13);
        body.extend_from_slice(&properties(last));
        body.extend_from_slice(b"\0\x01t\0\x01m");
        packet(&body)
    };
    let taken = said(&connect(0x06, 0)).await.expect("a CONNECT");
    assert_eq!(taken.bytes, connect(0x06, 1));
    for (flags, last) in [(0x06, 9), (0x02, 0)] {
        let same = connect(flags, last);
        assert_eq!(said(&same).await.expect("a CONNECT").bytes, same);
    }
}
