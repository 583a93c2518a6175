use super::*;

fn options() -> Options {
    let broker = "mqtt://127.0.0.1:1884".parse().expect("an address");
    let robot = RobotId::new("virt-01").expect("an id");
    Options::new("/nowhere/crawler-virt".into(), robot, broker)
}

#[test]
fn boot_arguments_are_one_line() {
    let mut options = options();
    assert_eq!(
        options.line().expect("a line"),
        "id=virt-01 fleet=swarm broker=10.0.2.2:1884"
    );
    options.broker.host = "robots.local".into();
    options.broker.credentials = Some(("ada".into(), "secret".into()));
    options.arguments.push("fault=line-stuck".into());
    assert_eq!(
        options.line().expect("a line"),
        "id=virt-01 fleet=swarm broker=robots.local:1884 user=ada password=secret fault=line-stuck"
    );
    options.broker.credentials = Some(("ada".into(), "my secret".into()));
    let error = options.line().expect_err("a blank").to_string();
    assert!(
        error.contains("password") && !error.contains("my"),
        "{error}"
    );
}

#[test]
fn what_is_missing_is_named_with_its_remedy() {
    let error = Emulator::start(options()).err().expect("no image");
    assert!(error.to_string().contains("cargo xtask image --board virt"));
    assert!(
        EmulatorError::NoQemu
            .to_string()
            .contains("qemu-system-misc")
    );
}

#[test]
fn a_text_file_is_not_an_image() {
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), "not an ELF").expect("a file");
    let options = Options {
        image: file.path().to_owned(),
        ..options()
    };
    let error = Emulator::start(options).err().expect("not an image");
    assert!(error.to_string().contains("is not an image"), "{error}");
}

#[test]
fn paths_with_commas_stay_whole() {
    let made = option("file=", Path::new("/a,b"), ",x");
    assert_eq!(made, "file=/a,,b,x");
}

/// The control socket of a bare machine, without any image of ours.
#[test]
fn the_control_socket_is_spoken_to() {
    let folder = tempfile::tempdir().expect("a folder");
    let (socket, said) = (folder.path().join("q"), folder.path().join("said"));
    let mut child = Command::new(QEMU)
        .args(["-M", "virt", "-m", "32M", "-bios", "none", "-S"])
        .args(["-display", "none", "-monitor", "none", "-serial", "none"])
        .args(["-netdev", "user,id=n0"])
        .args(["-device", "virtio-net-device,netdev=n0"])
        .arg("-qmp")
        .arg(option("unix:", &socket, ",server=on,wait=off"))
        .stdin(Stdio::null())
        .spawn()
        .expect("qemu-system-riscv32 is missing: apt-get install qemu-system-misc");
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
        let mut control = reach(&socket, &mut child, &said).expect("a control socket");
        let link = |up| serde_json::json!({"name": "n0", "up": up});
        control.execute("set_link", &link(false)).expect("down");
        control.execute("set_link", &link(true)).expect("up");
        let nothing = serde_json::json!({});
        control.execute("system_reset", &nothing).expect("a reset");
        let wrong = serde_json::json!({"name": "n1", "up": true});
        let error = control.execute("set_link", &wrong).expect_err("no n1");
        assert!(error.to_string().contains("n1"), "{error}");
        control.execute("quit", &nothing).expect("the end");
    }));
    end(&mut child);
    assert!(result.is_ok());
}
