//! Releases as a person or a script makes and verifies them.

use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::{Command, Output};

use serde_json::Value;

use crate::console::{Place, complaint, done, program, row};
use crate::scratch::Scratch;

/// A folder with a pair of keys and an image for an ESP32-C3.
struct Folder(Scratch);

impl Folder {
    fn new() -> Self {
        let folder = Self(Scratch::new());
        std::fs::create_dir_all(&folder.0.0).expect("a folder");
        folder.ok("keygen --out keys");
        folder.write("image", &esp(5, 150_000));
        folder
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.0.join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("a file");
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).expect("a file")
    }

    fn run(&self, arguments: &str) -> Output {
        let mut command = program();
        command.arg("release").args(arguments.split(' '));
        command.current_dir(&self.0.0).output().expect("runs")
    }

    #[track_caller]
    fn ok(&self, arguments: &str) -> String {
        done(&self.run(arguments))
    }

    #[track_caller]
    fn refused(&self, arguments: &str) -> String {
        complaint(&self.run(arguments), 1)
    }

    /// What `verify` says against a release, as codes.
    #[track_caller]
    fn faults(&self, arguments: &str) -> Vec<String> {
        let output = self.run(&format!("verify --json {arguments}"));
        let found: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|error| {
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            panic!("{error}: {said}")
        });
        let faults = found["faults"].as_array().expect("faults");
        let code = i32::from(!faults.is_empty());
        assert_eq!(output.status.code(), Some(code), "{found}");
        assert_eq!(found["genuine"], faults.is_empty(), "{found}");
        let codes = faults
            .iter()
            .map(|fault| fault["code"].as_str().expect("a code"));
        codes.map(str::to_owned).collect()
    }
}

/// The id in a table.
fn id(table: &str) -> &str {
    row(table, "id").split_whitespace().last().expect("an id")
}

/// An image for an ESP32 with this chip, as far as its header goes.
fn esp(chip: u8, length: usize) -> Vec<u8> {
    let mut image: Vec<u8> = (0..length).map(|at| (at / 7) as u8).collect();
    (image[0], image[1], image[12], image[13]) = (0xE9, 4, chip, 0);
    image
}

const SIGN: &str = "sign --key keys/release-key.pem --image image --board xiao-c3 --version 0.4.0 \
                    --sequence 12 --build abc123";
const PUBLIC: &str = "--public keys/release-public.pem";

#[test]
fn a_release_is_made_and_verified() {
    let folder = Folder::new();
    let made = folder.ok(&format!(
        "{SIGN} --floor 3 --expires 2099-01-31 --out release"
    ));
    let table = folder.ok(&format!(
        "verify release {PUBLIC} --image image --board xiao-c3 --above 11"
    ));
    assert_eq!(made, table);
    for (name, value) in [
        ("board", "xiao-c3 (esp32c3)"),
        ("version", "0.4.0"),
        ("build", "abc123"),
        ("sequence", "12"),
        ("floor", "3"),
        ("expires", "2099-01-31 00:00:00Z"),
        ("image", "150000 bytes in 3 blocks of 64 KiB"),
        ("verdict", "genuine"),
    ] {
        assert!(row(&table, name).ends_with(value), "{name}: {table}");
    }
    let json = folder.ok(&format!("verify release {PUBLIC} --json"));
    let found: Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(found["authentic"], true);
    assert_eq!(found["id"], id(&table), "{table}");
    assert_eq!(found["manifest"]["sequence"], 12);
    assert_eq!(found["manifest"]["expires"], 4_073_500_800_u64);
    // The same order gives the same bytes, in a file that holds the image as it is.
    folder.ok(&format!(
        "{SIGN} --floor 3 --expires 2099-01-31 --out again"
    ));
    assert_eq!(folder.read("release"), folder.read("again"));
    assert!(folder.read("release").ends_with(&folder.read("image")));
    // In days from now.
    let made = folder.ok(&format!("{SIGN} --expires 30 --out days"));
    assert!(row(&made, "expires").ends_with('Z'), "{made}");
}

