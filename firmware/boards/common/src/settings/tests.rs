use std::format;
use std::vec;
use std::vec::Vec;

use embassy_futures::block_on;
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use proptest::prelude::*;

use super::codec::{ENCODED_MAX, decode, encode};
use super::testing::{BLOCK, Gone, TestFlash, TestRng, any_settings, settings};
use super::*;

fn password() -> AccessPointPassword {
    AccessPointPassword::draw(&mut TestRng(7))
}

fn kept(settings: Settings) -> Kept {
    Kept {
        settings: Some(settings),
        access_point: Some(password()),
    }
}

fn load(flash: &mut TestFlash) -> Kept {
    block_on(Vault::new(flash).load()).expect("a flash that reads")
}

#[test]
fn debug_tells_neither_password() {
    let shown = format!("{:?}", kept(settings()));
    assert!(shown.contains("Werkstatt") && shown.contains("crawler-07"));
    for secret in ["correct", "horse", "hunter2", password().reveal()] {
        assert!(!shown.contains(secret), "{shown}");
    }
}

#[test]
fn values_are_refused_with_their_flaw() {
    let host = |text: &str| {
        text.parse::<Broker>()
            .map(|broker| (broker.host, broker.port))
    };
    assert_eq!(host("broker").unwrap().1, 1883);
    assert_eq!(host("a.b-c.example:65535").unwrap().1, 65535);
    for (text, flaw) in [
        ("", Flaw::Missing),
        (":1883", Flaw::Missing),
        ("broker:", Flaw::Port),
        ("broker:0", Flaw::Port),
        ("broker:65536", Flaw::Port),
        ("broker:+80", Flaw::Port),
        ("broker:80:80", Flaw::Port),
        ("10.0.0.256", Flaw::Host),
        ("192.168.1", Flaw::Host),
        ("17", Flaw::Host),
        ("-a", Flaw::Host),
        ("a..b", Flaw::Host),
        ("a_b", Flaw::Host),
        ("mqtt://broker", Flaw::Port),
        ("brökér", Flaw::Host),
        ("<script>", Flaw::Host),
    ] {
        assert_eq!(host(text), Err(flaw), "{text}");
    }
    assert_eq!(host(&"a".repeat(65)), Err(Flaw::TooLong));
    assert_eq!(host(&"a".repeat(64)), Err(Flaw::Host), "a label has 63");

    let phrase = |text: &str| Passphrase::new(text).map(|_| ());
    assert_eq!(phrase(""), Err(Flaw::Missing));
    assert_eq!(phrase("seven77"), Err(Flaw::TooShort));
    assert_eq!(phrase("eight888"), Ok(()));
    assert_eq!(phrase("with tab\t"), Err(Flaw::Character));
    assert_eq!(phrase("umläut-words"), Err(Flaw::Character));
    assert_eq!(phrase(&"f".repeat(64)), Ok(()));
    assert_eq!(phrase(&"g".repeat(64)), Err(Flaw::TooLong));
    assert_eq!(phrase(&"f".repeat(65)), Err(Flaw::TooLong));

    assert_eq!(Ssid::new("").unwrap_err(), Flaw::Missing);
    assert_eq!(Ssid::new("a\0b").unwrap_err(), Flaw::Character);
    assert_eq!(Ssid::new(&"ä".repeat(17)).unwrap_err(), Flaw::TooLong);
    assert!(credentials("ada", "").is_err() && credentials("", "x").is_err());
    assert_eq!(RangerMode::parse("laser"), Err(Flaw::Choice));
}

#[test]
fn access_point_passwords_differ_and_read_back() {
    let mut seen = Vec::new();
    for seed in 0..200 {
        let drawn = AccessPointPassword::draw(&mut TestRng(seed));
        assert_eq!(AccessPointPassword::new(drawn.reveal()), Ok(drawn.clone()));
        assert!(Passphrase::new(drawn.reveal()).is_ok(), "WPA2 takes it");
        assert!(!seen.contains(&drawn));
        seen.push(drawn);
    }
    for bad in ["", "abcd-efgh-jkm", "abcd-efgh-jkm0", "abcd_efgh-jkmn"] {
        assert!(AccessPointPassword::new(bad).is_err(), "{bad}");
    }
}

