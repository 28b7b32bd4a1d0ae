//! `veiloc query send --rig`: sends the sealed queries of a session unchanged.

use std::path::Path;
use std::sync::Arc;

use veiloc_client::{Answer, Client, ClientError, LocalizeRequest, RigMessage};

use super::connection::failure;
use crate::commands::rig_file;
use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// Reads a rig file and its queries, and requests the pose of the device. The client is created last.
pub(super) fn send(
    rig: &Path,
    map: &str,
    client: impl FnOnce() -> Result<Client, Failure>,
    request: &LocalizeRequest,
    ui: &Arc<Ui>,
) -> Result<Answer, Failure> {
    let frames = rig_file::read(rig)?.into_iter().map(|named| named.sealed).collect();
    let message = RigMessage { frames };
    let client = client()?;
    ui.info(format!(
        "{}: {} sealed queries, {} bytes",
        rig.display(),
        message.frames.len(),
        message.encode().len()
    ));
    client.localize_rig(map, &message, request).map_err(|error| match error {
        // Nothing was sent: the error names the session, not the service.
        ClientError::UnbalancedAnchors(unbalanced) => {
            Failure::refused(format!("{}: {unbalanced}", rig.display()))
        }
        error => failure(error),
    })
}
