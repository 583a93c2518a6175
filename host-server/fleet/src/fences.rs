//! Which robots are on the wrong side of a fence.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use crawler_protocol::RobotId;
use crawler_protocol::open::Telemetry;

use super::events::ONE_BY_ONE;
use super::{Fence, FenceAction, FenceKind, FleetState, Level, MAX_ROBOTS, Robot};

/// A robot has a bit for each.
const MOST: usize = u64::BITS as usize;

/// A robot that has crossed a fence.
#[derive(Debug, Clone, PartialEq)]
pub struct Crossing {
    /// Which.
    pub robot: RobotId,
    /// Which.
    pub fence: Arc<Fence>,
    /// To where it should be.
    pub back: bool,
}

/// The fences, and who has crossed one.
#[derive(Debug, Default)]
pub(super) struct Fences {
    list: Vec<Arc<Fence>>,
    /// By the last message.
    crossed: Vec<Crossing>,
    /// Since the last sweep, not yet told as events.
    untold: Vec<Crossing>,
}

impl Fences {
    pub(super) fn forget_crossings(&mut self) {
        self.crossed.clear();
    }
}

impl FleetState {
    /// Puts these in the place of the fences there were. Who was beyond one that stays still is, and
    /// is told of no second time.
    pub fn set_fences(&mut self, fences: Vec<Fence>) {
        let same = |(one, other): (&Arc<Fence>, &Fence)| **one == *other;
        let known = &self.fences.list;
        if known.len() == fences.len() && known.iter().zip(&fences).all(same) {
            return;
        }
        let places: HashMap<(&str, FenceKind), usize> = known
            .iter()
            .enumerate()
            .map(|(place, fence)| ((fence.id.as_str(), fence.kind), place))
            .collect();
        let from: Vec<Option<usize>> = fences
            .iter()
            .take(MOST)
            .map(|fence| places.get(&(fence.id.as_str(), fence.kind)).copied())
            .collect();
        for robot in self.slots.iter_mut().flatten() {
            let before = std::mem::take(&mut robot.beyond);
            for (place, old) in from.iter().enumerate() {
                let was = old.is_some_and(|old| before & (1_u64 << old) != 0);
                robot.beyond |= u64::from(was) << place;
            }
            if before != 0 {
                self.changed.insert(robot.index);
            }
        }
        self.fences.list = fences.into_iter().take(MOST).map(Arc::new).collect();
    }

    /// Holds the places of a robot against the fences: those of `earlier`, and where it is now.
    pub(super) fn check_fences(&mut self, id: &RobotId, earlier: &[Telemetry]) {
        if self.fences.list.is_empty() {
            return;
        }
        let index = self.indices.get(id).copied().map(usize::from);
        let Some(robot) = index.and_then(|index| self.slots.get_mut(index)?.as_mut()) else {
            return;
        };
        let Fences {
            list,
            crossed,
            untold,
        } = &mut self.fences;
        let before = robot.beyond;
        for sample in earlier.iter().chain(&robot.telemetry) {
            let at = [sample.pose.x, sample.pose.y].map(f64::from);
            for (place, fence) in list.iter().enumerate() {
                let bit = 1_u64 << place;
                let was = robot.beyond & bit != 0;
                if fence.is_violated(at, was) == was {
                    continue;
                }
                robot.beyond ^= bit;
                crossed.push(Crossing {
                    robot: id.clone(),
                    fence: Arc::clone(fence),
                    back: was,
                });
            }
        }
        // Emptied ten times a second; a flood between two sweeps is told in part.
        let room = MAX_ROBOTS.saturating_sub(untold.len());
        untold.extend(crossed.iter().take(room).cloned());
        if robot.beyond != before {
            let index = robot.index;
            self.changed.insert(index);
        }
    }

    /// Every fence.
    pub fn fences(&self) -> &[Arc<Fence>] {
        &self.fences.list
    }

