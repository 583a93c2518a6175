//! What is known of the robots of the fleet, and what of it has changed.

use std::collections::BTreeMap;

use crawler_protocol::{Kind, RobotId};
use crawler_updates::rollout::{BoardName, BuildId, Busy, Sighting};

/// A robot, as its status and telemetry show it.
#[derive(Debug, Clone, Copy)]
pub struct RobotView<'a> {
    /// The robot.
    pub robot: &'a RobotId,
    /// Its board.
    pub board: &'a str,
    /// Its kind.
    pub kind: Kind,
    /// The build that it runs.
    pub build: &'a str,
    /// How often it has started.
    pub boot: u32,
    /// Whether it is online.
    pub online: bool,
    /// Why it cannot take an update just now.
    pub busy: Option<Busy>,
}

/// The robots of the fleet.
pub trait Robots: Send + Sync + 'static {
    /// Shows every robot whose status is known. Called twice a second while there are rollouts: `show` returns at
    /// once.
    fn each(&self, show: &mut dyn FnMut(RobotView<'_>));
}

impl RobotView<'_> {
    fn is(&self, seen: &Sighting) -> bool {
        *self.robot == seen.robot
            && self.board == seen.board.as_str()
            && self.kind == seen.kind
            && self.build == seen.build.as_str()
            && self.boot == seen.boot
            && self.online == seen.online
            && self.busy == seen.busy
    }

    /// The same for the engine; `None` for a robot whose board or build has a name that none can have.
    fn sighting(&self) -> Option<Sighting> {
        Some(Sighting {
            robot: self.robot.clone(),
            board: BoardName::new(self.board).ok()?,
            kind: self.kind,
            build: BuildId::new(self.build).ok()?,
            boot: self.boot,
            online: self.online,
            busy: self.busy,
        })
    }
}

/// What was known when it was last looked at.
#[derive(Debug, Default)]
pub(crate) struct Known(BTreeMap<RobotId, Sighting>);

impl Known {
    /// What has changed since. A robot that nobody knows any more is offline.
    pub(crate) fn changes(&mut self, robots: &dyn Robots) -> Vec<Sighting> {
        let mut changes = Vec::new();
        let mut shown = 0;
        robots.each(&mut |view| {
            shown += 1;
            if self.0.get(view.robot).is_some_and(|seen| view.is(seen)) {
                return;
            }
            match view.sighting() {
                Some(seen) => changes.push(seen),
                None => shown -= 1,
            }
        });
        for seen in &changes {
            self.0.insert(seen.robot.clone(), seen.clone());
        }
        if self.0.len() > shown {
            let mut there = std::collections::BTreeSet::new();
            robots.each(&mut |view| {
                there.insert(view.robot.clone());
            });
            for seen in self.0.values_mut() {
                if seen.online && !there.contains(&seen.robot) {
                    seen.online = false;
                    changes.push(seen.clone());
                }
            }
        }
        changes
    }

    /// All that is known.
    pub(crate) fn all(&self) -> Vec<Sighting> {
        self.0.values().cloned().collect()
    }

    /// What a robot runs.
    pub(crate) fn build(&self, robot: &RobotId) -> Option<BuildId> {
        self.0.get(robot).map(|seen| seen.build.clone())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    type Line = (&'static str, &'static str, bool);

    struct Fleet(Mutex<Vec<Line>>);

    impl Robots for Fleet {
        fn each(&self, show: &mut dyn FnMut(RobotView<'_>)) {
            for (robot, build, online) in self.0.lock().unwrap().iter() {
                show(RobotView {
                    robot: &robot.parse().unwrap(),
                    board: "sim",
                    kind: Kind::Simulated,
                    build,
                    boot: 1,
                    online: *online,
                    busy: None,
                });
            }
        }
    }

    #[test]
    fn changes_are_told_once() {
        let fleet = Fleet(Mutex::new(vec![("a", "1", true), ("b", "1", true)]));
        let mut known = Known::default();
        let changes = |known: &mut Known, fleet: &Fleet| {
            let changes = known.changes(fleet).into_iter();
            let lines: Vec<_> = changes
                .map(|seen| format!("{} {} {}", seen.robot, seen.build, seen.online))
                .collect();
            lines
        };
        assert_eq!(changes(&mut known, &fleet), ["a 1 true", "b 1 true"]);
        assert!(changes(&mut known, &fleet).is_empty());
        *fleet.0.lock().unwrap() = vec![("a", "2", true), ("c", "not a name", true)];
        assert_eq!(changes(&mut known, &fleet), ["a 2 true", "b 1 false"]);
        assert!(changes(&mut known, &fleet).is_empty());
        let of_a = known.build(&"a".parse().unwrap());
        assert_eq!(of_a.map(String::from).as_deref(), Some("2"));
        assert_eq!(known.all().len(), 2);
    }
}
