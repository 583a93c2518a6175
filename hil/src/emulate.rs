//! `hil emulate`: boards under emulation until Ctrl-C.

use std::process::ExitCode;
use std::time::Duration;

use crawler_hil::emulator::{self, Emulator, EmulatorError, Options};
use crawler_image_format::pem;
use crawler_protocol::RobotId;
use tokio::time::Instant;

use crate::cannot;
use crate::cli::EmulateArguments;

/// How often their lines are looked for.
const LOOK: Duration = Duration::from_millis(100);
/// How often it is checked that they run.
const CHECK: Duration = Duration::from_secs(1);

pub(crate) async fn emulate(arguments: &EmulateArguments) -> ExitCode {
    let emulators = match start(arguments) {
        Ok(emulators) => emulators,
        Err(error) => return cannot(&error),
    };
    tokio::select! {
        error = follow(emulators) => cannot(&error),
        _ = tokio::signal::ctrl_c() => {
            eprintln!("hil: the emulators are switched off");
            ExitCode::SUCCESS
        }
        () = terminated() => ExitCode::SUCCESS,
    }
}

/// Whoever starts us in the background ends us so.
async fn terminated() {
    use tokio::signal::unix::{SignalKind, signal};
    match signal(SignalKind::terminate()) {
        Ok(mut signal) => {
            signal.recv().await;
        }
        // Then there is Ctrl-C alone.
        Err(_) => std::future::pending().await,
    }
}

fn start(arguments: &EmulateArguments) -> Result<Vec<Emulator>, Box<dyn std::error::Error>> {
    let image = match &arguments.image {
        Some(image) => image.clone(),
        None => emulator::image()?,
    };
    if let Some(folder) = &arguments.flash {
        std::fs::create_dir_all(folder)
            .map_err(|error| format!("{}: {error}", folder.display()))?;
    }
    let mut release_keys = Vec::new();
    for file in &arguments.release_keys {
        let text = std::fs::read_to_string(file)
            .map_err(|error| format!("{}: {error}", file.display()))?;
        let keys = pem::public_keys(&text)
            .ok_or_else(|| format!("{}: no public key of P-256 in PEM", file.display()))?;
        release_keys.extend(keys);
    }
    let mut emulators = Vec::new();
    for number in 1..=arguments.robots {
        let name = format!("virt-{number:02}");
        let flash = arguments
            .flash
            .as_ref()
            .map(|folder| folder.join(format!("{name}.flash")));
        emulators.push(Emulator::start(Options {
            fleet: arguments.fleet.clone(),
            arguments: arguments.boot.clone(),
            flash,
            release_keys: release_keys.clone(),
            ..Options::new(
                image.clone(),
                RobotId::new(&name)?,
                arguments.broker.clone(),
            )
        })?);
    }
    eprintln!("hil: {} running, Ctrl-C ends", emulators.len());
    Ok(emulators)
}

/// Prints what they log until one of them ends.
async fn follow(mut emulators: Vec<Emulator>) -> EmulatorError {
    let mut seen = vec![0; emulators.len()];
    let mut next_check = Instant::now() + CHECK;
    loop {
        for (emulator, seen) in emulators.iter().zip(&mut seen) {
            let lines = emulator.lines_after(*seen, std::time::Instant::now());
            *seen += lines.len() as u64;
            for line in lines {
                println!("{} {line}", emulator.robot());
            }
        }
        if Instant::now() >= next_check {
            next_check = Instant::now() + CHECK;
            for emulator in &mut emulators {
                if let Err(error) = emulator.check() {
                    return error;
                }
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}
