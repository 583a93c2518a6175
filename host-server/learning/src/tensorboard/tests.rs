//! Files are read here by code that shares nothing with what writes them.

use std::collections::BTreeMap;
use std::path::PathBuf;

use proptest::prelude::*;

use super::*;

/// CRC-32C bit by bit: RFC 3720, appendix B.4 has what comes out.
fn crc32c(bytes: &[u8]) -> u32 {
    let step = |crc: u32| (crc >> 1) ^ (0x82F6_3B78 & (crc & 1).wrapping_neg());
    !bytes.iter().fold(!0, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc))
    })
}

fn mask(crc: u32) -> u32 {
    crc.rotate_right(15).wrapping_add(0xA282_EAD8)
}

/// A field of a protocol buffer.
#[derive(Debug)]
enum Field<'a> {
    Varint(u64),
    Fixed64(u64),
    Bytes(&'a [u8]),
    Fixed32(u32),
}

fn varint(bytes: &mut &[u8]) -> u64 {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let (byte, rest) = bytes.split_first().expect("a byte");
        *bytes = rest;
        value |= u64::from(byte & 0x7F) << shift;
        if byte & 0x80 == 0 {
            break;
        }
    }
    value
}

fn fields(mut bytes: &[u8]) -> Vec<(u64, Field<'_>)> {
    let mut all = Vec::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let mut take = |length: usize| {
            let (taken, rest) = bytes.split_at(length);
            bytes = rest;
            taken
        };
        let field = match key & 7 {
            1 => Field::Fixed64(u64::from_le_bytes(take(8).try_into().expect("eight"))),
            5 => Field::Fixed32(u32::from_le_bytes(take(4).try_into().expect("four"))),
            kind => {
                let number = varint(&mut bytes);
                if kind == 0 {
                    Field::Varint(number)
                } else {
                    assert_eq!(kind, 2);
                    let (taken, rest) = bytes.split_at(number as usize);
                    bytes = rest;
                    Field::Bytes(taken)
                }
            }
        };
        all.push((key >> 3, field));
    }
    all
}

/// An event as it is read.
#[derive(Debug, Default)]
struct Read {
    wall_time: f64,
    step: u64,
    version: Option<String>,
    values: BTreeMap<String, f32>,
    is_start: bool,
}

fn text(bytes: &[u8]) -> String {
    std::str::from_utf8(bytes).expect("UTF-8").to_owned()
}

fn event(contents: &[u8]) -> Read {
    let mut read = Read::default();
    for field in fields(contents) {
        match field {
            (1, Field::Fixed64(bits)) => read.wall_time = f64::from_bits(bits),
            (2, Field::Varint(step)) => read.step = step,
            (3, Field::Bytes(version)) => read.version = Some(text(version)),
            (5, Field::Bytes(summary)) => {
                for field in fields(summary) {
                    let (1, Field::Bytes(value)) = field else {
                        panic!("{field:?}");
                    };
                    let (tag, number) = match fields(value)[..] {
                        [(1, Field::Bytes(tag)), (2, Field::Fixed32(bits))] => {
                            (text(tag), f32::from_bits(bits))
                        }
                        ref other => panic!("{other:?}"),
                    };
                    assert_eq!(read.values.insert(tag, number), None);
                }
            }
            (7, Field::Bytes(log)) => {
                read.is_start = matches!(fields(log)[..], [(1, Field::Varint(1))]);
            }
            other => panic!("{other:?}"),
        }
    }
    read
}

/// All events of a file, which has nothing else.
fn events(mut file: &[u8]) -> Vec<Read> {
    let mut all = Vec::new();
    while !file.is_empty() {
        let length = u64::from_le_bytes(file[..8].try_into().expect("eight")) as usize;
        let sum = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().expect("four"));
        assert_eq!(sum(&file[8..12]), mask(crc32c(&file[..8])));
        let contents = &file[12..12 + length];
        assert_eq!(sum(&file[12 + length..16 + length]), mask(crc32c(contents)));
        all.push(event(contents));
        file = &file[16 + length..];
    }
    all
}

/// What is shown of a file, step by step, without how fast it went.
pub(crate) fn shown(file: &[u8]) -> Vec<(u64, BTreeMap<String, f32>)> {
    let mut shown = all_shown(file);
    for (_, values) in &mut shown {
        if let Some(speed) = values.remove(SPEED) {
            assert!(speed > 0.0);
        }
    }
    shown
}

/// The same with everything: whatever comes after a start at its step or later is taken for undone.
fn all_shown(file: &[u8]) -> Vec<(u64, BTreeMap<String, f32>)> {
    let mut events = events(file).into_iter();
    let first = events.next().expect("a first event");
    assert_eq!(first.version.as_deref(), Some("brain.Event:2"));
    let mut shown: Vec<(u64, BTreeMap<String, f32>)> = Vec::new();
    for event in events {
        assert!(event.wall_time.is_finite() && event.version.is_none());
        if event.is_start {
            shown.retain(|(step, _)| *step < event.step);
        } else {
            assert!(shown.last().is_none_or(|(last, _)| *last < event.step));
            shown.push((event.step, event.values));
        }
    }
    shown
}

/// The same of a curve.
pub(crate) fn wanted(curve: &[Line]) -> Vec<(u64, BTreeMap<String, f32>)> {
    let of = |line: &Line| {
        let columns = [
            ("train/reward", line.reward),
            ("train/success", line.success),
            ("train/length", line.length),
            ("train/episodes", line.episodes as f32),
            ("train/entropy", line.entropy as f32),
            ("train/divergence", line.divergence as f32),
            ("train/clipped", line.clipped as f32),
            ("loss/policy", line.loss as f32),
            ("loss/value", line.critic as f32),
            ("shield/vetoes", line.vetoes),
        ];
        let told = columns.into_iter().filter(|(_, number)| !number.is_nan());
        let values = told.map(|(tag, number)| (tag.to_owned(), number));
        (line.steps, values.collect())
    };
    curve.iter().map(of).collect()
}

