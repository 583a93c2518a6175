//! A flash that is stricter than a real one and can lose power after any step, and settings to
//! put into it.

use core::convert::Infallible;
use std::string::String;
use std::vec::Vec;

use embedded_storage_async::nor_flash::{
    ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
};
use proptest::prelude::*;
use rand_core::TryRng;

use super::*;

/// An authority of tests: a point that everybody knows, the base point of the curve.
pub(crate) const AUTHORITY: &str =
    "036b17d1f2e12c4247f8bce6e563a440f277037d812deb33a0f4a13945d898c296";

/// Erase block of [`TestFlash`].
pub(crate) const BLOCK: usize = 1024;

/// Two blocks of flash in words of four bytes.
#[derive(Debug, Clone)]
pub(crate) struct TestFlash {
    pub(crate) bytes: Vec<u8>,
    /// Bytes that may still be erased or written before the power goes.
    pub(crate) power: Option<usize>,
    /// A byte that can no longer be erased to ones.
    pub(crate) worn: Option<usize>,
}

/// The power is gone, or the flash was misused.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gone;

impl NorFlashError for Gone {
    fn kind(&self) -> NorFlashErrorKind {
        NorFlashErrorKind::Other
    }
}

impl TestFlash {
    pub(crate) fn blank() -> Self {
        Self::holding(std::vec![0xFF; 2 * BLOCK])
    }

    pub(crate) const fn holding(bytes: Vec<u8>) -> Self {
        Self {
            bytes,
            power: None,
            worn: None,
        }
    }

    fn spend(&mut self) -> Result<(), Gone> {
        match &mut self.power {
            Some(0) => Err(Gone),
            Some(left) => {
                *left -= 1;
                Ok(())
            }
            None => Ok(()),
        }
    }
}

impl ErrorType for TestFlash {
    type Error = Gone;
}

impl ReadNorFlash for TestFlash {
    const READ_SIZE: usize = 4;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Gone> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        let from = offset as usize;
        bytes.copy_from_slice(&self.bytes[from..from + bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.bytes.len()
    }
}

impl NorFlash for TestFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = BLOCK;

    /// Bytes lose their content one after the other, from the end: where the power goes, the
    /// front of a record is still there.
    async fn erase(&mut self, from: u32, to: u32) -> Result<(), Gone> {
        assert!((from as usize).is_multiple_of(BLOCK) && (to as usize).is_multiple_of(BLOCK));
        for at in (from as usize..to as usize).rev() {
            self.spend()?;
            self.bytes[at] = if self.worn == Some(at) { 0x00 } else { 0xFF };
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Gone> {
        assert!(offset.is_multiple_of(4) && bytes.len().is_multiple_of(4));
        for (at, byte) in (offset as usize..).zip(bytes) {
            self.spend()?;
            // Writing can only clear bits.
            self.bytes[at] &= byte;
        }
        Ok(())
    }
}

/// A generator of random bits for tests, seeded.
#[derive(Debug)]
pub(crate) struct TestRng(pub(crate) u64);

impl TryRng for TestRng {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        self.try_next_u64().map(|bits| (bits >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        Ok(z ^ (z >> 31))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        for byte in bytes {
            *byte = self.try_next_u64()? as u8;
        }
        Ok(())
    }
}

/// Settings as a person might enter them.
pub(crate) fn settings() -> Settings {
    Settings {
        wifi: Some(Wifi {
            ssid: Ssid::new("Werkstatt <2>").unwrap(),
            passphrase: Some(Passphrase::new("correct horse").unwrap()),
        }),
        broker: "broker.local:1884".parse().unwrap(),
        fleet: Fleet::default(),
        id: RobotId::new("crawler-07").unwrap(),
        credentials: Some(credentials("robot", "hunter2&=").unwrap()),
        ranger: RangerMode::Pulse,
    }
}

/// Settings of every shape and length.
pub(crate) fn any_settings() -> impl Strategy<Value = Settings> {
    let passphrase = prop_oneof!["[ -~]{8,63}", "[0-9a-fA-F]{64}"];
    let wifi = (
        "[a-zA-Z <>&'\"äß☃]{1,8}|[ -~]{32}",
        prop::option::of(passphrase),
    );
    let account = prop::option::of(("[ -~]{1,32}", "[ -~]{1,64}|[ä☃]{1,16}"));
    (
        prop::option::of(wifi),
        "[a-z][a-z0-9]{0,30}(\\.[a-z]{1,15}){0,2}|[1-9]{1,2}\\.0\\.[0-9]\\.[1-9]",
        1..=u16::MAX,
        "[a-z0-9-]{1,32}",
        "[a-z0-9-]{1,32}",
        account,
        any::<bool>(),
        any::<bool>(),
    )
        .prop_map(
            |(wifi, host, port, fleet, id, account, pulse, secure)| Settings {
                wifi: wifi.map(|(ssid, passphrase): (String, Option<String>)| Wifi {
                    ssid: Ssid::new(&ssid).unwrap(),
                    passphrase: passphrase.map(|text| Passphrase::new(&text).unwrap()),
                }),
                broker: Broker {
                    authority: secure.then(|| AUTHORITY.parse().unwrap()),
                    ..Broker::new(&host, port).unwrap()
                },
                fleet: Fleet::new(&fleet).unwrap(),
                id: RobotId::new(&id).unwrap(),
                credentials: account.map(|(name, word)| credentials(&name, &word).unwrap()),
                ranger: if pulse {
                    RangerMode::Pulse
                } else {
                    RangerMode::Uart
                },
            },
        )
}
