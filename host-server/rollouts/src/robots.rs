//! What is known of the robots of the fleet, and what of it has changed.

use std::collections::BTreeMap;

use crawler_protocol::{Kind, ModelName, Models, RobotId};
use crawler_updates::rollout::{BoardName, BuildId, Busy, OWN_MODEL, Sighting};

/// A robot, as its status and telemetry show it.
#[derive(Debug, Clone, Copy)]
pub struct RobotView<'a> {
    /// The robot.
    pub robot: &'a RobotId,
    /// Its board.
    pub board: &'a str,
    /// Its kind.
    pub kind: Kind,
    /// Whether it has the capability `vision`.
    pub vision: bool,
    /// Whether it has the capability `policies`.
    pub policies: bool,
    /// The build that it runs.
    pub build: &'a str,
    /// The models that it uses, but for those of its program.
    pub models: &'a Models,
    /// How often it has started.
    pub boot: u32,
    /// Whether it is online.
    pub online: bool,
    /// Why it cannot take an update just now.
    pub busy: Option<Busy>,
}

/// The robots of the fleet.
pub trait Robots: Send + Sync + 'static {
    /// Shows every robot whose status is known. Called four times a second while there are rollouts: `show` returns at
    /// once.
    fn each(&self, show: &mut dyn FnMut(RobotView<'_>));
}

/// What a robot was seen to be.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Seen {
    sighting: Sighting,
    models: Models,
}

impl Seen {
    /// The robot.
    pub(crate) fn robot(&self) -> &RobotId {
        &self.sighting.robot
    }

    /// As a rollout of this model takes it, or one of programs.
    pub(crate) fn of(&self, model: Option<&ModelName>) -> Sighting {
        Sighting {
            build: self.build(model),
            ..self.sighting.clone()
        }
    }

    fn build(&self, model: Option<&ModelName>) -> BuildId {
        let Some(model) = model else {
            return self.sighting.build.clone();
        };
        let build = self
            .models
            .get(model)
            .map_or(OWN_MODEL, |build| build.as_str());
        // Every build of a robot is one, and so is the name for none.
        BuildId::new(build).unwrap_or_else(|_| self.sighting.build.clone())
    }
}

impl RobotView<'_> {
    fn is(&self, seen: &Seen) -> bool {
        let (models, seen) = (&seen.models, &seen.sighting);
        *self.models == *models
            && *self.robot == seen.robot
            && self.board == seen.board.as_str()
            && self.kind == seen.kind
            && self.vision == seen.vision
            && self.policies == seen.policies
            && self.build == seen.build.as_str()
            && self.boot == seen.boot
            && self.online == seen.online
            && self.busy == seen.busy
    }

    /// The same for the engine; `None` for a robot whose board or build has a name that none can have.
    fn seen(&self) -> Option<Seen> {
        Some(Seen {
            sighting: Sighting {
                robot: self.robot.clone(),
                board: BoardName::new(self.board).ok()?,
                kind: self.kind,
                vision: self.vision,
                policies: self.policies,
                build: BuildId::new(self.build).ok()?,
                boot: self.boot,
                online: self.online,
                busy: self.busy,
            },
            models: self.models.clone(),
        })
    }
}

/// What was known when it was last looked at: each robot that was there, and at which look.
#[derive(Debug, Default)]
pub(crate) struct Known {
    robots: BTreeMap<RobotId, (Seen, u64)>,
    looks: u64,
}

impl Known {
    /// What has changed since. A robot that nobody knows any more is offline, and forgotten.
    pub(crate) fn changes(&mut self, robots: &dyn Robots) -> Vec<Seen> {
        self.looks += 1;
        let mut changes = Vec::new();
        robots.each(&mut |view| {
            if let Some((seen, look)) = self.robots.get_mut(view.robot)
                && view.is(seen)
            {
                *look = self.looks;
            } else if let Some(seen) = view.seen() {
                self.robots
                    .insert(seen.robot().clone(), (seen.clone(), self.looks));
                changes.push(seen);
            }
        });
        let looks = self.looks;
        self.robots.retain(|_, (seen, look)| {
            let there = *look == looks;
            if !there && seen.sighting.online {
                let mut gone = seen.clone();
                gone.sighting.online = false;
                changes.push(gone);
            }
            there
        });
        changes
    }

    /// All that is known, as a rollout of this model takes it, or one of programs.
    pub(crate) fn all(&self, model: Option<&ModelName>) -> Vec<Sighting> {
        self.robots
            .values()
            .map(|(seen, _)| seen.of(model))
            .collect()
    }

    /// What a robot runs, or which model it uses.
    pub(crate) fn build(&self, robot: &RobotId, model: Option<&ModelName>) -> Option<BuildId> {
        let (seen, _) = self.robots.get(robot)?;
        Some(seen.build(model))
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
                    vision: false,
                    policies: false,
                    build,
                    models: &Models::new(),
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
            let changes = known.changes(fleet).into_iter().map(|seen| seen.of(None));
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
        let of_a = known.build(&"a".parse().unwrap(), None);
        assert_eq!(of_a.map(String::from).as_deref(), Some("2"));
        let all = known
            .all(None)
            .into_iter()
            .map(|seen| seen.robot.to_string());
        assert_eq!(all.collect::<Vec<_>>(), ["a"], "who is gone is forgotten");
        // Who comes back is new.
        *fleet.0.lock().unwrap() = vec![("a", "2", true), ("b", "1", true)];
        assert_eq!(changes(&mut known, &fleet), ["b 1 true"]);
        // Nobody can be told of a name that is none.
        *fleet.0.lock().unwrap() = vec![("a", "not a name", true), ("b", "1", false)];
        assert_eq!(changes(&mut known, &fleet), ["b 1 false", "a 2 false"]);
        *fleet.0.lock().unwrap() = Vec::new();
        assert!(changes(&mut known, &fleet).is_empty());
        assert!(known.all(None).is_empty());
    }

    /// A robot that uses these models.
    struct One(Models);
    impl Robots for One {
        fn each(&self, show: &mut dyn FnMut(RobotView<'_>)) {
            show(RobotView {
                robot: &"a".parse().unwrap(),
                board: "sim",
                kind: Kind::Simulated,
                vision: true,
                policies: false,
                build: "1",
                models: &self.0,
                boot: 1,
                online: true,
                busy: None,
            });
        }
    }

    #[test]
    fn a_rollout_of_a_model_sees_the_model() {
        let eyes: ModelName = "eyes".parse().unwrap();
        let mut models = Models::new();
        models
            .insert(eyes.clone(), "7e8f".parse().unwrap())
            .unwrap();
        let mut known = Known::default();
        let mut builds = |models| {
            let changes = known.changes(&One(models));
            let of = |model| changes.iter().map(move |seen| seen.of(model).build);
            let builds = of(None).chain(of(Some(&eyes)));
            builds.map(String::from).collect::<Vec<_>>()
        };
        assert_eq!(builds(Models::new()), ["1", OWN_MODEL]);
        assert!(builds(Models::new()).is_empty());
        assert_eq!(builds(models.clone()), ["1", "7e8f"]);
        assert!(builds(models).is_empty());
        assert_eq!(builds(Models::new()), ["1", OWN_MODEL]);
    }
}
