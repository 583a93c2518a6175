//! Fuzzes `release_gate`; see `gate.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("release_gate", data));
