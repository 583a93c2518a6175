//! `terracrawler release`: keys, and releases as files. Needs neither a server nor a network, but for `add`, which is
//! the console's.

mod args;
mod delta;
pub(crate) mod gate;
pub(crate) mod table;

use std::fs::File;
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::process::ExitCode;

use crawler_bundle::Bundle;
use crawler_release::{KeyId, Kind, MAX_IMAGE, PublicKey, Requires};
use crawler_sim::scenario::Trained;
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::unix_ms;
use crawler_updates::gate::{GATE_MAX, GateFault, GateReport, check, signer};
use crawler_updates::release::{
    Expected, FILE_MAX, Fault, SecretKey, SignFault, SignOptions, inspect, join, public_from_pem,
};

pub use args::{
    AddArgs, BundleArgs, DeltaArgs, GateArgs, ReleaseArgs, ReleaseTask, SignArgs, VerifyArgs,
};

/// The files that `keygen` makes.
const PRIVATE: &str = "release-key.pem";
const PUBLIC: &str = "release-public.pem";

/// The name of the one model that is no policy.
const EYES: &str = "eyes";

/// Most bytes of a file with a key.
const KEY_MAX: usize = 16 * 1_024;

/// Does what the command line asks for, where that takes no server: `None` where it does. 1 when it cannot be done, or
/// a release is not what it should be.
#[must_use]
pub fn run(args: &ReleaseArgs) -> Option<ExitCode> {
    let done = match &args.task {
        ReleaseTask::Keygen { out } => keygen(out),
        ReleaseTask::Bundle(args) => bundle(args),
        ReleaseTask::Sign(args) => sign(args),
        ReleaseTask::Verify(args) => verify(args),
        ReleaseTask::Delta(args) => delta::run(args),
        ReleaseTask::Gate(args) => gate::run(args),
        ReleaseTask::Add(_) => return None,
    };
    Some(done.unwrap_or_else(|error| error.tell()))
}

fn keygen(folder: &Path) -> Result<ExitCode, CliError> {
    std::fs::create_dir_all(folder)
        .or_say(|error| format!("cannot make {}: {error}", folder.display()))?;
    let key = SecretKey::generate()?;
    let (private, public) = (folder.join(PRIVATE), folder.join(PUBLIC));
    // Neither without the other: a public key of something else beside the private one is a trap.
    for path in [&private, &public] {
        if path.exists() {
            return Err(CliError::new(exists(path)));
        }
    }
    write_new(&private, 0o600, &[key.to_pem().as_bytes()])?;
    write_new(&public, 0o644, &[key.public_pem().as_bytes()])?;
    println!("key      {}", key.public().id());
    println!("private  {}", private.display());
    println!("public   {}", public.display());
    eprintln!(
        "Whoever has the private key can sign programs for every robot that knows the public one. Keep it \
         off the server, and a copy of it elsewhere: it cannot be made again."
    );
    Ok(ExitCode::SUCCESS)
}

fn bundle(args: &BundleArgs) -> Result<ExitCode, CliError> {
    let mut bundle = Bundle::new(&args.version, &args.build);
    bundle.parameters.clone_from(&args.set);
    bundle.parameters.sort_by(|one, other| one.0.cmp(&other.0));
    bundle.defects.clone_from(&args.defect);
    bundle.defects.sort_by_key(|defect| defect.kind);
    let image = bundle.image(args.size, args.seed);
    let image = image?;
    write_new(&args.out, 0o644, &[&image])?;
    println!("image    {}", args.out.display());
    println!("bytes    {}", image.len());
    for defect in &bundle.defects {
        println!("defect   {defect}");
    }
    Ok(ExitCode::SUCCESS)
}

fn sign(args: &SignArgs) -> Result<ExitCode, CliError> {
    let text = read_text(&args.key)?;
    let key = SecretKey::from_pem(&text).or_say(|fault| told(&args.key, &fault))?;
    let image = read(&args.image, MAX_IMAGE as usize)?;
    if args.kind == Kind::Policy {
        policy(args.name.as_deref(), &image).map_err(|error| error.of(args.image.display()))?;
    }
    let now = unix_ms() / 1_000;
    let expires = args.expires.map(|end| end.unix(now));
    if expires.is_some_and(|end| end <= now) {
        return Err(CliError::new(
            "the release would have expired already (--expires)",
        ));
    }
    let options = SignOptions {
        kind: args.kind,
        name: args.name.as_deref(),
        board: &args.board,
        chip: args.chip,
        version: &args.version,
        build: args.build.as_deref(),
        sequence: args.sequence,
        floor: args.floor,
        expires,
        requires: Requires {
            sequence: args.requires_sequence,
            protocol: args.requires_protocol,
        },
    };
    let envelope = options.sign(&image, &key).or_say(|fault| match fault {
        SignFault::Image(fault) => told(&args.image, fault),
        other => other.to_string(),
    })?;
    let file = join(&envelope, &image)?;
    write_new(&args.out, 0o644, &[&file])?;
    let expected = Expected {
        now,
        ..Expected::default()
    };
    let made = inspect(&file, &[key.public()], &expected)?;
    print!("{}", table::text(&args.out, &made));
    Ok(ExitCode::SUCCESS)
}

