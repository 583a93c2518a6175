//! The twin of one robot: a shadow, the body that it has, and what people were told of it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use crawler_twin::around::Room;
use crawler_twin::certificate::Certificate;
use crawler_twin::detect::Fault;
use crawler_twin::evidence::{Duty, Fix, Row, Supply};
use crawler_twin::shadow::Shadow;

use crate::inbox::{Evidence, Heard};
use crate::notice::Turn;
use crate::recording::{Recording, Tap};

/// A fault that is named for so long is told: the first name may become another one.
const TOLD_AFTER: Duration = Duration::from_secs(1);
/// A fault that is named anew within this time was there all the while.
const OVER_AFTER: Duration = Duration::from_secs(5);

/// What twins take for the time: seconds since they began, by a clock that does not jump.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clock {
    pub(crate) begun: Instant,
    /// Unix milliseconds that stamps count from.
    pub(crate) begun_ms: u64,
}

impl Clock {
    pub(crate) fn seconds(&self, at: Instant) -> f64 {
        at.saturating_duration_since(self.begun).as_secs_f64()
    }

    fn of_stamp(&self, unix_ms: u64) -> f64 {
        (i128::from(unix_ms) - i128::from(self.begun_ms)) as f64 * 1e-3
    }
}

/// A fault that people were told of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Alarm {
    /// As it is named now.
    pub(crate) fault: Fault,
    /// Since when.
    pub(crate) since: Instant,
    /// Whether people know.
    is_told: bool,
    /// Since when it is not named any more.
    gone: Option<Instant>,
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Twin {
    pub(crate) shadow: Shadow,
    /// `None` for the nominal body.
    pub(crate) body: Option<Arc<Certificate>>,
    /// Where it is, if that is known.
    pub(crate) room: Option<Arc<Room>>,
    /// When something of the robot or its tracker came last.
    pub(crate) heard: Instant,
    alarms: Vec<Alarm>,
    /// Rows that were no evidence.
    pub(crate) refused: u64,
    /// Telemetry repeats a voltage until there is another one.
    mv: u16,
    /// Where what is heard goes as well.
    tap: Tap,
}

impl Twin {
    pub(crate) fn new(
        body: Option<Arc<Certificate>>,
        room: Option<Arc<Room>>,
        now: Instant,
    ) -> Self {
        Self {
            shadow: shadow(body.as_deref()),
            body,
            room,
            heard: now,
            alarms: Vec::new(),
            refused: 0,
            mv: 0,
            tap: Tap::default(),
        }
    }

    /// Goes on with another body. What was found out with the one before is void.
    pub(crate) fn set_body(&mut self, body: Option<Arc<Certificate>>) -> Vec<Turn> {
        self.shadow = shadow(body.as_deref());
        self.body = body;
        self.mv = 0;
        self.end()
    }

    /// Keeps what is heard from now on.
    pub(crate) fn record(&mut self) -> Recording {
        let recording = Recording::default();
        self.tap = recording.tap();
        // It is to have a voltage, also where that stays as it is.
        self.mv = 0;
        recording
    }

    /// Forgets faults, as nobody looks for them any more.
    pub(crate) fn end(&mut self) -> Vec<Turn> {
        let told = self.alarms.drain(..).filter(|alarm| alarm.is_told);
        told.map(|alarm| Turn::IsLost(alarm.fault.fault)).collect()
    }

    /// Takes in where the next fix is, and whether another robot is beside it.
    pub(crate) fn near(&mut self, at: [f64; 2], is_beside: bool) {
        let room = self.room.as_deref();
        self.shadow
            .near(is_beside || room.is_some_and(|room| room.is_near(at)));
    }

    pub(crate) fn take(&mut self, heard: &Heard, clock: &Clock) {
        self.heard = self.heard.max(heard.arrived);
        let at_s = clock.of_stamp(heard.timestamp);
        let arrived_s = Some(clock.seconds(heard.arrived));
        match heard.evidence {
            Evidence::Sample { duty, mv } => {
                let duty = duty.map(f64::from);
                self.row(Row::Duty(Duty {
                    at_s,
                    arrived_s,
                    duty,
                }));
                if mv != 0 && mv != self.mv {
                    self.mv = mv;
                    let volts = f64::from(mv) * 1e-3;
                    self.row(Row::Supply(Supply {
                        at_s,
                        arrived_s,
                        volts,
                    }));
                }
            }
            Evidence::Fix(pose) => self.row(Row::Fix(Fix {
                at_s,
                arrived_s,
                x: f64::from(pose.x),
                y: f64::from(pose.y),
                theta: f64::from(pose.theta),
                sigma_m: f64::from(pose.sigma),
            })),
        }
    }

    fn row(&mut self, row: Row) {
        self.tap.put(row);
        self.refused += u64::from(self.shadow.take(row).is_err());
    }

    /// What people were told of, and is not over.
    pub(crate) fn told(&self) -> impl Iterator<Item = &Alarm> {
        self.alarms.iter().filter(|alarm| alarm.is_told)
    }

    /// Looks at what is named; returns what became of it since the last time.
    pub(crate) fn look(&mut self, now: Instant) -> Vec<Turn> {
        let named = self.shadow.faults();
        let mut turns = Vec::new();
        for fault in &named {
            let known = |alarm: &&mut Alarm| alarm.fault.fault == fault.fault;
            if let Some(alarm) = self.alarms.iter_mut().find(known) {
                (alarm.fault, alarm.gone) = (*fault, None);
                let lasts = now.saturating_duration_since(alarm.since) >= TOLD_AFTER;
                if lasts && !std::mem::replace(&mut alarm.is_told, true) {
                    turns.push(Turn::Begins(*fault));
                }
            } else {
                self.alarms.push(Alarm {
                    fault: *fault,
                    since: now,
                    is_told: false,
                    gone: None,
                });
            }
        }
        self.alarms.retain_mut(|alarm| {
            if named.iter().any(|fault| fault.fault == alarm.fault.fault) {
                return true;
            }
            if !alarm.is_told {
                return false;
            }
            let gone = *alarm.gone.get_or_insert(now);
            let stays = now.saturating_duration_since(gone) < OVER_AFTER;
            if !stays {
                turns.push(Turn::IsOver(alarm.fault.fault));
            }
            stays
        });
        turns
    }
}

fn shadow(body: Option<&Certificate>) -> Shadow {
    match body {
        Some(body) => Shadow::new(body.parameters, body.wander),
        None => Shadow::uncalibrated(),
    }
}
