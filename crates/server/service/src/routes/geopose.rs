//! The GeoPose Protocol (version 2) of Open AR Cloud: a sealed query in a GeoPose request, a GeoPose out.

use std::sync::Arc;

use axum::Extension;
use axum::body::Body;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;
use veiloc_map::MapFile;
use veiloc_protocol::SealedQuery;

use super::authorize::authenticate;
use super::localize::{ReadBody, check_media, json, localize_read, read, refuse};
use super::request_options::RequestOptions;
use crate::http::padding::PadLength;
use crate::http::problem::Problem;
use crate::maps::geo_reference::{GeoPose, GeoPoseAccuracy, GeoReference};
use crate::maps::{LoadedMap, MapLookup};
use crate::queue::Connection;
use crate::routes::decoded_request::{BodyKind, DecodedRequest};
use crate::serve::state::App;
use crate::telemetry::RequestContext;

/// `imageFormat` of a sealed query.
const SEALED: &str = "VEILOC_SEALED_QUERY";
/// The standard alphabet, with or without padding.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &STANDARD,
    GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent),
);
/// Bytes of a request without `imageBytes`.
const FIELDS: usize = 64 << 10;
/// Maximum length of `id`: it is repeated in the answer, which has one length.
const LONGEST_ID: usize = 256;

/// A GeoPose request. Other fields and readings of the protocol are not used.
#[derive(Debug, Deserialize, ToSchema)]
pub(super) struct GeoPoseRequest {
    /// Repeated in the answer; at most 256 bytes.
    id: String,
    /// Milliseconds since 1970; repeated in the answer.
    timestamp: f64,
    /// `geopose`
    #[serde(rename = "type")]
    kind: String,
    #[serde(rename = "sensorReadings")]
    sensor_readings: SensorReadings,
}

#[derive(Debug, Deserialize, ToSchema)]
struct SensorReadings {
    /// Exactly one.
    #[serde(rename = "cameraReadings", default)]
    camera_readings: Vec<CameraReading>,
}

#[derive(Debug, Deserialize, ToSchema)]
struct CameraReading {
    privacy: Privacy,
    /// `VEILOC_SEALED_QUERY`; images are refused.
    #[serde(rename = "imageFormat")]
    image_format: String,
    /// The bytes of the sealed query in base64.
    #[serde(rename = "imageBytes")]
    image_bytes: String,
    /// Absent, or not mirrored and not rotated: the pose is that of the camera of the sealed query.
    #[serde(rename = "imageOrientation", default)]
    image_orientation: Option<ImageOrientation>,
}

#[derive(Debug, Deserialize, ToSchema)]
struct Privacy {
    /// Contains the scheme of the query, for example `dcl`.
    #[serde(rename = "dataSanitizationApplied")]
    data_sanitization_applied: Vec<String>,
}

#[derive(Debug, Deserialize, ToSchema)]
struct ImageOrientation {
    mirrored: bool,
    rotation: f64,
}

/// The answer to a GeoPose request.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct GeoPoseResponse {
    /// That of the request.
    id: String,
    /// That of the request: when the camera was there.
    timestamp: f64,
    accuracy: GeoPoseAccuracy,
    /// `geopose`
    #[serde(rename = "type")]
    kind: &'static str,
    geopose: GeoPose,
}

/// The GeoPose of a sealed query (GeoPose Protocol, version 2).
///
/// The map is the one whose profile sealed the query, among those with a geographic reference (`--geo-reference`). A
/// doubtful pose is refused as 422, because a GeoPose cannot say that it is doubtful.
#[utoipa::path(post, path = "/geopose", security(("token" = [])),
    request_body = GeoPoseRequest,
    responses((status = 200, description = "The GeoPose of the camera", body = GeoPoseResponse)),
)]
pub(super) async fn geopose(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    headers: HeaderMap,
    mut body: Body,
) -> Response {
    match answer(&app, &connection, &context, &headers, &mut body).await {
        Ok(response) => response,
        Err(problem) => refuse(problem, body, &headers, app.options.timeouts.head).await,
    }
}

