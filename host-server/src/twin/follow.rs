//! A twin beside a robot, through a recording.

use std::process::ExitCode;

use crawler_system::cli_error::CliError;
use crawler_twin::body::Parameters;
use crawler_twin::detect::FaultName;
use crawler_twin::evidence::Row;
use crawler_twin::shadow::{Shadow, View};

use super::args::FollowArgs;
use super::{read_certificate, recording, told};

/// Follows, and says what there is to say: 0 when nothing is wrong, 1 when a fault was named.
pub(super) fn run(args: &FollowArgs) -> Result<ExitCode, CliError> {
    let drive = recording::read(&args.file, args.robot.as_deref())?;
    let certificate = args
        .certificate
        .as_deref()
        .map(read_certificate)
        .transpose()?;
    if let Some(certificate) = &certificate
        && certificate.about.robot != drive.robot
    {
        return Err(CliError::new(format!(
            "the certificate is of {}, and this recording of {}",
            certificate.about.robot, drive.robot
        )));
    }
    let (mut shadow, body) = if let Some(certificate) = &certificate {
        let shadow = Shadow::new(certificate.parameters, certificate.wander);
        (shadow, format!("certificate {}", certificate.id()))
    } else {
        let shadow = Shadow::new(Parameters::NOMINAL, 0.0);
        (shadow, "the nominal body".to_owned())
    };
    println!("{}: {} by {body}", args.file.display(), drive.robot);
    let (mut refused, mut named) = (0_u64, 0_u64);
    let mut there: Vec<FaultName> = Vec::new();
    let mut near = drive.near.iter();
    for row in &drive.rows {
        if matches!(row, Row::Fix(_)) {
            shadow.near(near.next().is_some_and(|is_near| *is_near));
        }
        refused += u64::from(shadow.take(*row).is_err());
        let at_s = row.arrived_s().unwrap_or(0.0);
        let faults = shadow.faults();
        for fault in faults.iter().filter(|fault| !there.contains(&fault.fault)) {
            named += 1;
            println!("{at_s:8.1} s  {fault}");
        }
        for name in &there {
            if !faults.iter().any(|fault| fault.fault == *name) {
                println!("{at_s:8.1} s  {} is over", name.name());
            }
        }
        there.clear();
        there.extend(faults.iter().map(|fault| fault.fault));
    }
    let view = shadow.view();
    let view = view.ok_or_else(|| {
        CliError::new(told(&args.file, "duties and fixes are of different times"))
    })?;
    print!("{}", summary(&view, refused));
    Ok(ExitCode::from(u8::from(named > 0)))
}

fn summary(view: &View, refused: u64) -> String {
    let pose = view.now.pose;
    let mut lines = vec![format!(
        "at the end: x {:.2} m, y {:.2} m, theta {:.2} rad, to {:.1} cm; {:.2} m/s, {:.2} rad/s",
        pose.x,
        pose.y,
        pose.theta,
        view.now.sigma_m * 100.0,
        view.v,
        view.w
    )];
    for residual in &view.residuals {
        lines.push(format!(
            "  {:>4.0} s ahead, the last {} times: {:.1} cm, {:.1} cm",
            residual.horizon_s,
            residual.count,
            residual.median_m * 100.0,
            residual.p90_m * 100.0
        ));
    }
    lines.push(format!(
        "  wheels against the body: left {:.3} ± {:.3}, right {:.3} ± {:.3}",
        view.gains[0], view.gain_sigma[0], view.gains[1], view.gain_sigma[1]
    ));
    lines.push(format!(
        "  {} fixes, consistency {:.2}, {:.0} % within their 95 % region; {} jumps, {} gaps, {refused} \
         rows refused",
        view.fixes,
        view.consistency,
        view.coverage * 100.0,
        view.jumps,
        view.gaps
    ));
    lines.join("\n") + "\n"
}
