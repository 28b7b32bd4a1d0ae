//! The generator of UniFFI: `bindings/mobile/generate.sh` runs it.

fn main() {
    uniffi::uniffi_bindgen_main();
}
