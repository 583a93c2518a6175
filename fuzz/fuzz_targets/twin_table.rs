//! Fuzzes `twin_table`; see `twins.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("twin_table", data));
