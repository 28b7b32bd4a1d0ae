//! A pack from an operator, as the device receives it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::pack(bytes);
});
