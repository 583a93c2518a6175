//! OpenSSL makes keys and signatures that are believed here, and believes those made here.

use std::path::Path;
use std::process::{Command, Output};

use crawler_release::{HASH, PublicKey, Refusal, Signed};
use p256::ecdsa::signature::hazmat::PrehashSigner as _;
use p256::ecdsa::{Signature, SigningKey};

use crate::support::{Draft, envelope, public};

/// Runs `openssl` in a folder; `None`, and a line that says so, where there is none.
fn openssl(folder: &Path, arguments: &str) -> Option<Output> {
    let mut command = Command::new("openssl");
    command.current_dir(folder).args(arguments.split(' '));
    match command.output() {
        Ok(output) => Some(output),
        Err(error) => {
            eprintln!("skipped: openssl cannot be run ({error}); cargo xtask setup installs it");
            None
        }
    }
}

#[track_caller]
fn done(output: &Output) {
    let text = [&output.stdout[..], &output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    assert!(output.status.success(), "{text}");
}

/// The scalars of a signature in DER (SEQUENCE of two INTEGERs), 32 bytes each.
fn scalars(der: &[u8]) -> [u8; 64] {
    let mut signature = [0; 64];
    assert_eq!(der[..2], [0x30, der.len() as u8 - 2]);
    let mut rest = &der[2..];
    for place in signature.chunks_mut(32) {
        assert_eq!(rest[0], 2);
        let (number, behind) = rest[2..].split_at(rest[1].into());
        rest = behind;
        let zeros = number.iter().take_while(|byte| **byte == 0).count();
        let number = &number[zeros..];
        place[32 - number.len()..].copy_from_slice(number);
    }
    assert!(rest.is_empty());
    signature
}

#[test]
fn what_openssl_signs_is_believed() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |arguments: &str| openssl(folder.path(), arguments);
    let generate = "genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out key.pem";
    let Some(output) = run(generate) else { return };
    done(&output);
    done(&run("pkey -in key.pem -pubout -outform DER -out public.der").expect("there"));
    let info = std::fs::read(folder.path().join("public.der")).expect("a key");
    // The point is the end of a SubjectPublicKeyInfo, as `docs/updates.md` says.
    let key = PublicKey::from_sec1(&info[info.len() - 65..]).expect("a point");
    for size in 1..=8 {
        let draft = Draft::of(&vec![7; size * 50_000]);
        let manifest = draft.encoded();
        std::fs::write(folder.path().join("manifest"), &manifest).expect("a file");
        done(&run("dgst -sha256 -sign key.pem -out signature manifest").expect("there"));
        let der = std::fs::read(folder.path().join("signature")).expect("a signature");
        let mut envelope = envelope(&key, &scalars(&der), &manifest);
        let believed = Signed::parse(&envelope).expect("whole").authenticate(&key);
        assert_eq!(believed, Ok(draft.manifest()));
        *envelope.last_mut().expect("bytes") ^= 1;
        let refused = Signed::parse(&envelope).expect("whole").authenticate(&key);
        assert_eq!(refused, Err(Refusal::BadSignature));
    }
}

#[test]
fn what_is_signed_here_openssl_believes() {
    // The SubjectPublicKeyInfo of a key of P-256 (RFC 5480), up to its point.
    const INFO: [u8; 26] = [
        0x30, 0x59, 0x30, 0x13, 6, 7, 0x2A, 0x86, 0x48, 0xCE, 0x3D, 2, 1, 6, 8, 0x2A, 0x86, 0x48,
        0xCE, 0x3D, 3, 1, 7, 3, 0x42, 0,
    ];
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).expect("a file");
    };
    for number in 1..=8 {
        let key = SigningKey::from_slice(&[number; 32]).expect("a key");
        let point = key.verifying_key().to_sec1_point(false);
        write("public.der", &[&INFO[..], point.as_bytes()].concat());
        let manifest = Draft::of(&[number; 1_000]).encoded();
        let hash: [u8; HASH] = Signed::new(public(&key).id(), &[0; 64], &manifest)
            .expect("short")
            .hash();
        let signature: Signature = key.sign_prehash(&hash).expect("signed");
        write("manifest", &manifest);
        write("signature", signature.to_der().as_bytes());
        let verify = "dgst -sha256 -verify public.der -keyform DER -signature signature manifest";
        let Some(output) = openssl(folder.path(), verify) else {
            return;
        };
        done(&output);
        write("manifest", &manifest[1..]);
        let output = openssl(folder.path(), verify).expect("there");
        assert!(!output.status.success(), "openssl believes anything");
    }
}
