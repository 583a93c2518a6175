//! Certificates of robots: files `{robot}.json` in a folder, and why one is not used.
//!
//! Whatever is in a file is checked before it is believed. A file is read again when its time or its length is another.

use std::collections::HashMap;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use crawler_protocol::RobotId;
use crawler_twin::certificate::{Certificate, CertificateError};

/// Longest file. A certificate has some 10 KB.
const LONGEST: u64 = 256 * 1024;
/// Files that are looked at. More robots never have twins at a time.
const MOST_FILES: usize = 20_000;

/// Why a certificate is not used.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum Refusal {
    /// The file cannot be read.
    Unreadable(String),
    /// It is too long for a certificate.
    TooLong,
    /// It is none.
    NoCertificate(String),
    /// It is one of another program than this.
    OtherFormat(String),
    /// It has numbers that no robot has.
    Unsound(String),
    /// It is of another robot than its name says.
    OtherRobot(String),
    /// The robot runs another program than the one that was calibrated.
    OtherBuild {
        /// That of the certificate.
        certificate: String,
        /// That of the robot.
        robot: String,
    },
    /// It had to be made anew by now.
    Expired,
}

impl Refusal {
    /// Its name, for programs.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Unreadable(_) => "unreadable",
            Self::TooLong => "too_long",
            Self::NoCertificate(_) => "no_certificate",
            Self::OtherFormat(_) => "other_format",
            Self::Unsound(_) => "unsound",
            Self::OtherRobot(_) => "other_robot",
            Self::OtherBuild { .. } => "other_build",
            Self::Expired => "expired",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(why) => write!(f, "the file cannot be read: {why}"),
            Self::TooLong => f.write_str("the file is too long for a certificate"),
            Self::NoCertificate(why) | Self::OtherFormat(why) | Self::Unsound(why) => {
                f.write_str(why)
            }
            Self::OtherRobot(robot) => write!(f, "it is of robot `{robot}`"),
            Self::OtherBuild { certificate, robot } => write!(
                f,
                "it is of a robot with program {certificate}, and this one runs {robot}"
            ),
            Self::Expired => f.write_str("it is too old: calibrate the robot again"),
        }
    }
}

/// What a file has.
pub(crate) type Read = Result<Arc<Certificate>, Refusal>;

#[derive(Debug)]
struct Entry {
    /// Time and length by which another content is told.
    stamp: (Option<SystemTime>, u64),
    read: Read,
}

/// See the [module](self).
#[derive(Debug)]
pub(crate) struct Folder {
    path: PathBuf,
    entries: HashMap<RobotId, Entry>,
}

impl Folder {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self {
            path,
            entries: HashMap::new(),
        }
    }

    /// Looks at the folder; true when anything in it is another than before. Where there is none, there are no
    /// certificates.
    pub(crate) fn look(&mut self) -> bool {
        let mut before = std::mem::take(&mut self.entries);
        let mut changed = false;
        let listed = match fs::read_dir(&self.path) {
            Ok(listed) => listed,
            Err(error) => {
                if error.kind() != io::ErrorKind::NotFound {
                    tracing::warn!(%error, folder = %self.path.display(), "certificates of robots cannot be read");
                }
                return !before.is_empty();
            }
        };
        for entry in listed.flatten().take(MOST_FILES) {
            let path = entry.path();
            let Some(robot) = robot_of(&path) else {
                continue;
            };
            let stamp = fs::metadata(&path).map(|data| (data.modified().ok(), data.len()));
            let stamp = stamp.unwrap_or((None, 0));
            let entry = match before.remove(&robot) {
                Some(known) if known.stamp == stamp && stamp.0.is_some() => known,
                _ => {
                    changed = true;
                    let read = read(&path, &robot);
                    if let Err(refusal) = &read {
                        tracing::warn!(%robot, %refusal, "a certificate is not used");
                    }
                    Entry { stamp, read }
                }
            };
            self.entries.insert(robot, entry);
        }
        changed || !before.is_empty()
    }

    /// What there is of each robot.
    pub(crate) fn all(&self) -> HashMap<RobotId, Read> {
        let entries = self.entries.iter();
        entries
            .map(|(robot, entry)| (robot.clone(), entry.read.clone()))
            .collect()
    }
}

/// Puts a certificate in its place: there is never half of one.
pub(crate) fn put(folder: &Path, certificate: &Certificate) -> io::Result<()> {
    let robot = &certificate.about.robot;
    // A name that is no robot's is nobody's file.
    let robot = RobotId::new(robot).map_err(|_| io::ErrorKind::InvalidInput)?;
    fs::create_dir_all(folder)?;
    let draft = folder.join(format!("{robot}.part"));
    let mut file = File::create(&draft)?;
    file.write_all(certificate.write().as_bytes())?;
    file.sync_all()?;
    fs::rename(&draft, folder.join(format!("{robot}.json")))
}

/// The robot whose certificate a file of this name is.
fn robot_of(path: &Path) -> Option<RobotId> {
    let name = path.file_name()?.to_str()?.strip_suffix(".json")?;
    RobotId::new(name).ok()
}

fn read(path: &Path, robot: &RobotId) -> Read {
    let unreadable = |error: io::Error| Refusal::Unreadable(error.to_string());
    if !fs::metadata(path).map_err(unreadable)?.is_file() {
        return Err(Refusal::Unreadable("it is no file".to_owned()));
    }
    let mut text = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    let read = file.take(LONGEST + 1).read_to_end(&mut text);
    if read.map_err(unreadable)? as u64 > LONGEST {
        return Err(Refusal::TooLong);
    }
    let read = Certificate::read(&text).map_err(|error| {
        let why = error.to_string();
        match error {
            CertificateError::Format(_) => Refusal::OtherFormat(why),
            CertificateError::Unsound => Refusal::Unsound(why),
            _ => Refusal::NoCertificate(why),
        }
    })?;
    if read.about.robot != robot.as_str() {
        let named = read.about.robot.chars().take(64).collect();
        return Err(Refusal::OtherRobot(named));
    }
    Ok(Arc::new(read))
}

/// Whether a certificate is used for a robot that runs `program`, where that is known, at `unix_ms`.
pub(crate) fn judge(read: &Read, program: Option<&str>, unix_ms: u64) -> Read {
    let certificate = read.as_ref().map_err(Clone::clone)?;
    let made_on = &certificate.about.build;
    if let Some(program) = program
        && !made_on.is_empty()
        && made_on != program
    {
        return Err(Refusal::OtherBuild {
            certificate: made_on.clone(),
            robot: program.to_owned(),
        });
    }
    if certificate.is_expired(unix_ms) {
        return Err(Refusal::Expired);
    }
    Ok(Arc::clone(certificate))
}
