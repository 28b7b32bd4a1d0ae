//! The self-test section: one record for all schemes, then one per scheme.

use veiloc_protocol::Scheme;
use zerocopy::{FromBytes, IntoBytes};

use super::layout::{SchemeTestRecord, SelfTestRecord};
use crate::self_test::{CameraErrors, ConfidenceCoverage, CovarianceCalibration, SchemeTest, SelfTest};

pub(super) fn encode(test: &SelfTest) -> Vec<u8> {
    let head = SelfTestRecord {
        scale: test.scale,
        assumed_noise_px: test.assumed_noise_px,
        images: test.images,
        schemes: test.schemes.len() as u32,
    };
    let mut bytes = head.as_bytes().to_vec();
    for scheme in &test.schemes {
        bytes.extend_from_slice(record(scheme).as_bytes());
    }
    bytes
}

/// Decodes the section; returns the reason if it is invalid.
pub(super) fn decode(bytes: &[u8]) -> Result<SelfTest, String> {
    let (head, rest) =
        SelfTestRecord::read_from_prefix(bytes).map_err(|_| "shorter than its first record".to_owned())?;
    let records = <[SchemeTestRecord]>::ref_from_bytes(rest).map_err(|_| "not whole records".to_owned())?;
    if records.len() != head.schemes as usize {
        return Err(format!("{} schemes, and {} records", head.schemes, records.len()));
    }
    let test = SelfTest {
        images: head.images,
        scale: head.scale,
        assumed_noise_px: head.assumed_noise_px,
        schemes: records.iter().map(scheme_test).collect::<Result<_, _>>()?,
    };
    test.check()?;
    Ok(test)
}

fn record(test: &SchemeTest) -> SchemeTestRecord {
    SchemeTestRecord {
        scheme: code(test.scheme),
        localized: test.localized,
        trusted: test.trusted,
        within_of_scale: test.within_of_scale,
        within: test.within,
        median_rotation_deg: test.median_rotation_deg,
        median_translation: test.median_translation,
        median_noise_px: test.median_noise_px,
        center_before: test.before.center,
        center_after: test.after.center,
        pose_before: test.before.pose,
        pose_after: test.after.pose,
        factor: test.calibration.factor,
        rotation_floor: test.calibration.rotation_floor,
        translation_floor: test.calibration.translation_floor,
        camera_sd: test.cameras.sd,
        min_camera_log_odds: test.cameras.min_log_odds,
        min_focal_gain: test.cameras.min_focal_gain,
    }
}

fn scheme_test(record: &SchemeTestRecord) -> Result<SchemeTest, String> {
    let scheme = Scheme::ALL.into_iter().find(|s| code(*s) == record.scheme);
    Ok(SchemeTest {
        scheme: scheme.ok_or_else(|| format!("scheme {} is unknown", record.scheme))?,
        localized: record.localized,
        trusted: record.trusted,
        within_of_scale: record.within_of_scale,
        within: record.within,
        median_rotation_deg: record.median_rotation_deg,
        median_translation: record.median_translation,
        median_noise_px: record.median_noise_px,
        before: ConfidenceCoverage { center: record.center_before, pose: record.pose_before },
        after: ConfidenceCoverage { center: record.center_after, pose: record.pose_after },
        calibration: CovarianceCalibration {
            factor: record.factor,
            rotation_floor: record.rotation_floor,
            translation_floor: record.translation_floor,
        },
        cameras: CameraErrors {
            sd: record.camera_sd,
            min_log_odds: record.min_camera_log_odds,
            min_focal_gain: record.min_focal_gain,
        },
    })
}

/// Code of the scheme, as on the wire.
const fn code(scheme: Scheme) -> u32 {
    match scheme {
        Scheme::Points => 1,
        Scheme::RandomLines => 2,
        Scheme::CoordinatePermutation => 3,
        Scheme::Dcl(_) => 4,
    }
}
