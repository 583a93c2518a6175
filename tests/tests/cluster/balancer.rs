//! One address for several servers: what a load balancer is, without its manners.

use std::io;
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Listens on a port of loopback for as long as the test runs.
pub(crate) struct LoadBalancer {
    port: u16,
}

impl LoadBalancer {
    /// Hands every connection to the next of `servers`, by port, that takes one.
    pub(crate) fn open(servers: Vec<u16>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let port = listener.local_addr().expect("a port").port();
        let next = Arc::new(AtomicUsize::new(0));
        thread::spawn(move || {
            for client in listener.incoming().flatten() {
                let start = next.fetch_add(1, Ordering::Relaxed);
                let mut turn = (0..servers.len()).map(|at| servers[(start + at) % servers.len()]);
                let server = turn.find_map(|port| TcpStream::connect(("127.0.0.1", port)).ok());
                if let Some(server) = server {
                    // A client that is gone is none of ours.
                    let _ = carry(client, server);
                }
            }
        });
        Self { port }
    }

    /// The one address.
    pub(crate) fn port(&self) -> u16 {
        self.port
    }
}

fn carry(client: TcpStream, server: TcpStream) -> io::Result<()> {
    for (mut from, mut to) in [(client.try_clone()?, server.try_clone()?), (server, client)] {
        thread::spawn(move || {
            let _ = io::copy(&mut from, &mut to);
            let _ = to.shutdown(Shutdown::Both);
            let _ = from.shutdown(Shutdown::Both);
        });
    }
    Ok(())
}
