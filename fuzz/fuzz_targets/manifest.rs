//! A manifest of regions, as a storage that is not trusted may give it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| veiloc_fuzz::manifest(bytes));
