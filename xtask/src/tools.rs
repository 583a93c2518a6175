//! Tools that are not Rust crates: what they are for, whether they are here, how to get them.

use crate::boards::{C6, S3};
use crate::cross;
use crate::run::{self, Failure, Outcome};

/// A program that is used here but does not build.
pub(crate) struct Tool {
    /// What it is called on the command line.
    pub(crate) program: &'static str,
    /// Debian's package of it, or packages.
    package: &'static str,
    /// What does not work without it.
    purpose: &'static str,
}

/// Builds the control room.
pub(crate) const NPM: Tool = Tool {
    program: "npm",
    package: "npm",
    purpose: "building the control room (Node.js 20.19 or newer)",
};
/// Shows the control room to its tests.
pub(crate) const CHROMIUM: Tool = Tool {
    program: "chromium",
    package: "chromium",
    purpose: "testing the control room in a browser",
};
/// An MQTT broker that we did not write.
pub(crate) const MOSQUITTO: Tool = Tool {
    program: "mosquitto",
    package: "mosquitto",
    purpose: "testing against an outside broker",
};
/// What several servers of a fleet share.
pub(crate) const REDIS: Tool = Tool {
    program: "redis-server",
    package: "redis-server",
    purpose: "testing several servers of one fleet",
};
/// Makes certificates that we did not.
pub(crate) const OPENSSL: Tool = Tool {
    program: "openssl",
    package: "openssl",
    purpose: "testing against an outside broker with TLS",
};
/// An MQTT client that we did not write.
pub(crate) const MOSQUITTO_PUB: Tool = Tool {
    program: "mosquitto_pub",
    package: "mosquitto-clients",
    purpose: "testing the embedded broker",
};
/// A database that we did not write.
pub(crate) const POSTGRES: Tool = Tool {
    program: "initdb",
    package: "postgresql",
    purpose: "testing with records in PostgreSQL",
};

/// A time-series engine that takes line protocol.
pub(crate) const INFLUXDB: Tool = Tool {
    program: "influxd",
    package: "influxdb",
    purpose: "testing history in an outside engine",
};
/// Another, which is asked in another language.
pub(crate) const VICTORIA_METRICS: Tool = Tool {
    program: "victoria-metrics",
    package: "victoria-metrics",
    purpose: "testing history in an outside engine",
};

/// The machine that the emulated robot runs on.
pub(crate) const QEMU: Tool = Tool {
    program: "qemu-system-riscv32",
    package: "qemu-system-misc",
    purpose: "running the emulated robot",
};

/// Counts instructions of programs of this machine.
pub(crate) const VALGRIND: Tool = Tool {
    program: "valgrind",
    package: "valgrind",
    purpose: "counting what simulated robots execute",
};

/// Runs WebAssembly.
pub(crate) const NODE: Tool = Tool {
    program: "node",
    package: "nodejs",
    purpose: "comparing histories with those in WebAssembly",
};
/// Links programs for RISC-V under Linux.
pub(crate) const RISCV_LINKER: Tool = Tool {
    program: "riscv64-linux-gnu-gcc",
    package: "gcc-riscv64-linux-gnu libc6-dev-riscv64-cross",
    purpose: "comparing histories with those on RISC-V",
};
/// Runs them.
pub(crate) const QEMU_USER: Tool = Tool {
    program: "qemu-riscv64",
    package: "qemu-user",
    purpose: "comparing histories with those on RISC-V",
};

/// Debian's newest compiler, with sources of std and a linker for RISC-V: builds the boards where
/// rustup has no targets, and checks the S3 board where Espressif's compiler is not installed.
const COMPILER: [&str; 5] = [
    "rustc-web",
    "cargo-web",
    "rust-web-src",
    "rust-web-clippy",
    "lld-22",
];

const ALL: [&Tool; 13] = [
    &NPM,
    &CHROMIUM,
    &MOSQUITTO,
    &MOSQUITTO_PUB,
    &POSTGRES,
    &INFLUXDB,
    &VICTORIA_METRICS,
    &REDIS,
    &OPENSSL,
    &QEMU,
    &NODE,
    &RISCV_LINKER,
    &QEMU_USER,
];

