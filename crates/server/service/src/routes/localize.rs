//! Localization: a sealed query in, a pose out.

use std::num::NonZeroU64;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::Extension;
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::http::header::{CONTENT_ENCODING, CONTENT_TYPE};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use veiloc_geometry::Point3;
use veiloc_pose::{PositionPrior, Stop};
use veiloc_protocol::{Answer, AnswerDocument, AnswerState, AnswerTimes};

use super::accept::AnswerFormat;
use super::authorize::{authenticate, resolve_map, resolve_region};
use super::body;
use super::request_options::{self, RequestOptions};
use crate::auth::Lane;
use crate::auth::tokens::Caller;
use crate::http::padding::{self, PadLength};
use crate::http::problem::Problem;
use crate::maps::remote::RemoteRequest;
use crate::maps::{Backend, LoadedMap};
use crate::queue::Connection;
use crate::queue::clock::Gate;
use crate::queue::pool::{JobSpec, Rejected};
use crate::routes::decoded_request::{BodyKind, DecodedRequest, LocalizeFailure};
use crate::serve::state::App;
use crate::telemetry::panics;
use crate::telemetry::{LocalizationOutcome, RequestContext, RequestStage};

/// The pose of a sealed query.
///
/// The body is one `veiloc.v1.SealedQuery` message. After 408, 429, 503 or 504 the client may send the same bytes
/// again; it must not seal the image a second time.
#[utoipa::path(post, path = "/v1/maps/{name}/localize", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("veiloc-trusted-only" = Option<bool>, Header, description = "Withhold a doubtful pose: the answer has its doubts and no pose"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content(
        (Vec<u8> = "application/x-protobuf"),
        (Vec<u8> = "application/octet-stream"),
    )),
    responses(
        (status = 200, description = "The pose, in the form that `Accept` requests", content(
            (AnswerDocument = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
        )),
))]
pub(super) async fn localize(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &connection, context, Target::Map(name), headers, body, BodyKind::Query).await
}

/// The pose of the rig of a session.
///
/// The body holds up to 32 sealed queries with their relative poses (docs/reference/http.md). The answer is like that of a
/// single query, with the pose of the rig. After 408, 429, 503 or 504 the client may send the same bytes again.
#[utoipa::path(post, path = "/v1/maps/{name}/localize-rig", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("veiloc-trusted-only" = Option<bool>, Header, description = "Withhold a doubtful pose: the answer has its doubts and no pose"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content(
        (Vec<u8> = "application/x-protobuf"),
        (Vec<u8> = "application/octet-stream"),
    )),
    responses(
        (status = 200, description = "The pose, in the form that `Accept` requests", content(
            (AnswerDocument = "application/json"),
            (Vec<u8> = "application/x-protobuf"),
        )),
))]
pub(super) async fn localize_rig(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &connection, context, Target::Map(name), headers, body, BodyKind::Rig).await
}

/// The pose of a sealed query in one region of a published map.
///
/// For gateways and balancers, of a service that reads regions from a store (`veiloc serve --store`).
#[utoipa::path(post, path = "/v1/maps/{name}/regions/{region}/localize", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("region" = String, Path, description = "The SHA-256 of the region, as in the manifest"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content((Vec<u8> = "application/x-protobuf"))),
    responses((status = 200, description = "The pose, in the form that `Accept` requests", body = AnswerDocument)),
)]
pub(super) async fn localize_region(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    path: Result<Path<(String, String)>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &connection, context, Target::region(path), headers, body, BodyKind::Query).await
}

/// The pose of the rig of a session in one region of a published map.
///
/// For gateways and balancers, of a service that reads regions from a store (`veiloc serve --store`).
#[utoipa::path(post, path = "/v1/maps/{name}/regions/{region}/localize-rig", security(("token" = [])),
    params(
        ("name" = String, Path, description = "Name of the map"),
        ("region" = String, Path, description = "The SHA-256 of the region, as in the manifest"),
        ("veiloc-near" = Option<String>, Header, description = "Where the camera roughly is: X,Y,Z,SD in map units"),
    ),
    request_body(content((Vec<u8> = "application/x-protobuf"))),
    responses((status = 200, description = "The pose, in the form that `Accept` requests", body = AnswerDocument)),
)]
pub(super) async fn localize_region_rig(
    State(app): State<Arc<App>>,
    Extension(connection): Extension<Arc<Connection>>,
    Extension(context): Extension<Arc<RequestContext>>,
    path: Result<Path<(String, String)>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &connection, context, Target::region(path), headers, body, BodyKind::Rig).await
}

