//! How connections end, and who is on their other side.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::time::Instant;

use crawler_sim::net::lockstep::LinkModel;
use crawler_sim::net::proxy::{Proxy, ProxyConfig, ProxyError};

use super::{LIMIT, QUICK, echo, exchange, hello, proxy, robot, server, setup};
use crate::common::port::refusing;

#[test]
fn ends_and_resets_reach_the_other_side() {
    // A half-closed connection still hears the answer.
    let polite = server(|mut stream| {
        let mut all = Vec::new();
        stream.read_to_end(&mut all).unwrap();
        stream.write_all(&(all.len() as u32).to_be_bytes()).unwrap();
    });
    let through = proxy(polite, setup(QUICK, None));
    let mut stream = robot(&through, "r", false);
    stream.write_all(&[5; 10_000]).unwrap();
    stream.shutdown(Shutdown::Write).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let all = 10_000 + hello("r").len() as u32;
    assert_eq!(answer, all.to_be_bytes());
    // A server that drops the connection with something unread resets it.
    let rude = server(|stream| {
        assert_eq!(stream.peek(&mut [0]).unwrap(), 1);
        drop(stream);
    });
    let through = proxy(rude, setup(QUICK, None));
    let mut stream = robot(&through, "r", false);
    let mut rest = Vec::new();
    let ended = stream.read_to_end(&mut rest);
    assert!(
        matches!(&ended, Err(error) if error.kind() == ErrorKind::ConnectionReset),
        "{ended:?}"
    );
    // Nobody listens there, and nobody else can.
    let (_kept, nowhere) = refusing();
    let through = proxy(nowhere, setup(QUICK, None));
    let mut stream = robot(&through, "r", false);
    assert!(stream.read_to_end(&mut rest).is_err());
}

#[test]
fn a_sender_whose_receiver_does_not_read_waits() {
    let (hold, held) = channel();
    // Who says `deaf` is not heard; to the others it answers.
    let server = server(move |stream| {
        let mut said = [0; 64];
        let name = hello("deaf");
        loop {
            let len = stream.peek(&mut said).unwrap();
            if said[..len].starts_with(&name) {
                return hold.send(stream).unwrap();
            }
            if len == 0 || !name.starts_with(&said[..len]) {
                return echo(stream);
            }
        }
    });
    let proxy = proxy(server, setup(QUICK, None));
    let mut stream = robot(&proxy, "deaf", false);
    let mut receiver = held.recv_timeout(LIMIT).unwrap();
    let other = robot(&proxy, "other", true);
    stream.set_nonblocking(true).unwrap();
    let block: Vec<u8> = (0..65_536_u32).map(|n| (n % 251) as u8).collect();
    let mut written = Vec::new();
    // The proxy keeps 64 KiB; the rest is in buffers of the operating system. It is over when
    // nothing more is taken while others are served for a while.
    let mut refused = 0;
    while refused < 20 {
        match stream.write(&block) {
            Ok(len) => {
                written.extend_from_slice(&block[..len]);
                refused = 0;
                assert!(written.len() < 32 << 20, "{} and no end", written.len());
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                refused += 1;
                for _ in 0..10 {
                    assert_eq!(exchange(&other, b"marker", 6), b"marker");
                }
            }
            Err(error) => panic!("{error}"),
        }
    }
    println!("{} bytes until the sender had to wait", written.len());
    // All of it arrives when the receiver reads after all.
    drop(stream);
    let mut all = Vec::new();
    receiver.set_read_timeout(Some(LIMIT)).unwrap();
    receiver.read_to_end(&mut all).unwrap();
    let name = hello("deaf");
    assert!(all.starts_with(&name));
    assert!(all[name.len()..] == written, "{} bytes", all.len());
}

#[test]
fn what_is_no_mqtt_is_carried_too_and_garbage_harms_nobody() {
    let proxy = proxy(server(echo), setup(QUICK, None));
    let good = robot(&proxy, "r", true);
    for bytes in [
        b"GET / HTTP/1.1\r\n\r\n".to_vec(),
        vec![0; 5_000],
        b"\x10\xFF\xFF\xFF\xFF\xFF".to_vec(),
    ] {
        let stream = TcpStream::connect(proxy.address()).unwrap();
        assert_eq!(exchange(&stream, &bytes, 1_000), bytes);
    }
    // Half a greeting, and gone.
    drop(
        TcpStream::connect(proxy.address())
            .unwrap()
            .write(&[0x10, 40, 0]),
    );
    assert_eq!(exchange(&good, b"still", 5), b"still");
    assert_eq!(proxy.metrics().stations, 2, "a name and an address");
}

#[test]
fn what_is_under_way_arrives_before_the_end() {
    let link = LinkModel {
        latency_ms: 200.0,
        ..QUICK
    };
    let (tell, told) = channel();
    let sink = server(move |mut stream| {
        let mut all = vec![0; hello("r").len()];
        stream.read_exact(&mut all).unwrap();
        tell.send(all.clone()).unwrap();
        let _ = stream.read_to_end(&mut all);
        tell.send(all).unwrap();
    });
    let taken = proxy(sink, setup(link, None));
    let address = taken.address();
    let mut stream = robot(&taken, "r", false);
    assert_eq!(told.recv_timeout(LIMIT).unwrap(), hello("r"));
    stream.write_all(b"goodbye").unwrap();
    drop(stream);
    let begun = Instant::now();
    taken.stop(5 * LIMIT).unwrap();
    let took = begun.elapsed();
    assert!(took < LIMIT, "nothing is left to wait for: {took:?}");
    let all = told.recv_timeout(LIMIT).unwrap();
    assert!(all.ends_with(b"goodbye"));
    assert!(TcpStream::connect(address).is_err());
}

#[test]
fn an_address_that_is_taken_is_named() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let error = Proxy::start(&ProxyConfig {
        listen: taken.local_addr().unwrap(),
        broker: Vec::new(),
        setup: setup(QUICK, None),
        most_connections: 1,
    })
    .unwrap_err();
    assert!(matches!(error, ProxyError::Listen(..)));
    let port = taken.local_addr().unwrap().port().to_string();
    assert!(error.to_string().contains(&port), "{error}");
}
