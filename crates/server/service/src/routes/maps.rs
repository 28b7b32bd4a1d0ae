//! Which maps there are, and what a device needs to seal for one.

use std::sync::Arc;

use axum::Extension;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::{CACHE_CONTROL, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::admit::{admit, asked};
use super::versions::version;
use crate::problem::Problem;
use crate::queue::Guest;
use crate::state::App;
use crate::telemetry::Trail;

/// All maps that the token may ask for.
#[derive(Serialize, ToSchema)]
pub(super) struct MapList {
    /// In the order the operator gave them, then those of the folder; without those that cannot be opened.
    maps: Vec<MapEntry>,
}

/// A map.
#[derive(Serialize, ToSchema)]
struct MapEntry {
    /// Part of its addresses.
    name: String,
    /// Registered images.
    images: usize,
    /// Map points.
    points: usize,
    /// Name of its profile: 32 hexadecimal digits, the first half of the SHA-256 of its bytes.
    profile_id: String,
}

/// The maps that are served and that the token may ask for.
#[utoipa::path(get, path = "/v1/maps", security(("token" = [])), responses(
    (status = 200, description = "All maps that the token may ask for", body = MapList),
))]
pub(super) async fn list(
    State(app): State<Arc<App>>,
    Extension(guest): Extension<Arc<Guest>>,
    Extension(trail): Extension<Arc<Trail>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let caller = admit(&app, &guest, &trail, &headers)?;
    let slots = app.maps.slots();
    let own = slots.iter().filter(|slot| caller.may_ask_for(slot.name()));
    let maps = own.filter_map(|slot| slot.current()).map(|hosted| MapEntry {
        name: hosted.name.clone(),
        images: hosted.images,
        points: hosted.points,
        profile_id: hosted.profile_id.clone(),
    });
    let body = serde_json::to_vec(&MapList { maps: maps.collect() }).map_err(|_| Problem::Broken)?;
    Ok(([(CONTENT_TYPE, "application/json")], body).into_response())
}

/// The profile a device seals with: one `veiloc.v1.Profile` message. Its `ETag` changes when it does.
#[utoipa::path(get, path = "/v1/maps/{name}/profile", security(("token" = [])),
    params(("name" = String, Path, description = "Name of the map")),
    responses(
        (status = 200, description = "The profile", body = Vec<u8>, content_type = "application/x-protobuf"),
        (status = 304, description = "The one the client has (If-None-Match)"),
))]
pub(super) async fn profile(
    State(app): State<Arc<App>>,
    Extension(guest): Extension<Arc<Guest>>,
    Extension(trail): Extension<Arc<Trail>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let hosted = asked(&app, &guest, &trail, name, &headers)?;
    let common = [(CACHE_CONTROL, "no-cache")];
    Ok((common, version(&hosted.profile, None, "application/x-protobuf", &headers)).into_response())
}
