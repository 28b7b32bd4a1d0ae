//! Classifies abnormal ends of connections. Error texts are discarded, because they could contain input (rule L8).

use std::error::Error;
use std::io;

use crate::queue::Connection;
use crate::telemetry::ConnectionFault;

/// The fault of a connection; `None` if it ended normally. Disconnecting while idle and exceeding the idle time are
/// normal.
pub(crate) fn fault_of(connection: &Connection, ended: hyper::Result<()>) -> Option<ConnectionFault> {
    if connection.is_busy() {
        return Some(ConnectionFault::Left);
    }
    let error = ended.err()?;
    if connection.is_idle() {
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
