//! The type check of the ESP32-S3 board where Espressif's compiler is not installed.
//!
//! Upstream rustc has the Xtensa target, but no inline assembly for it, and the code generator
//! behind it does not know the S3. So std is built from a scratch copy whose assembly macros
//! expand to `unreachable!`, for the plainest Xtensa processor. That proves types, features and
//! APIs of the board against the real esp-hal; it generates no code.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::boards::{self, S3};
use crate::cross::{self, Source};
use crate::files;
use crate::run::{self, Failure, Outcome};

/// Raised when this file makes the scratch folder differently.
const RECIPE: u32 = 1;

/// Crates with naked functions, whose only content may be assembly.
const NAKED: [&str; 2] = ["esp-hal", "esp-rtos"];

/// How LLVM lays data out on Xtensa; the specification built into rustc is that of another LLVM.
const LAYOUT: &str = "e-m:e-p:32:32-i8:8:32-i16:16:32-i64:64-n32";

/// Checks the board with all features of the S3.
///
/// # Errors
/// When neither Espressif's compiler nor one with the sources of std is here, or the check fails.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if !arguments.is_empty() {
        return Err(Failure("cargo xtask check-s3".to_owned()));
    }
    let source = match (cross::compiler(&S3), cross::source()) {
        (Ok(compiler), _) => return run::run_command(compiler.cargo(&S3, "check")),
        (Err(_), Some(source)) => source,
        (Err(missing), None) => return Err(missing),
    };
    let scratch = run::target_dir().join("check-s3");
    let patches = prepare(&scratch, &source)?;
    let board = copy_board(&scratch)?;
    run::run_command(check(&scratch, &source, &board, &patches))
}

/// Makes the parts of the scratch folder that depend on versions alone, unless they are there.
/// Returns the crates to patch in.
fn prepare(scratch: &Path, source: &Source) -> Outcome<Vec<(&'static str, PathBuf)>> {
    let originals = locate(&NAKED)?;
    let rustc = source.rustc.to_string_lossy();
    let mut versions = format!("recipe {RECIPE}\n{}\n", source.library.display());
    versions += &run::output(&rustc, &["-vV"]).unwrap_or_default();
    for (_, original) in &originals {
        // Writing to a string cannot fail.
        let _ = write!(versions, "\n{}", original.display());
    }
    let patches = NAKED.map(|name| (name, scratch.join(name))).to_vec();
    let stamp = scratch.join("versions");
    if fs::read_to_string(&stamp).is_ok_and(|made| made == versions) {
        return Ok(patches);
    }
    files::remove(scratch)?;
    files::copy(&source.library, &scratch.join("library"), &mut |_, text| {
        text
    })?;
    files::edit(&scratch.join("library/core/src/arch.rs"), without_assembly)?;
    for ((_, original), (_, copy)) in originals.iter().zip(&patches) {
        files::copy(original, copy, &mut |_, text| {
            text.replace("#[unsafe(naked)]", "")
        })?;
    }
    let mut print = Command::new(&source.rustc);
    print.args(["-Zunstable-options", "--print", "target-spec-json"]);
    print.args(["--target", S3.triple]);
    source.prepare(&mut print);
    let specification = run::output_of(print)
        .ok_or_else(|| Failure(format!("{rustc} does not know the target {}", S3.triple)))?;
    files::write(&specification_file(scratch), &plain_xtensa(&specification)?)?;
    files::write(&stamp, &versions)?;
    Ok(patches)
}

/// rustc takes the name of the target from the name of this file.
fn specification_file(scratch: &Path) -> PathBuf {
    scratch.join(format!("{}.json", S3.triple))
}

