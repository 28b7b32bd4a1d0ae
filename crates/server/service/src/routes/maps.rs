//! The list of maps, and the profiles with which devices seal.

use std::sync::Arc;

use axum::Extension;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;
use veiloc_protocol::MapCoordinates;

use super::authorize::{authenticate, authorize_map};
use super::versions::version;
use crate::http::problem::Problem;
use crate::queue::Connection;
use crate::serve::state::App;
use crate::telemetry::RequestContext;

/// All maps that the token may use.
#[derive(Serialize, ToSchema)]
pub(super) struct MapList {
    /// In configured order, then those of the maps folder; without maps that cannot be opened.
    maps: Vec<MapEntry>,
}

/// A map.
#[derive(Serialize, ToSchema)]
struct MapEntry {
    /// Name of the map, a part of its addresses.
    name: String,
    /// Registered images.
    images: usize,
    /// Map points.
    points: usize,
    /// Id of its profile: 32 hexadecimal digits, the first half of the SHA-256 of its bytes.
    profile_id: String,
    /// Id of its pack, in the same form; `null` when the service gives none.
    pack_id: Option<String>,
    /// Metres of a unit of the map, 1; `null` when the unit is not known.
    metres_per_unit: Option<f64>,
    /// Direction of gravity in the map, a unit vector; `null` when the map does not know it.
    down: Option<[f64; 3]>,
}

/// The maps that the token may use.
#[utoipa::path(get, path = "/v1/maps", security(("token" = [])), responses(
    (status = 200, description = "All maps that the token may use", body = MapList),
))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let caller = authenticate(&app, &connection, &context, &headers)?;
    let slots = app.maps.slots();
    let own = slots.iter().filter(|slot| caller.allows_map(slot.name()));
    let maps = own.filter_map(|slot| slot.current()).map(|loaded| {
        let MapCoordinates { metres_per_unit, down } = loaded.coordinates();
        MapEntry {
            name: loaded.name.clone(),
            images: loaded.images,
            points: loaded.points,
            profile_id: loaded.profile_id.clone(),
            pack_id: loaded.pack.as_ref().map(|(_, id)| id.clone()),
            metres_per_unit,
            down,
        }
    });
    let body = serde_json::to_vec(&MapList { maps: maps.collect() }).map_err(|_| Problem::Broken)?;
    Ok(([(CONTENT_TYPE, "application/json")], body).into_response())
}

/// The profile with which a device seals: one `veiloc.v1.Profile` message. Its `ETag` changes with the profile.
#[utoipa::path(get, path = "/v1/maps/{name}/profile", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map")),
    responses(
        (status = 200, description = "The profile", body = Vec<u8>, content_type = "application/x-protobuf"),
        (status = 304, description = "The client has the current profile (If-None-Match)"),
))]
pub(super) async fn profile(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let loaded = authorize_map(&app, &connection, &context, name, &headers)?;
    let common = [(CACHE_CONTROL, "no-cache")];
    Ok((common, version(&loaded.profile, None, "application/x-protobuf", &headers)).into_response())
}

/// The pack with which a device sends only what the place knows: one `veiloc.v1.Pack` message. Its `ETag` changes with the
/// pack.
#[utoipa::path(get, path = "/v1/maps/{name}/pack", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map")),
    responses(
        (status = 200, description = "The pack", body = Vec<u8>, content_type = "application/x-protobuf"),
        (status = 304, description = "The client has the current pack (If-None-Match)"),
        (status = 404, description = "The operator gives no packs, or the map is unknown"),
))]
pub(super) async fn pack(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let loaded = authorize_map(&app, &connection, &context, name, &headers)?;
    let (pack, _) = loaded.pack.as_ref().ok_or(Problem::NoPack)?;
    let common = [(CACHE_CONTROL, "no-cache")];
    Ok((common, version(pack, None, "application/x-protobuf", &headers)).into_response())
}
