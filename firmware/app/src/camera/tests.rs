//! Captures with a camera and a link that follow a script.

use core::cell::{Cell, RefCell};
use core::future::pending;
use std::boxed::Box;
use std::rc::Rc;
use std::string::{String, ToString};
use std::vec;
use std::vec::Vec;

use crawler_hal::{Camera, CameraErrorKind, Clock, Duration, FrameFormat};
use crawler_protocol::Reason;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;

use super::{ImageSlot, Outcome, STILL_WITHIN, camera};
use crate::testing::{Executor, TestRobot, robot_with};

const JPEG: [u8; 6] = [0xFF, 0xD8, 0xFF, 0xE0, 0xFF, 0xD9];

/// What the camera does at the next call.
#[derive(Clone, Copy)]
enum Act {
    Write(&'static [u8]),
    /// Claims to have written more than there is room for.
    Boast,
    Fail(CameraErrorKind),
    Hang,
}

#[derive(Clone)]
struct Script {
    act: Rc<Cell<Act>>,
    stills: Rc<Cell<u32>>,
}

impl Camera for Script {
    type Error = CameraErrorKind;

    fn size(&self) -> (u16, u16) {
        (96, 96)
    }

    fn format(&self) -> FrameFormat {
        FrameFormat::Grey8
    }

    async fn capture(&mut self, _: &mut [u8]) -> Result<(), CameraErrorKind> {
        Ok(())
    }

    async fn still(&mut self, jpeg: &mut [u8]) -> Result<usize, CameraErrorKind> {
        self.stills.set(self.stills.get() + 1);
        match self.act.get() {
            Act::Write(bytes) => {
                jpeg[..bytes.len()].copy_from_slice(bytes);
                Ok(bytes.len())
            }
            Act::Boast => Ok(jpeg.len() + 1),
            Act::Fail(kind) => Err(kind),
            Act::Hang => pending().await,
        }
    }
}

type Slot = ImageSlot<NoopRawMutex, Box<[u8]>>;

struct Bench<'a> {
    robot: &'a TestRobot,
    slot: &'a Slot,
    script: Script,
    executor: Executor<'a>,
    told: RefCell<Vec<String>>,
}

impl<'a> Bench<'a> {
    fn new(robot: &'a TestRobot, slot: &'a Slot, act: Act) -> Self {
        let script = Script {
            act: Rc::new(Cell::new(act)),
            stills: Rc::default(),
        };
        let mut executor = Executor::default();
        let clock = executor.clock.clone();
        executor.spawn(camera(robot, script.clone(), slot, clock));
        executor.run_woken();
        Self {
            robot,
            slot,
            script,
            executor,
            told: RefCell::default(),
        }
    }

    /// Asks for a still, and lets `span` pass.
    fn ask(&mut self, seq: u64, span: Duration) {
        let text = std::format!(
            r#"{{"command":"capture","timestamp":0,"seq":{seq},"source":"operator:ada"}}"#
        );
        self.robot
            .submit(text.as_bytes(), self.executor.clock.now());
        self.executor.run_for(span);
    }

    /// The answers since the last call, as `seq status reason`.
    fn answers(&self) -> Vec<String> {
        let mut all = Vec::new();
        while let Some((ticket, answer)) = self.robot.outbox.next_answer() {
            self.robot.outbox.delivered(ticket);
            let reason = answer.reason.map_or("-", Reason::name);
            all.push(std::format!("{} {} {reason}", answer.seq, answer.status));
        }
        all
    }

    /// Texts of the log records `camera` so far.
    fn told(&self) -> Vec<String> {
        let now = self.executor.clock.now();
        while let Some(entry) = self.robot.outbox.next_log(0, now) {
            if entry.event == "camera" {
                self.told.borrow_mut().push(entry.text.to_string());
            }
        }
        self.told.borrow().clone()
    }

    /// Plays the link: takes the image and settles it.
    fn settle(&mut self, outcome: Outcome) -> (Vec<u8>, u32) {
        let image = self.slot.collect().expect("an image waits");
        let seen = (image.jpeg().to_vec(), image.frame());
        self.slot.settle(image.into_buffer(), outcome);
        self.executor.run_woken();
        seen
    }
}

const MOMENT: Duration = Duration::from_millis(10);

