//! The console: accounts, credentials, releases, audit log and backups, from the shell of the server's machine.
//!
//! Every command but those of rollouts and calibrations works on the data directory, or on the database that `--database` names, beside
//! a running server or without one: the records take several processes. A running server looks for what the console changed every few seconds.
//! What a command does is written to the audit log under `console:NAME`, where NAME is the person's
//! name on this machine.

mod args;
mod audit;
mod backup;
mod doctor;
mod mosquitto;
mod releases;
mod robots;
mod users;

use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::Path;
use std::process::ExitCode;

use crawler_records::{Entry, Records, RecordsError};
use serde_json::Value;

use crate::config::Settings;
use crate::learn_node::{self, LearnNodeArgs};
use crate::release::AddArgs;
use crate::rollout::{self, RolloutArgs};
use crate::twin::{self, TwinArgs};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::now_ms;

pub use args::{
    AuditArgs, AuditTask, BackupArgs, RestoreArgs, RobotArgs, RobotTask, UserArgs, UserTask, Whose,
};
pub use mosquitto::{MosquittoArgs, MosquittoTask};

/// Longest name of a person on this machine that goes into the log.
const LONGEST_NAME: usize = 48;

/// Does one thing. 1 when it cannot be done.
#[must_use]
pub fn run(task: Task, settings: &Settings) -> ExitCode {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let runtime = match runtime {
        Ok(runtime) => runtime,
        Err(error) => {
            let error = CliError::new(format!("cannot start: {error}"));
            return error.tell();
        }
    };
    // What is left of a broker that does not answer must not hold up the end.
    let result = runtime.block_on(task.run(settings));
    runtime.shutdown_background();
    result.unwrap_or_else(|error| error.tell())
}

/// What the console does.
#[derive(Debug)]
pub enum Task {
    /// Accounts of people.
    User(UserArgs),
    /// Credentials of robots and simulators.
    Robot(RobotArgs),
    /// A release, to be added.
    AddRelease(AddArgs),
    /// Rollouts of a server that runs.
    Rollout(RolloutArgs),
    /// Twins of a server that runs.
    Twin(Box<TwinArgs>),
    /// A node of a training.
    LearnNode(Box<LearnNodeArgs>),
    /// Who did what.
    Audit(AuditArgs),
    /// Copies everything to one file.
    Backup(BackupArgs),
    /// Puts that back.
    Restore(RestoreArgs),
    /// Configurations for another broker.
    Mosquitto(MosquittoArgs),
    /// Checks what a server needs.
    Doctor,
}

