//! Parameters and boots through power cuts, wear and nonsense.

use crawler_hal::{Duration, Instant};
use crawler_protocol::{Action, Command, ParameterValue, ParameterValues, Reason, ResponseStatus};
use proptest::prelude::*;

use super::store;
use crate::goal::{Goal, Swarm};
use crate::parameters::Parameter;
use crate::perception::Battery;
use crate::testing::flash::{PAGE, TestFlash};
use crate::testing::{Executor, TestRobot, robot, source};

/// Boots a robot on `flash`, lets it load, hands it over, and lets it run on.
fn boot<T>(flash: &TestFlash, then: impl FnOnce(&TestRobot, &mut dyn FnMut(&Command)) -> T) -> T {
    let robot = robot("store");
    let mut executor = Executor::default();
    executor.spawn(store(&robot, flash.clone(), executor.clock.clone()));
    executor.run_for(Duration::from_secs(4));
    assert!(robot.is_loaded(), "loaded, or given up");
    then(&robot, &mut |command| {
        assert!(robot.route(command, Instant::BOOT, |_| ()).is_ok());
        executor.run_for(Duration::from_secs(4));
    })
}

fn set(name: &str, value: f32) -> Command {
    let pair = (
        name.try_into().expect("short"),
        ParameterValue::Number(value),
    );
    let values: ParameterValues = [pair].into_iter().collect();
    Command {
        action: Action::Set(values),
        timestamp: 0,
        seq: 1,
        source: source("operator:ada"),
    }
}

fn answer(robot: &TestRobot) -> (ResponseStatus, Option<Reason>) {
    let (ticket, answer) = robot.outbox.next_answer().expect("answered");
    robot.outbox.sent(ticket);
    robot.outbox.delivered(ticket);
    (answer.status, answer.reason)
}

fn max_speed(robot: &TestRobot) -> f32 {
    robot.with_parameters(|parameters| parameters.number(Parameter::MaxSpeed))
}

#[test]
fn boots_are_counted_and_parameters_kept() {
    let flash = TestFlash::new(4);
    for count in 1..=40 {
        boot(&flash, |robot, send| {
            assert_eq!(robot.boot().count, count);
            let before = 0.1 + (count - 1) as f32 * 0.01;
            if count > 1 {
                assert!((max_speed(robot) - before).abs() < 1e-6);
            }
            send(&set("max_speed", before + 0.01));
            assert_eq!(answer(robot), (ResponseStatus::Completed, None));
        });
    }
}

#[test]
fn what_a_restart_interrupts_is_told_to_the_next_boot_alone() {
    let flash = TestFlash::new(2);
    let goal = Goal::Swarm(Swarm::Flock);
    let told = |flash: &TestFlash| {
        boot(flash, |robot, _| {
            robot.control_handle().take_goal_before_restart()
        })
    };
    assert_eq!(told(&flash), None);
    boot(&flash, |robot, send| {
        robot.control_handle().keep_goal(goal);
        // Whatever else is written meanwhile.
        send(&set("max_speed", 0.3));
    });
    assert_eq!(told(&flash), Some(goal));
    assert_eq!(told(&flash), None);
    assert!((boot(&flash, |robot, _| max_speed(robot)) - 0.3).abs() < 1e-6);
}

#[test]
fn an_illegal_set_changes_neither_memory_nor_flash() {
    let flash = TestFlash::new(2);
    boot(&flash, |robot, send| {
        let changes = flash.0.borrow().changes;
        send(&set("max_speed", 99.0));
        assert_eq!(
            answer(robot),
            (ResponseStatus::Rejected, Some(Reason::OutOfRange))
        );
        assert_eq!(max_speed(robot), 0.5);
        assert_eq!(flash.0.borrow().changes, changes);
    });
}

#[test]
fn a_worn_flash_costs_persistence_and_not_the_boot() {
    let flash = TestFlash::new(2);
    boot(&flash, |robot, send| {
        send(&set("max_speed", 0.3));
        assert_eq!(answer(robot).0, ResponseStatus::Completed);
    });
    flash.0.borrow_mut().worn = true;
    boot(&flash, |robot, send| {
        assert!((max_speed(robot) - 0.3).abs() < 1e-6, "still readable");
        assert_eq!(robot.boot().count, 0, "not counted");
        send(&set("max_speed", 0.4));
        assert_eq!(
            answer(robot),
            (ResponseStatus::Failed, Some(Reason::StorageFailed))
        );
        assert!((max_speed(robot) - 0.3).abs() < 1e-6, "all or nothing");
    });
    flash.0.borrow_mut().deaf = true;
    boot(&flash, |robot, _| assert_eq!(max_speed(robot), 0.5));
}

/// Noise in part of each page may pass for an empty map, or a full one, until something is written.
#[test]
fn noise_at_the_ends_of_pages_costs_the_content_alone() {
    let mut state = 1_u64;
    for round in 0..300 {
        let flash = TestFlash::new(4);
        for (index, byte) in flash.0.borrow_mut().bytes.iter_mut().enumerate() {
            let within = index % PAGE;
            if !(32..PAGE - 32).contains(&within) {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                *byte = (state >> 56) as u8;
            }
        }
        flash.0.borrow_mut().spoiled = true;
        boot(&flash, |robot, send| {
            assert_eq!(robot.boot().count, 1, "round {round}");
            send(&set("max_speed", 0.3));
            assert_eq!(answer(robot).0, ResponseStatus::Completed, "round {round}");
        });
        boot(&flash, |robot, _| {
            assert_eq!(robot.boot().count, 2, "round {round}");
            assert!((max_speed(robot) - 0.3).abs() < 1e-6, "round {round}");
        });
    }
}

