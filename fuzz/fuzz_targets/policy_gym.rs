//! Fuzzes `policy_gym`; see `policies.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("policy_gym", data));
