//! Captures of the real robot program, end to end, in virtual time.

use std::collections::BTreeMap;

use crate::common::{scenario, settle};
use crawler_hal::Duration;
use crawler_protocol::{
    Action, Capability, LogRecord, Reason, Response, ResponseStatus, RobotState, StatusMessage,
    Topic,
};
use crawler_sim::faults::Fault;
use crawler_sim::net::lockstep::{Cut, Origin, PeerFault};
use crawler_sim::run::Simulation;

const SECOND: Duration = Duration::from_secs(1);

/// What robots have published since the last look, repetitions left out.
#[derive(Default)]
struct Heard {
    answers: BTreeMap<u64, Vec<(ResponseStatus, Option<Reason>)>>,
    images: Vec<Vec<u8>>,
    repeated_images: usize,
    camera_logs: Vec<String>,
    capabilities: Vec<Capability>,
}

impl Heard {
    fn listen(&mut self, simulation: &Simulation) {
        let network = simulation.network().expect("lockstep");
        for message in network.take_record() {
            let topic = Topic::parse(simulation.fleet(), &message.topic).expect("a topic");
            let first = message.origin != Origin::Repeated;
            match topic {
                Topic::Response(_) if first => {
                    let answer = Response::from_json(&message.payload).expect("an answer");
                    let all = self.answers.entry(answer.seq).or_default();
                    all.push((answer.status, answer.reason));
                }
                Topic::Image(_) if first => {
                    assert!(message.at_least_once && !message.retain);
                    self.images.push(message.payload);
                }
                Topic::Image(_) => self.repeated_images += 1,
                Topic::Logs(_) => {
                    let record = LogRecord::from_json(&message.payload).expect("a record");
                    if record.event == "camera" {
                        self.camera_logs.push(record.text.as_str().to_owned());
                    }
                }
                Topic::Status(_) if message.origin != Origin::Will => {
                    let status = StatusMessage::from_json(&message.payload).expect("a status");
                    self.capabilities = status.capabilities.to_vec();
                }
                _ => {}
            }
        }
        assert_eq!(network.statistics().unrecorded, 0);
        // A cut link ends in silence; nothing else may be wrong.
        let mut faults = network.take_faults();
        faults.retain(|(_, fault)| *fault != PeerFault::KeepAlive);
        assert_eq!(faults, []);
    }
}

fn with_cameras(robots: u32, share: f32, seed: u64) -> Simulation {
    let mut scenario = scenario("arena", robots);
    scenario.command = None;
    scenario.spawn.camera_share = share;
    let simulation = Simulation::lockstep(scenario, seed).expect("a simulation");
    simulation.network().expect("lockstep").record(200_000);
    simulation
}

fn listened(simulation: &Simulation) -> Heard {
    let mut heard = Heard::default();
    heard.listen(simulation);
    heard
}

fn is_picture(jpeg: &[u8]) {
    let mut decoder = jpeg_decoder::Decoder::new(jpeg);
    let pixels = decoder.decode().expect("a JPEG");
    assert_eq!(pixels.len(), 320 * 240 * 3);
    let (least, most) = pixels.iter().fold((255, 0), |(least, most), &pixel| {
        (pixel.min(least), pixel.max(most))
    });
    assert!(most - least > 60, "a picture, not a grey card");
}

const ACCEPTED: (ResponseStatus, Option<Reason>) = (ResponseStatus::Accepted, None);
const COMPLETED: (ResponseStatus, Option<Reason>) = (ResponseStatus::Completed, None);

fn failed(reason: Reason) -> (ResponseStatus, Option<Reason>) {
    (ResponseStatus::Failed, Some(reason))
}

#[test]
fn a_capture_brings_a_picture_and_a_moving_robot_keeps_moving() {
    let mut simulation = with_cameras(1, 1.0, 3);
    settle(&mut simulation);
    simulation.submit(0, crate::common::wander());
    simulation.run_for(SECOND);
    let seq = simulation.submit(0, Action::Capture);
    simulation.run_for(SECOND);
    let heard = listened(&simulation);
    assert_eq!(heard.answers[&seq], [ACCEPTED, COMPLETED]);
    assert_eq!(heard.images.len(), 1, "the one at boot is shown to nobody");
    is_picture(&heard.images[0]);
    assert_eq!(heard.camera_logs, [""; 0]);
    assert!(heard.capabilities.contains(&Capability::Camera));
    let seen = simulation.observe(0).expect("there");
    assert_eq!((seen.starvations, simulation.boots(0)), (0, 1));
}

#[test]
fn cameras_are_for_those_who_have_one() {
    let mut simulation = with_cameras(4, 0.5, 3);
    settle(&mut simulation);
    let mut images = 0;
    for robot in 0..4 {
        let _ = listened(&simulation);
        let seq = simulation.submit(robot, Action::Capture);
        simulation.run_for(SECOND);
        let heard = listened(&simulation);
        images += heard.images.len();
        if simulation.scenario().has_camera(robot) {
            assert_eq!(heard.answers[&seq], [ACCEPTED, COMPLETED]);
        } else {
            let refused = (ResponseStatus::Rejected, Some(Reason::Unsupported));
            assert_eq!(heard.answers[&seq], [refused]);
        }
    }
    assert_eq!(images, 2);
}

