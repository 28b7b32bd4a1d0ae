//! Who asks, and whether they may ask now, for this map: the first things that are looked at.

use std::sync::Arc;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::HeaderMap;

use crate::maps::Hosted;
use crate::problem::Problem;
use crate::queue::Guest;
use crate::state::App;
use crate::telemetry::Trail;
use crate::tokens::Caller;

/// Who asks, one request taken from its allowance. The connection learns which token it brought, the trail
/// whose it is.
pub(super) fn admit(
    app: &App,
    guest: &Guest,
    trail: &Trail,
    headers: &HeaderMap,
) -> Result<Arc<Caller>, Problem> {
    let callers = app.callers();
    let identified = callers.identify(headers);
    if callers.ask_for_tokens() {
        guest.brought(identified.as_ref().ok().map(|caller| caller.key()));
    }
    let caller = identified?;
    caller.sign(trail);
    caller.spend()?;
    Ok(caller)
}

/// The map that somebody asks something of who may; the trail learns which.
pub(super) fn asked(
    app: &App,
    guest: &Guest,
    trail: &Trail,
    name: Result<Path<String>, PathRejection>,
    headers: &HeaderMap,
) -> Result<Arc<Hosted>, Problem> {
    let caller = admit(app, guest, trail, headers)?;
    let hosted = wanted(app, &caller, name)?;
    trail.about(hosted.name.as_str().into());
    Ok(hosted)
}

/// The map that is asked for. One that the caller may not ask for is no other than one that does not exist: nobody is told
/// what else is served.
pub(super) fn wanted(
    app: &App,
    caller: &Caller,
    name: Result<Path<String>, PathRejection>,
) -> Result<Arc<Hosted>, Problem> {
    let name = name.map_err(|_| Problem::UnknownMap)?;
    if caller.may_ask_for(&name) { app.maps.served(&name) } else { Err(Problem::UnknownMap) }
}
