//! The limit of open files: each connection is an open file, and the system limits their number per process.

use crate::error::ServerError;
use crate::options::ServerOptions;

/// Reserve for maps, tokens, certificates, the log, standard streams, and connections that are closing.
const OTHER_FILES: u64 = 128;

/// Raises the process's limit of open files to what the options need.
///
/// # Errors
/// [`ServerError::OpenFiles`]: the system does not allow as many.
#[cfg(unix)]
pub(crate) fn raise_limit(options: &ServerOptions) -> Result<(), ServerError> {
    let needed = options.connections.get() as u64 + crate::serve::admin::CONNECTIONS as u64 + OTHER_FILES;
    // If the limit cannot be read, it cannot be checked.
    let Ok((soft, _)) = rlimit::Resource::NOFILE.get() else { return Ok(()) };
    let allowed = if soft >= needed { soft } else { rlimit::increase_nofile_limit(needed).unwrap_or(soft) };
    if allowed < needed {
        return Err(ServerError::OpenFiles { connections: options.connections.get(), needed, allowed });
    }
    Ok(())
}

/// Other systems have no such limit.
#[cfg(not(unix))]
pub(crate) fn raise_limit(_: &ServerOptions) -> Result<(), ServerError> {
    let _ = OTHER_FILES;
    Ok(())
}