/// What is to be searched, as the address names it.
enum Target {
    Map(Result<Path<String>, PathRejection>),
    /// Map and region; `None` if they are no text.
    Region(Option<(String, String)>),
}

impl Target {
    fn region(path: Result<Path<(String, String)>, PathRejection>) -> Self {
        Self::Region(path.ok().map(|Path(both)| both))
    }
}

/// Handles a request with a body of this kind.
async fn serve(
    app: Arc<App>,
    connection: &Connection,
    context: Arc<RequestContext>,
    target: Target,
    headers: HeaderMap,
    mut body: Body,
    kind: BodyKind,
) -> Response {
    let result = match check_head(&app, connection, &context, target, &headers).await {
        Ok(request) => answer(&app, &context, request, kind, &mut body).await,
        Err(problem) => Err(problem),
    };
    match result {
        Ok(response) => response,
        Err(problem) => refuse(problem, body, &headers, app.options.timeouts.head).await,
    }
}

/// The response of a refused request, after the rest of its body.
pub(super) async fn refuse(problem: Problem, body: Body, headers: &HeaderMap, time: Duration) -> Response {
    // If the body was read completely, nothing is left; a body that was too slow is not waited for again.
    if !matches!(problem, Problem::TooSlow { .. }) {
        body::drain(body, headers, time).await;
    }
    problem.into_response()
}

/// Properties of a request before its body is read.
struct CheckedRequest {
    caller: Arc<Caller>,
    loaded: Arc<LoadedMap>,
    format: AnswerFormat,
    request_options: RequestOptions,
}

/// All checks that need no body.
async fn check_head(
    app: &App,
    connection: &Connection,
    context: &RequestContext,
    target: Target,
    headers: &HeaderMap,
) -> Result<CheckedRequest, Problem> {
    let caller = authenticate(app, connection, context, headers)?;
    let loaded = match target {
        Target::Map(name) => resolve_map(app, &caller, name)?,
        Target::Region(path) => resolve_region(app, &caller, path).await?,
    };
    check_media(headers, &["application/x-protobuf", "application/octet-stream"])?;
    let mut request_options = RequestOptions::read(headers)?;
    if caller.is_gateway() {
        request_options.client = request_options::client(headers)?;
    }
    let format = AnswerFormat::negotiate(headers);
    context.set_map(loaded.name.as_str().into());
    Ok(CheckedRequest { caller, loaded, format, request_options })
}

/// Checks that the body is one of these media types, and not compressed.
pub(super) fn check_media(headers: &HeaderMap, known: &[&str]) -> Result<(), Problem> {
    let media = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let media = media.split(';').next().unwrap_or_default().trim();
    let plain = headers.get_all(CONTENT_ENCODING).into_iter().all(|value| value == "identity");
    let is_known = plain && known.iter().any(|known| media.eq_ignore_ascii_case(known));
    is_known.then_some(()).ok_or(Problem::MediaType)
}

/// Reads the whole body, and records the time.
pub(super) async fn read(
    app: &App,
    context: &RequestContext,
    body: &mut Body,
    limit: usize,
) -> Result<Vec<u8>, Problem> {
    let (started, begun) = (Instant::now(), context.elapsed());
    let bytes = body::read(body, limit, app.options.timeouts.body).await?;
    let read = RequestStage { name: "read", within: None, begun, took: started.elapsed() };
    app.metrics.stage(read.name, read.took);
    context.stage(read);
    Ok(bytes)
}

async fn answer(
    app: &Arc<App>,
    context: &Arc<RequestContext>,
    request: CheckedRequest,
    kind: BodyKind,
    body: &mut Body,
) -> Result<Response, Problem> {
    let CheckedRequest { caller, loaded, format, request_options } = request;
    let bytes = read(app, context, body, loaded.longest(kind)).await?;
    let request = DecodedRequest::decode(kind, &bytes).map_err(|e| Problem::of_query(&e))?;
    let read = ReadBody { request, bytes };
    let answer = localize_read(app, context, &caller, &loaded, read, request_options).await?;
    let body = match format {
        AnswerFormat::Protobuf => answer.encode(),
        AnswerFormat::Json => json(&AnswerDocument::new(&answer))?,
    };
    let mut response = ([(CONTENT_TYPE, format.content_type())], body).into_response();
    response.extensions_mut().insert(PadLength);
    Ok(response)
}

