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
use tokio::runtime::Handle;
use tokio::sync::oneshot;
use veiloc_geometry::Point3;
use veiloc_localization::{LocalizeOptions, StageTimes};
use veiloc_pose::{PositionPrior, Stop};
use veiloc_protocol::{AnswerDocument, AnswerState, AnswerTimes};

use super::accept::Form;
use super::admit::{admit, wanted};
use super::body;
use super::wishes::Wishes;
use crate::asked::{Asked, Found, Kind, Unanswered};
use crate::elsewhere::Question;
use crate::maps::{Held, Hosted};
use crate::padding::{self, Hidden};
use crate::panics;
use crate::pool::{Order, Refused};
use crate::problem::Problem;
use crate::queue::Guest;
use crate::state::App;
use crate::telemetry::{Outcome, RequestId, Stage, Trail};
use crate::tokens::Caller;

/// Where a sealed query was taken.
///
/// The body is one `veiloc.v1.SealedQuery` message. After 408, 429, 503 or 504 the same bytes may be sent
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
            (Vec<u8> = "application/x-protobuf"),
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
    let form = Form::negotiate(headers);
    trail.about(hosted.name.as_str().into());
    Ok(Request { caller, hosted, form, wishes })
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
    let bytes = body::read(body, hosted.longest(kind), app.options.timeouts.body).await?;
    let read = Stage { name: "read", within: None, begun, took: started.elapsed() };
    app.metrics.stage(read.name, read.took);
    trail.stage(read);
    let asked = Asked::decode(kind, &bytes).map_err(|e| Problem::of_query(&e))?;
    tracing::debug!(request = %trail.id(), map = hosted.name, frames = asked.frames(), "sealed queries read");
    caller.spend_session(asked.frames())?;

    // Who localizes here has read them.
    let bytes = if hosted.map().is_some() { Vec::new() } else { bytes };
    let result = compute(app, trail, &caller, hosted.clone(), Read { asked, bytes }, wishes).await?;
    let Found { answer, times } = result.map_err(|why| {
        if matches!(why, Unanswered::NoPose(_)) {
            app.metrics.localization(&hosted.name, Outcome::NotLocalized);
        }
        Problem::of_unanswered(why, app.options.timeouts.localize)
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
    let body = match form {
        Form::Protobuf => answer.encode(),
        Form::Json => json(&AnswerDocument::new(&hosted.name, &answer))?,
    };
    let mut response = ([(CONTENT_TYPE, form.content_type())], body).into_response();
    response.extensions_mut().insert(Hidden);
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
    result: Result<Found, Unanswered>,
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

/// Ends a job that nobody waits for any more: its time is up, its client has left, or the service gives up on it.
struct StopWhenDropped {
    stop: Stop,
    /// Dropped with it, and so heard by whoever waits for others at the other end.
    #[expect(dead_code, reason = "that it is dropped is what it is for")]
    gone: oneshot::Sender<()>,
}

impl Drop for StopWhenDropped {
    fn drop(&mut self) {
        self.stop.set();
    }
}

/// A body, and what it was found to hold.
struct Read {
    asked: Asked,
    bytes: Vec<u8>,
}

/// What a job works with.
struct Job {
    hosted: Arc<Hosted>,
    read: Read,
    wishes: Wishes,
    options: LocalizeOptions,
    /// When its result is worth nothing any more.
    deadline: Instant,
    gone: oneshot::Receiver<()>,
    /// Where those are asked who hold the map.
    runtime: Handle,
    id: RequestId,
}

impl Job {
    /// Localizes it, or has it localized, after a wait of so many milliseconds.
    fn work(self, queue_ms: f64) -> Result<Found, Unanswered> {
        let Read { asked, bytes } = self.read;
        let by = match &self.hosted.held {
            Held::Here(map) => return asked.localize(map, &self.options, queue_ms),
            Held::Elsewhere { by, .. } => by,
        };
        let within = self.deadline.saturating_duration_since(Instant::now());
        let question = Question { request: self.id, asked, bytes, near: self.wishes.near, within };
        let mut answer = self.runtime.block_on(async {
            tokio::select! {
                answer = by.localize(question) => answer,
                _ = self.gone => Err(Unanswered::Stopped),
            }
        })?;
        let AnswerTimes { retrieve_ms, match_ms, pose_ms, .. } = answer.times;
        answer.times.queue_ms += queue_ms;
        Ok(Found { answer, times: StageTimes { retrieve_ms, match_ms, pose_ms } })
    }
}

/// Localizes on a thread of the pool.
async fn compute(
    app: &Arc<App>,
    trail: &Trail,
    caller: &Caller,
    hosted: Arc<Hosted>,
    read: Read,
    wishes: Wishes,
) -> Result<Result<Found, Unanswered>, Problem> {
    let mut options = app.options.localize.clone();
    if let Some(near) = wishes.near {
        let [x, y, z] = near.center();
        options.position = Some(PositionPrior { center: Point3::new(x, y, z), sd: near.sd() });
    }
    options.pose.stop = Stop::default();
    let (held, gone) = oneshot::channel();
    let _stop = StopWhenDropped { stop: options.pose.stop.clone(), gone: held };
    let hosted_name = hosted.name.clone();
    let limit = app.options.timeouts.localize;
    // Where no token is asked for, nobody is told apart.
    let order = Order { who: app.tokens.is_some().then(|| caller.key()), rows: read.asked.rows(), limit };
    let (id, begun) = (trail.id(), trail.elapsed());
    let (deadline, runtime) = (Instant::now() + limit, Handle::current());
    let job = Job { hosted, read, wishes, options, deadline, gone, runtime, id };
    let work = move |waited: Duration| {
        let started = Instant::now();
        let result = panics::during(id, || job.work(waited.as_secs_f64() * 1e3));
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
