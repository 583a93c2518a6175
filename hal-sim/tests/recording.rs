//! Recordings hold what happened, and replaying them finds what a program does otherwise.

use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{forward, scenario, wander};
use crawler_detector::BLOB;
use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, ParameterValue, ParameterValues};
use crawler_sim::faults::Fault;
use crawler_sim::net::lockstep::Cut;
use crawler_sim::run::{Link, Simulation};
use crawler_sim::scenario::Scenario;
use crawler_sim::tools::recording::{RecordTo, Recorder};
use crawler_sim::tools::replay::{ProgramAction, Recording, Report, replay};
use crawler_sim::what_if::Run;

/// A file that is gone when it is not needed any more.
pub(crate) struct Scratch(pub(crate) PathBuf);

impl Scratch {
    pub(crate) fn new(name: &str) -> Self {
        let name = format!("terracrawler-{}-{name}.mcap", std::process::id());
        Self(std::env::temp_dir().join(name))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = fs::remove_file(&self.0);
    }
}

fn mixed() -> Scenario {
    let mut scenario = scenario("arena", 4);
    scenario.spawn.pulse_share = Some(0.5);
    scenario.spawn.camera_share = 0.25;
    scenario.detector = Some(BLOB);
    scenario
}

type Move = fn(&mut Simulation);

/// What happens in the recorded world: commands, faults, resets, comings and goings.
const SCRIPT: [(u64, Move); 13] = [
    (5_500, |world| {
        world.submit_all(wander());
    }),
    (7_000, |world| world.cut(1, Cut::Radio)),
    (7_300, |world| {
        world.inject(0, Fault::LineStuck, None).expect("sound");
    }),
    (8_450, |world| {
        world.inject(2, Fault::RangerDead, None).expect("sound");
    }),
    (8_700, |world| {
        world
            .inject(3, Fault::ClockStep { ms: -90_000 }, None)
            .expect("sound");
    }),
    (9_000, |world| {
        world.submit(3, forward(50, 1_000));
    }),
    (10_000, |world| world.heal(2)),
    (10_000, |world| world.heal(0)),
    (11_000, |world| world.crash(0, "src/x.rs:1: tired")),
    (12_000, |world| world.cut(1, Cut::None)),
    (13_000, |world| {
        world.submit(3, Action::Reboot);
    }),
    (14_000, |world| world.remove(2)),
    (14_500, |world| {
        world.spawn().expect("room");
    }),
];
pub(crate) const END: u64 = 22_000;

fn to(file: &Path) -> RecordTo {
    RecordTo {
        file: file.to_owned(),
        build: "0.0.0 (tests)".to_owned(),
    }
}

pub(crate) fn record(link: Link, file: &Scratch) -> Simulation {
    let mut recorder = Recorder::create(&to(&file.0)).expect("a file");
    let mut world = Simulation::recorded(link, mixed(), 5, recorder.event_logs()).expect("sound");
    for (ms, act) in SCRIPT {
        recorder
            .run_until(&mut world, Instant::from_millis(ms))
            .expect("room on the disk");
        act(&mut world);
    }
    recorder
        .run_until(&mut world, Instant::from_millis(END))
        .expect("room");
    let recorded = recorder.finish(&world).expect("room");
    assert_eq!(recorded.lost, 0);
    assert!(recorded.messages > 1_000);
    world
}

fn read(file: &Scratch) -> Recording {
    Recording::read(fs::File::open(&file.0).expect("a file")).expect("a recording")
}

fn parameter(name: &str, value: f32) -> ParameterValues {
    let mut values = ParameterValues::new();
    let name = heapless::String::try_from(name).expect("short");
    values
        .push((name, ParameterValue::Number(value)))
        .expect("room");
    values
}

fn rerun(recording: &Recording, parameters: &ParameterValues) -> Vec<Report> {
    replay(recording, parameters, Some(BLOB), |_| {}).expect("replays")
}

#[test]
fn a_recorded_world_has_the_history_of_one_that_is_not() {
    for (link, name) in [(Link::Lockstep, "history"), (Link::None, "history-alone")] {
        let recorded = record(link, &Scratch::new(name));
        let mut plain = Simulation::linked(link, mixed(), 5).expect("sound");
        for (ms, act) in SCRIPT {
            plain.run_until(Instant::from_millis(ms));
            act(&mut plain);
        }
        plain.run_until(Instant::from_millis(END));
        assert_eq!(recorded.history_hash(), plain.history_hash(), "{link:?}");
        assert_eq!(recorded.second_hashes(), plain.second_hashes());
    }
}

#[test]
fn the_same_program_does_the_same_through_faults_and_resets() {
    for (link, name) in [(Link::Lockstep, "same"), (Link::None, "same-alone")] {
        let file = Scratch::new(name);
        record(link, &file);
        let recording = read(&file);
        assert!(!recording.cut_off);
        assert_eq!(recording.end_us(), END * 1_000);
        let reports = rerun(&recording, &ParameterValues::new());
        assert_eq!(reports.len(), 5);
        for report in &reports {
            assert!(report.is_same(), "{link:?}: {report:#?}");
            assert!(report.agreed > 100, "{report:?}");
        }
        let boots: Vec<u32> = reports.iter().map(|report| report.boots).collect();
        assert_eq!(boots[0], 2, "one crash");
    }
}

