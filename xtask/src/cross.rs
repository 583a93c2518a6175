//! Which compiler builds for which chip, and how it is called.
//!
//! On a machine with rustup, its targets; for Xtensa, Espressif's toolchain. Elsewhere a compiler
//! that comes with the sources of std builds those too: that needs unstable options of cargo, which
//! a stable compiler grants to `RUSTC_BOOTSTRAP`.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, SystemTime};

use crate::boards::{self, Board};
use crate::run::{self, Failure, Outcome};

/// Variables that chose a toolchain for this process and must not choose one for the boards.
/// Flags of the host have no place there either: they would replace a board's own.
const HOST_ONLY: [&str; 12] = [
    "CARGO",
    "CARGO_BUILD_TARGET",
    "CARGO_ENCODED_RUSTFLAGS",
    "LD_LIBRARY_PATH",
    "RUSTC",
    "RUSTC_BOOTSTRAP",
    "RUSTC_WRAPPER",
    "RUSTC_WORKSPACE_WRAPPER",
    "RUSTDOC",
    "RUSTFLAGS",
    "RUSTUP_TOOLCHAIN",
    "__CARGO_TESTS_ONLY_SRC_ROOT",
];

/// Set to `stock` or `source` to try one way where both would work.
const CHOICE: &str = "XTASK_COMPILER";

/// Downloading a target takes seconds; a machine without network must not wait longer.
const DOWNLOAD: Duration = Duration::from_secs(90);

/// How long a failed download is not tried again.
const PATIENCE: Duration = Duration::from_hours(24);

/// A compiler for one chip.
#[derive(Debug)]
pub(crate) enum Compiler {
    /// rustup's, with a std made for the target.
    Stock,
    /// Espressif's for Xtensa, as espup installs it; its linker lies in this folder.
    Espressif(PathBuf),
    /// One that builds std from source.
    Source(Source),
}

/// A compiler with the sources of its std.
#[derive(Debug)]
pub(crate) struct Source {
    /// Its cargo.
    pub(crate) cargo: PathBuf,
    /// Its rustc.
    pub(crate) rustc: PathBuf,
    /// The folder `library` of its sources.
    pub(crate) library: PathBuf,
    /// A linker for RISC-V.
    linker: Option<PathBuf>,
}

/// Finds a compiler for `board`, adding a rustup target where that works.
///
/// # Errors
/// One line that says what is missing and how to get it.
pub(crate) fn compiler(board: &Board) -> Outcome<Compiler> {
    let choice = std::env::var(CHOICE).unwrap_or_default();
    if board.triple.starts_with("xtensa") {
        return espressif().map(Compiler::Espressif).ok_or_else(|| {
            Failure(format!(
                "{} needs Espressif's compiler: `cargo install espup --locked && espup install`. \
                 `cargo xtask check-s3` needs only the sources of std: `rustup component add \
                 rust-src`, or on Debian `cargo xtask setup` as root",
                board.name
            ))
        });
    }
    let stock = match choice.as_str() {
        "source" => false,
        "" | "stock" => installed(board.triple) || add(board.triple),
        other => {
            return Err(Failure(format!("{CHOICE}={other}: stock or source")));
        }
    };
    if stock {
        return Ok(Compiler::Stock);
    }
    match source() {
        Some(source) if choice != "stock" => Ok(Compiler::Source(source)),
        _ => Err(Failure(format!(
            "nothing here compiles for {}: `rustup target add {}`, or on Debian `cargo xtask setup` as root",
            board.name, board.triple
        ))),
    }
}

/// Whether the compiler in use has a std for `triple`, or rustup has got it now.
pub(crate) fn has_std(triple: &str) -> bool {
    installed(triple) || add(triple)
}

/// Whether the compiler in use has a std for `triple`.
fn installed(triple: &str) -> bool {
    run::output("rustc", &["--print", "target-libdir", "--target", triple])
        .is_some_and(|folder| Path::new(&folder).is_dir())
}

