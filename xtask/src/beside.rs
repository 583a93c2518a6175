//! Steps beside others. The program of a board is linked by one core, and most tests wait for sockets and
//! processes: what that leaves of the cores another process of this program has, at the lowest priority.

use std::fs::{self, File};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};

use crate::report::Report;
use crate::run::{self, Failure, Outcome};
use crate::{check_s3, test};

/// Steps that such a process takes.
#[derive(Debug)]
pub(crate) struct Steps {
    /// The hidden command of the process.
    name: &'static str,
    take: fn(&mut Report),
}

/// Beside the program of the emulated board.
pub(crate) const CONTROL_ROOM: Steps = Steps {
    name: "steps-beside-a-board",
    take: |report| report.step("control room", |_| test::control_room()),
};

/// Beside the tests: what has a folder of its own to be built in.
pub(crate) const BOARDS: Steps = Steps {
    name: "steps-beside-the-tests",
    take: |report| {
        report.step("images of the boards", |_| test::images());
        report.step("clippy of boards", |_| test::clippy_of_boards());
        report.step("check of the S3 board", |_| check_s3::command(&[]));
    },
};

/// Takes the steps whose hidden command is `name`; `None` when that is another command.
pub(crate) fn command(name: &str) -> Option<Outcome> {
    let steps = [CONTROL_ROOM, BOARDS];
    let steps = steps.into_iter().find(|steps| steps.name == name)?;
    let mut report = Report::default();
    (steps.take)(&mut report);
    // The list of all steps is printed by whoever started this.
    Some(report.outcome())
}

/// The process. Dropped before its end, it is ended.
#[derive(Debug)]
pub(crate) struct Beside {
    process: Child,
    /// What it prints, which is shown when it has ended, and not amid what others print.
    output: PathBuf,
}

impl Beside {
    /// Starts `steps`.
    ///
    /// # Errors
    /// When the process cannot be started.
    pub(crate) fn start(steps: &Steps) -> Outcome<Self> {
        let name = steps.name;
        let failed = |error| Failure(format!("cannot start the {name}: {error}"));
        let program = run::this_program()?;
        let folder = run::root().join(run::target_dir());
        fs::create_dir_all(&folder).map_err(failed)?;
        let output = folder.join(format!("{name}.txt"));
        let file = File::create(&output).map_err(failed)?;
        let mut command = match run::output("nice", &["true"]) {
            Some(_) => {
                let mut command = Command::new("nice");
                command.args(["-n", "19"]).arg(program);
                command
            }
            None => Command::new(program),
        };
        let process = command
            .arg(name)
            .stdin(Stdio::null())
            .stdout(file.try_clone().map_err(failed)?)
            .stderr(file)
            .spawn()
            .map_err(failed)?;
        Ok(Self { process, output })
    }

    /// Waits for the steps, shows what they printed, and tells `report` how each went.
    ///
    /// # Errors
    /// When the process did not come to its end; a step that failed is told to `report` alone.
    pub(crate) fn end(mut self, report: &mut Report) -> Outcome {
        let lost = |error| Failure(format!("what they came to is lost: {error}"));
        let status = self.process.wait().map_err(lost)?;
        let printed = fs::read(&self.output).map_err(lost)?;
        let printed = String::from_utf8_lossy(&printed);
        println!("{printed}");
        let failed = report.steps_of(&printed);
        if status.success() || failed {
            Ok(())
        } else {
            Err(Failure(format!("they ended with {status}")))
        }
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // Already ended is fine.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
