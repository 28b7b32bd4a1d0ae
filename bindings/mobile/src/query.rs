//! Sealed queries: the bytes to send.

use std::sync::Arc;

use veiloc_ar::rig_message;
use veiloc_protocol::{SealedQuery, SizeClass};

use crate::error::VeilocException;
use crate::pose::CameraPose;
use crate::sealer::Sealer;

/// A sealed query.
#[derive(uniffi::Object)]
pub struct Query {
    pub(crate) sealed: SealedQuery,
    pub(crate) sealer: Arc<Sealer>,
    pub(crate) keypoints: u32,
    pub(crate) brightness: f64,
}

#[uniffi::export]
impl Query {
    /// The bytes for `POST /v1/maps/{map}/localize`: all that leaves the device. `rows`: all rows, or one of `steps`.
    /// After a network error, send the same bytes again.
    ///
    /// # Errors
    /// [`VeilocException::Argument`] for a number of rows that is not a step.
    #[uniffi::method(default(rows = None))]
    pub fn bytes(&self, rows: Option<u32>) -> Result<Vec<u8>, VeilocException> {
        let Some(rows) = rows else { return Ok(self.sealed.encode()) };
        let class = SizeClass::from_rows(rows as usize)
            .ok_or_else(|| VeilocException::argument(format!("{rows} rows are not a step of the query")))?;
        let part = self.sealed.first_rows(class, self.sealer.sealer.profile());
        Ok(part.map_err(VeilocException::argument)?.encode())
    }

    /// Rows of the query.
    pub fn rows(&self) -> u32 {
        self.sealed.len() as u32
    }

    /// Rows of each step of progressive localization that can determine a pose, ascending.
    pub fn steps(&self) -> Vec<u32> {
        let steps = self.sealed.useful_steps(self.sealer.sealer.profile());
        steps.map(|class| class.rows() as u32).collect()
    }

    /// Keypoints that were found in the frame.
    pub fn keypoints(&self) -> u32 {
        self.keypoints
    }

    /// Mean gray of the frame, 0 to 1.
    pub fn brightness(&self) -> f64 {
        self.brightness
    }
}

/// Several queries of one device and the poses of their cameras, for `POST /v1/maps/{map}/localize-rig`: localized
/// together. The answer is the pose of the first camera. Only poses relative to it are sent.
///
/// `rotation_sd_deg` and `translation_sd` (metres): how exact the AR framework's poses are.
///
/// # Errors
/// [`VeilocException::Argument`] for no or more than 32 queries, another number of poses, invalid numbers, or queries that were
/// not sealed in one session.
#[uniffi::export]
pub fn rig_bytes(
    queries: Vec<Arc<Query>>,
    cameras_in_world: Vec<CameraPose>,
    metres_per_unit: f64,
    rotation_sd_deg: f64,
    translation_sd: f64,
) -> Result<Vec<u8>, VeilocException> {
    let cameras: Vec<_> =
        cameras_in_world.into_iter().map(CameraPose::cam_from_ar).collect::<Result<_, _>>()?;
    let queries = queries.iter().map(|query| query.sealed.clone()).collect();
    let message = rig_message(queries, &cameras, metres_per_unit, rotation_sd_deg, translation_sd);
    message.map(|message| message.encode()).map_err(VeilocException::argument)
}