/// Asks rustup for `triple`. A failure is remembered for a day.
fn add(triple: &str) -> bool {
    if run::output("rustup", &["--version"]).is_none() {
        return false;
    }
    let failed = run::target_dir().join(format!("boards/no-rustup-target-{triple}"));
    let recent = fs::metadata(&failed)
        .and_then(|metadata| metadata.modified())
        .is_ok_and(|when| {
            SystemTime::now()
                .duration_since(when)
                .is_ok_and(|age| age < PATIENCE)
        });
    if recent {
        return false;
    }
    println!("rustup target add {triple}");
    let mut command = Command::new("rustup");
    command.args(["target", "add", triple]);
    command.current_dir(run::root());
    if run::within(command, DOWNLOAD) && installed(triple) {
        return true;
    }
    println!("rustup cannot get it here; trying a compiler that builds std from source");
    if let Some(folder) = failed.parent() {
        // Only a note that saves time: without it the next run asks again.
        let _ = fs::create_dir_all(folder).and_then(|()| fs::write(&failed, ""));
    }
    false
}

/// The folder of Espressif's linker, where espup's toolchain is installed.
fn espressif() -> Option<PathBuf> {
    let sysroot = run::output("rustup", &["run", "esp", "rustc", "--print", "sysroot"])?;
    // toolchain/xtensa-esp-elf/<version>/xtensa-esp-elf/bin
    fs::read_dir(Path::new(&sysroot).join("xtensa-esp-elf"))
        .ok()?
        .filter_map(Result::ok)
        .map(|entry| entry.path().join("xtensa-esp-elf/bin"))
        .filter(|folder| folder.is_dir())
        .max()
}

/// A compiler with sources: rustup's with the component `rust-src`, or Debian's.
pub(crate) fn source() -> Option<Source> {
    let of = |cargo: &str, rustc: &str, linker: fn() -> Option<PathBuf>| {
        let sysroot = run::output(rustc, &["--print", "sysroot"])?;
        let library = Path::new(&sysroot).join("lib/rustlib/src/rust/library");
        library.join("core/src/lib.rs").is_file().then(|| Source {
            cargo: cargo.into(),
            rustc: rustc.into(),
            library,
            linker: linker(),
        })
    };
    // rustup's rustc brings its own linker.
    of(&run::cargo_program(), "rustc", || None)
        .or_else(|| of("/usr/bin/cargo", "/usr/bin/rustc", linker))
}

/// A linker that knows RISC-V: LLVM's, as Debian or rustup install it.
fn linker() -> Option<PathBuf> {
    let newest = fs::read_dir("/usr/bin")
        .ok()?
        .filter_map(Result::ok)
        .map(|entry| entry.path())
        .filter(|path| {
            path.file_name()
                .and_then(|name| name.to_str()?.strip_prefix("ld.lld-"))
                .is_some_and(|version| version.parse::<u32>().is_ok())
        })
        .max();
    newest.or_else(|| {
        let libraries = run::output("rustc", &["--print", "target-libdir"])?;
        let linker = Path::new(&libraries).parent()?.join("bin/rust-lld");
        linker.is_file().then_some(linker)
    })
}

impl Compiler {
    /// A cargo command in the workspace of `board`, for its chip and its features.
    pub(crate) fn cargo(&self, board: &Board, subcommand: &str) -> Command {
        let mut command = match self {
            Self::Stock => Command::new("cargo"),
            Self::Espressif(_) => {
                let mut command = Command::new("rustup");
                command.args(["run", "esp", "cargo"]);
                command
            }
            // cargo would take the first clippy on the search path, which may be another compiler's.
            Self::Source(source) if subcommand == "clippy" => Command::new(source.clippy()),
            Self::Source(source) => Command::new(&source.cargo),
        };
        forget_host(&mut command);
        command
            .current_dir(board.folder())
            .stdin(std::process::Stdio::null())
            .args([subcommand, "--release", "--locked", "--quiet"])
            .args(["--target", board.triple, "--target-dir"])
            .arg(boards::target_dir())
            .args(board.features());
        match self {
            Self::Stock => {}
            Self::Espressif(linker) => {
                command.arg(format!("-Zbuild-std={}", board.std));
                command.env("PATH", path_with(linker));
            }
            Self::Source(source) => {
                source.prepare(&mut command);
                command.arg(format!("-Zbuild-std={}", board.std));
                if let Some(linker) = &source.linker {
                    let triple = board.triple.to_uppercase().replace('-', "_");
                    command.env(format!("CARGO_TARGET_{triple}_LINKER"), linker);
                }
            }
        }
        command
    }

    /// Whether its lints are installed as well.
    pub(crate) fn has_clippy(&self) -> bool {
        match self {
            Self::Stock => run::output("cargo", &["clippy", "--version"]),
            Self::Espressif(_) => run::output("rustup", &["run", "esp", "cargo-clippy", "-V"]),
            Self::Source(source) => run::output(&source.clippy().to_string_lossy(), &["--version"]),
        }
        .is_some()
    }