#[test]
fn settings_reach_the_configuration_of_the_program() {
    let mut config = crawler_app::Config {
        id: RobotId::new("unset").unwrap(),
        fleet: Fleet::new("unset").unwrap(),
        broker_host: heapless::String::new(),
        broker_port: 1,
        kind: crawler_protocol::Kind::Physical,
        board: "test",
        firmware: "0",
        build: None,
        geometry: crawler_app::Geometry::default(),
        credentials: None,
        camera: false,
        eyes: None,
        faults: false,
    };
    settings().apply_to(&mut config);
    assert_eq!(config.id.as_str(), "crawler-07");
    assert_eq!(config.fleet, Fleet::default());
    assert_eq!(
        (config.broker_host.as_str(), config.broker_port),
        ("broker.local", 1884)
    );
    assert_eq!(config.credentials.unwrap().password, "hunter2&=");
}

#[test]
fn a_flash_of_another_shape_is_refused() {
    for length in [0, BLOCK, 2 * BLOCK - 1] {
        let mut flash = TestFlash::holding(vec![0xFF; length]);
        assert_eq!(
            block_on(Vault::new(&mut flash).load()),
            Err(VaultError::Unfit)
        );
        let stored = block_on(Vault::new(&mut flash).store(&Kept::default()));
        assert_eq!(stored, Err(VaultError::Unfit));
    }
}

#[test]
fn a_worn_flash_is_noticed_and_keeps_the_old_settings() {
    let mut flash = TestFlash::blank();
    block_on(Vault::new(&mut flash).store(&kept(settings()))).unwrap();
    // In the middle of the record that comes next.
    flash.worn = Some(BLOCK + 20);
    let mut other = settings();
    other.id = RobotId::new("other").unwrap();
    let outcome = block_on(Vault::new(&mut flash).store(&kept(other)));
    assert_eq!(outcome, Err(VaultError::Worn));
    assert_eq!(load(&mut flash), kept(settings()));
}

#[test]
fn forgetting_leaves_no_password_behind() {
    let mut flash = TestFlash::blank();
    for _ in 0..3 {
        block_on(Vault::new(&mut flash).store(&kept(settings()))).unwrap();
    }
    block_on(Vault::new(&mut flash).forget()).unwrap();
    let left = load(&mut flash);
    assert_eq!((left.settings, left.access_point), (None, Some(password())));
    for secret in [&b"correct"[..], b"hunter2", b"Werkstatt"] {
        assert!(!flash.bytes.windows(secret.len()).any(|part| part == secret));
    }
}

#[test]
fn a_flash_that_is_cut_off_while_forgetting_is_never_without_password() {
    for power in 0..3 * BLOCK {
        let mut flash = TestFlash::blank();
        block_on(Vault::new(&mut flash).store(&kept(settings()))).unwrap();
        flash.power = Some(power);
        let outcome = block_on(Vault::new(&mut flash).forget());
        flash.power = None;
        let left = load(&mut flash);
        assert_eq!(left.access_point, Some(password()), "after {power} bytes");
        assert!(outcome.is_err() || left.settings.is_none());
    }
}

/// Every byte of an erase and a write, and every step is survived by the next attempt too.
#[test]
fn a_power_cut_at_any_byte_leaves_old_or_new_settings() {
    let old = kept(settings());
    let new = kept(Settings {
        id: RobotId::new("crawler-08").unwrap(),
        ..settings()
    });
    let mut outcomes = [0; 2];
    for before in 0..3 {
        let mut start = TestFlash::blank();
        for _ in 0..=before {
            block_on(Vault::new(&mut start).store(&old)).unwrap();
        }
        for power in 0..BLOCK + 600 {
            let mut flash = start.clone();
            flash.power = Some(power);
            let outcome = block_on(Vault::new(&mut flash).store(&new));
            flash.power = None;
            let found = load(&mut flash);
            assert!(found == old || found == new, "after {power} bytes");
            assert!(outcome.is_err() || found == new);
            outcomes[usize::from(found == new)] += 1;
            block_on(Vault::new(&mut flash).store(&new)).unwrap();
            assert_eq!(load(&mut flash), new, "after {power} bytes, again");
        }
    }
    assert!(outcomes.iter().all(|count| *count > 100), "{outcomes:?}");
}

