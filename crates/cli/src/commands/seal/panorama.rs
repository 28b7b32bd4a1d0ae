//! Seals panoramas: the pinhole images of each, and the rig file that joins them.

use std::path::Path;

use veiloc_client::Mask;
use veiloc_features::{FeatureError, Image, faces_of_image};
use veiloc_obfuscation::{KnownCamera, Sealer};
use veiloc_protocol::FocalKnowledge;

use super::batch::SealedFiles;
use super::{Attitude, RIG, extract_image, seal};
use crate::args::extraction_error::extraction_error;
use crate::commands::rig_file;
use crate::commands::session_args;
use crate::output::exit::Failure;
use crate::output::items::{InputError, InputErrorKind};

/// Seals the pinhole images of a panorama, each with its own anchors: no keypoint is in two of them. Those with too little texture,
/// such as a ceiling, are left out.
pub(super) fn seal_panorama(
    path: &Path,
    sealer: &Sealer,
    mask: Option<&Mask>,
) -> Result<Result<SealedFiles, InputError>, Failure> {
    let faces = match faces(path, mask) {
        Ok(faces) => faces,
        Err(error) => return Ok(Err(extraction_error(&error.into()))),
    };
    let (mut files, mut frames) = (Vec::new(), Vec::new());
    let (mut found, mut sent) = (0, 0);
    let mut last_fault = None;
    for (face, image) in faces {
        let camera = KnownCamera::calibrated(face.camera);
        let sealed = extract_image(sealer, image, camera, None, Attitude::default())
            .map(|extracted| (extracted.features().keypoints.len(), seal(sealer, extracted, None)));
        match sealed {
            Ok((keypoints, Ok(query))) => {
                found += keypoints;
                sent += query.len();
                let name = format!("{}.vquery", face.name);
                frames.push((name.clone(), face.cam_from_rig, None));
                files.push((name, query.encode()));
            }
            Ok((_, Err(veiloc_client::ClientError::Seal(error)))) => {
                last_fault = Some(InputError::new(InputErrorKind::Unfit, error));
            }
            Ok((_, Err(error))) => return Err(session_args::failure(&error)),
            Err(error) => last_fault = Some(extraction_error(&error)),
        }
    }
    if let Some(fault) = last_fault.filter(|_| files.is_empty()) {
        return Ok(Err(fault));
    }
    // Last: without it the others are no answerable query.
    files.push((RIG.to_owned(), rig_file::fixed(&frames)?));
    Ok(Ok(SealedFiles {
        files,
        focal: FocalKnowledge::Calibrated,
        found,
        sent,
        result: Some(RIG),
        session: None,
    }))
}

fn faces(
    path: &Path,
    mask: Option<&Mask>,
) -> Result<Vec<(veiloc_geometry::PanoramaFace, Image)>, FeatureError> {
    let image = Image::open(path)?;
    let image = match mask {
        Some(mask) => image.without(mask)?,
        None => image,
    };
    faces_of_image(&image)
}
