//! The emulated board as a device on the bench: QEMU with a robot's image, a serial line, a
//! network cable that can be pulled, and flash in a file.
//!
//! The image resets the machine in place, so that a reboot of the program is none of the emulator;
//! [`Emulator::power_cycle`] is what cuts its power. Each emulator is a process of its own, ended by
//! its own id when the value is dropped, also while a test panics.

mod banks;
mod error;
mod qmp;
mod serial;

use std::ffi::OsString;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crawler_image_format::elf::{self, ElfError};
use crawler_image_format::keys::{self, KEY};
use crawler_protocol::{Fleet, RobotId};
use tempfile::TempDir;

use crate::BrokerUrl;
use qmp::Qmp;
use serial::Log;

pub use error::EmulatorError;
pub use serial::Line;

/// Where the image of the emulated board lies below a target directory.
pub const IMAGE: &str = "boards/riscv32imac-unknown-none-elf/release/crawler-virt";
/// Name of its boot stage, which lies beside it.
const BOOT_STAGE: &str = "crawler-virt-boot";
/// Names another image.
pub const IMAGE_VARIABLE: &str = "CRAWLER_VIRT_ELF";
/// The emulator.
pub const QEMU: &str = "qemu-system-riscv32";

/// This machine, as an emulated one sees it.
const HOST: &str = "10.0.2.2";
/// For the emulator to offer its control socket.
const STARTS: Duration = Duration::from_mins(1);

/// What to emulate.
#[derive(Debug, Clone)]
pub struct Options {
    /// The program, an ELF file, beside which the boot stage lies. The board is flashed with it unless it
    /// was flashed with the same one before: updates of it survive.
    pub image: PathBuf,
    /// Id of the robot.
    pub robot: RobotId,
    /// Its fleet.
    pub fleet: Fleet,
    /// Its broker, as this machine knows it.
    pub broker: BrokerUrl,
    /// Further boot arguments, like `fault=ranger-dead`.
    pub arguments: Vec<String>,
    /// The file that is its flash, made when it is not there; none is one that ends with the
    /// emulator.
    pub flash: Option<PathBuf>,
    /// Public keys of the releases that it takes: uncompressed points of P-256. Without any it takes none.
    pub release_keys: Vec<[u8; KEY]>,
    /// Ports of this machine's loopback that lead to ports of the robot: ours, its.
    pub forwards: Vec<(u16, u16)>,
}

impl Options {
    /// A robot without faults and with fresh flash.
    pub fn new(image: PathBuf, robot: RobotId, broker: BrokerUrl) -> Self {
        Self {
            image,
            robot,
            fleet: Fleet::default(),
            broker,
            arguments: Vec::new(),
            flash: None,
            release_keys: Vec::new(),
            forwards: Vec::new(),
        }
    }

    /// The image that the board is flashed with: the program, with its release keys. A release of it is this image
    /// as well.
    ///
    /// # Errors
    /// [`EmulatorError`] when the program cannot be read, or is none.
    pub fn program(&self) -> Result<Vec<u8>, EmulatorError> {
        let mut elf = read(&self.image)?;
        if !self.release_keys.is_empty() {
            keys::set(&mut elf, &self.release_keys).map_err(|error| {
                EmulatorError::NotAnImage(self.image.clone(), error.to_string())
            })?;
        }
        image_of(&self.image, &elf, elf::image)
    }

    /// The network card's other end, as QEMU is told.
    fn network(&self) -> String {
        let forwards = self.forwards.iter().map(|(ours, theirs)| {
            // Loopback alone: nobody else on the network of this machine.
            format!(",hostfwd=tcp:127.0.0.1:{ours}-:{theirs}")
        });
        std::iter::once("user,id=n0".to_owned())
            .chain(forwards)
            .collect()
    }

