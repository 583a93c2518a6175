//! Fuzzes `policy_blob`; see `robots.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("policy_blob", data));
