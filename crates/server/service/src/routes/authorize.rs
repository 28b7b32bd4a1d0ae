//! Authentication, rate limit and map access: the first checks of a request.

use std::sync::Arc;

use axum::extract::Path;
use axum::extract::rejection::PathRejection;
use axum::http::HeaderMap;

use veiloc_map::is_map_name;
use veiloc_map::regions::ObjectId;

use crate::auth::tokens::Caller;
use crate::http::problem::Problem;
use crate::maps::LoadedMap;
use crate::maps::regions::RegionFailure;
use crate::queue::Connection;
use crate::serve::state::App;
use crate::telemetry::RequestContext;

/// Header of W3C Trace Context.
const TRACEPARENT: &str = "traceparent";

/// Authenticates the client and takes one request from its rate limit. Records the token in the connection and in the
/// request context.
pub(super) fn authenticate(
    app: &App,
    connection: &Connection,
    context: &RequestContext,
    headers: &HeaderMap,
) -> Result<Arc<Caller>, Problem> {
    let callers = app.callers();
    let identified = callers.identify(headers);
    if callers.require_tokens() {
        connection.authenticate(identified.as_ref().ok().map(|caller| caller.key()));
    }
    let caller = identified?;
    caller.record_in(context);
    if caller.is_gateway() {
        let parent = headers.get(TRACEPARENT).and_then(|value| value.to_str().ok());
        context.continue_trace(parent.unwrap_or_default());
    }
    caller.spend()?;
    Ok(caller)
}

/// Authenticates the client and resolves the map; records the map in the request context.
pub(super) fn authorize_map(
    app: &App,
    connection: &Connection,
    context: &RequestContext,
    name: Result<Path<String>, PathRejection>,
    headers: &HeaderMap,
) -> Result<Arc<LoadedMap>, Problem> {
    let caller = authenticate(app, connection, context, headers)?;
    let loaded = resolve_map(app, &caller, name)?;
    context.set_map(loaded.name.as_str().into());
    Ok(loaded)
}

/// Resolves the map. A map that the token may not use is treated like an unknown map, so a client learns nothing
/// about other maps.
pub(super) fn resolve_map(
    app: &App,
    caller: &Caller,
    name: Result<Path<String>, PathRejection>,
) -> Result<Arc<LoadedMap>, Problem> {
    let name = name.map_err(|_| Problem::UnknownMap)?;
    if caller.allows_map(&name) { app.maps.served(&name) } else { Err(Problem::UnknownMap) }
}

/// Resolves a region of a published map, which may have to be read first. As with maps, a client learns nothing about
/// those that its token may not use.
pub(super) async fn resolve_region(
    app: &App,
    caller: &Caller,
    path: Option<(String, String)>,
) -> Result<Arc<LoadedMap>, Problem> {
    let (map, region) = path.ok_or(Problem::UnknownMap)?;
    let regions = app.options.regions.as_ref().filter(|_| is_map_name(&map) && caller.allows_map(&map));
    let region: ObjectId = region.parse().map_err(|_| Problem::UnknownMap)?;
    let opened = regions.ok_or(Problem::UnknownMap)?.source.region(&map, region).await;
    opened.map(|region| region.0).map_err(RegionFailure::problem)
}