/// Localizes decoded queries, and waits until an answer may leave.
pub(super) async fn localize_read(
    app: &Arc<App>,
    context: &Arc<RequestContext>,
    caller: &Caller,
    loaded: &Arc<LoadedMap>,
    ReadBody { request, bytes }: ReadBody,
    request_options: RequestOptions,
) -> Result<Answer, Problem> {
    tracing::debug!(request = %context.id(), map = loaded.name, frames = request.frames(), "sealed queries read");
    caller.spend_session(request.frames())?;

    // A local map needs only the decoded queries.
    let bytes = if loaded.map().is_some() { Vec::new() } else { bytes };
    let (received, begun) = (tokio::time::Instant::now(), context.elapsed());
    let read = ReadBody { request, bytes };
    let result = compute(app, context, caller, loaded.clone(), read, request_options).await?;
    if !caller.is_gateway() {
        hold(app, context, received, begun).await;
    }
    let result = result.unwrap_or(Err(LocalizeFailure::TimedOut));
    let answer = result.map_err(|why| {
        if matches!(why, LocalizeFailure::NoPose(_)) {
            app.metrics.localization(&loaded.name, LocalizationOutcome::NotLocalized);
        }
        Problem::of_failure(why, app.options.timeouts.localize)
    })?;
    let outcome = match answer.state() {
        AnswerState::Trusted => LocalizationOutcome::Trusted,
        AnswerState::Doubtful => LocalizationOutcome::Doubtful,
    };
    app.metrics.localization(&loaded.name, outcome);
    for (stage, ms) in stage_durations(&answer.times) {
        app.metrics.stage(stage, ms);
    }

    Ok(if request_options.trusted_only { answer.trusted_only() } else { answer })
}

/// Waits until a whole number of quanta has passed since the body was received, so that the time of the answer does not
/// show whether the query was localized (rule L12).
async fn hold(app: &App, context: &RequestContext, received: tokio::time::Instant, begun: Duration) {
    let worked = received.elapsed();
    let wait = remaining(worked, app.options.answer_quantum);
    tokio::time::sleep(wait).await;
    let held = RequestStage { name: "hold", within: None, begun: begun + worked, took: wait };
    app.metrics.stage(held.name, held.took);
    context.stage(held);
    if worked > app.options.answer_quantum && !app.options.answer_quantum.is_zero() {
        app.metrics.late_answer();
    }
}

/// Time until the next multiple of `quantum`, at least one; zero without a quantum.
fn remaining(worked: Duration, quantum: Duration) -> Duration {
    if quantum.is_zero() {
        return Duration::ZERO;
    }
    let quanta = worked.as_nanos().div_ceil(quantum.as_nanos()).clamp(1, u128::from(u32::MAX)) as u32;
    (quantum * quanta).saturating_sub(worked)
}

pub(super) fn json(document: &impl Serialize) -> Result<Vec<u8>, Problem> {
    serde_json::to_vec(document).map(padding::json).map_err(|_| Problem::Broken)
}

/// The stages of a localization, in order.
fn stage_durations(times: &AnswerTimes) -> [(&'static str, Duration); 3] {
    [("retrieve", times.retrieve_ms), ("match", times.match_ms), ("pose", times.pose_ms)]
        .map(|(name, ms)| (name, Duration::from_secs_f64(ms.max(0.0) / 1e3)))
}

struct JobResult {
    result: Result<Answer, LocalizeFailure>,
    waited: Duration,
    took: Duration,
}

impl JobResult {
    /// Records the stages in the request context; `begun`: when the job was submitted.
    fn record_stages(&self, context: &RequestContext, begun: Duration) {
        context.stage(RequestStage { name: "queue", within: None, begun, took: self.waited });
        let mut begun = begun + self.waited;
        context.stage(RequestStage { name: "localize", within: None, begun, took: self.took });
        for (name, took) in self.result.iter().flat_map(|found| stage_durations(&found.times)) {
            context.stage(RequestStage { name, within: Some("localize"), begun, took });
            begun += took;
        }
    }
}

/// Cancels a job when its request is dropped: on timeout, on disconnection, or when the service aborts.
struct StopWhenDropped(Stop);

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.0.set();
    }
}

/// A body and its decoded form.
pub(super) struct ReadBody {
    pub(super) request: DecodedRequest,
    pub(super) bytes: Vec<u8>,
}

