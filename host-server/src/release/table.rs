//! What is said of a release: to people as a table, to programs as JSON.

use std::fmt::Write as _;
use std::path::Path;

use crawler_release::Manifest;
use crawler_updates::release::Inspection;
use serde_json::{Value, json};

use super::args::shown;

/// The table.
pub(crate) fn text(path: &Path, found: &Inspection<'_>) -> String {
    let mut out = String::new();
    let mut row = |name: &str, value: &str| {
        let _ = writeln!(out, "{name:<12}{value}");
    };
    row("release", &path.display().to_string());
    row("id", &found.id.to_string());
    let signature = if found.authentic {
        format!("by key {}", found.key)
    } else {
        format!("NOT VERIFIED; it names key {}", found.key)
    };
    row("signature", &signature);
    if let Some(manifest) = &found.manifest {
        for (name, value) in rows(manifest) {
            row(name, &value);
        }
    }
    for fault in &found.faults {
        row("REFUSED", &format!("{}: {}", fault.code, fault.text));
    }
    if found.faults.is_empty() {
        row("verdict", "genuine");
    }
    out
}

fn rows(manifest: &Manifest<'_>) -> Vec<(&'static str, String)> {
    let kind = match manifest.name {
        Some(name) => format!("{} {name}", manifest.kind),
        None => manifest.kind.to_string(),
    };
    let mut rows = vec![
        ("kind", kind),
        ("board", format!("{} ({})", manifest.board, manifest.chip)),
        ("version", manifest.version.to_owned()),
        ("build", manifest.build.to_owned()),
        ("sequence", manifest.sequence.to_string()),
        ("floor", manifest.floor.to_string()),
        (
            "expires",
            manifest.expires.map_or("never".to_owned(), shown),
        ),
        (
            "image",
            format!(
                "{} bytes in {} blocks of {} KiB",
                manifest.size,
                manifest.block_count(),
                manifest.block_size / 1_024
            ),
        ),
        ("sha256", hex(manifest.sha256)),
    ];
    if let Some(delta) = manifest.delta {
        rows.push((
            "delta",
            format!("{} bytes from build {}", delta.size, delta.build),
        ));
    }
    let requires = manifest.requires;
    if requires.sequence > 0 {
        rows.push((
            "requires",
            format!("sequence {} or later", requires.sequence),
        ));
    }
    if requires.protocol > 0 {
        rows.push((
            "requires",
            format!("protocol {} or later", requires.protocol),
        ));
    }
    rows
}

/// One JSON object on a line.
pub(super) fn json(path: &Path, found: &Inspection<'_>) -> Value {
    let faults = found.faults.iter();
    let faults = faults.map(|fault| json!({ "code": fault.code, "text": fault.text }));
    json!({
        "file": path.to_string_lossy(),
        "id": found.id.to_string(),
        "genuine": found.faults.is_empty(),
        "authentic": found.authentic,
        "key": found.key.to_string(),
        "faults": faults.collect::<Vec<_>>(),
        "manifest": found.manifest.as_ref().map(manifest),
    })
}

fn manifest(manifest: &Manifest<'_>) -> Value {
    let delta = manifest
        .delta
        .map(|delta| json!({ "base": hex(delta.base), "build": delta.build, "size": delta.size }));
    json!({
        "kind": manifest.kind.name(),
        "name": manifest.name,
        "board": manifest.board,
        "chip": manifest.chip.to_string(),
        "version": manifest.version,
        "build": manifest.build,
        "sequence": manifest.sequence,
        "floor": manifest.floor,
        "expires": manifest.expires,
        "size": manifest.size,
        "sha256": hex(manifest.sha256),
        "block_size": manifest.block_size,
        "blocks": manifest.block_count(),
        "delta": delta,
        "requires": {
            "sequence": manifest.requires.sequence,
            "protocol": manifest.requires.protocol,
        },
    })
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut out, byte| {
        let _ = write!(out, "{byte:02x}");
        out
    })
}
