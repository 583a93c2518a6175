//! Fuzzes `delta_patch`; see `delta.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("delta_patch", data));
