//! A calibration of a robot where it stands, by a running server.

use std::process::ExitCode;
use std::time::Duration;

use crawler_system::cli_error::{CliError, OrSay as _};
use serde::Deserialize;
use serde_json::{Value, json};

use super::args::CalibrateArgs;
use crate::client::Client;
use crate::config::Settings;

/// How often to ask.
const LOOK: Duration = Duration::from_secs(1);

#[derive(Deserialize)]
struct Reason {
    code: String,
    detail: String,
}

#[derive(Deserialize)]
struct Permit {
    refused: Option<Reason>,
    seconds: f64,
    size: Option<[f64; 2]>,
}

#[derive(Deserialize)]
struct Pair {
    median: f64,
    p90: f64,
}

#[derive(Deserialize)]
struct Errors {
    ahead_s: f64,
    own: Pair,
    nominal: Pair,
    previous: Option<Pair>,
}

#[derive(Deserialize)]
struct Calibration {
    number: u64,
    state: String,
    begun_legs: usize,
    legs: usize,
    reason: Option<Reason>,
    certificate: Option<String>,
    errors: Vec<Errors>,
}

fn read<T: for<'a> Deserialize<'a>>(value: Value) -> Result<T, CliError> {
    serde_json::from_value(value)
        .or_say(|error| format!("what the server says cannot be read: {error}"))
}

/// Has a server calibrate a robot: 0 with a certificate, or where it may begin; 1 without.
///
/// # Errors
/// One line: what cannot be done, and why.
pub(crate) async fn run(args: &CalibrateArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    let mut client = args.remote.client(settings)?;
    args.remote.log_in(&mut client).await?;
    let done = if args.confirmed {
        calibrate(&mut client, args).await
    } else {
        ask(&mut client, args).await
    };
    client.log_out().await;
    done
}

fn place(args: &CalibrateArgs) -> String {
    let robot = args.live.as_ref().map_or("", |robot| robot.as_str());
    format!("/api/v1/robots/{robot}/twin")
}

/// Says whether it may begin, and what it would be.
async fn ask(client: &mut Client, args: &CalibrateArgs) -> Result<ExitCode, CliError> {
    let mut path = format!("{}/permit", place(args));
    if let Some(around) = args.around {
        path = format!("{path}?around={around}");
    }
    let permit: Permit = read(client.get(&path).await?)?;
    if let Some([length, width]) = permit.size {
        println!(
            "the robot would drive for {:.0} s on {length:.1} × {width:.1} m",
            permit.seconds
        );
    }
    let Some(refused) = permit.refused else {
        println!("it may begin: look at the floor, and say --confirmed");
        return Ok(ExitCode::SUCCESS);
    };
    println!("it may not begin ({}): {}", refused.code, refused.detail);
    Ok(ExitCode::FAILURE)
}

/// Begins, follows it to its end, and stops it when a person does not want it any more.
async fn calibrate(client: &mut Client, args: &CalibrateArgs) -> Result<ExitCode, CliError> {
    let mut body = json!({ "confirmed": true });
    if let Some(floor) = &args.common.floor {
        body["floor"] = floor.as_str().into();
    }
    if let Some(around) = args.around {
        body["around"] = around.into();
    }
    let all = format!("{}/calibrations", place(args));
    let begun = client.post(&all, body.to_string().into_bytes()).await?;
    let mut now: Calibration = read(begun)?;
    let path = format!("{all}/{}", now.number);
    let (mut said, mut stopped) = (String::new(), false);
    loop {
        let words = format!("{} ({} of {})", now.state, now.begun_legs, now.legs);
        if words != said {
            println!("{words}");
            said = words;
        }
        if now.reason.is_some() || now.certificate.is_some() {
            return Ok(tell(&now));
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            _ = tokio::signal::ctrl_c(), if !stopped => {
                stopped = true;
                client.delete(&path).await?;
            }
        }
        now = read(client.get(&path).await?)?;
    }
}

fn tell(calibration: &Calibration) -> ExitCode {
    for errors in &calibration.errors {
        let of = |pair: &Pair| format!("{:.1} cm, {:.1} cm", pair.median * 100.0, pair.p90 * 100.0);
        let before = errors.previous.as_ref();
        let before = before.map_or_else(String::new, |pair| format!("; before {}", of(pair)));
        println!(
            "  {:>4.0} s ahead: {}; nominal {}{before}",
            errors.ahead_s,
            of(&errors.own),
            of(&errors.nominal)
        );
    }
    match (&calibration.reason, &calibration.certificate) {
        (Some(reason), _) => {
            println!("no certificate ({}): {}", reason.code, reason.detail);
            ExitCode::FAILURE
        }
        (None, certificate) => {
            println!("certificate {}", certificate.as_deref().unwrap_or_default());
            ExitCode::SUCCESS
        }
    }
}
