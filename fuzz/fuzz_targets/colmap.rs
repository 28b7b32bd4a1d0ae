//! A folder with a COLMAP model, text or binary.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::colmap(bytes);
});
