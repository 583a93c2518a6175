//! Fuzzes `boot_otadata`; see `boot.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("boot_otadata", data));
