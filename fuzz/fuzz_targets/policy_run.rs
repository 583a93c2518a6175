//! Fuzzes `policy_run`; see `policies.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("policy_run", data));
