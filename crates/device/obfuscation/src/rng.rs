//! Random numbers fit for sealing.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;

use crate::SealError;

/// A cryptographic generator seeded by the operating system, with which a device seals.
///
/// Order, dither, random directions, pairs and decoys depend on it; a predictable generator would reveal them.
///
/// # Errors
/// [`SealError::NoEntropy`] when the operating system has no random numbers.
pub fn device_rng() -> Result<ChaCha20Rng, SealError> {
    let mut seed = [0; 32];
    getrandom::fill(&mut seed).map_err(|e| SealError::NoEntropy { reason: e.to_string() })?;
    Ok(ChaCha20Rng::from_seed(seed))
}

#[cfg(test)]
mod tests {
    use rand::Rng;

    use super::*;

    #[test]
    fn two_devices_draw_different_numbers() {
        let draw = || device_rng().expect("every test machine has entropy").random::<u128>();
        assert_ne!(draw(), draw());
    }
}
