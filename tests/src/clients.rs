//! The clients that come with Mosquitto: tools that nobody here wrote.

use std::process::Command;

use crate::engines::program;

/// Publishes with `mosquitto_pub` at QoS 1.
///
/// # Panics
/// When the tool is missing or reports a failure.
pub fn publish(port: u16, topic: &str, payload: &str) {
    let output = Command::new(program("mosquitto_pub"))
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", topic, "-m", payload])
        .output()
        .expect("mosquitto_pub");
    assert!(
        output.status.success(),
        "mosquitto_pub: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}

/// Collects with `mosquitto_sub` what arrives on `filter` until `count` messages or `seconds`,
/// as `(topic, payload)`; retained messages count.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe(port: u16, filter: &str, count: usize, seconds: u32) -> Vec<(String, String)> {
    subscribe_with(port, &[], filter, count, seconds)
}

/// The same with further `arguments`, such as `-u` and `-P`.
///
/// # Panics
/// When the tool is missing.
pub fn subscribe_with(
    port: u16,
    arguments: &[&str],
    filter: &str,
    count: usize,
    seconds: u32,
) -> Vec<(String, String)> {
    let output = Command::new(program("mosquitto_sub"))
        .args(["-V", "mqttv5", "-h", "127.0.0.1", "-p", &port.to_string()])
        .args(["-q", "1", "-t", filter, "-F", "%t %p"])
        .args(arguments)
        .args(["-C", &count.to_string(), "-W", &seconds.to_string()])
        .output()
        .expect("mosquitto_sub");
    String::from_utf8_lossy(&output.stdout)
        .lines()
        .filter_map(|line| line.split_once(' '))
        .map(|(topic, payload)| (topic.to_owned(), payload.to_owned()))
        .collect()
}