#[test]
fn a_region_without_a_shape_costs_persistence_and_not_the_boot() {
    for pages in [0, 1] {
        boot(&TestFlash::new(pages), |robot, send| {
            send(&set("max_speed", 0.4));
            assert_eq!(
                answer(robot),
                (ResponseStatus::Failed, Some(Reason::StorageFailed))
            );
        });
    }
}

#[test]
fn nothing_is_written_while_the_voltage_is_too_low() {
    let flash = TestFlash::new(2);
    let robot = robot("store");
    let low = Battery {
        brown_out: true,
        ..Battery::default()
    };
    robot.power_handle().publish(low);
    let mut executor = Executor::default();
    executor.spawn(store(&robot, flash.clone(), executor.clock.clone()));
    executor.run_for(Duration::from_secs(4));
    assert!(
        robot
            .route(&set("max_speed", 0.4), Instant::BOOT, |_| ())
            .is_ok()
    );
    executor.run_for(Duration::from_secs(4));
    assert_eq!(
        answer(&robot),
        (ResponseStatus::Failed, Some(Reason::LowBattery))
    );
    assert_eq!(flash.0.borrow().changes, 0);
    // Charged, it is stored.
    robot.power_handle().publish(Battery::default());
    assert!(
        robot
            .route(&set("max_speed", 0.4), Instant::BOOT, |_| ())
            .is_ok()
    );
    executor.run_for(Duration::from_secs(4));
    assert_eq!(answer(&robot), (ResponseStatus::Completed, None));
}

#[test]
fn a_value_that_is_not_kept_needs_no_flash() {
    let flash = TestFlash::new(2);
    flash.0.borrow_mut().worn = true;
    boot(&flash, |robot, send| {
        let pair = (
            "avoidance".try_into().expect("short"),
            ParameterValue::Bool(false),
        );
        let values: ParameterValues = [pair].into_iter().collect();
        send(&Command {
            action: Action::Set(values),
            ..set("max_speed", 0.3)
        });
        assert_eq!(answer(robot), (ResponseStatus::Completed, None));
        assert!(!robot.with_parameters(|p| p.switch(Parameter::Avoidance)));
    });
}

proptest! {
    #![proptest_config(crawler_properties::cases(200))]

    /// Power cuts after any byte of any write: what is loaded afterwards is what was set before,
    /// or what was being set, and never anything else.
    #[test]
    fn a_power_cut_leaves_the_old_value_or_the_new(
        cuts in prop::collection::vec(0_usize..400, 1..25),
    ) {
        let flash = TestFlash::new(2);
        let mut known = 0.5_f32;
        for (index, cut) in cuts.into_iter().enumerate() {
            let wanted = 0.1 + index as f32 * 0.01;
            known = boot(&flash, |robot, send| {
                let loaded = max_speed(robot);
                assert!((loaded - known).abs() < 1e-6, "lost: {loaded}, not {known}");
                flash.0.borrow_mut().power = Some(cut);
                send(&set("max_speed", wanted));
                let (status, _) = answer(robot);
                if status == ResponseStatus::Completed {
                    assert!((max_speed(robot) - wanted).abs() < 1e-6);
                }
                status
            }).pipe(|status| {
                flash.0.borrow_mut().power = None;
                boot(&flash, |robot, _| {
                    let loaded = max_speed(robot);
                    let new = (loaded - wanted).abs() < 1e-6;
                    let old = (loaded - known).abs() < 1e-6;
                    let failed = status != ResponseStatus::Completed;
                    assert!(new || old && failed, "{loaded}: neither {known} nor {wanted}");
                    loaded
                })
            });
        }
    }

    /// Any content whatsoever: it boots, and the flash is usable afterwards or says that it is not.
    #[test]
    fn any_content_boots(seed in any::<u64>(), spoiled in 1_usize..200) {
        use rand_core::TryRng as _;
        let flash = TestFlash::new(2);
        boot(&flash, |_, send| send(&set("max_speed", 0.3)));
        let mut rng = crate::testing::TestRng(seed | 1);
        for _ in 0..spoiled {
            let Ok(random) = rng.try_next_u64();
            let at = random as usize % (2 * PAGE);
            flash.0.borrow_mut().bytes[at] = (random >> 40) as u8;
        }
        flash.0.borrow_mut().spoiled = true;
        let works = boot(&flash, |robot, send| {
            send(&set("max_speed", 0.4));
            answer(robot).0 == ResponseStatus::Completed
        });
        if works {
            boot(&flash, |robot, _| assert!((max_speed(robot) - 0.4).abs() < 1e-6));
        }
    }
}

/// Reads better than a nested block in the loop above.
trait Pipe: Sized {
    fn pipe<T>(self, then: impl FnOnce(Self) -> T) -> T {
        then(self)
    }
}

impl Pipe for ResponseStatus {}