    /// What builds, for the person who reads the numbers.
    pub(crate) fn version(&self) -> String {
        let version = match self {
            Self::Stock => run::output("rustc", &["--version"]),
            Self::Espressif(_) => run::output("rustup", &["run", "esp", "rustc", "--version"]),
            Self::Source(source) => run::output(&source.rustc.to_string_lossy(), &["--version"]),
        };
        version.unwrap_or_else(|| "rustc of unknown version".to_owned())
    }
}

impl Source {
    /// The clippy that came with this compiler.
    fn clippy(&self) -> PathBuf {
        self.cargo.with_file_name("cargo-clippy")
    }

    /// Lets `command` use this compiler, and its unstable options.
    pub(crate) fn prepare(&self, command: &mut Command) {
        command
            .env("RUSTC", &self.rustc)
            .env("RUSTC_BOOTSTRAP", "1");
        // Without this, rustup's proxy would pick the toolchain for a cargo that is not its own.
        if self.rustc.is_absolute() {
            command.env("RUSTDOC", self.rustc.with_file_name("rustdoc"));
        }
    }
}

/// Removes from the environment of `command` what belongs to the compiler of the host.
pub(crate) fn forget_host(command: &mut Command) {
    for variable in HOST_ONLY {
        command.env_remove(variable);
    }
}

/// The search path with `folder` before everything else.
fn path_with(folder: &Path) -> OsString {
    let old = std::env::var_os("PATH").unwrap_or_default();
    std::env::join_paths(std::iter::once(folder.to_owned()).chain(std::env::split_paths(&old)))
        .unwrap_or(old)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::path::{Path, PathBuf};
    use std::process::Command;

    use super::{Compiler, Source, path_with};
    use crate::boards::{C3, VIRT};

    fn source() -> Compiler {
        Compiler::Source(Source {
            cargo: "/usr/bin/cargo".into(),
            rustc: "/usr/bin/rustc".into(),
            library: "/library".into(),
            linker: Some("/usr/bin/ld.lld-22".into()),
        })
    }

    fn words(command: &Command) -> Vec<String> {
        command
            .get_args()
            .map(|word| word.to_string_lossy().into_owned())
            .collect()
    }

    fn variables(command: &Command) -> BTreeMap<String, Option<String>> {
        let text = |part: &std::ffi::OsStr| part.to_string_lossy().into_owned();
        command
            .get_envs()
            .map(|(name, value)| (text(name), value.map(text)))
            .collect()
    }

    #[test]
    fn another_compiler_is_not_told_what_rustup_chose() {
        let variables = variables(&source().cargo(&C3, "build"));
        for gone in ["RUSTUP_TOOLCHAIN", "RUSTFLAGS", "LD_LIBRARY_PATH"] {
            assert_eq!(variables[gone], None, "{gone}");
        }
        for (name, value) in [
            ("RUSTC", "/usr/bin/rustc"),
            ("RUSTC_BOOTSTRAP", "1"),
            (
                "CARGO_TARGET_RISCV32IMC_UNKNOWN_NONE_ELF_LINKER",
                "/usr/bin/ld.lld-22",
            ),
        ] {
            assert_eq!(variables[name].as_deref(), Some(value), "{name}");
        }
    }

    #[test]
    fn only_a_compiler_with_sources_builds_std() {
        let std = |compiler: Compiler, board| {
            words(&compiler.cargo(board, "build"))
                .into_iter()
                .find(|word| word.starts_with("-Zbuild-std"))
        };
        assert_eq!(std(Compiler::Stock, &C3), None);
        assert_eq!(
            std(source(), &C3).as_deref(),
            Some("-Zbuild-std=core,alloc")
        );
        assert_eq!(std(source(), &VIRT).as_deref(), Some("-Zbuild-std=core"));
    }

    #[test]
    fn clippy_is_that_of_the_compiler() {
        let command = source().cargo(&VIRT, "clippy");
        assert_eq!(command.get_program(), "/usr/bin/cargo-clippy");
        assert_eq!(words(&command).first().map(String::as_str), Some("clippy"));
    }

    #[test]
    fn a_folder_goes_before_the_search_path() {
        let path = path_with(Path::new("/first"));
        let folders: Vec<PathBuf> = std::env::split_paths(&path).collect();
        assert_eq!(
            folders.first().map(PathBuf::as_path),
            Some(Path::new("/first"))
        );
        assert!(folders.len() > 1);
    }
}
