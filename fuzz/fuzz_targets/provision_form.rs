//! Fuzzes `provision_form`; see `board.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("provision_form", data));
