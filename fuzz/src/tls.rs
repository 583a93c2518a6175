//! Fuzz targets of what a server says to a robot that speaks TLS. The fuzzer and the replay of its
//! corpus in the tests of `crawler-tls` include this file.

use core::convert::Infallible;

use crawler_tls::{Authority, Buffers, Connection, Expected, Step, check_certificates};
use rand_core::{TryCryptoRng, TryRng};

/// The body of a target. Panics when it finds a fault.
pub type Target = fn(&[u8]);

/// Name and body of every target.
pub const TARGETS: [(&str, Target); 2] = [("tls_certificate", certificate), ("tls_server", server)];

/// The base point of the curve, whose key everybody knows.
const AUTHORITY: &str = "036b17d1f2e12c4247f8bce6e563a440f277037d812deb33a0f4a13945d898c296";

/// The same numbers every time: what a fuzzer finds has to come again.
struct Same(u8);

impl TryRng for Same {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        let mut bytes = [0; 4];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes))
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        let mut bytes = [0; 8];
        self.try_fill_bytes(&mut bytes)?;
        Ok(u64::from_le_bytes(bytes))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for byte in bytes {
            self.0 = self.0.wrapping_add(1);
            *byte = self.0;
        }
        Ok(())
    }
}

impl TryCryptoRng for Same {}

fn expected() -> Expected<'static> {
    Expected {
        host: "broker.lan",
        authority: AUTHORITY.parse().expect("a point"),
        now: None,
    }
}

/// A key that is taken for an authority's survives being written and read again, and nobody is
/// believed for whom the authority has not signed.
fn certificate(data: &[u8]) {
    if let Ok(read) = Authority::of_certificate(data) {
        assert_eq!(read.to_string().parse(), Ok(read));
    }
    assert!(check_certificates(data, &expected()).is_err());
}

/// However it arrives, the same is made of it, and nobody is believed.
fn server(data: &[u8]) {
    assert_eq!(outcome(data, 1), outcome(data, usize::MAX));
}

fn outcome(mut data: &[u8], chunk: usize) -> Option<&'static str> {
    let expected = expected();
    let mut buffers = Buffers::new();
    let mut client = Connection::start(&mut buffers, &expected, &mut Same(0)).expect("a host");
    loop {
        assert!(!client.is_open(), "nobody has proved anything");
        match client.shake(&expected) {
            Err(error) => return Some(error.reason()),
            Ok(Step::Hungry) => match client.space() {
                Err(error) => return Some(error.reason()),
                Ok(_) if data.is_empty() => return None,
                Ok(space) => {
                    let count = space.len().min(chunk).min(data.len());
                    let (now, later) = data.split_at(count);
                    space[..count].copy_from_slice(now);
                    data = later;
                    client.received(count);
                }
            },
            Ok(Step::Worked) => {}
            Ok(Step::Data | Step::Ended) => panic!("nothing was said"),
        }
    }
}