#[test]
fn what_is_wrong_with_a_release_is_said() {
    let folder = Folder::new();
    folder.ok(&format!("{SIGN} --out release"));
    folder.ok("keygen --out other");
    let whole = folder.read("release");

    assert_eq!(folder.faults("release"), ["no_key"]);
    let table = folder.run("verify release");
    let table = String::from_utf8(table.stdout).expect("UTF-8");
    assert!(row(&table, "signature").contains("NOT VERIFIED"), "{table}");
    assert!(!table.contains("genuine"), "{table}");
    assert_eq!(
        folder.faults("release --public other/release-public.pem"),
        ["unknown_key"]
    );
    assert!(
        folder
            .faults(&format!(
                "release {PUBLIC} --public other/release-public.pem"
            ))
            .is_empty()
    );
    assert_eq!(
        folder.faults(&format!(
            "release {PUBLIC} --board virt --above 12 --image keys/release-key.pem"
        )),
        ["other_image", "wrong_board", "downgrade"]
    );
    for (change, expected) in [
        // Its signature, its manifest, the first block, the last.
        (20, "bad_signature"),
        (100, "bad_signature"),
        (whole.len() - 149_000, "bad_block"),
        (whole.len() - 1, "bad_block"),
    ] {
        let mut changed = whole.clone();
        changed[change] ^= 1;
        folder.write("changed", &changed);
        let faults = folder.faults(&format!("changed {PUBLIC}"));
        assert!(
            faults.contains(&expected.to_owned()),
            "{change}: {faults:?}"
        );
    }
    folder.write("cut", &whole[..whole.len() - 1]);
    assert_eq!(folder.faults(&format!("cut {PUBLIC}")), ["image_too_short"]);
    for (name, bytes) in [
        ("text", &b"no release"[..]),
        ("empty", b""),
        ("head", &whole[..80]),
    ] {
        folder.write(name, bytes);
        let said = folder.refused(&format!("verify {name} {PUBLIC}"));
        assert!(said.contains("not a release"), "{said}");
    }
    assert!(
        folder
            .refused("verify nowhere")
            .contains("cannot read nowhere")
    );
    assert!(
        folder
            .refused("verify release --public keys/release-key.pem")
            .contains("a private key")
    );
}

#[test]
fn what_no_robot_could_take_is_not_signed() {
    let folder = Folder::new();
    folder.write("c6", &esp(13, 1_000));
    folder.write("raw", b"machine code");
    for (change, why) in [
        (
            "--image c6",
            "the image is for esp32c6, the board has esp32c3",
        ),
        ("--image raw", "not an image for an ESP32"),
        ("--board virt", "which the board does not have"),
        ("--board Rover", "a-z"),
        ("--floor 13", "floor"),
        ("--requires-sequence 12", "require"),
        ("--version 1:2", "version"),
        ("--kind model", "name"),
        ("--name eyes", "name"),
        ("--expires 1999-12-31", "expired"),
        ("--key keys/release-public.pem", "the private one"),
        ("--key image", "more than"),
        ("--key nowhere", "cannot read nowhere"),
        ("--image nowhere", "cannot read nowhere"),
        ("--out image", "not written over"),
        ("--out nowhere/release", "cannot write"),
    ] {
        let (option, value) = change.split_once(' ').expect("two words");
        let mut words: Vec<&str> = SIGN.split_whitespace().chain(["--out", "out"]).collect();
        match words.iter().position(|word| *word == option) {
            Some(at) => words[at + 1] = value,
            None => words.extend([option, value]),
        }
        let said = folder.refused(&words.join(" "));
        assert!(said.contains(why), "{change}: {said}");
        assert!(!folder.path("out").exists(), "{change}");
    }
    let without = SIGN.replace(" --build abc123", "");
    assert!(
        folder
            .refused(&format!("{without} --out out"))
            .contains("--build")
    );
    for words in [
        "--sequence 0",
        "--sequence -1",
        "--sequence 12 --expires never",
        "--sequence 12 --chip toaster",
        "--sequence 12 --kind virus",
    ] {
        let output = folder.run(&format!(
            "{} --out out",
            SIGN.replace("--sequence 12", words)
        ));
        assert_eq!(output.status.code(), Some(2), "{words}");
    }
}