    /// The boot arguments in one line.
    ///
    /// # Errors
    /// [`EmulatorError::Argument`] for one that would fall apart at a blank.
    fn line(&self) -> Result<String, EmulatorError> {
        let host = match self.broker.host.as_str() {
            // Its own loopback is not ours.
            "127.0.0.1" | "localhost" | "[::1]" => HOST,
            host => host,
        };
        let mut words = vec![
            format!("id={}", self.robot),
            format!("fleet={}", self.fleet),
            format!("broker={host}:{}", self.broker.port),
        ];
        if let Some((user, password)) = &self.broker.credentials {
            words.push(format!("user={user}"));
            words.push(format!("password={password}"));
        }
        words.extend(self.arguments.iter().cloned());
        let falls_apart = |word: &&String| word.contains(char::is_whitespace);
        match words.iter().find(falls_apart) {
            // Whatever stands before the sign is no secret.
            Some(word) => Err(EmulatorError::Argument(
                word.split('=').next().unwrap_or_default().to_owned(),
            )),
            None => Ok(words.join(" ")),
        }
    }
}

/// The command for QEMU, which gets a processor before everything else that wants one, where that is
/// allowed: a board runs in real time, sleeps nearly always, and one that wakes too late has missed
/// what its body told it.
fn in_time() -> Command {
    // The lowest of the real-time priorities (sched(7)).
    let first = || {
        let mut command = Command::new("chrt");
        command.args(["--rr", "1", QEMU]);
        command
    };
    // This fails where it is not allowed, and where there is no QEMU.
    let allowed = first().arg("-version").stdin(Stdio::null()).output();
    if allowed.is_ok_and(|output| output.status.success()) {
        first()
    } else {
        Command::new(QEMU)
    }
}

/// Where the image should be: at `CRAWLER_VIRT_ELF`, else below the target directory that the
/// running program was built in.
///
/// # Errors
/// [`EmulatorError::NoImage`] when it is not there.
pub fn image() -> Result<PathBuf, EmulatorError> {
    if let Some(named) = std::env::var_os(IMAGE_VARIABLE) {
        let named = PathBuf::from(named);
        return if named.is_file() {
            Ok(named)
        } else {
            Err(EmulatorError::NoImage(named))
        };
    }
    built(IMAGE).ok_or_else(|| EmulatorError::NoImage(Path::new("target").join(IMAGE)))
}

/// The boot stage that lies beside `image`, or else where the build puts it.
fn boot_stage(image: &Path) -> Result<PathBuf, EmulatorError> {
    let beside = image.with_file_name(BOOT_STAGE);
    if beside.is_file() {
        return Ok(beside);
    }
    let usual = Path::new(IMAGE).with_file_name(BOOT_STAGE);
    built(&usual.to_string_lossy()).ok_or(EmulatorError::NoImage(beside))
}

fn read(path: &Path) -> Result<Vec<u8>, EmulatorError> {
    std::fs::read(path).map_err(|error| EmulatorError::File(path.to_owned(), error))
}

/// What `convert` makes of the ELF file at `path`.
fn image_of(
    path: &Path,
    elf: &[u8],
    convert: impl Fn(&[u8]) -> Result<Vec<u8>, ElfError>,
) -> Result<Vec<u8>, EmulatorError> {
    convert(elf).map_err(|error| EmulatorError::NotAnImage(path.to_owned(), error.to_string()))
}

/// A file below the target directory that the running program was built in.
fn built(file: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().unwrap_or_default();
    program
        .ancestors()
        .map(|folder| folder.join(file))
        .find(|path| path.is_file())
}

/// A board under emulation.
pub struct Emulator {
    options: Options,
    /// The parts of one power-on.
    machine: Option<Machine>,
    log: Arc<Log>,
    /// Control socket, boot stage, and flash that nobody named.
    folder: TempDir,
    boot: PathBuf,
    flash: PathBuf,
    starts: u32,
}

struct Machine {
    child: Child,
    control: Qmp,
    reader: std::thread::JoinHandle<()>,
    said: PathBuf,
}

