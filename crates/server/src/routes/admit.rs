//! Who asks, and whether they may ask now: the first thing that is looked at.

use std::sync::Arc;

use axum::http::HeaderMap;

use crate::problem::Problem;
use crate::state::App;
use crate::tokens::Caller;

/// Who asks, one request taken from its allowance.
pub(super) fn admit(app: &App, headers: &HeaderMap) -> Result<Arc<Caller>, Problem> {
    let caller = app.callers().identify(headers)?;
    caller.spend()?;
    Ok(caller)
}