#[test]
fn other_parameters_part_when_they_first_matter() {
    let file = Scratch::new("parameters");
    record(Link::Lockstep, &file);
    let recording = read(&file);
    let changed = rerun(&recording, &parameter("safe_distance_mm", 1_900.0));
    let differences: Vec<_> = changed
        .iter()
        .filter_map(|r| r.difference.as_ref())
        .collect();
    assert!(!differences.is_empty());
    for (boot, difference) in differences {
        assert_eq!(*boot, 1);
        // Nobody drives before it is told to.
        assert!(difference.at_us > 5_000_000, "{difference}");
        assert!(difference.recorded.is_some() || difference.now.is_some());
    }
    let trimmed = rerun(&recording, &parameter("trim_left", 0.9));
    for report in trimmed.iter().take(2) {
        let (_, difference) = report.difference.as_ref().expect("it drives");
        assert_eq!(difference.output, "duty", "{difference}");
        let Some((at, ProgramAction::Duty(left, _))) = &difference.recorded else {
            panic!("{difference}");
        };
        assert!(*at > 5_000_000 && *left != 0);
    }
    assert!(replay(&recording, &parameter("no_such_thing", 1.0), None, |_| {}).is_err());
}

#[test]
fn a_recording_that_was_cut_off_is_good_up_to_its_last_chunk() {
    let file = Scratch::new("cut");
    record(Link::Lockstep, &file);
    let whole = fs::read(&file.0).expect("a file");
    for share in [30, 50, 90] {
        let part = &whole[..whole.len() * share / 100];
        let recording = Recording::read(part).expect("its beginning is there");
        assert!(recording.cut_off);
        assert!(recording.end_us() > 0 && recording.end_us() < END * 1_000);
        for report in rerun(&recording, &ParameterValues::new()) {
            assert!(report.is_same(), "{share} %: {report:#?}");
        }
    }
}

#[test]
fn a_changed_recording_is_refused_or_found_out() {
    let file = Scratch::new("changed");
    record(Link::Lockstep, &file);
    let whole = fs::read(&file.0).expect("a file");
    // The checksum of a chunk finds any change within it.
    for at in [whole.len() / 3, whole.len() / 2] {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        assert!(Recording::read(bytes.as_slice()).is_err(), "byte {at}");
    }
    for hostile in [
        &b""[..],
        b"\x89MCAP0\r\n",
        b"not a recording at all",
        &[0xFF; 5_000],
    ] {
        assert!(Recording::read(hostile).is_err());
    }
}

/// A file like a recording, with marks at these moments and nothing else.
fn marks(at_us: &[u64], chunks: bool) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let options = mcap::WriteOptions::new()
        .profile("terracrawler")
        .compression(None)
        .use_chunks(chunks);
    let mut writer = options.create(&mut bytes).expect("in memory");
    let words = [("format".to_owned(), "1".to_owned())];
    let start = mcap::records::Metadata {
        name: "terracrawler".to_owned(),
        metadata: words.into(),
    };
    writer.write_metadata(&start).expect("in memory");
    let channel = writer.add_channel(0, "/mark", "json", &std::collections::BTreeMap::new());
    let channel_id = channel.expect("in memory");
    for (sequence, &at_us) in (0..).zip(at_us) {
        let header = mcap::records::MessageHeader {
            channel_id,
            sequence,
            log_time: at_us,
            publish_time: at_us,
        };
        let line = format!("{{\"at_us\":{at_us}}}");
        writer
            .write_to_known_channel(&header, line.as_bytes())
            .expect("in memory");
    }
    writer.finish().expect("in memory");
    drop(writer);
    bytes.into_inner()
}

#[test]
fn a_recording_of_eternity_in_a_few_bytes_is_refused() {
    let sound = Recording::read(marks(&[0, 100_000, 900_000], false).as_slice()).expect("sound");
    assert_eq!(sound.end_us(), 900_000);
    for (moments, told) in [
        (&[0, u64::MAX][..], "nothing is known of the time"),
        (&[10_000_000_000], "nothing is known of the time"),
        (&[0, 200_000, 100_000], "backwards"),
    ] {
        let error = Recording::read(marks(moments, false).as_slice()).expect_err("no recording");
        assert!(error.to_string().contains(told), "{error}");
    }
}

#[test]
fn no_damage_to_a_recording_is_more_than_an_error() {
    for chunks in [false, true] {
        let whole = marks(&[0, 100_000, 900_000], chunks);
        assert!(Recording::read(whole.as_slice()).is_ok());
        let mut refused = 0;
        for at in 0..whole.len() {
            for value in [whole[at] ^ (1 << (at % 8)), 0, 0xFF] {
                let mut bytes = whole.clone();
                bytes[at] = value;
                refused += usize::from(Recording::read(bytes.as_slice()).is_err());
                let _ = Run::read(bytes.as_slice(), None);
            }
            let _ = Recording::read(&whole[..at]);
            let _ = Run::read(&whole[..at], None);
        }
        assert!(refused > whole.len() / 4, "{refused} of {}", whole.len());
    }
}

#[test]
fn what_is_not_written_is_told_and_the_world_goes_on() {
    let nowhere = Path::new("/nowhere/at/all.mcap");
    let error = Recorder::create(&to(nowhere)).expect_err("no such directory");
    assert!(error.to_string().contains("/nowhere"), "{error}");
    // Every write to it fails as on a full disk.
    let full = Path::new("/dev/full");
    if !full.exists() {
        return;
    }
    let Ok(mut recorder) = Recorder::create(&to(full)) else {
        return;
    };
    let mut world =
        Simulation::recorded(Link::Lockstep, mixed(), 5, recorder.event_logs()).unwrap();
    let error = recorder.run_until(&mut world, Instant::from_millis(30_000));
    let error = error.expect_err("the disk is full").to_string();
    assert!(error.contains("/dev/full"), "{error}");
    let reached = world.now();
    drop(recorder);
    world.run_for(Duration::from_secs(1));
    assert!(world.now() > reached);
}
