//! The one thing the service is for: a sealed query in, a pose out.

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
use veiloc_localize::{LocalizeError, LocalizeOptions, StageTimes, localize as localize_query, localize_rig};
use veiloc_map::MapFile;
use veiloc_query::{
    Answer, AnswerDocument, AnswerState, AnswerVersion, QueryError, RigMessage, SealedFrame, SealedQuery,
};
use veiloc_robust::{PositionPrior, Stop};

use super::accept::{Form, Unmet};
use super::admit::{admit, wanted};
use super::body;
use super::wishes::Wishes;
use crate::answer::{answer_of, answer_of_rig};
use crate::geo::GeoPoseDocument;
use crate::maps::Hosted;
use crate::padding::{self, Hidden};
use crate::panics;
use crate::pool::{Order, Refused};
use crate::problem::Problem;
use crate::state::App;
use crate::tokens::Caller;
use veiloc_admission::Guest;
use veiloc_observe::{Outcome, Stage, Trail};

/// Where a sealed query was taken.
///
/// The body is one `SealedQuery` message of `veiloc.v1`, `v2` or `v3`. After 408, 429, 503 or 504 the same bytes may be sent
/// again; the image must not be sealed a second time.
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
        (status = 200, description = "The pose, in the form that `Accept` asks for", content(
            (AnswerDocument = "application/json"),
            (GeoPoseDocument = "application/geopose+json"),
            (Vec<u8> = "application/x-protobuf"),
            (Vec<u8> = "application/x-protobuf;version=2"),
            (Vec<u8> = "application/x-protobuf;version=3"),
        )),
))]
pub(super) async fn localize(
    State(app): State<Arc<App>>,
    Extension(guest): Extension<Arc<Guest>>,
    Extension(trail): Extension<Arc<Trail>>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    body: Body,
) -> Response {
    serve(app, &guest, trail, name, headers, body, Kind::Query).await
}

/// What a body holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// One sealed query.
    Query,
    /// Those of a session.
    Rig,
}

/// Answers a body of this kind.
pub(super) async fn serve(
    app: Arc<App>,
    guest: &Guest,
    trail: Arc<Trail>,
    name: Result<Path<String>, PathRejection>,
    headers: HeaderMap,
    mut body: Body,
    kind: Kind,
) -> Response {
    let result = match welcome(&app, guest, &trail, name, &headers) {
        Ok(asked) => answer(&app, &trail, asked, kind, &mut body).await,
        Err(problem) => Err(problem),
    };
    match result {
        Ok(response) => response,
        Err(problem) => {
            // Of a body that was read nothing is left; one that was too slow is not waited for again.
            if !matches!(problem, Problem::TooSlow { .. }) {
                body::drain(body, &headers, app.options.timeouts.head).await;
            }
            problem.into_response()
        }
    }
}

/// What is known of a request before its body is read.
struct Request {
    caller: Arc<Caller>,
    hosted: Arc<Hosted>,
    form: Form,
    wishes: Wishes,
}

