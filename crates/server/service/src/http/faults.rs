//! What went wrong with a connection, as a kind to be counted. The texts of errors go nowhere: they could hold what was
//! sent (rule L8).

use std::error::Error;
use std::io;

use crate::queue::Guest;
use crate::telemetry::ConnectionFault;

/// Why a connection ended, when it was not well. A client that goes while nothing is going on does nothing wrong, nor does
/// one that is idle for too long.
pub(crate) fn fault_of(guest: &Guest, ended: hyper::Result<()>) -> Option<ConnectionFault> {
    if guest.is_busy() {
        return Some(ConnectionFault::Left);
    }
    let error = ended.err()?;
    if guest.is_idle() {
        return None;
    }
    let causes = || std::iter::successors(Some(&error as &(dyn Error + 'static)), |error| (*error).source());
    if causes().filter_map(|e| e.downcast_ref::<io::Error>()).any(|e| e.kind() == io::ErrorKind::TimedOut) {
        return Some(ConnectionFault::AnswerTimeout);
    }
    Some(match causes().find_map(|error| error.downcast_ref::<hyper::Error>()) {
        Some(error) if error.is_parse_too_large() => ConnectionFault::HeadTooLong,
        Some(error) if error.is_parse() => ConnectionFault::NotHttp,
        Some(error) if error.is_timeout() => ConnectionFault::HeadTimeout,
        _ => ConnectionFault::Interrupted,
    })
}
