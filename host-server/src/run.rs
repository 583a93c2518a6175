//! A run of the program, from settings to the end of the process.

use std::io::{IsTerminal as _, Write as _};
use std::time::Duration;

use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing_subscriber::EnvFilter;

use crate::config::{Broker, LogFormat, Role, Settings};
use crate::server::{Robots, Server, StartError, WorkerProcess};
use crawler_system::text::log_fields;

/// Stopping takes at most this long; whatever still hangs then is left to the operating system. Simulated robots alone have 20 s to
/// come to rest, and whatever else hangs is cut short after five.
const LAST_CALL: Duration = Duration::from_secs(45);

/// Why a run ended otherwise than by being told to.
#[derive(Debug)]
#[non_exhaustive]
pub enum RunError {
    /// The log filter is not one.
    Log(String),
    /// The operating system does not give what every program needs.
    System(std::io::Error),
    /// The server did not start.
    Start(StartError),
    /// Stopping took too long.
    Hung,
}

impl std::fmt::Display for RunError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Log(text) => write!(f, "the log filter cannot be used: {text}"),
            Self::System(error) => write!(f, "cannot start: {error}"),
            Self::Start(error) => error.fmt(f),
            Self::Hung => f.write_str("stopping took too long; gave up"),
        }
    }
}

impl std::error::Error for RunError {}

/// Starts what `settings` ask for and runs it until Ctrl-C or SIGTERM. A second one ends the process
/// at once.
///
/// # Errors
/// [`RunError`] when it does not start, or does not stop.
pub fn run(settings: &Settings) -> Result<(), RunError> {
    log_to_stderr(settings)?;
    raise_file_limit();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .thread_name("server")
        .enable_all()
        .build()
        .map_err(RunError::System)?;
    let result = runtime.block_on(until_told(settings));
    runtime.shutdown_timeout(Duration::from_secs(1));
    result
}

/// What runs: with a server or without.
enum Running {
    Server(Box<Server>),
    Robots(Robots),
    Worker(WorkerProcess),
}

impl Running {
    async fn start(settings: &Settings) -> Result<Self, StartError> {
        Ok(match settings.role {
            Role::Up | Role::Serve => Self::Server(Box::new(Server::start(settings).await?)),
            Role::Sim => Self::Robots(Robots::start(settings).await?),
            Role::Worker => Self::Worker(WorkerProcess::start(settings).await?),
        })
    }

    async fn stop(self) {
        match self {
            Self::Server(server) => server.stop().await,
            Self::Robots(robots) => robots.stop().await,
            Self::Worker(worker) => worker.stop().await,
        }
    }
}

async fn until_told(settings: &Settings) -> Result<(), RunError> {
    let mut signals = Signals::new().map_err(RunError::System)?;
    let running = tokio::select! {
        started = Running::start(settings) => started.map_err(RunError::Start)?,
        name = signals.next() => {
            tracing::info!(signal = name, "told to stop while starting");
            return Ok(());
        }
    };
    greet(settings, &running);
    let name = signals.next().await;
    tracing::info!(signal = name, "stopping; once more ends at once");
    tokio::select! {
        stopped = tokio::time::timeout(LAST_CALL, running.stop()) => {
            stopped.map_err(|_| RunError::Hung)?;
        }
        name = signals.next() => {
            tracing::warn!(signal = name, "ending at once");
            std::process::exit(130);
        }
    }
    tracing::info!("stopped");
    Ok(())
}

pub(crate) struct Signals {
    interrupt: Signal,
    terminate: Signal,
}

impl Signals {
    pub(crate) fn new() -> std::io::Result<Self> {
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
        })
    }

    pub(crate) async fn next(&mut self) -> &'static str {
        tokio::select! {
            _ = self.interrupt.recv() => "SIGINT",
            _ = self.terminate.recv() => "SIGTERM",
        }
    }
}