fn bench(act: Act, test: impl FnOnce(Bench<'_>)) {
    let robot = robot_with("ada-1", |config| config.camera = true);
    let slot = Slot::new(vec![0; 64].into_boxed_slice());
    test(Bench::new(&robot, &slot, act));
}

#[test]
fn a_capture_is_accepted_delivered_and_completed_in_this_order() {
    bench(Act::Write(&JPEG), |mut bench| {
        assert_eq!(bench.script.stills.get(), 1, "the one at boot");
        assert!(bench.slot.collect().is_none(), "which nobody sees");
        for round in 1..=3_u32 {
            let seq = u64::from(round);
            bench.ask(seq, MOMENT);
            assert_eq!(bench.answers(), [std::format!("{seq} accepted -")]);
            assert_eq!(bench.settle(Outcome::Delivered), (JPEG.to_vec(), round));
            assert_eq!(bench.answers(), [std::format!("{seq} completed -")]);
        }
        assert_eq!(bench.told(), [""; 0], "a camera that works is no news");
    });
}

#[test]
fn a_body_without_a_camera_says_so_at_once() {
    let robot = robot_with("ada-1", |config| config.camera = false);
    let slot = Slot::new(vec![0; 64].into_boxed_slice());
    let mut bench = Bench::new(&robot, &slot, Act::Write(&JPEG));
    bench.ask(1, MOMENT);
    assert_eq!(bench.answers(), ["1 rejected unsupported"]);
}

#[test]
fn one_capture_at_a_time() {
    bench(Act::Write(&JPEG), |mut bench| {
        bench.ask(1, MOMENT);
        bench.ask(2, MOMENT);
        assert_eq!(bench.answers(), ["1 accepted -", "2 rejected busy"]);
        bench.settle(Outcome::Delivered);
        bench.ask(3, MOMENT);
        assert_eq!(bench.answers(), ["1 completed -", "3 accepted -"]);
    });
}

#[test]
fn a_camera_that_never_answers_costs_a_bounded_time_and_is_told_once() {
    bench(Act::Hang, |mut bench| {
        bench.executor.run_for(STILL_WITHIN);
        assert_eq!(bench.told(), ["the camera does not answer"]);
        bench.ask(1, STILL_WITHIN.saturating_sub(MOMENT));
        assert_eq!(bench.answers(), ["1 accepted -"]);
        bench.executor.run_for(MOMENT);
        assert_eq!(bench.answers(), ["1 failed timeout"]);
        bench.script.act.set(Act::Write(&JPEG));
        bench.ask(2, MOMENT);
        bench.settle(Outcome::Delivered);
        assert_eq!(bench.answers(), ["2 accepted -", "2 completed -"]);
        let told = ["the camera does not answer", "the camera works again"];
        assert_eq!(bench.told(), told);
    });
}

#[test]
fn every_failure_has_its_reason() {
    let whole: &[u8] = &JPEG;
    for (act, reason, news) in [
        (Act::Fail(CameraErrorKind::Absent), Reason::Fault, 1),
        (Act::Fail(CameraErrorKind::Stalled), Reason::Timeout, 1),
        (Act::Fail(CameraErrorKind::Garbled), Reason::Fault, 1),
        (Act::Fail(CameraErrorKind::Other), Reason::Fault, 1),
        // No fault of the camera.
        (Act::Fail(CameraErrorKind::TooLarge), Reason::TooLarge, 0),
        // What a broken driver might do.
        (Act::Boast, Reason::Fault, 1),
        (Act::Write(&[]), Reason::Fault, 1),
        (Act::Write(&whole[1..]), Reason::Fault, 1),
        (Act::Write(&whole[..5]), Reason::Fault, 1),
        (Act::Write(b"GIF89a"), Reason::Fault, 1),
    ] {
        bench(act, |mut bench| {
            for seq in 1..=2 {
                bench.ask(seq, MOMENT);
                let failed = std::format!("{seq} failed {reason}");
                assert_eq!(bench.answers(), [std::format!("{seq} accepted -"), failed]);
            }
            assert_eq!(bench.told().len(), news, "{:?}", bench.told());
        });
    }
    for (outcome, reason) in [
        (Outcome::TooLarge, "too_large"),
        (Outcome::Refused, "fault"),
    ] {
        bench(Act::Write(&JPEG), |mut bench| {
            bench.ask(1, MOMENT);
            bench.settle(outcome);
            let failed = std::format!("1 failed {reason}");
            assert_eq!(bench.answers(), ["1 accepted -".to_string(), failed]);
            assert!(bench.told().is_empty());
        });
    }
}

#[test]
fn the_final_answer_of_a_capture_is_remembered() {
    bench(Act::Fail(CameraErrorKind::Absent), |mut bench| {
        bench.ask(1, MOMENT);
        bench.ask(1, MOMENT);
        let all = ["1 accepted -", "1 failed fault"];
        // The repetition is the same answer, which still waits.
        assert_eq!(bench.answers(), all);
        bench.ask(1, MOMENT);
        assert_eq!(bench.answers(), ["1 failed fault"]);
        assert_eq!(bench.script.stills.get(), 2, "one at boot, one for it");
    });
}
