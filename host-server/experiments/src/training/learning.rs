//! How a training learns: by itself, or by nodes at the broker.

use std::time::{Duration, Instant};

use crawler_federation::Nodes;
use crawler_learning::federated::Coordination;
use crawler_learning::{Line, Run, RunError, Summary};

use super::asked::Means;
use super::job::Work;
use super::told::NodesView;

/// How often a training that waits for nodes looks whether it is to stand.
const LOOK: Duration = Duration::from_millis(200);

/// What learns.
pub(super) enum Learning {
    Alone(Box<Run>),
    Federated(Box<Federated>),
}

/// What nodes learn.
pub(super) struct Federated {
    run: Coordination,
    nodes: Option<Nodes>,
    /// Times of the run are from here on.
    begun: Instant,
    /// When nodes were told last.
    told: Option<Duration>,
}

/// What a step came to.
pub(super) enum Step {
    /// Nodes have not all answered yet.
    Waits(NodesView),
    /// A round is over.
    Round(Line),
    /// All of them are.
    Over,
}

impl Learning {
    /// Begins a run, or goes on with the one that is there.
    pub(super) fn open(work: &Work) -> Result<Self, RunError> {
        let scenario = work.scenario.clone();
        Ok(match &work.means {
            Means::Alone(options) => {
                let run = Run::open(options, &work.folder, scenario, work.threads)?;
                Self::Alone(Box::new(run))
            }
            Means::Federated(together) => {
                let now = Duration::ZERO;
                let run = Coordination::open(together, &work.folder, scenario, work.threads, now)?;
                Self::Federated(Box::new(Federated {
                    run,
                    nodes: work.broker.as_ref().map(|broker| broker.meet(work.id)),
                    begun: Instant::now(),
                    told: None,
                }))
            }
        })
    }

    /// The curve so far.
    pub(super) fn curve(&self) -> &str {
        match self {
            Self::Alone(run) => run.curve(),
            Self::Federated(together) => together.run.curve(),
        }
    }

    /// Rounds so far.
    pub(super) fn rounds(&self) -> u64 {
        match self {
            Self::Alone(run) => run.rounds().0,
            Self::Federated(together) => together.run.coordinator().rounds().into(),
        }
    }

    /// Goes on by a round, or waits a little for one.
    pub(super) fn step(&mut self) -> Result<Step, RunError> {
        match self {
            Self::Alone(run) => Ok(run.round()?.map_or(Step::Over, Step::Round)),
            Self::Federated(together) => together.step(),
        }
    }

    /// Whether a round that is over is written down.
    pub(super) const fn is_kept(&self, line: &Line) -> bool {
        match self {
            Self::Alone(_) => line.is_kept(),
            Self::Federated(_) => true,
        }
    }

    /// Writes down what is not yet.
    pub(super) fn keep(&self) -> Result<(), RunError> {
        match self {
            Self::Alone(run) => run.keep(),
            // Each round is, before nodes are told of the next one.
            Self::Federated(_) => Ok(()),
        }
    }

    /// The policy so far, for robots.
    pub(super) fn so_far(&self) -> Result<Vec<u8>, RunError> {
        match self {
            Self::Alone(run) => run.so_far(),
            Self::Federated(together) => together.run.so_far(),
        }
    }

    /// Judges what was learned, and writes it down.
    pub(super) fn finish(&self) -> Result<Summary, RunError> {
        match self {
            Self::Alone(run) => run.finish(),
            Self::Federated(together) => together.run.finish(),
        }
    }

    /// Who has answered, where nodes learn.
    pub(super) fn nodes(&self) -> Option<NodesView> {
        match self {
            Self::Alone(_) => None,
            Self::Federated(together) => Some(together.view()),
        }
    }

    /// Has nodes do nothing until it goes on.
    pub(super) fn stand(self) {
        if let Self::Federated(together) = self
            && let Some(nodes) = together.nodes
        {
            nodes.withdraw();
        }
    }

    /// Leaves with the broker what came of it, so that nodes know that it is over.
    pub(super) fn end(self) {
        if let Self::Federated(together) = self
            && let Some(nodes) = together.nodes
        {
            nodes.end_with(together.run.coordinator().announcement());
        }
    }
}

impl Federated {
    fn view(&self) -> NodesView {
        NodesView::of(self.run.coordinator(), self.run.last())
    }

    fn step(&mut self) -> Result<Step, RunError> {
        let now = self.begun.elapsed();
        let coordinator = self.run.coordinator();
        if coordinator.is_over() {
            return Ok(Step::Over);
        }
        // Once more after the deadline: what a node has answered may be lost, and is said again.
        let again = coordinator.settings().deadline;
        if self
            .told
            .is_none_or(|told| now.saturating_sub(told) >= again)
        {
            if let Some(nodes) = &self.nodes {
                nodes.announce(coordinator.announcement());
            }
            self.told = Some(now);
        }
        let wait = coordinator.due(now).unwrap_or(LOOK).min(LOOK);
        match &self.nodes {
            Some(nodes) => {
                if let Some((node, bytes)) = nodes.hear(wait) {
                    let answer = self.run.receive(&node, &bytes);
                    tracing::debug!(node, ?answer, "a node has answered");
                }
            }
            None => std::thread::sleep(wait),
        }
        match self.run.close(self.begun.elapsed())? {
            Some(line) => {
                self.told = None;
                Ok(Step::Round(line))
            }
            None => Ok(Step::Waits(self.view())),
        }
    }
}