/// Everything that can be said before the body is looked at.
fn welcome(
    app: &App,
    guest: &Guest,
    trail: &Trail,
    name: Result<Path<String>, PathRejection>,
    headers: &HeaderMap,
) -> Result<Request, Problem> {
    let caller = admit(app, guest, trail, headers)?;
    let hosted = wanted(app, &caller, name)?;
    let media = headers.get(CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    let media = media.split(';').next().unwrap_or_default().trim();
    let known = ["application/x-protobuf", "application/octet-stream"];
    let plain = headers.get_all(CONTENT_ENCODING).into_iter().all(|value| value == "identity");
    if !plain || !known.iter().any(|known| media.eq_ignore_ascii_case(known)) {
        return Err(Problem::MediaType);
    }
    let wishes = Wishes::read(headers)?;
    // Said before anything is spent on an answer that could not be given.
    match Form::negotiate(headers, Form::offered(hosted.geo.is_some(), wishes.trusted_only)) {
        Ok(form) => {
            trail.about(hosted.name.as_str().into());
            Ok(Request { caller, hosted, form, wishes })
        }
        Err(Unmet::OnlyGeoPose) => Err(Problem::NotAcceptable),
    }
}

async fn answer(
    app: &Arc<App>,
    trail: &Arc<Trail>,
    request: Request,
    kind: Kind,
    body: &mut Body,
) -> Result<Response, Problem> {
    let Request { caller, hosted, form, wishes } = request;
    let (started, begun) = (Instant::now(), trail.elapsed());
    let limit = match kind {
        Kind::Query => hosted.longest_query,
        Kind::Rig => RigMessage::longest(hosted.longest_query),
    };
    let bytes = body::read(body, limit, app.options.timeouts.body).await?;
    let read = Stage { name: "read", within: None, begun, took: started.elapsed() };
    app.metrics.stage(read.name, read.took);
    trail.stage(read);
    let asked = Asked::decode(kind, &bytes).map_err(|e| Problem::of_query(&e))?;
    tracing::debug!(request = %trail.id(), map = hosted.name, frames = asked.frames(), "sealed queries read");
    drop(bytes);
    caller.spend_session(asked.frames())?;

    let result = compute(app, trail, &caller, hosted.clone(), asked, wishes).await?;
    let Found { answer, times } = result.map_err(|error| {
        if matches!(error, LocalizeError::NoPose { .. }) {
            app.metrics.localization(&hosted.name, Outcome::NotLocalized);
        }
        Problem::of_localization(&error)
    })?;
    let outcome = match answer.state() {
        AnswerState::Trusted => Outcome::Trusted,
        AnswerState::Doubtful => Outcome::Doubtful,
    };
    app.metrics.localization(&hosted.name, outcome);
    for (stage, ms) in parts(&times) {
        app.metrics.stage(stage, ms);
    }

    let answer = if wishes.trusted_only { answer.trusted_only() } else { answer };
    let (body, hidden) = match form {
        Form::Protobuf(version) => {
            let hidden = match version {
                AnswerVersion::Plain => Hidden::Head,
                AnswerVersion::Padded | AnswerVersion::Full => Hidden::Body,
            };
            (answer.encode(version).map_err(|_| Problem::Broken)?, hidden)
        }
        Form::GeoPose => {
            let frame = hosted.geo.as_ref().ok_or(Problem::NotAcceptable)?;
            (json(&frame.geo_pose(&answer))?, Hidden::Body)
        }
        Form::Json => (json(&AnswerDocument::new(&hosted.name, &answer))?, Hidden::Body),
    };
    let mut response = ([(CONTENT_TYPE, form.content_type())], body).into_response();
    response.extensions_mut().insert(hidden);
    Ok(response)
}

fn json(document: &impl Serialize) -> Result<Vec<u8>, Problem> {
    serde_json::to_vec(document).map(padding::json).map_err(|_| Problem::Broken)
}

/// The parts of a localization, in their order.
fn parts(times: &StageTimes) -> [(&'static str, Duration); 3] {
    [("retrieve", times.retrieve_ms), ("match", times.match_ms), ("pose", times.pose_ms)]
        .map(|(name, ms)| (name, Duration::from_secs_f64(ms.max(0.0) / 1e3)))
}

struct Done {
    result: Result<Found, LocalizeError>,
    waited: Duration,
    took: Duration,
}

impl Done {
    /// Notes what took how long, of a request that was handed over `begun` after its beginning.
    fn note(&self, trail: &Trail, begun: Duration) {
        trail.stage(Stage { name: "queue", within: None, begun, took: self.waited });
        let mut begun = begun + self.waited;
        trail.stage(Stage { name: "localize", within: None, begun, took: self.took });
        for (name, took) in self.result.iter().flat_map(|found| parts(&found.times)) {
            trail.stage(Stage { name, within: Some("localize"), begun, took });
            begun += took;
        }
    }
}

/// What is told, and what the stages took.
struct Found {
    answer: Answer,
    times: StageTimes,
}

/// What a body was found to hold.
enum Asked {
    Query(Box<SealedQuery>),
    Rig(Vec<SealedFrame>),
}

impl Asked {
    fn decode(kind: Kind, bytes: &[u8]) -> Result<Self, QueryError> {
        Ok(match kind {
            Kind::Query => Self::Query(Box::new(SealedQuery::decode(bytes)?)),
            Kind::Rig => Self::Rig(RigMessage::decode(bytes)?.frames),
        })
    }

    /// Images that it is about.
    fn frames(&self) -> usize {
        match self {
            Self::Query(_) => 1,
            Self::Rig(frames) => frames.len(),
        }
    }

    /// Rows of all queries.
    fn rows(&self) -> usize {
        match self {
            Self::Query(query) => query.descriptors().len(),
            Self::Rig(frames) => frames.iter().map(|frame| frame.query.descriptors().len()).sum(),
        }
    }

    /// Localizes it after a wait of so many milliseconds.
    fn localize(
        &self,
        map: &MapFile,
        options: &LocalizeOptions,
        queue_ms: f64,
    ) -> Result<Found, LocalizeError> {
        match self {
            Self::Query(query) => localize_query(query, map, options)
                .map(|found| Found { answer: answer_of(&found, queue_ms), times: found.times }),
            Self::Rig(frames) => localize_rig(frames, map, options)
                .map(|found| Found { answer: answer_of_rig(&found, queue_ms), times: found.times }),
        }
    }
}

/// Ends a job that nobody waits for any more: its time is up, its client has left, or the service gives up on it.
struct StopWhenDropped(Stop);

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.0.set();
    }
}

