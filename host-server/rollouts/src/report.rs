//! What robots say, as the engine takes it.

use crawler_protocol::open::{Update, UpdateReport};
use crawler_protocol::{MAX_MESSAGE, ReleaseId, RobotId, UpdateOutcome, UpdatePart, UpdateStage};
use crawler_release::Want;
use crawler_release::chunk::Part;
use crawler_updates::rollout::{BuildId, Code, Report};

/// A message of a robot.
#[derive(Debug, PartialEq)]
pub(crate) enum Said {
    /// It asks for chunks.
    Want(Want),
    /// It says something about a release.
    Report(ReleaseId, Told),
    /// It says what it runs, which its status tells as well.
    Have,
}

/// A report of which the build may be left out, where the status tells it.
#[derive(Debug, PartialEq)]
pub(crate) enum Told {
    /// As it is.
    Whole(Report),
    /// It runs the new program on trial.
    Trial(Option<BuildId>),
    /// It runs a program for good.
    Confirmed(Option<BuildId>),
}

impl Told {
    /// The report, of a robot of whom `runs` is known as what it runs; `None` where nobody knows.
    pub(crate) fn with(self, runs: impl FnOnce() -> Option<BuildId>) -> Option<Report> {
        match self {
            Self::Whole(report) => Some(report),
            Self::Trial(build) => build.or_else(runs).map(Report::Trial),
            Self::Confirmed(build) => build.or_else(runs).map(Report::Confirmed),
        }
    }
}

/// Reads a message on the topic of `robot`; `None` for what is none of a robot, is another's, or says something that
/// only a later version knows.
pub(crate) fn read(robot: &RobotId, payload: &[u8]) -> Option<Said> {
    if payload.len() > MAX_MESSAGE {
        return None;
    }
    let Ok(Update::Report(read)) = crawler_protocol::open::update(payload) else {
        return None;
    };
    let report = read.message;
    if report.robot() != robot {
        return None;
    }
    said(report)
}

fn said(report: UpdateReport) -> Option<Said> {
    Some(match report {
        UpdateReport::Have { .. } => Said::Have,
        UpdateReport::Want {
            tag,
            part,
            first,
            missing,
            ..
        } => Said::Want(Want {
            tag,
            part: match part.known()? {
                UpdatePart::Manifest => Part::Manifest,
                UpdatePart::Image => Part::Image,
                UpdatePart::Delta => Part::Delta,
            },
            first,
            missing,
        }),
        UpdateReport::Progress {
            release,
            state,
            reason,
            bytes,
            build,
            ..
        } => {
            let report = match state.known()? {
                UpdateStage::Deferred => Report::Deferred(code(reason.as_ref())?),
                UpdateStage::Preparing => Report::Preparing,
                UpdateStage::Receiving => Report::Receiving(bytes),
                UpdateStage::Verifying => Report::Verifying,
                UpdateStage::Staged => Report::Staged,
                UpdateStage::Trial => {
                    return Some(Said::Report(
                        release,
                        Told::Trial(build.as_ref().and_then(own)),
                    ));
                }
            };
            Said::Report(release, Told::Whole(report))
        }
        UpdateReport::Outcome {
            release,
            outcome,
            reason,
            build,
            lasting,
            ..
        } => {
            let report = match outcome.known()? {
                UpdateOutcome::Confirmed => {
                    return Some(Said::Report(
                        release,
                        Told::Confirmed(build.as_ref().and_then(own)),
                    ));
                }
                UpdateOutcome::RolledBack => Report::RolledBack(code(reason.as_ref())?),
                UpdateOutcome::Refused => Report::Refused {
                    code: code(reason.as_ref())?,
                    lasting: lasting.unwrap_or(false),
                },
                UpdateOutcome::Withdrawn => Report::Withdrawn,
            };
            Said::Report(release, Told::Whole(report))
        }
    })
}

/// The same name, as the engine has it.
fn own(build: &crawler_protocol::BuildId) -> Option<BuildId> {
    BuildId::new(build.as_str()).ok()
}

