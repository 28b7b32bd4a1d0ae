//! The sRGB curve (IEC 61966-2-1) between stored samples and linear light, both 0 to 1.

/// Light of a stored sample.
pub(super) fn light_of(stored: f32) -> f32 {
    if stored <= 0.040_45 { stored / 12.92 } else { ((stored + 0.055) / 1.055).powf(2.4) }
}

/// The sample of this light; values are clamped to black and white.
pub(super) fn stored_of(light: f32) -> f32 {
    let light = light.clamp(0.0, 1.0);
    if light <= 0.003_130_8 { light * 12.92 } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_round_trip() {
        for i in 0..=255 {
            let stored = i as f32 / 255.0;
            assert!((stored_of(light_of(stored)) - stored).abs() < 1e-4, "{i}");
        }
        // Middle gray: 18 % of the light is stored as 118.
        assert!((stored_of(0.18) * 255.0 - 118.0).abs() < 0.5);
        assert!(stored_of(-1.0) == 0.0 && (stored_of(7.0) - 1.0).abs() < 1e-6);
    }
}