impl Tool {
    /// Whether the program is on the search path. Debian puts servers where a user's path does
    /// not look, and `PostgreSQL` into a folder of each version.
    pub(crate) fn present(&self) -> bool {
        std::env::var_os("PATH")
            .iter()
            .flat_map(std::env::split_paths)
            .chain(["/usr/sbin".into(), "/usr/local/sbin".into()])
            .chain(
                std::fs::read_dir("/usr/lib/postgresql")
                    .into_iter()
                    .flatten()
                    .filter_map(|version| Some(version.ok()?.path().join("bin"))),
            )
            .any(|folder| folder.join(self.program).is_file())
    }

    fn missing(&self) -> String {
        format!(
            "{} is missing (for {}): sudo apt-get install {}",
            self.program, self.purpose, self.package
        )
    }

    /// Nothing when the tool is here.
    ///
    /// # Errors
    /// One line that names the tool, its purpose and its package.
    pub(crate) fn require(&self) -> Outcome {
        if self.present() {
            Ok(())
        } else {
            Err(Failure(self.missing()))
        }
    }
}

/// Installs what is missing: with cargo what is made of Rust, with apt the rest, where that is allowed.
///
/// # Errors
/// Names everything that is still missing.
pub(crate) fn setup() -> Outcome {
    let others = packages();
    let runner = nextest();
    match (others, runner) {
        (Err(Failure(one)), Err(Failure(other))) => Err(Failure(format!("{one}\n{other}"))),
        (others, runner) => others.and(runner),
    }
}

/// The program that runs the tests.
fn nextest() -> Outcome {
    let present = || run::output("cargo", &["nextest", "--version"]).is_some();
    if present() {
        return Ok(());
    }
    println!("installing cargo-nextest");
    let installed = run::cargo(&["install", "--quiet", "--locked", "cargo-nextest"]);
    if installed.is_ok() && present() {
        return Ok(());
    }
    Err(Failure(
        "cargo-nextest is missing (for running the tests): cargo install cargo-nextest --locked"
            .to_owned(),
    ))
}

/// What comes in packages of Debian.
fn packages() -> Outcome {
    let mut packages: Vec<&str> = ALL
        .into_iter()
        .filter(|tool| !tool.present())
        .flat_map(|tool| tool.package.split(' '))
        .collect();
    if !compilers_missing().is_empty() {
        packages.extend(COMPILER);
    }
    if packages.is_empty() {
        return Ok(());
    }
    let may_install = run::output("id", &["-u"]).as_deref() == Some("0")
        && run::output("apt-get", &["--version"]).is_some();
    if may_install {
        let root = run::root();
        let quiet = [("DEBIAN_FRONTEND", "noninteractive")];
        run::run(&root, "apt-get", &["update", "-qq"])?;
        let install: Vec<&str> = ["install", "-y", "-qq", "--no-install-recommends"]
            .into_iter()
            .chain(packages)
            .collect();
        run::run_with_env(&root, "apt-get", &install, &quiet)?;
    }
    let still: Vec<String> = ALL
        .into_iter()
        .filter(|tool| !tool.present())
        .map(Tool::missing)
        .chain(compilers_missing())
        .collect();
    if still.is_empty() {
        Ok(())
    } else {
        Err(Failure(still.join("\n")))
    }
}

/// What cannot be compiled or checked here, with the way to get it.
fn compilers_missing() -> Vec<String> {
    let riscv = cross::compiler(&C6).and_then(|compiler| {
        if compiler.has_clippy() {
            return Ok(());
        }
        Err(Failure(
            "the boards' compiler has no clippy: `rustup component add clippy`, or on Debian \
             `cargo xtask setup` as root"
                .to_owned(),
        ))
    });
    let xtensa = match cross::source() {
        Some(_) => Ok(()),
        None => cross::compiler(&S3).map(|_| ()),
    };
    [riscv, xtensa]
        .into_iter()
        .filter_map(Result::err)
        .map(|Failure(reason)| reason)
        .collect()
}
