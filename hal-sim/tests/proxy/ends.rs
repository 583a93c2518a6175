//! How connections end, and who is on their other side.

use std::io::{ErrorKind, Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::channel;
use std::time::{Duration, Instant};

use crawler_sim::net::lockstep::LinkModel;
use crawler_sim::net::proxy::{Proxy, ProxyConfig, ProxyError};

use super::{QUICK, echo, exchange, hello, proxy, robot, server, setup};

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
        std::thread::sleep(Duration::from_millis(100));
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
    // Nobody listens there.
    let nowhere = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap();
    let through = proxy(nowhere, setup(QUICK, None));
    let mut stream = robot(&through, "r", false);
    assert!(stream.read_to_end(&mut rest).is_err());
}

#[test]
fn a_sender_whose_receiver_does_not_read_waits() {
    let (hold, held) = channel();
    let deaf = server(move |stream| hold.send(stream).unwrap());
    let proxy = proxy(deaf, setup(QUICK, None));
    let mut stream = robot(&proxy, "r", false);
    let _kept = held.recv().unwrap();
    stream
        .set_write_timeout(Some(Duration::from_millis(500)))
        .unwrap();
    let mut written = 0_usize;
    let block = vec![1; 65_536];
    while let Ok(len) = stream.write(&block) {
        written += len;
        assert!(written < 32 << 20, "{written} bytes and no end");
    }
    println!("{written} bytes until the sender had to wait");
    // The proxy keeps 64 KiB; the rest is in buffers of the operating system.
    proxy.stop(Duration::ZERO).unwrap();
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
    let (told, heard) = channel();
    let sink = server(move |mut stream| {
        let mut all = Vec::new();
        let _ = stream.read_to_end(&mut all);
        told.send(all).unwrap();
    });
    let taken = proxy(sink, setup(link, None));
    let address = taken.address();
    let mut stream = robot(&taken, "r", false);
    std::thread::sleep(Duration::from_millis(800));
    stream.write_all(b"goodbye").unwrap();
    drop(stream);
    let begun = Instant::now();
    taken.stop(Duration::from_secs(5)).unwrap();
    let took = begun.elapsed();
    assert!(took < Duration::from_secs(2), "{took:?}");
    let all = heard.recv_timeout(Duration::from_secs(1)).unwrap();
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