/// Localizes on a thread of the pool.
async fn compute(
    app: &Arc<App>,
    trail: &Trail,
    caller: &Caller,
    hosted: Arc<Hosted>,
    asked: Asked,
    wishes: Wishes,
) -> Result<Result<Found, LocalizeError>, Problem> {
    let mut options = app.options.localize.clone();
    if let Some(near) = wishes.near {
        let [x, y, z] = near.center();
        options.position = Some(PositionPrior { center: Point3::new(x, y, z), sd: near.sd() });
    }
    options.pose.stop = Stop::default();
    let _stop = StopWhenDropped(options.pose.stop.clone());
    let hosted_name = hosted.name.clone();
    let limit = app.options.timeouts.localize;
    // Where no token is asked for, nobody is told apart.
    let order = Order { who: app.tokens.is_some().then(|| caller.key()), rows: asked.rows(), limit };
    let (id, begun) = (trail.id(), trail.elapsed());
    let work = move |waited: Duration| {
        let started = Instant::now();
        let queue_ms = waited.as_secs_f64() * 1e3;
        let result = panics::during(id, || asked.localize(&hosted.map, &options, queue_ms));
        Done { result, waited, took: started.elapsed() }
    };
    let result = app.pool.submit(order, work).map_err(|refused| match refused {
        Refused::Full { retry_after } => Problem::QueueFull { retry_after },
        Refused::Late { retry_after } => Problem::Overdue { retry_after },
        Refused::Closed => Problem::Stopping { retry_after: NonZeroU64::MIN },
    })?;
    match tokio::time::timeout(limit, result).await {
        Err(_) => Err(Problem::TimedOut { seconds: limit.as_secs().max(1) }),
        Ok(Ok(done)) => {
            done.note(trail, begun);
            app.metrics.stage("queue", done.waited);
            Ok(done.result)
        }
        Ok(Err(_)) => {
            tracing::error!(
                request = %id,
                map = hosted_name,
                "localization broke; this is a bug in veiloc, the line before says where"
            );
            Err(Problem::Broken)
        }
    }
}
