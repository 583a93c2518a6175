//! A reader of the live feed that comes back by itself, as the control room does.

use std::io::{self, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use serde_json::Value;

/// The kind of frame that says how many robots there are.
const METRICS: u8 = 4;
/// Larger frames the feed does not send.
const MOST: u64 = 16 * 1024 * 1024;

/// What the reader has seen.
#[derive(Default)]
pub(crate) struct Seen {
    /// Times it was connected.
    pub(crate) connections: AtomicU64,
    /// Robots that were online in the newest frame that says so; none while not connected.
    pub(crate) online: AtomicUsize,
    stop: AtomicBool,
}

/// Reads for as long as it is there.
pub(crate) struct Reader {
    pub(crate) seen: Arc<Seen>,
    task: Option<JoinHandle<()>>,
}

impl Reader {
    pub(crate) fn start(port: u16) -> Self {
        let seen = Arc::new(Seen::default());
        let here = Arc::clone(&seen);
        let task = thread::spawn(move || {
            while !here.stop.load(Ordering::Relaxed) {
                // Lost, or refused: again.
                let _ = read(port, &here);
                here.online.store(0, Ordering::Relaxed);
                thread::sleep(Duration::from_millis(200));
            }
        });
        Self {
            seen,
            task: Some(task),
        }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.seen.stop.store(true, Ordering::Relaxed);
        if let Some(task) = self.task.take() {
            let _ = task.join();
        }
    }
}

fn read(port: u16, seen: &Seen) -> io::Result<()> {
    let mut stream = TcpStream::connect(("127.0.0.1", port))?;
    stream.set_read_timeout(Some(Duration::from_mins(1)))?;
    // RFC 6455, with the key of its example.
    write!(
        stream,
        "GET /api/v1/live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n\
         Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )?;
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte)?;
        head.push(byte[0]);
    }
    if !head.starts_with(b"HTTP/1.1 101") {
        return Err(io::Error::other("no WebSocket"));
    }
    seen.connections.fetch_add(1, Ordering::Relaxed);
    while !seen.stop.load(Ordering::Relaxed) {
        let mut start = [0; 2];
        stream.read_exact(&mut start)?;
        let length = match start[1] & 0x7F {
            126 => {
                let mut length = [0; 2];
                stream.read_exact(&mut length)?;
                u64::from(u16::from_be_bytes(length))
            }
            127 => {
                let mut length = [0; 8];
                stream.read_exact(&mut length)?;
                u64::from_be_bytes(length)
            }
            short => u64::from(short),
        };
        assert!(length <= MOST, "a frame of {length} bytes");
        let mut frame = vec![0; length as usize];
        stream.read_exact(&mut frame)?;
        if let [METRICS, json @ ..] = &frame[..] {
            let metrics: Value = serde_json::from_slice(json).expect("metrics");
            let online = metrics["robots"]["online"].as_u64().expect("a number");
            seen.online.store(online as usize, Ordering::Relaxed);
        }
    }
    Ok(())
}