    /// Who crossed a fence by the last message.
    pub fn take_crossings(&mut self) -> Vec<Crossing> {
        std::mem::take(&mut self.fences.crossed)
    }

    /// The fence that a robot is on the wrong side of; of several the first that stops.
    pub fn fence_of(&self, robot: &Robot) -> Option<&Fence> {
        let mut beyond = self.beyond(robot);
        let first = beyond.next()?;
        if first.action == FenceAction::Stop {
            return Some(first);
        }
        Some(
            beyond
                .find(|fence| fence.action == FenceAction::Stop)
                .unwrap_or(first),
        )
    }

    /// Whether a robot is on the wrong side of a fence that stops.
    pub fn must_stop(&self, id: &RobotId) -> bool {
        self.get(id).is_some_and(|robot| {
            self.beyond(robot)
                .any(|fence| fence.action == FenceAction::Stop)
        })
    }

    fn beyond(&self, robot: &Robot) -> impl Iterator<Item = &Fence> {
        let bits = robot.beyond;
        let list = self.fences.list.iter().enumerate();
        list.filter(move |(place, _)| bits & (1_u64 << place) != 0)
            .map(|(_, fence)| &**fence)
    }

    /// Makes events of what was crossed since the last time; one of many robots at the same fence.
    pub(super) fn tell_crossings(&mut self) {
        let untold = std::mem::take(&mut self.fences.untold);
        let mut groups: BTreeMap<(bool, &str), Vec<&Crossing>> = BTreeMap::new();
        for crossing in &untold {
            let group = (crossing.back, crossing.fence.id.as_str());
            groups.entry(group).or_default().push(crossing);
        }
        for ((back, _), crossings) in groups {
            let Some(Crossing { fence, .. }) = crossings.first() else {
                continue;
            };
            let level = if back { Level::Info } else { Level::Warn };
            let text = format!("{} fence {}", fence.crossing_verb(back), fence.name);
            if crossings.len() > ONE_BY_ONE {
                let text = format!("{} robots {text}", crossings.len());
                self.events.heard(level, None, text);
                continue;
            }
            for crossing in crossings {
                let robot = Some(crossing.robot.clone());
                self.events.heard(level, robot, text.clone());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::super::Incoming;
    use super::super::Shape;
    use super::super::ingest::Rejection;
    use super::*;

    fn fence(id: &str, kind: FenceKind, action: FenceAction, half: f64) -> Fence {
        let corners = vec![[-half, -half], [half, -half], [half, half], [-half, half]];
        Fence {
            id: id.into(),
            name: format!("yard {id}"),
            kind,
            action,
            shape: Shape::new(corners).expect("a square"),
            by: "ada".into(),
            made_at: 1,
        }
    }

    fn hear(fleet: &mut FleetState, robot: &str, x: f32, retained: bool) -> Vec<Crossing> {
        let payload = format!(
            r#"{{"robot":"{robot}","seq":1,"timestamp":6,"state":"MOVING","behaviour":"manual","pose":{{"x":{x},"y":0.0,"theta":0.0,"sigma":0.1}},"range_mm":null,"temperature_c":null,"wheels":{{"left":0.0,"right":0.0}},"battery":{{"mv":7400,"percent":50}},"rssi_dbm":null}}"#
        );
        let topic = format!("swarm/telemetry/{robot}");
        let message = Incoming {
            topic: topic.as_bytes(),
            payload: payload.as_bytes(),
            retained,
            content_type: None,
            properties: &[],
        };
        let received: Result<_, Rejection> = fleet.receive(&message, Instant::now());
        received.expect("telemetry");
        fleet.take_crossings()
    }

    fn name_of<'a>(fleet: &'a FleetState, robot: &str) -> Option<&'a str> {
        let robot = fleet.get(&RobotId::new(robot).expect("id"))?;
        fleet.fence_of(robot).map(|fence| fence.name.as_str())
    }

    fn told(fleet: &mut FleetState) -> Vec<(Level, bool, String)> {
        fleet.tell_crossings();
        let (events, _, _) = fleet.events.since(0);
        let told = events.map(|event| (event.level, event.robot.is_some(), event.text.clone()));
        let told = told.collect();
        fleet.events = super::super::EventLog::default();
        told
    }

    #[test]
    fn a_crossing_is_told_once_each_way() {
        let mut fleet = FleetState::new(crawler_protocol::Fleet::default());
        fleet.set_fences(vec![fence("1", FenceKind::KeepIn, FenceAction::Stop, 2.0)]);
        assert_eq!(hear(&mut fleet, "a", 1.0, false), []);
        // A retained message is of long ago.
        assert_eq!(hear(&mut fleet, "b", 5.0, true), []);
        let out = hear(&mut fleet, "a", 2.2, false);
        assert!(matches!(out.as_slice(), [crossing] if !crossing.back));
        assert_eq!(name_of(&fleet, "a"), Some("yard 1"));
        assert!(fleet.must_stop(&RobotId::new("a").expect("id")));
        for x in [9.0, 2.5, 1.95] {
            assert_eq!(hear(&mut fleet, "a", x, false), [], "{x}");
        }
        let back = hear(&mut fleet, "a", 1.8, false);
        assert!(matches!(back.as_slice(), [crossing] if crossing.back));
        assert_eq!(name_of(&fleet, "a"), None);
        assert_eq!(
            told(&mut fleet),
            [
                (Level::Warn, true, "left fence yard 1".to_owned()),
                (Level::Info, true, "came back into fence yard 1".to_owned()),
            ]
        );
        assert_eq!(told(&mut fleet), []);
    }

    #[test]
    fn many_at_one_fence_are_one_event() {
        let mut fleet = FleetState::new(crawler_protocol::Fleet::default());
        fleet.set_fences(vec![fence("1", FenceKind::KeepOut, FenceAction::Warn, 2.0)]);
        for n in 0..30 {
            let crossed = hear(&mut fleet, &format!("r-{n}"), 0.0, false);
            assert_eq!(crossed.len(), 1);
        }
        assert_eq!(
            told(&mut fleet),
            [(
                Level::Warn,
                false,
                "30 robots entered fence yard 1".to_owned()
            )]
        );
    }

    #[test]
    fn other_fences_do_not_make_a_crossing_of_an_old_one() {
        let mut fleet = FleetState::new(crawler_protocol::Fleet::default());
        let warn = fence("1", FenceKind::KeepIn, FenceAction::Warn, 2.0);
        fleet.set_fences(vec![warn.clone()]);
        assert_eq!(hear(&mut fleet, "a", 3.0, false).len(), 1);
        let stop = fence("0", FenceKind::KeepIn, FenceAction::Stop, 2.5);
        fleet.set_fences(vec![stop.clone(), warn.clone()]);
        assert_eq!(name_of(&fleet, "a"), Some("yard 1"));
        // It is beyond the new one as well, and of the two that stops is shown.
        let crossed = hear(&mut fleet, "a", 3.0, false);
        assert!(matches!(crossed.as_slice(), [one] if one.fence.id == "0"));
        assert_eq!(name_of(&fleet, "a"), Some("yard 0"));
        fleet.set_fences(vec![warn.clone()]);
        assert_eq!(name_of(&fleet, "a"), Some("yard 1"));
        assert_eq!(hear(&mut fleet, "a", 3.0, false), []);
        // Turned inside out it is another fence.
        fleet.set_fences(vec![fence("1", FenceKind::KeepOut, FenceAction::Warn, 2.0)]);
        assert_eq!(name_of(&fleet, "a"), None);
        assert_eq!(hear(&mut fleet, "a", 3.0, false), []);
        assert_eq!(hear(&mut fleet, "a", 1.0, false).len(), 1);
        fleet.set_fences(Vec::new());
        assert_eq!(name_of(&fleet, "a"), None);
    }
}