#[test]
fn a_delta_is_made_between_two_releases() {
    let folder = Folder::new();
    let sign = |image: &str, change: (&str, &str), out: &str| {
        let sign = SIGN.replace("--image image", &format!("--image {image}"));
        folder.ok(&format!("{} --out {out}", sign.replace(change.0, change.1)));
    };
    let mut image = folder.read("image");
    sign("image", ("abc123", "old"), "old.release");
    image[100_000] ^= 0x55;
    image.splice(50_000..50_000, *b"something that was put in");
    folder.write("next", &image);
    sign("next", ("abc123", "new"), "new.release");
    let delta = "delta --from old.release --to new.release --out patch";
    let said = folder.ok(delta);
    assert!(row(&said, "from").ends_with("old.release: build old, 150000 bytes"));
    assert!(row(&said, "to").ends_with("new.release: build new, 150025 bytes"));
    let patch = folder.read("patch");
    assert!(patch.len() < 1_500, "{said}");
    let expected = format!("patch: {} bytes, 0.", patch.len());
    assert!(row(&said, "delta").contains(&expected), "{said}");
    let old = folder.read("image");
    let made = crawler_updates::delta::apply(&old, image.len() as u32, &patch);
    assert!(made.as_ref() == Ok(&image));

    // Nothing is written over, and nothing of no use is written.
    assert!(folder.refused(delta).contains("patch exists already"));
    folder.write("text", b"text");
    sign(
        "image",
        ("--board xiao-c3", "--board mine"),
        "other.release",
    );
    for (from, to, said) in [
        ("old.release", "old.release", "the same build"),
        ("old.release", "other.release", "the same board"),
        ("text", "new.release", "text: not a release"),
        ("old.release", "text", "text: not a release"),
        ("missing", "new.release", "cannot read missing"),
    ] {
        let refused = folder.refused(&format!("delta --from {from} --to {to} --out none"));
        assert!(refused.contains(said), "{refused}");
    }
    assert!(!folder.path("none").exists());
}

/// A scenario that takes a moment, and asks for little.
const STRAIGHT: &str = "
name = \"straight\"
duration_s = 25.0
[arena]
width = 4.0
height = 2.0
[spawn]
poses = [{ x = -0.6, y = 0.0 }]
[[goals]]
x = 0.6
y = 0.0
[success]
reach = \"all\"
";