impl Task {
    async fn run(self, settings: &Settings) -> Result<ExitCode, CliError> {
        match self {
            Self::User(args) => users::run(args.task, settings).await?,
            Self::Robot(args) => robots::run(args.task, settings).await?,
            Self::AddRelease(args) => return releases::add(&args, settings).await,
            Self::Rollout(args) => return rollout::run(args, settings).await,
            Self::Twin(args) => return twin::ask(&args, settings).await,
            Self::LearnNode(args) => return learn_node::run(&args, settings).await,
            Self::Audit(args) => return audit::run(args.task, settings).await,
            Self::Backup(args) => backup::backup(&args.file, settings).await?,
            Self::Restore(args) => backup::restore(&args.file, args.replace, settings).await?,
            Self::Mosquitto(args) => mosquitto::run(&args.task, settings)?,
            Self::Doctor => return Ok(doctor::run(settings).await),
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// The records, and who is at the keyboard.
struct Console {
    records: Records,
    who: String,
}

impl Console {
    /// Opens the records. `make` says whether they may be made: a typing mistake in `--data` or
    /// `--database` must not look like a server without accounts.
    async fn open(settings: &Settings, make: bool) -> Result<Self, CliError> {
        if settings.database.is_some() {
            // Accounts, credentials and audit log need no data directory then.
            return Self::connect(settings, None, make).await;
        }
        let data = &settings.data;
        if make && !data.exists() {
            crawler_system::data::make_private(data)
                .or_say(|error| format!("cannot make {}: {error}", data.display()))?;
        }
        check_owner(data)?;
        if !make && !data.join(crawler_records::RECORDS_FILE).exists() {
            return Err(CliError::new(format!(
                "{} holds no records: is it the data directory of the server (--data)?",
                data.display()
            )));
        }
        let records = Records::open(data).await?;
        Ok(Self::of(records))
    }

    /// The same with the history, for backups.
    async fn open_all(settings: &Settings) -> Result<Self, CliError> {
        if settings.database.is_none() {
            return Self::open(settings, false).await;
        }
        check_owner(&settings.data)?;
        Self::connect(settings, Some(&settings.data), false).await
    }

    async fn connect(
        settings: &Settings,
        history: Option<&Path>,
        make: bool,
    ) -> Result<Self, CliError> {
        let Some(url) = &settings.database else {
            return Err(CliError::new("no database is named (--database)"));
        };
        match Records::connect(url.reveal(), history, make).await {
            Ok(records) => Ok(Self::of(records)),
            Err(RecordsError::NotFound) => Err(CliError::new(format!(
                "{url} holds no records: is it the database of the server (--database)?"
            ))),
            Err(error) => Err(error.into()),
        }
    }

    fn of(records: Records) -> Self {
        let who = operator();
        Self { records, who }
    }

    /// Writes down what was done, or refused, and passes the result on.
    async fn noted<T>(
        &self,
        action: &str,
        target: &str,
        detail: Value,
        result: Result<T, RecordsError>,
    ) -> Result<T, CliError> {
        let outcome = match &result {
            Ok(_) => "ok".to_owned(),
            Err(error) => format!("refused: {error}"),
        };
        self.note(action, target, detail, &outcome).await?;
        result.map_err(CliError::from)
    }

    async fn note(
        &self,
        action: &str,
        target: &str,
        detail: Value,
        outcome: &str,
    ) -> Result<(), CliError> {
        let entry = Entry {
            at: now_ms(),
            who: self.who.clone(),
            from: "console".into(),
            action: action.into(),
            target: target.into(),
            detail,
            outcome: outcome.chars().take(100).collect(),
        };
        self.records
            .audit()
            .append(entry)
            .await
            .map(drop)
            .or_say(|error| format!("the audit log cannot be written: {error}"))
    }

    /// Everything is on disk when this returns.
    async fn close(self) {
        self.records.close().await;
    }
}

/// Files that root makes in a directory of the server's account are files the server cannot write.
fn check_owner(data: &Path) -> Result<(), CliError> {
    let owner = match std::fs::metadata(data) {
        Ok(metadata) => metadata.uid(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            return Err(CliError::new(format!(
                "there is no data directory {}: name the server's with --data",
                data.display()
            )));
        }
        Err(error) => {
            return Err(CliError::new(format!(
                "cannot read {}: {error}",
                data.display()
            )));
        }
    };
    if owner == rustix::process::geteuid().as_raw() {
        return Ok(());
    }
    Err(CliError::new(format!(
        "{} belongs to another account (user {owner}): run this as that one, like `sudo -u '#{owner}' \
         terracrawler …`",
        data.display()
    )))
}

/// Who is at the keyboard, as the machine calls them. Whoever can write the records can claim any
/// name; it is there for honest people who look for each other.
fn operator() -> String {
    let named = ["SUDO_USER", "USER", "LOGNAME"]
        .into_iter()
        .filter_map(|variable| std::env::var(variable).ok())
        .map(|name| {
            name.chars()
                .filter(|c| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-'))
                .take(LONGEST_NAME)
                .collect::<String>()
        })
        .find(|name| !name.is_empty());
    let name = named.unwrap_or_else(|| format!("uid-{}", rustix::process::getuid().as_raw()));
    format!("console:{name}")
}
