//! Known answers: RFC 8448, section 3. Its suite is another; secrets do not depend on that.

use std::string::String;
use std::vec::Vec;

use crate::keys::{check_finished, derive, finished, handshake, master};

fn bytes(text: &str) -> Vec<u8> {
    let digits: String = text.split_whitespace().collect();
    (0..digits.len() / 2)
        .map(|at| u8::from_str_radix(&digits[2 * at..2 * at + 2], 16).expect("digits"))
        .collect()
}

fn secret(text: &str) -> [u8; 32] {
    bytes(text).try_into().expect("32 bytes")
}

#[test]
fn secrets_are_those_of_the_published_trace() {
    let shared = secret("8bd4054fb55b9d63fdfbacf9f04b9f0d35e6d63f537563efd46272900f89492d");
    let stage = handshake(&shared).unwrap();
    assert_eq!(
        *stage,
        secret("1dc826e93606aa6fdc0aadc12f741b01046aa6b99f691ed221a9f0ca043fbeac")
    );
    let hellos = secret("860c06edc07858ee8e78f0e7428c58edd6b43f2ca3e6e95f02ed063cf0e1cad8");
    let client = derive(&stage, "c hs traffic", &hellos).unwrap();
    assert_eq!(
        *client,
        secret("b3eddb126e067f35a780b3abf45e2d8f3b1a950738f52e9600746a0e27a55a21")
    );
    let server = derive(&stage, "s hs traffic", &hellos).unwrap();
    assert_eq!(
        *server,
        secret("b67b7d690cc16c4e75e54213cb2d37b4e9c912bcded9105d42befd59d391ad38")
    );
    assert_eq!(
        *master(&stage).unwrap(),
        secret("18df06843d13a08bf2a449844c5f8a478001bc4d4c627984d5a41da8d0402919")
    );
}

#[test]
fn a_mac_is_checked_against_itself_alone() {
    let (one, hash) = ([7; 32], [9; 32]);
    let mac = finished(&one, &hash).unwrap();
    assert!(check_finished(&one, &hash, &mac).is_ok());
    assert!(check_finished(&one, &hash, &mac[..31]).is_err());
    assert!(check_finished(&[8; 32], &hash, &mac).is_err());
    assert!(check_finished(&one, &[8; 32], &mac).is_err());
}