/// Whether robots would drive by an image under this name.
fn policy(name: Option<&str>, image: &[u8]) -> Result<(), CliError> {
    if name == Some(EYES) {
        return Err(CliError::new(format!(
            "{EYES} is the name of a detector: call the policy something else"
        )));
    }
    Trained::new(name.unwrap_or_default(), image.to_vec())?;
    Ok(())
}

fn verify(args: &VerifyArgs) -> Result<ExitCode, CliError> {
    let keys: Vec<PublicKey> = args
        .public
        .iter()
        .map(|path| public_from_pem(&read_text(path)?).or_say(|fault| told(path, &fault)))
        .collect::<Result<_, _>>()?;
    let file = read(&args.file, FILE_MAX)?;
    let image = args.image.as_deref();
    let image = image
        .map(|path| read(path, MAX_IMAGE as usize))
        .transpose()?;
    let expected = Expected {
        board: args.board.as_deref(),
        above: args.above,
        image: image.as_deref(),
        now: unix_ms() / 1_000,
    };
    let found = inspect(&file, &keys, &expected);
    let mut found = found.or_say(|fault| told(&args.file, &fault))?;
    let gate = match &args.gate {
        Some(path) => Some(Gate::read(path, &keys, &found.id.to_string())?),
        None => None,
    };
    if let Some(fault) = gate.as_ref().and_then(Gate::fault) {
        found.faults.push(Fault {
            code: fault.code(),
            text: fault.to_string(),
        });
    }
    if args.json {
        let mut object = table::json(&args.file, &found);
        object["gate"] = gate.as_ref().map(Gate::json).into();
        println!("{object}");
    } else {
        print!("{}", table::text(&args.file, &found));
        print!("{}", gate.map(|gate| gate.text()).unwrap_or_default());
    }
    Ok(if found.faults.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// A report on a release, from a file.
pub(crate) struct Gate<'a> {
    path: &'a Path,
    key: KeyId,
    /// What is in the file.
    pub(crate) file: Vec<u8>,
    /// What it says, if it is believed.
    pub(crate) report: Result<GateReport, GateFault>,
}

impl<'a> Gate<'a> {
    /// Reads one that is to be about `release`.
    ///
    /// # Errors
    /// When the file cannot be read, or is none of a report.
    pub(crate) fn read(
        path: &'a Path,
        keys: &[PublicKey],
        release: &str,
    ) -> Result<Self, CliError> {
        let file = read(path, GATE_MAX)?;
        let key = signer(&file).or_say(|fault| told(path, &fault))?;
        let report = check(&file, keys, release);
        Ok(Self {
            path,
            key,
            file,
            report,
        })
    }

    /// What is against it: it is not believed, or says that the release did not pass.
    fn fault(&self) -> Option<GateFault> {
        match &self.report {
            Ok(report) if report.passed => None,
            Ok(_) => Some(GateFault::Failed),
            Err(fault) => Some(fault.clone()),
        }
    }

    /// The table.
    pub(crate) fn text(&self) -> String {
        gate::shown::text(self.path, self.key, &self.report)
    }

    fn json(&self) -> serde_json::Value {
        gate::shown::json(self.path, &self.report)
    }
}

pub(crate) fn told(path: &Path, what: &dyn std::fmt::Display) -> String {
    format!("{}: {what}", path.display())
}

fn exists(path: &Path) -> String {
    format!("{} exists already, and is not written over", path.display())
}

/// Reads a file of at most so many bytes.
pub(crate) fn read(path: &Path, most: usize) -> Result<Vec<u8>, CliError> {
    let refused = |error: &io::Error| format!("cannot read {}: {error}", path.display());
    let file = File::open(path).or_say(refused)?;
    let mut bytes = Vec::new();
    // One more than there may be tells that there are too many.
    file.take(most as u64 + 1)
        .read_to_end(&mut bytes)
        .or_say(refused)?;
    if bytes.len() > most {
        return Err(CliError::new(told(
            path,
            &format!("more than {most} bytes"),
        )));
    }
    Ok(bytes)
}

fn read_text(path: &Path) -> Result<String, CliError> {
    String::from_utf8(read(path, KEY_MAX)?).or_say(|_| told(path, &"not a key in PEM"))
}

/// Writes a file that is not there yet, and all of it or nothing.
fn write_new(path: &Path, mode: u32, parts: &[&[u8]]) -> Result<(), CliError> {
    let mut options = File::options();
    options.write(true).create_new(true).mode(mode);
    let mut file = options.open(path).or_say(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => exists(path),
        _ => format!("cannot write {}: {error}", path.display()),
    })?;
    let written = parts
        .iter()
        .try_for_each(|part| file.write_all(part))
        .and_then(|()| file.sync_all());
    written.or_say(|error| {
        // Half a key or half a release is of no use to anybody.
        let _ = std::fs::remove_file(path);
        format!("cannot write {}: {error}", path.display())
    })
}
