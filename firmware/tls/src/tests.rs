//! The client against rustls, and against servers that mean it no good.

mod answers;
mod certificates;
mod hostile;
mod interop;
mod recorded;
mod server;
mod traces;
mod wycheproof;

use std::vec;
use std::vec::Vec;

use rand_core::{TryCryptoRng, TryRng};

use crate::{Authority, Buffers, Connection, Expected, Step, TlsError};

/// The name that certificates of the tests are for.
const HOST: &str = "broker.lan";
/// 2027-01-01.
const NOW: u64 = 1_798_761_600;

/// Numbers from a seed. Good for tests alone.
struct TestRng(u64);

impl TryRng for TestRng {
    type Error = core::convert::Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        self.try_next_u64().map(|bits| (bits >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        Ok(z ^ (z >> 31))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for byte in bytes {
            *byte = self.try_next_u64()? as u8;
        }
        Ok(())
    }
}

impl TryCryptoRng for TestRng {}

/// The other end of a connection: takes bytes, says bytes.
trait Peer {
    fn take(&mut self, bytes: &[u8]) -> Vec<u8>;
}

/// Moves bytes between both until nobody has anything to say, `chunk` of the server's at a time;
/// what the client has heard.
fn talk(
    client: &mut Connection<'_>,
    expected: &Expected<'_>,
    peer: &mut dyn Peer,
    chunk: usize,
) -> Result<Vec<u8>, TlsError> {
    let (mut heard, mut wire) = (Vec::new(), peer.take(&[]));
    loop {
        let said = client.pending().to_vec();
        client.sent(said.len());
        if !said.is_empty() {
            wire.extend(peer.take(&said));
        }
        let step = if client.is_open() {
            client.step()
        } else {
            client.shake(expected)
        };
        match step {
            Err(error) => {
                // The server is told; what it makes of that is not waited for.
                let said = client.pending().to_vec();
                peer.take(&said);
                return Err(error);
            }
            Ok(Step::Ended) => return Ok(heard),
            Ok(Step::Worked) => {}
            Ok(Step::Data) => {
                let data = client.plaintext();
                heard.extend_from_slice(data);
                let count = data.len();
                client.consume(count);
            }
            Ok(Step::Hungry) => {
                if wire.is_empty() {
                    return Ok(heard);
                }
                let space = client.space()?;
                let count = space.len().min(chunk).min(wire.len());
                space[..count].copy_from_slice(&wire[..count]);
                wire.drain(..count);
                client.received(count);
            }
        }
    }
}

fn expected(authority: Authority) -> Expected<'static> {
    Expected {
        host: HOST,
        authority,
        now: Some(NOW),
    }
}

/// A handshake from beginning to end.
fn shake(expected: &Expected<'_>, peer: &mut dyn Peer) -> Result<(), TlsError> {
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, expected, &mut TestRng(1))?;
    talk(&mut client, expected, peer, usize::MAX)?;
    assert!(client.is_open(), "no error, and no connection");
    Ok(())
}

/// What a server says, given in advance.
struct Canned(Vec<u8>);

impl Peer for Canned {
    fn take(&mut self, _: &[u8]) -> Vec<u8> {
        core::mem::take(&mut self.0)
    }
}

fn record(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut record = vec![kind, 3, 3];
    record.extend((body.len() as u16).to_be_bytes());
    record.extend(body);
    record
}