const PLAN: &str = "
[[evaluate]]
scenario = \"straight.toml\"
seeds = 2
thresholds = [\"success >= 1\"]
[[replay]]
recording = \"run.mcap\"
";

const GATE: &str = "gate release --key keys/release-key.pem --plan gate.toml";

#[test]
fn a_release_is_tried_and_what_comes_of_it_is_signed() {
    let folder = Folder::new();
    folder.ok(&format!("{SIGN} --out release"));
    folder.ok("keygen --out other");
    folder.write("straight.toml", STRAIGHT.as_bytes());
    folder.write("gate.toml", PLAN.as_bytes());
    let mut replay = program();
    replay.args(["replay", "--scenario", "straight.toml"]);
    replay.args(["--until", "3", "--record", "run.mcap"]);
    done(&replay.current_dir(&folder.0.0).output().expect("runs"));

    let said = folder.ok(&format!("{GATE} --out release.gate"));
    assert!(row(&said, "outcome").ends_with("passed"), "{said}");
    let table = folder.ok(&format!("verify release {PUBLIC} --gate release.gate"));
    assert!(table.contains("genuine"), "{table}");
    for (name, value) in [
        ("about", "(build abc123)"),
        (
            "evaluated",
            "straight: 2 of 2 runs succeed; 1 robots, seeds 1 to 2",
        ),
        ("threshold", "95 % interval 0.3424 to 1.0000)"),
        ("replayed", "run.mcap: 1 of 1 robots do the same"),
        ("outcome", "passed"),
    ] {
        assert!(row(&table, name).ends_with(value), "{name}: {table}");
    }
    let with_gate = format!("release {PUBLIC} --gate");
    assert!(
        folder
            .faults(&format!("{with_gate} release.gate"))
            .is_empty()
    );
    let json = folder.ok(&format!("verify {with_gate} release.gate --json"));
    let found: Value = serde_json::from_str(&json).expect("JSON");
    let report = &found["gate"]["report"];
    assert_eq!(
        (&report["release"], &report["passed"]),
        (&found["id"], &Value::Bool(true))
    );
    let program = report["evaluator"]["program"]
        .as_str()
        .expect("a hash")
        .to_owned();

    // What is against a report is said, as of a release.
    let whole = folder.read("release.gate");
    let mut changed = whole.clone();
    *changed.last_mut().expect("bytes") ^= 1;
    folder.write("changed.gate", &changed);
    folder.ok(&format!("{} --out later", SIGN.replace("12", "13")));
    for (arguments, codes) in [
        (
            format!("{with_gate} changed.gate"),
            &["gate_bad_signature"][..],
        ),
        (
            "release --gate release.gate".to_owned(),
            &["no_key", "gate_no_key"],
        ),
        (
            "release --public other/release-public.pem --gate release.gate".to_owned(),
            &["unknown_key", "gate_unknown_key"],
        ),
        (
            format!("later {PUBLIC} --gate release.gate"),
            &["gate_other_release"],
        ),
    ] {
        assert_eq!(folder.faults(&arguments), codes, "{arguments}");
    }
    let said = folder.refused(&format!("verify {with_gate} image"));
    assert!(said.contains("image: "), "{said}");

    // It binds to a program: that of the image has to be this one.
    let bound = format!("{GATE} --program {program} --out bound.gate");
    assert!(folder.ok(&bound).contains("passed"));
    let other = program.replace(
        &program[..1],
        if program.starts_with('0') { "1" } else { "0" },
    );
    let said = folder.refused(&format!("{GATE} --program {other} --out none"));
    assert!(said.contains("other sources"), "{said}");

    // Nothing is written over, and nothing is tried that is not genuine.
    let said = folder.refused(&format!("{GATE} --out release.gate"));
    assert!(said.contains("release.gate exists already"), "{said}");
    for (from, to, why) in [
        ("keys/", "other/", "release: signed with the unknown key"),
        ("gate release", "gate image", "image: not a release"),
        ("gate.toml", "nowhere.toml", "cannot read nowhere.toml"),
        ("gate.toml", "straight.toml", "straight.toml: "),
    ] {
        let said = folder.refused(&format!("{} --out none", GATE.replace(from, to)));
        assert!(said.contains(why), "{from}: {said}");
    }
    assert!(!folder.path("none").exists());
    assert_eq!(folder.read("release.gate"), whole);
}

#[test]
fn a_release_that_does_not_pass_has_a_report_that_says_so() {
    let folder = Folder::new();
    folder.ok(&format!("{SIGN} --out release"));
    folder.write("straight.toml", STRAIGHT.as_bytes());
    let evaluate = PLAN.split("[[replay]]").next().expect("a part");
    folder.write("gate.toml", evaluate.replace(">= 1", "<= 0.5").as_bytes());
    let output = folder.run(&format!("{GATE} --out failed.gate"));
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(row(&said, "outcome").ends_with("NOT PASSED"), "{said}");
    let faults = folder.faults(&format!("release {PUBLIC} --gate failed.gate"));
    assert_eq!(faults, ["gate_failed"]);

    // What was expected and is not there is as bad as what is there and was not.
    let mut replay = program();
    replay.args(["replay", "--scenario", "straight.toml"]);
    replay.args(["--until", "3", "--record", "run.mcap"]);
    done(&replay.current_dir(&folder.0.0).output().expect("runs"));
    let expected =
        "expected = [{ robot = \"sim-0001\", output = \"duty\", at_s = 1.5, why = \"slower\" }]";
    folder.write("gate.toml", format!("{PLAN}{expected}\n").as_bytes());
    let output = folder.run(&format!("{GATE} --out missing.gate"));
    assert_eq!(output.status.code(), Some(1));
    let said = String::from_utf8(output.stdout).expect("UTF-8");
    assert!(
        row(&said, "difference").ends_with("NOT FOUND, although expected (slower)"),
        "{said}"
    );
}

/// A robot that stands and looks at a thing.
const LOOKS: &str = "
name = \"looks\"
duration_s = 12.0
[arena]
width = 3.0
height = 2.0
paint = \"blue\"
objects = [{ shape = \"cylinder\", x = 0.0, y = 0.0, size = 0.16, colour = \"red\" }]
[spawn]
camera_share = 1.0
poses = [{ x = -1.0, y = 0.0, theta = 0.0 }]
[[commands]]
at_s = 7.0
command = \"set\"
parameters = { vision_always = true }
[success]
alive = \"all\"
";

/// A model of the same shape that says the same of everything: that it is nothing.
fn blind(model: &[u8]) -> Vec<u8> {
    // By `models/micromodel/src/blob.rs`: the last of the layers behind the header, whose highest output becomes its
    // lowest, and the CRC-32 (ISO-HDLC) of all behind it.
    let mut blind = model.to_vec();
    let layers = usize::from(u16::from_le_bytes([blind[6], blind[7]]));
    let last = 32 + 32 * (layers - 1);
    blind[last + 7] = blind[last + 6];
    let crc = blind[16..].iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 * (crc & 1))
        })
    });
    blind[12..16].copy_from_slice(&(!crc).to_le_bytes());
    blind
}