impl Emulator {
    /// Switches a board on.
    ///
    /// # Errors
    /// [`EmulatorError`] says in one line what is missing.
    pub fn start(options: Options) -> Result<Self, EmulatorError> {
        let folder = tempfile::Builder::new()
            .prefix("hil-")
            .tempdir()
            .map_err(|error| EmulatorError::File(std::env::temp_dir(), error))?;
        let flash = match &options.flash {
            Some(flash) => flash.clone(),
            None => folder.path().join("flash"),
        };
        let log = Arc::new(Log::read_by(&options.image)?);
        let program = options.program()?;
        let stage = boot_stage(&options.image)?;
        let stage = image_of(&stage, &read(&stage)?, elf::boot_stage)?;
        let boot = folder.path().join("boot");
        banks::boot(&boot, &stage).map_err(|error| EmulatorError::File(boot.clone(), error))?;
        banks::flash(&flash, &program)
            .map_err(|error| EmulatorError::File(flash.clone(), error))?;
        let mut emulator = Self {
            options,
            machine: None,
            log,
            folder,
            boot,
            flash,
            starts: 0,
        };
        emulator.power_on()?;
        Ok(emulator)
    }

    fn power_on(&mut self) -> Result<(), EmulatorError> {
        self.starts += 1;
        let path = |name: &str| self.folder.path().join(format!("{name}-{}", self.starts));
        let (socket, said) = (path("control"), path("said"));
        let stderr =
            File::create(&said).map_err(|error| EmulatorError::File(said.clone(), error))?;
        // The machine starts in the first flash bank: QEMU 7.2 loads no kernel when the second one is there, but
        // takes boot arguments only along with one, which nobody looks at.
        let kernel = path("kernel");
        std::fs::write(&kernel, "none\n")
            .map_err(|error| EmulatorError::File(kernel.clone(), error))?;
        let mut child = in_time()
            .args(["-M", "virt", "-smp", "1", "-m", "32M"])
            .args(["-bios", "none"])
            .arg("-kernel")
            .arg(&kernel)
            .arg("-append")
            .arg(self.options.line()?)
            .args(["-display", "none", "-monitor", "none"])
            .args(["-chardev", "stdio,id=uart,signal=off"])
            .args(["-serial", "chardev:uart"])
            .args(["-netdev", &self.options.network()])
            .args(["-device", "virtio-net-device,netdev=n0"])
            .arg("-drive")
            .arg(option(
                "if=pflash,unit=0,format=raw,readonly=on,file=",
                &self.boot,
                "",
            ))
            .arg("-drive")
            .arg(option("if=pflash,unit=1,format=raw,file=", &self.flash, ""))
            .arg("-qmp")
            .arg(option("unix:", &socket, ",server=on,wait=off"))
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(stderr)
            .spawn()
            .map_err(|error| match error.kind() {
                std::io::ErrorKind::NotFound => EmulatorError::NoQemu,
                _ => EmulatorError::Start(error),
            })?;
        let serial = child.stdout.take();
        let log = Arc::clone(&self.log);
        let reader = std::thread::spawn(move || {
            if let Some(serial) = serial {
                log.read(serial);
            }
        });
        let control = match reach(&socket, &mut child, &said) {
            Ok(control) => control,
            Err(error) => {
                end(&mut child);
                let _ = reader.join();
                return Err(error);
            }
        };
        self.machine = Some(Machine {
            child,
            control,
            reader,
            said,
        });
        Ok(())
    }

    /// Id of the robot.
    pub const fn robot(&self) -> &RobotId {
        &self.options.robot
    }

    /// Id of the process, while it runs.
    pub fn process(&self) -> Option<u32> {
        self.machine.as_ref().map(|machine| machine.child.id())
    }

    /// Checks that the emulator runs.
    ///
    /// # Errors
    /// [`EmulatorError::Ended`] when it does not.
    pub fn check(&mut self) -> Result<(), EmulatorError> {
        match &mut self.machine {
            Some(machine) => match machine.child.try_wait() {
                Ok(Some(status)) => Err(ended(status, &machine.said)),
                Ok(None) | Err(_) => Ok(()),
            },
            None => Err(EmulatorError::Control("it is switched off".into())),
        }
    }

