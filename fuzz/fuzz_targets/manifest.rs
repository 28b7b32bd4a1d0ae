//! A manifest of regions from an untrusted store.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::manifest(bytes);
});
