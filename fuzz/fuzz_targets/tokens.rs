//! A token file that an operator wrote.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::tokens(bytes);
});