#[test]
fn a_gate_tells_a_model_that_finds_things_from_one_that_does_not() {
    let folder = Folder::new();
    let shipped = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../models/detector/detector.tcmm"
    );
    let model = std::fs::read(shipped).expect("the model that is shipped");
    folder.write("looks.toml", LOOKS.as_bytes());
    folder.write(
        "gate.toml",
        b"[[evaluate]]\nscenario = \"looks.toml\"\nseeds = 1\nthresholds = [\"found >= 1\"]\n",
    );
    for (image, outcome, code) in [
        (model.clone(), "passed", 0),
        (blind(&model), "NOT PASSED", 1),
    ] {
        folder.write("eyes.model", &image);
        let _ = std::fs::remove_file(folder.path("release"));
        folder.ok(
            "sign --key keys/release-key.pem --image eyes.model --kind model --name eyes \
             --board sim --version 2 --sequence 2 --out release",
        );
        let _ = std::fs::remove_file(folder.path("eyes.gate"));
        let output = folder.run(&format!("{GATE} --out eyes.gate"));
        let said = String::from_utf8(output.stdout).expect("UTF-8");
        assert!(row(&said, "outcome").ends_with(outcome), "{said}");
        assert_eq!(output.status.code(), Some(code), "{said}");
    }
}

#[test]
fn a_model_is_tried_by_robots_that_see_with_it() {
    let folder = Folder::new();
    let shipped = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../models/detector/detector.tcmm"
    );
    let model = std::fs::read(shipped).expect("the model that is shipped");
    let sees = STRAIGHT.replace("[spawn]", "[spawn]\ncamera_share = 1.0");
    folder.write("straight.toml", sees.as_bytes());
    let (evaluate, _) = PLAN.split_once("[[replay]]").expect("both");
    folder.write(
        "gate.toml",
        evaluate.replace("seeds = 2", "seeds = 1").as_bytes(),
    );
    let sign = |image: &[u8]| {
        folder.write("eyes.model", image);
        let _ = std::fs::remove_file(folder.path("release"));
        folder.ok(
            "sign --key keys/release-key.pem --image eyes.model --kind model --name eyes \
             --board xiao-s3-sense --version 2 --sequence 2 --out release",
        );
    };
    sign(&model);
    let said = folder.ok(&format!("{GATE} --out eyes.gate"));
    assert!(row(&said, "outcome").ends_with("passed"), "{said}");
    let table = folder.ok(&format!("verify release {PUBLIC} --gate eyes.gate"));
    assert!(row(&table, "outcome").ends_with("passed"), "{table}");
    // What no robot can run passes nothing.
    sign(&model[..model.len() / 2]);
    let output = folder.run(&format!("{GATE} --out torn.gate"));
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let faults = folder.faults(&format!("release {PUBLIC} --gate torn.gate"));
    assert_eq!(faults, ["gate_failed"]);
}

/// `release add` keeps a report beside its release, also later.
#[test]
fn a_gate_is_added_with_its_release() {
    let place = Place::with_admin();
    let folder = Folder::new();
    folder.ok(&format!("{SIGN} --out release"));
    folder.write("straight.toml", STRAIGHT.as_bytes());
    let evaluate = PLAN.split("[[replay]]").next().expect("a part");
    folder.write("gate.toml", evaluate.as_bytes());
    folder.ok(&format!("{GATE} --out release.gate"));
    let data = place.path().display();
    let add = |more: &str| {
        format!("add release --release-key keys/release-public.pem --data {data}{more}")
    };
    folder.write("text", b"text");
    let said = folder.refused(&add(" --gate text"));
    assert!(said.contains("not a report"), "{said}");
    let said = folder.ok(&add(" --gate release.gate"));
    assert!(said.ends_with("added, with its gate\n"), "{said}");
    let said = folder.ok(&add(" --gate release.gate"));
    assert!(said.ends_with("has this gate now\n"), "{said}");
    folder.refused(&add(""));
    let log = place.ok(&["audit", "list"]);
    assert_eq!(log.matches("release.gate").count(), 2, "{log}");
    assert_eq!(log.matches("release.add").count(), 2, "{log}");
}