/// Why, also where the robot does not say.
fn code(reason: Option<&crawler_protocol::ReasonCode>) -> Option<Code> {
    let code = reason.map_or("unsaid", |reason| reason.as_str());
    Code::new(code).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot() -> RobotId {
        RobotId::new("r1").unwrap()
    }

    fn said(text: &str) -> Option<Said> {
        read(&robot(), text.as_bytes())
    }

    #[test]
    fn every_message_is_read() {
        let release: ReleaseId = "9f2c1ab034d5e6f7".parse().unwrap();
        let told = |report| Some(Said::Report(release, report));
        let whole = |report| told(Told::Whole(report));
        let code = |text| Code::new(text).unwrap();
        let progress = |state: &str, more: &str| {
            said(&format!(
                r#"{{"update":"progress","robot":"r1","release":"9f2c1ab034d5e6f7","state":"{state}","reason":null,"bytes":5{more}}}"#
            ))
        };
        assert_eq!(
            progress("deferred", ""),
            whole(Report::Deferred(code("unsaid")))
        );
        assert_eq!(progress("preparing", ""), whole(Report::Preparing));
        assert_eq!(progress("receiving", ""), whole(Report::Receiving(5)));
        assert_eq!(progress("verifying", ""), whole(Report::Verifying));
        assert_eq!(progress("staged", ""), whole(Report::Staged));
        assert_eq!(progress("trial", ""), told(Told::Trial(None)));
        let build = BuildId::new("b2").unwrap();
        assert_eq!(
            progress("trial", r#","build":"b2""#),
            told(Told::Trial(Some(build.clone())))
        );
        assert_eq!(progress("pondering", ""), None);
        let outcome = |outcome: &str, more: &str| {
            said(&format!(
                r#"{{"update":"outcome","robot":"r1","release":"9f2c1ab034d5e6f7","outcome":"{outcome}","reason":"why"{more}}}"#
            ))
        };
        assert_eq!(
            outcome("confirmed", r#","build":"b2""#),
            told(Told::Confirmed(Some(build)))
        );
        assert_eq!(
            outcome("rolled_back", ""),
            whole(Report::RolledBack(code("why")))
        );
        for (more, lasting) in [("", false), (r#","lasting":true"#, true)] {
            let code = code("why");
            assert_eq!(
                outcome("refused", more),
                whole(Report::Refused { code, lasting })
            );
        }
        assert_eq!(outcome("withdrawn", ""), whole(Report::Withdrawn));
        let want =
            r#"{"update":"want","robot":"r1","tag":9,"part":"image","first":16,"missing":3}"#;
        let Some(Said::Want(want)) = said(want) else {
            panic!("{want}");
        };
        assert_eq!(
            (want.tag, want.part, want.first, want.missing),
            (9, Part::Image, 16, 3)
        );
        let have = r#"{"update":"have","robot":"r1","build":"b1","sequence":1,"floor":0}"#;
        assert_eq!(said(have), Some(Said::Have));
    }

    #[test]
    fn what_is_none_of_a_robot_is_passed_over() {
        for text in [
            "",
            "nonsense",
            "\u{1}\0chunk",
            r#"{"update":"offer","release":"9f2c1ab034d5e6f7"}"#,
            r#"{"update":"sing","robot":"r1"}"#,
            r#"{"update":"have","robot":"r2","build":"b1","sequence":1,"floor":0}"#,
        ] {
            assert_eq!(said(text), None, "{text}");
        }
        let long = format!(
            r#"{{"update":"have","robot":"r1","x":"{}"}}"#,
            "x".repeat(2_000)
        );
        assert_eq!(said(&long), None);
    }

    #[test]
    fn what_a_robot_runs_may_be_known_from_elsewhere() {
        let build = |name| BuildId::new(name).unwrap();
        let known = || Some(build("known"));
        assert_eq!(
            Told::Trial(None).with(known),
            Some(Report::Trial(build("known")))
        );
        assert_eq!(Told::Trial(None).with(|| None), None);
        let said = Told::Confirmed(Some(build("said"))).with(known);
        assert_eq!(said, Some(Report::Confirmed(build("said"))));
    }
}