    fn control(
        &mut self,
        command: &str,
        arguments: &serde_json::Value,
    ) -> Result<(), EmulatorError> {
        self.check()?;
        match &mut self.machine {
            Some(machine) => machine.control.execute(command, arguments),
            None => Ok(()),
        }
    }

    /// Pulls the network cable (`false`) or plugs it in again (`true`).
    ///
    /// # Errors
    /// [`EmulatorError`] when the emulator does not do so.
    pub fn set_link(&mut self, up: bool) -> Result<(), EmulatorError> {
        self.control("set_link", &serde_json::json!({"name": "n0", "up": up}))
    }

    /// Presses the reset button.
    ///
    /// # Errors
    /// [`EmulatorError`] when the emulator does not do so.
    pub fn reset(&mut self) -> Result<(), EmulatorError> {
        self.control("system_reset", &serde_json::json!({}))
    }

    /// Stops the machine's clock (`true`), or lets it go on: a robot that neither moves nor
    /// answers, with its connection as it was.
    ///
    /// # Errors
    /// [`EmulatorError`] when the emulator does not do so.
    pub fn freeze(&mut self, frozen: bool) -> Result<(), EmulatorError> {
        let command = if frozen { "stop" } else { "cont" };
        self.control(command, &serde_json::json!({}))
    }

    /// Cuts the power and switches it on again. RAM is lost, flash is not.
    ///
    /// # Errors
    /// [`EmulatorError`] when it does not start again.
    pub fn power_cycle(&mut self) -> Result<(), EmulatorError> {
        self.power_off();
        self.power_on()
    }

    /// Cuts the power.
    pub fn power_off(&mut self) {
        if let Some(mut machine) = self.machine.take() {
            end(&mut machine.child);
            // Its pipe is closed now.
            let _ = machine.reader.join();
        }
    }

    /// Everything the board logged so far, as far as it is remembered.
    pub fn lines(&self) -> Vec<Line> {
        self.log.lines()
    }

    /// How many lines the board has logged.
    pub fn logged(&self) -> u64 {
        self.log.count()
    }

    /// The lines that came after the first `count`; waits for one until `until`.
    pub fn lines_after(&self, count: u64, until: Instant) -> Vec<Line> {
        self.log.after(count, until)
    }

    /// Waits until the board has logged a line with `text` in it; also finds an earlier one.
    pub fn wait_line(&self, text: &str, limit: Duration) -> Option<Line> {
        let until = Instant::now() + limit;
        let mut seen = 0;
        loop {
            let lines = self.log.after(seen, until);
            if let Some(line) = lines.iter().find(|line| line.text.contains(text)) {
                return Some(line.clone());
            }
            if lines.is_empty() {
                return None;
            }
            seen += lines.len() as u64;
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.power_off();
    }
}

/// Ends a process of ours.
fn end(child: &mut Child) {
    // Already ended is fine.
    let _ = child.kill();
    let _ = child.wait();
}

/// An option of QEMU with a path in it: a comma there is written twice.
fn option(before: &str, path: &Path, after: &str) -> OsString {
    let path = path.to_string_lossy().replace(',', ",,");
    format!("{before}{path}{after}").into()
}

fn ended(status: ExitStatus, said: &Path) -> EmulatorError {
    EmulatorError::Ended(status, std::fs::read_to_string(said).unwrap_or_default())
}

/// Waits for the control socket.
fn reach(socket: &Path, child: &mut Child, said: &Path) -> Result<Qmp, EmulatorError> {
    let began = Instant::now();
    loop {
        if let Ok(Some(status)) = child.try_wait() {
            return Err(ended(status, said));
        }
        match Qmp::connect(socket) {
            Ok(control) => return Ok(control),
            Err(error) if began.elapsed() > STARTS => return Err(error),
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}

#[cfg(test)]
mod tests;