#[test]
fn keys_are_not_lost_and_not_shown() {
    let folder = Folder::new();
    let mode = |name: &str| {
        let metadata = std::fs::metadata(folder.path(name)).expect("a file");
        metadata.permissions().mode() & 0o777
    };
    assert_eq!(mode("keys/release-key.pem"), 0o600);
    let key = folder.read("keys/release-key.pem");
    assert!(
        folder
            .refused("keygen --out keys")
            .contains("not written over")
    );
    assert_eq!(folder.read("keys/release-key.pem"), key);
    // Nor is half of a pair completed with something else.
    std::fs::remove_file(folder.path("keys/release-key.pem")).expect("removed");
    assert!(
        folder
            .refused("keygen --out keys")
            .contains("not written over")
    );
    assert!(!folder.path("keys/release-key.pem").exists());
}

/// OpenSSL believes our releases, and signs some itself.
#[test]
fn keys_and_signatures_are_those_of_openssl() {
    let folder = Folder::new();
    let openssl = |arguments: &str| {
        let mut command = Command::new("openssl");
        command.args(arguments.split(' ')).current_dir(&folder.0.0);
        command.output()
    };
    let read = "pkey -in keys/release-key.pem -pubout -outform DER -out ours.der";
    match openssl(read) {
        Ok(output) => done(&output),
        Err(error) => {
            eprintln!("skipped: openssl cannot be run ({error}); cargo xtask setup installs it");
            return;
        }
    };
    let public = "pkey -pubin -in keys/release-public.pem -outform DER -out public.der";
    done(&openssl(public).expect("there"));
    assert_eq!(folder.read("ours.der"), folder.read("public.der"));

    folder.ok(&format!("{SIGN} --out release"));
    let file = folder.read("release");
    let envelope = &file[2..2 + usize::from(u16::from_le_bytes([file[0], file[1]]))];
    folder.write("manifest", &envelope[76..]);
    folder.write("signature", &der(&envelope[12..76]));
    let verify = "dgst -sha256 -verify keys/release-public.pem -signature signature manifest";
    assert!(done(&openssl(verify).expect("there")).contains("Verified OK"));
    folder.write("manifest", &envelope[75..]);
    assert!(!openssl(verify).expect("there").status.success());

    let generate = "genpkey -algorithm EC -pkeyopt ec_paramgen_curve:P-256 -out theirs.pem";
    done(&openssl(generate).expect("there"));
    done(&openssl("pkey -in theirs.pem -pubout -out theirs.pub").expect("there"));
    let sign = SIGN.replace("keys/release-key.pem", "theirs.pem");
    folder.ok(&format!("{sign} --out theirs"));
    assert!(folder.faults("theirs --public theirs.pub").is_empty());
    // The older form of a key says how to get at the newer.
    done(&openssl("ec -in theirs.pem -out old.pem").expect("there"));
    let sign = SIGN.replace("keys/release-key.pem", "old.pem");
    assert!(
        folder
            .refused(&format!("{sign} --out old"))
            .contains("openssl pkcs8")
    );
}

/// Two numbers as DER has them: SEQUENCE of INTEGER.
fn der(signature: &[u8]) -> Vec<u8> {
    let mut body = Vec::new();
    for number in signature.chunks(32) {
        let zeros = number.iter().take_while(|byte| **byte == 0).count();
        let number = &number[zeros..];
        let sign = usize::from(number[0] >= 0x80);
        body.extend([2, (number.len() + sign) as u8]);
        body.extend(&[0][..sign]);
        body.extend(number);
    }
    [&[0x30, body.len() as u8], &body[..]].concat()
}