async fn answer(
    app: &Arc<App>,
    connection: &Connection,
    context: &Arc<RequestContext>,
    headers: &HeaderMap,
    body: &mut Body,
) -> Result<Response, Problem> {
    let caller = authenticate(app, connection, context, headers)?;
    let served = |reference: &GeoReference| match app.maps.find(&reference.map) {
        MapLookup::Served(loaded) if caller.allows_map(&reference.map) => Some(loaded),
        _ => None,
    };
    let references = app.options.geo_references.iter();
    let places: Vec<(&GeoReference, Arc<LoadedMap>)> =
        references.filter_map(|reference| Some((reference, served(reference)?))).collect();
    let longest = places.iter().map(|(_, loaded)| loaded.longest(BodyKind::Query)).max();
    let longest = longest.ok_or(Problem::NoGeoReference)?;
    check_media(headers, &["application/json"])?;
    // Base64 has four bytes for three.
    let text = read(app, context, body, longest.div_ceil(3) * 4 + FIELDS).await?;

    let request: GeoPoseRequest = serde_json::from_slice(&text).map_err(|_| malformed(NOT_A_REQUEST))?;
    let query = request.sealed_query()?;
    let decoded = DecodedRequest::decode(BodyKind::Query, &query).map_err(|e| Problem::of_query(&e))?;
    let of_profile = |query: &SealedQuery| {
        let id = query.profile_id().to_string();
        places.iter().find(|(_, loaded)| loaded.profile_id == id)
    };
    let sealed = decoded.queries().next().ok_or(Problem::Broken)?;
    if !request.names_scheme(sealed.scheme().name()) {
        return Err(malformed("privacy.dataSanitizationApplied must contain the scheme of the query"));
    }
    let (reference, loaded) = of_profile(sealed).ok_or(Problem::WrongProfile)?;
    context.set_map(loaded.name.as_str().into());

    let read = ReadBody { request: decoded, bytes: query };
    let options = RequestOptions { trusted_only: true, ..RequestOptions::default() };
    let answer = localize_read(app, context, &caller, loaded, read, options).await?;
    let found = answer
        .pose
        .and_then(|pose| {
            reference.geopose(&pose, loaded.coordinates().down, loaded.map().and_then(MapFile::alignment))
        })
        .ok_or(Problem::NotLocalized(": its pose is doubtful, and a GeoPose cannot say so"))?;
    let (geopose, accuracy) = found;
    let GeoPoseRequest { id, timestamp, .. } = request;
    let body = json(&GeoPoseResponse { id, timestamp, accuracy, kind: "geopose", geopose })?;
    let mut response = ([(CONTENT_TYPE, "application/json")], body).into_response();
    response.extensions_mut().insert(PadLength);
    Ok(response)
}

impl GeoPoseRequest {
    /// The bytes of its query.
    fn sealed_query(&self) -> Result<Vec<u8>, Problem> {
        let [reading] = self.sensor_readings.camera_readings.as_slice() else {
            return Err(malformed("sensorReadings.cameraReadings must have one reading"));
        };
        let is_upright =
            reading.image_orientation.as_ref().is_none_or(|turn| !turn.mirrored && turn.rotation == 0.0);
        for (is_valid, why) in [
            (self.kind == "geopose", "type must be geopose"),
            (self.id.len() <= LONGEST_ID, "id must have at most 256 bytes"),
            (self.timestamp.is_finite(), "timestamp must be a number"),
            (
                reading.image_format == SEALED,
                "imageFormat must be VEILOC_SEALED_QUERY: this service takes no images; seal the image on the device",
            ),
            (is_upright, "imageOrientation must be absent, or without mirroring and rotation"),
        ] {
            if !is_valid {
                return Err(malformed(why));
            }
        }
        // Encoders of phones break lines, and some leave the padding away (RFC 2045, RFC 4648).
        let text: String = reading.image_bytes.chars().filter(|c| !c.is_ascii_whitespace()).collect();
        BASE64.decode(text).map_err(|_| malformed("imageBytes must be base64"))
    }

    /// Whether the client states that this scheme was applied.
    fn names_scheme(&self, scheme: &str) -> bool {
        let readings = &self.sensor_readings.camera_readings;
        readings
            .iter()
            .all(|reading| reading.privacy.data_sanitization_applied.iter().any(|named| named == scheme))
    }
}

const NOT_A_REQUEST: &str = "the body must be a GeoPoseReq of the GeoPose Protocol, version 2, in JSON: id, type and imageBytes are strings, timestamp is a \
     number, and sensorReadings has cameraReadings with privacy.dataSanitizationApplied, imageFormat and imageBytes (see \
     /v1/openapi.json)";

fn malformed(why: &str) -> Problem {
    Problem::Malformed(why.to_owned())
}
