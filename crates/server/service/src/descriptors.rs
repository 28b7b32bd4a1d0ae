//! Open files: every connection is one, and the system allows a process so many.

use crate::error::ServerError;
use crate::options::ServerOptions;

/// For maps, tokens and certificates being read, the log, standard streams, and connections that are just being closed.
const OTHERS: u64 = 128;

/// Raises the process's limit of open files to what the options need.
///
/// # Errors
/// [`ServerError::OpenFiles`] when the system does not allow as many.
#[cfg(unix)]
pub(crate) fn make_room(options: &ServerOptions) -> Result<(), ServerError> {
    let needed = options.connections.get() as u64 + crate::admin::CONNECTIONS as u64 + OTHERS;
    // Where the limit cannot be asked for there is nothing to hold the options against.
    let Ok((soft, _)) = rlimit::Resource::NOFILE.get() else { return Ok(()) };
    let allowed = if soft >= needed { soft } else { rlimit::increase_nofile_limit(needed).unwrap_or(soft) };
    if allowed < needed {
        return Err(ServerError::OpenFiles { connections: options.connections.get(), needed, allowed });
    }
    Ok(())
}

/// Elsewhere there is no such limit.
#[cfg(not(unix))]
pub(crate) fn make_room(_: &ServerOptions) -> Result<(), ServerError> {
    let _ = OTHERS;
    Ok(())
}
