//! Fuzzes `map_segment`; see `targets.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("map_segment", data));
