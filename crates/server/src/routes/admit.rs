//! Who asks, and whether they may ask now: the first thing that is looked at.

use std::sync::Arc;

use axum::http::HeaderMap;

use crate::problem::Problem;
use crate::state::App;
use crate::tokens::Caller;
use veiloc_admission::Guest;

/// Who asks, one request taken from its allowance. The connection learns which token it brought.
pub(super) fn admit(app: &App, guest: &Guest, headers: &HeaderMap) -> Result<Arc<Caller>, Problem> {
    let callers = app.callers();
    let identified = callers.identify(headers);
    if callers.ask_for_tokens() {
        guest.brought(identified.as_ref().ok().map(|caller| caller.key()));
    }
    let caller = identified?;
    caller.spend()?;
    Ok(caller)
}
