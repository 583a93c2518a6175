//! Fuzzes `credential`; see `access.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("credential", data));
