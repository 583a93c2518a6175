//! What a server said once, for counting instructions on a board: `handshake.bin`, the authority in
//! its first 33 bytes. With `CRAWLER_TLS_RECORD=1` it is made anew.

use std::path::Path;
use std::vec::Vec;

use rand_core::{TryCryptoRng, TryRng};

use super::interop::{Made, Rustls, config, server, server_params};
use super::{Canned, HOST, NOW, Peer, talk};
use crate::{Authority, Buffers, Connection, Expected};

/// One after the other: the client then says the same each time.
struct Counting(u8);

impl TryRng for Counting {
    type Error = core::convert::Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        let mut bytes = [0; 4];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        let mut bytes = [0; 8];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for byte in bytes {
            self.0 = self.0.wrapping_add(1);
            *byte = self.0;
        }
        Ok(())
    }
}

impl TryCryptoRng for Counting {}

fn expected(authority: Authority) -> Expected<'static> {
    Expected {
        host: HOST,
        authority,
        now: Some(NOW),
    }
}

/// Notes what it says.
struct Noted(Rustls, Vec<u8>);

impl Peer for Noted {
    fn take(&mut self, bytes: &[u8]) -> Vec<u8> {
        let said = self.0.take(bytes);
        self.1.extend_from_slice(&said);
        said
    }
}

fn opens(authority: Authority, peer: &mut dyn Peer) -> bool {
    let expected = expected(authority);
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, &expected, &mut Counting(0)).unwrap();
    talk(&mut client, &expected, peer, usize::MAX).unwrap();
    client.is_open()
}

#[test]
fn the_recorded_handshake_opens_a_connection() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/tests/handshake.bin");
    if std::env::var_os("CRAWLER_TLS_RECORD").is_some() {
        let root = Made::root();
        let mut config = config(server(&root, &server_params()));
        config.send_tls13_tickets = 0;
        let mut peer = Noted(Rustls::new(config), root.pin().as_bytes().to_vec());
        assert!(opens(root.pin(), &mut peer));
        std::fs::write(&file, peer.1).expect("writable");
    }
    let bytes = std::fs::read(file).expect("recorded");
    let (authority, said) = bytes.split_at(33);
    let authority = Authority::new(authority.try_into().unwrap()).unwrap();
    // It comes when the client has spoken.
    assert!(opens(authority, &mut Canned(said.to_vec())));
}