/// Localizes on a thread of the pool, or asks the remote backend; `None`: not within the time limit.
///
/// # Errors
/// What does not depend on the content of the query: a full queue, a shutdown, an internal error.
async fn compute(
    app: &Arc<App>,
    context: &Arc<RequestContext>,
    caller: &Caller,
    loaded: Arc<LoadedMap>,
    read: ReadBody,
    request_options: RequestOptions,
) -> Result<Option<Result<Answer, LocalizeFailure>>, Problem> {
    let begun = context.elapsed();
    // Without tokens, clients are not distinguished; a gateway says whose query it is.
    let key = app.tokens.is_some().then(|| caller.key());
    let client = request_options.client.map(Lane::key).or(key);
    match &loaded.backend {
        Backend::Local(_) => {
            let (rows, is_session) = (read.request.rows(), read.request.frames() > 1);
            let spec = JobSpec { client, rows, is_session, limit: app.options.timeouts.localize };
            localize_here(app, context, begun, loaded, read.request, request_options, spec).await
        }
        Backend::Remote { backend, .. } => {
            let (within, started) = (app.options.timeouts.localize, Instant::now());
            let request = RemoteRequest {
                id: context.id(),
                client,
                decoded: read.request,
                bytes: read.bytes,
                near: request_options.near,
                within,
                trace: app.sends_traces().then(|| context.clone()),
            };
            // Dropping the future cancels the work on the other side.
            let Ok(result) = tokio::time::timeout(within, backend.localize(request)).await else {
                return Ok(None);
            };
            let done = JobResult { result, waited: Duration::ZERO, took: started.elapsed() };
            done.record_stages(context, begun);
            Ok(Some(done.result))
        }
    }
}

/// Localizes in a local map on a thread of the pool.
async fn localize_here(
    app: &Arc<App>,
    context: &Arc<RequestContext>,
    begun: Duration,
    loaded: Arc<LoadedMap>,
    request: DecodedRequest,
    request_options: RequestOptions,
    spec: JobSpec,
) -> Result<Option<Result<Answer, LocalizeFailure>>, Problem> {
    let mut options = app.options.localize.clone();
    if let Some(near) = request_options.near {
        let [x, y, z] = near.center();
        options.position = Some(PositionPrior { center: Point3::new(x, y, z), sd: near.sd() });
    }
    options.pose.stop = Stop::default();
    let _stop = StopWhenDropped(options.pose.stop.clone());
    let (id, map_name, gate) = (context.id(), loaded.name.clone(), app.options.gate.clone());
    let work = move |waited: Duration| {
        gate.iter().for_each(Gate::pass);
        let (started, queue_ms) = (Instant::now(), waited.as_secs_f64() * 1e3);
        let localize = || match loaded.map() {
            Some(map) => request.localize(map, &options, queue_ms),
            None => Err(LocalizeFailure::Broken),
        };
        JobResult { result: panics::with_request(id, localize), waited, took: started.elapsed() }
    };
    let result = app.pool.submit(spec, work).map_err(|refused| match refused {
        Rejected::Full { retry_after } => Problem::QueueFull { retry_after },
        Rejected::Late { retry_after } => Problem::Overdue { retry_after },
        Rejected::Closed => Problem::Stopping { retry_after: NonZeroU64::MIN },
    })?;
    match tokio::time::timeout(spec.limit, result).await {
        Err(_) => Ok(None),
        Ok(Ok(done)) => {
            done.record_stages(context, begun);
            app.metrics.stage("queue", done.waited);
            Ok(Some(done.result))
        }
        Ok(Err(_)) => {
            tracing::error!(
                request = %id,
                map = map_name,
                "localization panicked; this is a bug in veiloc, the line before has the location"
            );
            Err(Problem::Broken)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_leave_at_whole_quanta() {
        let ms = Duration::from_millis;
        // Work, quantum, wait.
        for (worked, quantum, wait) in [
            (0, 250, 250),
            (1, 250, 249),
            (250, 250, 0),
            (251, 250, 249),
            (700, 250, 50),
            (700, 0, 0),
            (30_000, 7_000, 5_000),
        ] {
            assert_eq!(remaining(ms(worked), ms(quantum)), ms(wait), "{worked} ms, quantum {quantum} ms");
        }
        assert_eq!(remaining(Duration::MAX, Duration::from_nanos(1)), Duration::ZERO);
    }
}
