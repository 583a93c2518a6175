//! Fuzzes `twin_certificate`; see `twins.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("twin_certificate", data));
