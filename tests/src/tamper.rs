//! Somebody on the line.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Carries connections to a server, and changes what the server says from the moment it is told to.
#[derive(Debug)]
pub struct Tamper {
    port: u16,
    active: Arc<AtomicBool>,
}

impl Tamper {
    /// Listens at a port of loopback and carries to another.
    ///
    /// # Panics
    /// When there is no free port.
    pub fn start(to: u16) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = listener.local_addr().expect("its address").port();
        let active = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&active);
        // It ends with the process of the test.
        std::thread::spawn(move || {
            while let Ok((client, _)) = listener.accept() {
                let Ok(server) = TcpStream::connect(("127.0.0.1", to)) else {
                    continue;
                };
                let pair = client
                    .try_clone()
                    .and_then(|c| Ok((c, server.try_clone()?)));
                let Ok((client_too, server_too)) = pair else {
                    continue;
                };
                std::thread::spawn(move || carry(client_too, server_too, None));
                let seen = Arc::clone(&seen);
                std::thread::spawn(move || carry(server, client, Some(&seen)));
            }
        });
        Self { port, active }
    }

    /// Where it listens.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// From now on a bit of whatever the server says is another.
    pub fn begin(&self) {
        self.active.store(true, Ordering::SeqCst);
    }
}

fn carry(mut from: TcpStream, mut to: TcpStream, tamper: Option<&AtomicBool>) {
    let mut bytes = [0; 4_096];
    while let Ok(count @ 1..) = from.read(&mut bytes) {
        if tamper.is_some_and(|active| active.load(Ordering::SeqCst)) {
            // The last byte of what came is in the tag of a record.
            bytes[count - 1] ^= 1;
        }
        if to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    // The other direction finds out by itself.
    let _ = to.shutdown(Shutdown::Both);
    let _ = from.shutdown(Shutdown::Both);
}