#[test]
fn a_bundle_is_made_signed_and_refused_where_it_does_not_belong() {
    let folder = Folder::new();
    let made = folder.ok(
        "bundle --version 0.4.0 --build abc123 --size 20000 --defect never-link@10% --defect panic=5000 \
         --set safe_distance_mm=700 --out bundle",
    );
    assert_eq!(row(&made, "bytes"), "bytes    20000");
    assert!(
        made.contains("panic=5000\n") && made.contains("never-link@10%"),
        "{made}"
    );
    assert_eq!(folder.read("bundle").len(), 20_000);
    let sign = |board: &str, version: &str, build: &str, out: &str| {
        format!(
            "sign --key keys/release-key.pem --image bundle --board {board} --version {version} --sequence 12 \
             --build {build} --out {out}"
        )
    };
    folder.ok(&sign("sim", "0.4.0", "abc123", "good.release"));
    assert_eq!(
        folder.faults(&format!("good.release {PUBLIC} --board sim")),
        [""; 0]
    );
    for (board, version, build, said) in [
        ("sim", "0.4.1", "abc123", "another version"),
        ("sim", "0.4.0", "abc124", "another build"),
        ("virt", "0.4.0", "abc123", "for simulated robots"),
        ("xiao-c3", "0.4.0", "abc123", "for simulated robots"),
    ] {
        let complaint = folder.refused(&sign(board, version, build, "bad.release"));
        assert!(complaint.contains(said), "{complaint}");
    }
    folder.write("bundle", &esp(5, 1_000));
    let complaint = folder.refused(&sign("sim", "0.4.0", "abc123", "bad.release"));
    assert!(complaint.contains("release bundle"), "{complaint}");
    let twice = "bundle --version 1 --build b --defect panic=1 --defect panic=2 --out twice";
    assert!(folder.refused(twice).contains("at most once"));
    let small = "bundle --version 1 --build b --size 10 --out small";
    assert!(folder.refused(small).contains("at least as many"));
    assert!(!folder.path("bad.release").exists() && !folder.path("twice").exists());
}

#[test]
fn a_genuine_release_is_added_once_and_the_log_says_by_whom() {
    let folder = Folder::new();
    folder.ok(&format!("{SIGN} --out release"));
    let place = Place::with_admin();
    let add = |file: &str, key: Option<&str>| {
        let [file, key] = [Some(file), key].map(|name| name.map(|name| folder.path(name)));
        let key = key.map(|key| key.display().to_string());
        let file = file.expect("a file").display().to_string();
        let mut arguments = vec!["release", "add", &file];
        arguments.extend(key.iter().flat_map(|key| ["--release-key", key]));
        place.run(&arguments)
    };
    let public = Some("keys/release-public.pem");
    // Without a key, with the other half, and with another one.
    let told = complaint(&add("release", None), 1);
    assert!(told.contains("--release-key"), "{told}");
    let told = complaint(&add("release", Some("keys/release-key.pem")), 1);
    assert!(told.contains("a private key"), "{told}");
    let told = complaint(&add("nothing", public), 1);
    assert!(told.contains("No such file"), "{told}");
    folder.ok("keygen --out other");
    let refused = add("release", Some("other/release-public.pem"));
    let said = String::from_utf8(refused.stdout).expect("UTF-8");
    assert_eq!(refused.status.code(), Some(1));
    assert!(row(&said, "REFUSED").contains("unknown_key"), "{said}");

    let table = done(&add("release", public));
    assert!(row(&table, "verdict").ends_with("genuine"), "{table}");
    let told = complaint(&add("release", public), 1);
    assert!(told.contains("already"), "{told}");
    let log = place.ok(&["audit", "list"]);
    let added = id(&table);
    let added = log
        .lines()
        .filter(|line| line.contains("release.add") && line.contains(added));
    let added: Vec<_> = added.collect();
    assert_eq!(added.len(), 2, "{log}");
    assert!(
        added[1].contains("console:tester") && added[1].contains("ok"),
        "{log}"
    );

    // A directory that holds no records gets none by a typing mistake.
    let file = folder.path("release").display().to_string();
    let key = folder.path("keys/release-public.pem").display().to_string();
    let other = Place::new();
    std::fs::create_dir_all(other.path()).expect("a folder");
    let told = other.refused(&["release", "add", &file, "--release-key", &key]);
    assert!(told.contains("holds no records"), "{told}");
}
