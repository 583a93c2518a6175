//! `terracrawler release delta`.

use std::process::ExitCode;

use crawler_release::Manifest;
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_updates::delta::{BetweenFault, Side, between};
use crawler_updates::release::FILE_MAX;

use super::args::DeltaArgs;
use super::{read, told, write_new};

/// Makes the delta, writes it, and says how small it is.
pub(super) fn run(args: &DeltaArgs) -> Result<ExitCode, CliError> {
    let from = read(&args.from, FILE_MAX)?;
    let to = read(&args.to, FILE_MAX)?;
    let made = between(&from, &to).or_say(|fault| match fault {
        BetweenFault::File(side, why) => told(args.file(*side), why),
        BetweenFault::Image(side, why) => told(args.file(*side), why),
        fault => fault.to_string(),
    })?;
    write_new(&args.out, 0o644, &[&made.patch])?;
    let row = |name: &str, manifest: &Manifest<'_>, side| {
        let file = args.file(side).display();
        println!(
            "{name:<8}{file}: build {}, {} bytes",
            manifest.build, manifest.size
        );
    };
    row("from", &made.from, Side::From);
    row("to", &made.to, Side::To);
    let bytes = made.patch.len();
    let share = bytes as f64 * 100.0 / f64::from(made.to.size);
    println!(
        "delta   {}: {bytes} bytes, {share:.1} % of the image",
        args.out.display()
    );
    Ok(ExitCode::SUCCESS)
}
