//! Fuzzes `model`; see `models.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("model", data));