#[test]
fn the_sequence_runs_over() {
    let mut flash = TestFlash::blank();
    let mut vault = Vault::new(&mut flash);
    block_on(vault.store(&kept(settings()))).unwrap();
    // The number just before it runs over, in a record of the same content.
    let mut record = vec![0; 512];
    block_on(vault.into_inner().read(0, &mut record)).unwrap();
    record[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
    let end = 12 + usize::from(u16::from_le_bytes([record[6], record[7]]));
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&record[..end]);
    record[end..end + 4].copy_from_slice(&sum.to_le_bytes());
    block_on(flash.erase(0, BLOCK as u32)).unwrap();
    block_on(flash.write(0, &record)).unwrap();
    for number in 0..4 {
        let next = kept(Settings {
            id: RobotId::new(&format!("r{number}")).unwrap(),
            ..settings()
        });
        block_on(Vault::new(&mut flash).store(&next)).unwrap();
        assert_eq!(load(&mut flash), next);
    }
}

proptest! {
    #[test]
    fn what_is_encoded_is_decoded(
        settings in prop::option::of(any_settings()),
        named in any::<bool>(),
    ) {
        let kept = Kept { settings, access_point: named.then(password) };
        let mut buffer = [0; ENCODED_MAX];
        let bytes = encode(&kept, &mut buffer);
        prop_assert_eq!(decode(bytes), Ok(kept.clone()));
        // Cut anywhere, it is an error, or fewer fields, never other ones.
        for end in 0..bytes.len() {
            if let Ok(part) = decode(&bytes[..end]) {
                prop_assert!(part.settings.is_none() || part.settings.map(|s| s.id) == kept.settings.as_ref().map(|s| s.id.clone()));
            }
        }
        // A field of a newer program does not matter.
        let mut longer = bytes.to_vec();
        longer.extend([200, 3, 1, 2, 3]);
        prop_assert_eq!(decode(&longer), Ok(kept));
    }

    #[test]
    fn noise_is_decoded_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = decode(&bytes);
    }

    #[test]
    fn noise_in_flash_is_no_settings_and_no_obstacle(
        seed in any::<u64>(),
        magic in any::<bool>(),
        next in any_settings(),
    ) {
        use rand_core::TryRng;
        let mut bytes = vec![0; 2 * BLOCK];
        let Ok(()) = TestRng(seed).try_fill_bytes(&mut bytes);
        if magic {
            bytes[..5].copy_from_slice(b"TCST\x01");
            bytes[BLOCK..BLOCK + 5].copy_from_slice(b"TCST\x01");
        }
        let mut flash = TestFlash::holding(bytes);
        prop_assert_eq!(load(&mut flash), Kept::default());
        let next = kept(next);
        block_on(Vault::new(&mut flash).store(&next)).unwrap();
        prop_assert_eq!(load(&mut flash), next);
    }

    /// One, two or three bits of the newest record: noticed, and the record before it serves.
    #[test]
    fn bit_flips_bring_back_the_record_before(
        first in any_settings(),
        second in any_settings(),
        flips in prop::collection::btree_set(0_usize..8 * 140, 1..=3),
    ) {
        let mut flash = TestFlash::blank();
        block_on(Vault::new(&mut flash).store(&kept(first.clone()))).unwrap();
        block_on(Vault::new(&mut flash).store(&kept(second.clone()))).unwrap();
        let length = usize::from(u16::from_le_bytes([
            flash.bytes[BLOCK + 6], flash.bytes[BLOCK + 7],
        ]));
        for flip in flips {
            // Within the record: header (but the spare byte is covered too), content, checksum.
            let bit = flip % (8 * (length + 16));
            flash.bytes[BLOCK + bit / 8] ^= 1 << (bit % 8);
        }
        let found = load(&mut flash);
        let untouched = found == kept(second.clone());
        // Two flips may meet in one bit and undo each other.
        prop_assert!(found == kept(first) || untouched);
        block_on(Vault::new(&mut flash).store(&kept(second.clone()))).unwrap();
        prop_assert_eq!(load(&mut flash), kept(second));
    }
}

#[test]
fn misuse_of_the_test_flash_shows() {
    let mut flash = TestFlash::blank();
    flash.power = Some(0);
    assert!(matches!(block_on(flash.erase(0, BLOCK as u32)), Err(Gone)));
}