/// Where cargo keeps the sources of `names` that the board's lock file asks for.
fn locate(names: &[&'static str]) -> Outcome<Vec<(&'static str, PathBuf)>> {
    let manifest = S3.folder().join("Cargo.toml");
    let mut metadata = Command::new(run::cargo_program());
    metadata
        .args(["metadata", "--locked", "--format-version", "1"])
        .arg("--manifest-path")
        .arg(&manifest)
        .stderr(std::process::Stdio::inherit());
    let metadata = run::output_of(metadata)
        .ok_or_else(|| Failure(format!("cargo metadata fails for {}", manifest.display())))?;
    names
        .iter()
        .map(|name| {
            manifest_of(&metadata, name)
                .map(|folder| (*name, folder))
                .ok_or_else(|| Failure(format!("{} does not use {name}", manifest.display())))
        })
        .collect()
}

/// The folder of the package `name` in the output of `cargo metadata`.
fn manifest_of(metadata: &str, name: &str) -> Option<PathBuf> {
    metadata
        .split("\"manifest_path\":\"")
        .skip(1)
        .filter_map(|rest| rest.split_once('"'))
        .map(|(path, _)| Path::new(path))
        .filter_map(Path::parent)
        .find(|folder| {
            folder
                .file_name()
                .and_then(|folder| folder.to_str()?.strip_prefix(name)?.strip_prefix('-'))
                .is_some_and(|version| version.starts_with(|digit: char| digit.is_ascii_digit()))
        })
        .map(Path::to_owned)
}

/// Copies the board, so that its lock file stays as it is when the patches change it. Files that
/// did not change keep their time, and cargo what it made of them.
fn copy_board(scratch: &Path) -> Outcome<PathBuf> {
    let copy = scratch.join("board");
    let firmware = run::root().join("firmware");
    files::mirror(&S3.folder(), &copy, &|path, text| {
        if path.ends_with("Cargo.toml") {
            text.replace(
                "path = \"../../",
                &format!("path = \"{}/", firmware.display()),
            )
            .replace(
                "path = \"../",
                &format!("path = \"{}/", boards::folder().display()),
            )
        } else {
            text
        }
    })?;
    Ok(copy)
}

fn check(
    scratch: &Path,
    source: &Source,
    board: &Path,
    patches: &[(&'static str, PathBuf)],
) -> Command {
    let mut command = Command::new(&source.cargo);
    cross::forget_host(&mut command);
    source.prepare(&mut command);
    command
        .current_dir(board)
        .stdin(std::process::Stdio::null())
        .env("__CARGO_TESTS_ONLY_SRC_ROOT", scratch.join("library"))
        // What follows an assembly macro is unreachable in this check, and only in it.
        .env("RUSTFLAGS", "-Aunreachable_code -Aunused")
        .args(["check", "--release", "--quiet"])
        .args(["-Zbuild-std=core,alloc", "-Zjson-target-spec", "--target"])
        .arg(specification_file(scratch))
        .arg("--target-dir")
        .arg(boards::target_dir())
        .args(S3.features());
    for (name, folder) in patches {
        command.arg("--config");
        command.arg(format!(
            "patch.crates-io.{name}.path={:?}",
            folder.display().to_string()
        ));
    }
    command
}

/// `core::arch` with assembly macros that take anything and generate nothing.
fn without_assembly(text: &str) -> Outcome<String> {
    const BUILT_IN: &str = "#[rustc_builtin_macro]\npub macro ";
    let mut parts = text.split(BUILT_IN);
    let mut plain = parts.next().unwrap_or_default().to_owned();
    let mut found = Vec::new();
    for part in parts {
        let broken = || Failure("core::arch is written differently here".to_owned());
        let (name, rest) = part.split_once('(').ok_or_else(broken)?;
        let (_, after) = rest.split_once("\n}\n").ok_or_else(broken)?;
        let expansion = if name == "global_asm" {
            "const _: () = ();"
        } else {
            "::core::unreachable!()"
        };
        plain.extend(["pub macro ", name, "($($anything:tt)*) {\n    ", expansion]);
        plain.extend(["\n}\n", after]);
        found.push(name);
    }
    if ["asm", "naked_asm", "global_asm"]
        .iter()
        .all(|name| found.contains(name))
    {
        Ok(plain)
    } else {
        Err(Failure(format!(
            "core::arch has other macros than asm, naked_asm and global_asm: {found:?}"
        )))
    }
}

/// The specification rustc prints, for a processor that every LLVM with Xtensa knows.
fn plain_xtensa(specification: &str) -> Outcome<String> {
    let mut lines = Vec::new();
    let mut replaced = 0;
    for line in specification.lines() {
        let key = line.trim().split(':').next().unwrap_or_default();
        match key {
            "\"cpu\"" => {
                replaced += 1;
                lines.push("  \"cpu\": \"esp32\",".to_owned());
                lines.push("  \"features\": \"-dfpaccel,-fp,-bool\",".to_owned());
            }
            "\"data-layout\"" => {
                replaced += 1;
                lines.push(format!("  \"data-layout\": \"{LAYOUT}\","));
            }
            // Ours, above.
            "\"features\"" => {}
            _ => lines.push(line.to_owned()),
        }
    }
    if replaced == 2 {
        Ok(lines.join("\n"))
    } else {
        Err(Failure(format!(
            "rustc describes {} without cpu or data-layout",
            S3.triple
        )))
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{manifest_of, plain_xtensa, without_assembly};

    const ARCH: &str = "use a;\n\
        #[rustc_builtin_macro]\npub macro asm(\"x\", $(y,)*) {\n    /* built-in */\n}\n\
        /// Text.\n\
        #[rustc_builtin_macro]\npub macro naked_asm(\"x\") {\n    /* built-in */\n}\n\
        #[rustc_builtin_macro]\npub macro global_asm(\"x\") {\n    /* built-in */\n}\n\
        pub fn breakpoint() {}\n";

    #[test]
    fn assembly_macros_take_anything() {
        let plain = without_assembly(ARCH).expect("plain");
        assert!(!plain.contains("rustc_builtin_macro"), "{plain}");
        assert_eq!(plain.matches("::core::unreachable!()").count(), 2);
        assert_eq!(plain.matches("const _: () = ();").count(), 1);
        assert!(plain.starts_with("use a;\n") && plain.ends_with("pub fn breakpoint() {}\n"));
    }

    #[test]
    fn another_core_is_noticed() {
        for text in [
            "",
            "pub macro asm() {}",
            &ARCH.replace("naked_asm", "bare_asm"),
        ] {
            assert!(without_assembly(text).is_err());
        }
    }

    #[test]
    fn the_target_becomes_a_plain_one() {
        let printed = "{\n  \"arch\": \"xtensa\",\n  \"cpu\": \"esp32s3\",\n  \
            \"data-layout\": \"e-m:e\",\n  \"features\": \"+x\",\n  \"vendor\": \"espressif\"\n}";
        let plain = plain_xtensa(printed).expect("plain");
        assert!(plain.contains("\"cpu\": \"esp32\","));
        assert!(plain.contains("i64:64-n32\","));
        assert_eq!(plain.matches("features").count(), 1);
        assert!(plain_xtensa("{}").is_err());
    }

    #[test]
    fn a_package_is_found_by_its_whole_name() {
        let metadata = r#"{"manifest_path":"/r/esp-hal-procmacros-0.2.0/Cargo.toml"},
            {"manifest_path":"/r/esp-hal-1.2.2/Cargo.toml"},{"name":"x"}"#;
        assert_eq!(
            manifest_of(metadata, "esp-hal").as_deref(),
            Some(Path::new("/r/esp-hal-1.2.2"))
        );
        assert_eq!(manifest_of(metadata, "esp-rtos"), None);
    }
}