pub(crate) fn log_to_stderr(settings: &Settings) -> Result<(), RunError> {
    let filter = EnvFilter::try_new(&settings.log)
        .map_err(|error| RunError::Log(format!("`{}`: {error}", settings.log)))?;
    let log = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr);
    let result = match settings.log_format {
        LogFormat::Text => log
            .fmt_fields(log_fields())
            .with_ansi(std::io::stderr().is_terminal())
            .try_init(),
        LogFormat::Json => log.json().flatten_event(true).try_init(),
    };
    result.map_err(|error| RunError::Log(error.to_string()))
}

/// Every robot in this process takes two files, one for each end of its connection.
fn raise_file_limit() {
    match rlimit::increase_nofile_limit(u64::MAX) {
        Ok(limit) => tracing::debug!(limit, "open files"),
        Err(error) => tracing::warn!(%error, "cannot raise the limit of open files"),
    }
}

/// Says where everything is.
fn greet(settings: &Settings, running: &Running) {
    // A closed pipe is no reason to stop.
    let text = match running {
        Running::Server(server) => greeting(settings, server),
        Running::Robots(robots) => format!(
            "{} simulated robots of fleet `{}` are on their way to {}.\nCtrl-C stops and ends them.\n",
            robots.count(),
            settings.fleet,
            robots.broker()
        ),
        Running::Worker(worker) => format!(
            "Working on experiments as `{}`, {} trials at a time, build {}.\n\
             Ctrl-C gives back what is under way and ends it.\n",
            worker.name(),
            worker.threads(),
            crawler_experiments::BUILD
        ),
    };
    let _ = write!(std::io::stdout(), "{text}");
    let exposed = if settings.open {
        settings.exposed()
    } else {
        Vec::new()
    };
    for (what, address) in exposed {
        tracing::warn!(
            %address,
            "{what}: reachable from other machines, and open: there is no authentication, anybody \
             who reaches it can steer the robots"
        );
    }
}

fn greeting(settings: &Settings, server: &Server) -> String {
    let http = server.http();
    let scheme = if server.https() { "https" } else { "http" };
    // A page must be opened at an address, even when we listen at all of them.
    let page = if http.ip().is_unspecified() {
        format!("{scheme}://localhost:{}", http.port())
    } else {
        format!("{scheme}://{http}")
    };
    let pin = server.authority().map_or_else(String::new, |path| {
        format!("  TLS           clients trust {}\n", path.display())
    });
    let whose = match settings.broker {
        Broker::Embedded(_) => "embedded",
        Broker::Outside(_) => "outside",
    };
    let robots = match settings.role {
        Role::Up => format!("  robots        {} simulated\n", server.simulated()),
        Role::Serve | Role::Sim | Role::Worker => String::new(),
    };
    let access = access(settings, server.invitation());
    format!(
        "Terracrawler is running.\n  \
           control room  {page}/\n  \
           API           {page}/api/v1/openapi.json\n  \
           MQTT broker   {} ({whose}), fleet `{}`\n\
         {pin}{robots}{access}Ctrl-C stops the robots and ends the program.\n",
        server.mqtt(),
        settings.fleet
    )
}

/// Who can get in, and how the first one does.
fn access(settings: &Settings, invitation: Option<&str>) -> String {
    let mut text = if settings.exposed().is_empty() {
        "Only this machine can connect".to_owned()
    } else if settings.open {
        "OTHER MACHINES CAN CONNECT".to_owned()
    } else {
        "Other machines can connect".to_owned()
    };
    text.push_str(if settings.open {
        ", and the server is open: whoever connects can steer.\n"
    } else {
        ". People need an account, robots a secret.\n"
    });
    if let Some(link) = invitation {
        text.push_str(
            "Nobody can administer it yet. Whoever opens this address can, once, within a day:\n",
        );
        text.push_str("  ");
        text.push_str(link);
        text.push('\n');
    }
    text
}
