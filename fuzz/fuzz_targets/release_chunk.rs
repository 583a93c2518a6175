//! Fuzzes `release_chunk`; see `release.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("release_chunk", data));
