//! The bench: emulated robots, and the suite that any robot must pass.

use crate::boards::VIRT;
use crate::run::{self, Failure, Outcome};
use crate::{image, tools};

/// `cargo xtask hil --robot ID --broker URL …`: the suite on one robot, whatever its body.
///
/// # Errors
/// When the suite cannot be built or fails.
pub(crate) fn suite(arguments: &[String]) -> Outcome {
    call("suite", arguments)
}

/// `cargo xtask emulate …`: robots in QEMU until Ctrl-C.
///
/// # Errors
/// When QEMU or a compiler is missing, or the build fails.
pub(crate) fn emulate(arguments: &[String]) -> Outcome {
    tools::QEMU.require()?;
    // With the decoder of its log, which the bench calls.
    image::image(&VIRT)?;
    call("emulate", arguments)
}

fn call(subcommand: &str, arguments: &[String]) -> Outcome {
    run::cargo(&[
        "build",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "crawler-hil",
    ])?;
    let program = run::target_dir().join("release").join("hil");
    if !program.is_file() {
        return Err(Failure(format!("{} was not built", program.display())));
    }
    run::replace_with(
        &program,
        std::iter::once(subcommand.to_owned()).chain(arguments.iter().cloned()),
    )
}