const SPEED: &str = "speed/steps_per_second";

fn curve(rounds: u64) -> Vec<Line> {
    let line = |round| Line {
        round,
        steps: round * 3_072,
        episodes: round as usize % 3,
        reward: if round % 3 == 0 {
            f32::NAN
        } else {
            -1.5 * round as f32
        },
        success: if round % 3 == 0 { f32::NAN } else { 0.25 },
        length: if round % 3 == 0 { f32::NAN } else { 321.0 },
        entropy: 1.9,
        divergence: 0.012,
        clipped: 0.1,
        critic: 3.25,
        loss: -0.001_5,
        vetoes: 0.5,
    };
    (1..=rounds).map(line).collect()
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("crawler-events-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).expect("a folder");
    folder
}

fn add(folder: &Path, all: &[Line], kept: usize, more: usize) {
    let mut events = Events::open(folder, &all[..kept], 1.7e9).expect("opened");
    for line in &all[kept..kept + more] {
        events
            .add(line, 3_072, 1.5, 1.7e9 + line.round as f64)
            .expect("added");
    }
    events.sync().expect("on the disk");
}

fn contents(folder: &Path) -> Vec<u8> {
    fs::read(folder.join(NAME)).expect("a file")
}

#[test]
fn the_reader_of_these_tests_knows_the_checksum() {
    // RFC 3720, appendix B.4.
    assert_eq!(crc32c(&[0; 32]), 0x8A91_36AA);
    assert_eq!(crc32c(b"123456789"), 0xE306_9283);
}

#[test]
fn rounds_that_are_made_again_are_shown_once() {
    let (folder, all) = (folder("again"), curve(40));
    add(&folder, &all, 0, 7);
    // Killed before there was a checkpoint, then twice after it, then ended in order.
    add(&folder, &all, 0, 19);
    add(&folder, &all, 10, 3);
    add(&folder, &all, 10, 10);
    let before = contents(&folder);
    add(&folder, &all, 20, 20);
    let file = contents(&folder);
    assert!(file.starts_with(&before), "it only grows");
    assert!(
        all_shown(&file)
            .iter()
            .all(|(_, values)| values[SPEED] == 2_048.0)
    );
    assert_eq!(shown(&file), wanted(&all));
    let starts: Vec<u64> = events(&file)
        .iter()
        .filter(|event| event.is_start)
        .map(|event| event.step)
        .collect();
    assert_eq!(starts, [1, 10 * 3_072 + 1, 10 * 3_072 + 1]);
    let _ = fs::remove_dir_all(folder);
}

#[test]
fn a_run_from_before_there_were_such_files_has_one_of_its_curve() {
    let (folder, all) = (folder("before"), curve(12));
    add(&folder, &all, 10, 2);
    assert_eq!(shown(&contents(&folder)), wanted(&all));
    let _ = fs::remove_dir_all(folder);
}

#[test]
fn a_run_that_is_killed_again_and_again_does_not_fill_the_disk() {
    let (folder, all) = (folder("killed"), curve(20));
    // As it would be after some thousand times.
    let mut events = Events::open(&folder, &all[..10], 1.7e9).expect("opened");
    let again = |events: &mut Events| {
        for line in &all[10..19] {
            events.add(line, 3_072, 1.5, 1.7e9).expect("added");
        }
    };
    while contents(&folder).len() as u64 <= SPARE + 10 * ROUND {
        for _ in 0..100 {
            again(&mut events);
        }
    }
    drop(events);
    add(&folder, &all, 10, 10);
    let file = contents(&folder);
    assert!(file.len() as u64 <= 21 * ROUND, "{}", file.len());
    assert_eq!(shown(&file), wanted(&all));
    let _ = fs::remove_dir_all(folder);
}

#[test]
fn what_cannot_be_written_is_an_error() {
    let folder = folder("odd");
    fs::create_dir(folder.join(NAME)).expect("a folder in its place");
    Events::open(&folder, &[], 0.0).expect_err("a folder is no file");
    Events::open(&folder.join("nowhere"), &[], 0.0).expect_err("no folder");
    let _ = fs::remove_dir_all(folder);
}

proptest! {
    /// However a file was cut or damaged: what is kept is shown once, as it was, and what comes after it too.
    #[test]
    fn no_damage_costs_a_round(
        sessions in prop::collection::vec((0_usize..4, 0_usize..12), 1..6),
        cut in any::<prop::sample::Index>(),
        damage in prop::option::of((any::<prop::sample::Index>(), 1_u8..)),
        name in any::<u64>(),
    ) {
        let (folder, all) = (folder(&format!("damage-{name}")), curve(64));
        let mut kept = 0;
        for (checkpoints, more) in sessions {
            add(&folder, &all, kept, checkpoints * 5 + more.min(4));
            kept += checkpoints * 5;
            kept = kept.min(50);
            if kept == 50 {
                break;
            }
        }
        let mut file = contents(&folder);
        file.truncate(cut.index(file.len() + 1));
        if let Some((at, bits)) = damage && !file.is_empty() {
            let at = at.index(file.len());
            file[at] ^= bits;
        }
        fs::write(folder.join(NAME), &file).expect("written");
        add(&folder, &all, kept, 10);
        let shown = shown(&contents(&folder));
        let _ = fs::remove_dir_all(folder);
        prop_assert_eq!(shown, wanted(&all[..kept + 10]));
    }
}