#[test]
fn two_captures_at_once_are_one_capture_and_one_refusal() {
    let mut simulation = with_cameras(1, 1.0, 3);
    settle(&mut simulation);
    let first = simulation.submit(0, Action::Capture);
    let second = simulation.submit(0, Action::Capture);
    simulation.run_for(SECOND);
    let third = simulation.submit(0, Action::Capture);
    simulation.run_for(SECOND);
    let heard = listened(&simulation);
    let busy = (ResponseStatus::Rejected, Some(Reason::Busy));
    assert_eq!(heard.answers[&first], [ACCEPTED, COMPLETED]);
    assert_eq!(heard.answers[&second], [busy]);
    assert_eq!(heard.answers[&third], [ACCEPTED, COMPLETED]);
    assert_eq!(heard.images.len(), 2);
}

#[test]
fn a_broken_camera_fails_captures_and_nothing_else() {
    for (fault, reason, text) in [
        (Fault::CameraAbsent, Reason::Fault, "no camera sensor found"),
        (
            Fault::CameraStalled,
            Reason::Timeout,
            "the camera does not answer",
        ),
        (
            Fault::CameraGarbage,
            Reason::Fault,
            "the camera sends what is no picture",
        ),
    ] {
        let mut simulation = with_cameras(1, 1.0, 5);
        simulation.inject(0, fault, None).expect("sound");
        settle(&mut simulation);
        let before = listened(&simulation);
        assert_eq!(before.camera_logs, [text], "known before anyone asks");
        let state = |simulation: &Simulation| simulation.robot(0).expect("there").snapshot().state;
        assert_eq!(state(&simulation), RobotState::Idle);
        let first = simulation.submit(0, Action::Capture);
        simulation.run_for(Duration::from_millis(500));
        assert_eq!(state(&simulation), RobotState::Idle, "{fault:?}");
        // It obeys meanwhile.
        let turn = simulation.submit(0, crate::common::forward(0, 100));
        simulation.run_for(SECOND * 4);
        let second = simulation.submit(0, Action::Capture);
        simulation.run_for(SECOND * 4);
        let heard = listened(&simulation);
        assert_eq!(heard.answers[&first], [ACCEPTED, failed(reason)]);
        assert_eq!(heard.answers[&turn], [ACCEPTED, COMPLETED], "{fault:?}");
        assert_eq!(heard.answers[&second], [ACCEPTED, failed(reason)]);
        assert!(heard.camera_logs.is_empty() && heard.images.is_empty());
        simulation.heal(0);
        let third = simulation.submit(0, Action::Capture);
        simulation.run_for(SECOND);
        let heard = listened(&simulation);
        assert_eq!(heard.answers[&third], [ACCEPTED, COMPLETED]);
        assert_eq!(heard.camera_logs, ["the camera works again"]);
        assert_eq!(simulation.boots(0), 1);
    }
}

#[test]
fn an_image_arrives_whole_and_once_whatever_the_link_does() {
    let mut repeated = 0;
    for (number, cut) in [Cut::Silent, Cut::Radio].into_iter().enumerate() {
        // At another moment of the capture each: before it arrives, while the still is taken,
        // while its bytes travel, and before its acknowledgement.
        for after_ms in [1, 100, 258, 262, 266, 270, 274, 278] {
            let mut simulation = with_cameras(1, 1.0, 11 + number as u64);
            settle(&mut simulation);
            let seq = simulation.submit(0, Action::Capture);
            simulation.run_for(Duration::from_millis(after_ms));
            simulation.cut(0, cut);
            // Long enough for both ends to give the connection up, shorter than the session.
            simulation.run_for(SECOND * 14);
            simulation.cut(0, Cut::None);
            simulation.run_for(SECOND * 20);
            let heard = listened(&simulation);
            assert_eq!(
                heard.answers[&seq],
                [ACCEPTED, COMPLETED],
                "{cut:?} after {after_ms} ms"
            );
            assert_eq!(heard.images.len(), 1, "{cut:?} after {after_ms} ms");
            is_picture(&heard.images[0]);
            repeated += heard.repeated_images;
        }
    }
    assert!(
        repeated > 0,
        "some cut fell between an image and its PUBACK"
    );
}

#[test]
fn pictures_are_part_of_a_run_and_repeat_with_it() {
    let run = |seed| {
        let mut simulation = with_cameras(3, 1.0, seed);
        settle(&mut simulation);
        simulation.submit_all(Action::Capture);
        simulation.run_for(SECOND);
        (simulation.history_hash(), listened(&simulation).images)
    };
    let (first, second) = (run(21), run(21));
    assert_eq!(first.1.len(), 3);
    assert_eq!(first, second);
    assert_ne!(first.0, run(22).0);
}
