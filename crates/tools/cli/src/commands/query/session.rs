//! `veiloc query send --rig`: the sealed queries of a session, sent as they are.

use std::path::Path;
use std::sync::Arc;

use veiloc_client::{Answer, Client, ClientError, LocalizeRequest, RigMessage};

use super::connection::failure;
use crate::commands::rig_file;
use crate::exit::Failure;
use crate::ui::Ui;

/// Reads a rig file and its queries, and asks where the device was. Nothing is sealed, and the client is made last.
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
    ui.say(format!(
        "{}: {} sealed queries, {} bytes",
        rig.display(),
        message.frames.len(),
        message.encode().len()
    ));
    client.localize_rig(map, &message, request).map_err(|error| match error {
        // Not sent: which session it is matters more than which service.
        ClientError::Lopsided(lopsided) => Failure::refused(format!("{}: {lopsided}", rig.display())),
        error => failure(error),
    })
}
