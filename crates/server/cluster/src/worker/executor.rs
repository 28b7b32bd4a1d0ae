//! The threads of a worker, and what they do with a request.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use veiloc_descriptor::GlobalDescriptor;
use veiloc_geometry::Point3;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{Index, ObjectId};
use veiloc_pose::{PositionPrior, Stop};
use veiloc_protocol::PositionHint;
use veiloc_service::labour::{JobSpec, Pool, Rejected, with_request};
use veiloc_service::telemetry::{RequestId, WorkerCounts};
use veiloc_service::{DecodedRequest, Clock, LocalizeOutput, BodyKind, LocalizeFailure};

use super::content::Content;
use crate::message::{Candidate, MOST_REGIONS, Outcome, Request, RequestName, Wanted, Why};

/// Bytes of a query for each of its rows, about: what a job costs is told before the query is read.
const ROW_BYTES: usize = 132;

/// What threads and subscriptions share.
pub(crate) struct Executor {
    /// For poses.
    pool: Pool,
    /// For searches: they take less than a millisecond in a town, and must not wait behind poses.
    searches: Pool,
    localize: LocalizeOptions,
    counts: Arc<WorkerCounts>,
    /// Requests that are waiting or worked on: a second message of one is another worker's.
    at_it: Mutex<HashSet<(RequestName, ObjectId)>>,
}

/// What came of a request.
pub(crate) struct Done {
    pub(crate) outcome: Outcome,
    pub(crate) worked: Duration,
    pub(crate) waited: Duration,
}

impl Done {
    /// Outcome without work.
    pub(crate) const fn at_once(outcome: Outcome) -> Self {
        Self { outcome, worked: Duration::ZERO, waited: Duration::ZERO }
    }
}

impl Executor {
    pub(crate) fn start(
        threads: NonZeroUsize,
        queue: NonZeroUsize,
        localize: LocalizeOptions,
        counts: Arc<WorkerCounts>,
    ) -> std::io::Result<Self> {
        Ok(Self {
            pool: Pool::start(threads, queue, Clock::default())?,
            searches: Pool::start(NonZeroUsize::MIN, SEARCHES, Clock::default())?,
            localize,
            counts,
            at_it: Mutex::default(),
        })
    }

    /// Requests that wait, and threads that localize.
    pub(crate) fn load(&self) -> (usize, usize) {
        (self.pool.queued(), self.pool.busy())
    }

    /// What was taken is finished, and nothing more taken. Blocks.
    pub(crate) fn finish(&self) {
        self.pool.finish();
        self.searches.finish();
    }

    /// Counts a reply.
    pub(crate) fn said(&self, outcome: &Outcome) {
        self.counts.reply(match outcome {
            Outcome::Here | Outcome::Regions(_) | Outcome::Pose(_) => "answered",
            Outcome::LocalizeFailure(_) => "unanswered",
            Outcome::Rejected(Why::Busy { .. } | Why::Leaving) => "busy",
            Outcome::Rejected(Why::AtIt) => "twin",
            Outcome::Rejected(Why::NotHeld | Why::Unread) => "unread",
            Outcome::Rejected(Why::Broken) => "broken",
        });
    }

    /// Does what is wanted of the object whose content this is.
    pub(crate) async fn work(self: &Arc<Self>, request: Request, content: &Arc<Content>) -> Done {
        let Request { name, object, within, wanted } = request;
        match wanted {
            Wanted::Ping => {
                self.counts.request("ping");
                Done::at_once(Outcome::Here)
            }
            Wanted::Search { globals } => {
                self.counts.request("search");
                let content = content.clone();
                let retrieve = self.localize.retrieve;
                let spec = JobSpec { client: None, rows: 0, limit: within };
                self.queued(&self.searches, name, spec, Stop::default(), move || {
                    let Content::Index(index) = &*content else { return Outcome::Rejected(Why::NotHeld) };
                    search(index, &globals, retrieve)
                })
                .await
            }
            Wanted::Pose { kind, body, near } => {
                self.counts.request("pose");
                let Some(_here) = AtIt::begin(self, name, object) else {
                    return Done::at_once(Outcome::Rejected(Why::AtIt));
                };
                let spec = JobSpec { client: None, rows: body.len() / ROW_BYTES, limit: within };
                let mut options = self.localize.clone();
                options.pose.stop = Stop::default();
                let stop = options.pose.stop.clone();
                let content = content.clone();
                self.queued(&self.pool, name, spec, stop, move || {
                    let Content::Region(map) = &*content else { return Outcome::Rejected(Why::NotHeld) };
                    pose(map, kind, &body, near, options)
                })
                .await
            }
        }
    }

    /// On a thread of this pool, as long as there is time. Dropped before its end, it is not begun, or soon stopped.
    async fn queued(
        &self,
        pool: &Pool,
        name: RequestName,
        spec: JobSpec,
        stop: Stop,
        work: impl FnOnce() -> Outcome + Send + 'static,
    ) -> Done {
        let counts = self.counts.clone();
        let begun = Arc::new(AtomicBool::new(false));
        let mut job_of = JobOf { stop, begun: begun.clone(), counts: &self.counts, ended: false };
        let job = move |waited: Duration| {
            begun.store(true, Ordering::Relaxed);
            let started = Instant::now();
            let outcome = with_request(RequestId::from_bytes(name), work);
            let worked = started.elapsed();
            counts.worked(worked);
            // Times of an answer are those of the worker: the gateway adds its own.
            Done { outcome: with_wait(outcome, waited), worked, waited }
        };
        let limit = spec.limit;
        let result = match pool.submit(spec, job) {
            Ok(result) => result,
            Err(refused) => {
                job_of.ended = true;
                return Done::at_once(Outcome::Rejected(match refused {
                    Rejected::Full { retry_after } | Rejected::Late { retry_after } => {
                        Why::Busy { retry_after }
                    }
                    Rejected::Closed => Why::Leaving,
                }));
            }
        };
        let ended = tokio::time::timeout(limit, result).await;
        job_of.ended = true;
        match ended {
            Ok(Ok(done)) => done,
            Ok(Err(_)) => {
                tracing::error!("localization broke; this is a bug in veiloc, the line before says where");
                Done::at_once(Outcome::Rejected(Why::Broken))
            }
            Err(_) => Done::at_once(Outcome::LocalizeFailure(LocalizeFailure::TimedOut)),
        }
    }

    fn at_it(&self) -> MutexGuard<'_, HashSet<(RequestName, ObjectId)>> {
        self.at_it.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A job that somebody waits for; when nobody does any more it is stopped, and counted unless it had ended by itself or by
/// the clock. One that still waits for a thread is not begun: its receiver is gone.
struct JobOf<'a> {
    stop: Stop,
    begun: Arc<AtomicBool>,
    counts: &'a WorkerCounts,
    ended: bool,
}

impl Drop for JobOf<'_> {
    fn drop(&mut self) {
        self.stop.set();
        if !self.ended {
            self.counts.cancelled(if self.begun.load(Ordering::Relaxed) { "working" } else { "waiting" });
        }
    }
}

/// Searches that may wait.
const SEARCHES: NonZeroUsize = NonZeroUsize::MIN.saturating_add(255);

/// Marks a request as ours until it is dropped.
struct AtIt<'a> {
    executor: &'a Executor,
    request: (RequestName, ObjectId),
}

impl<'a> AtIt<'a> {
    /// `None` when it is already.
    fn begin(executor: &'a Executor, name: RequestName, object: ObjectId) -> Option<Self> {
        let request = (name, object);
        let is_first = executor.at_it().insert(request);
        // Made only then: dropping one takes the mark away.
        is_first.then(|| Self { executor, request })
    }
}

impl Drop for AtIt<'_> {
    fn drop(&mut self) {
        self.executor.at_it().remove(&self.request);
    }
}

fn with_wait(outcome: Outcome, waited: Duration) -> Outcome {
    match outcome {
        Outcome::Pose(mut answer) => {
            answer.times.queue_ms = waited.as_secs_f64() * 1e3;
            Outcome::Pose(answer)
        }
        other => other,
    }
}

/// The regions to ask for these images: of several, what they hold for all of them together.
fn search(index: &Index, globals: &[Bytes], retrieve: usize) -> Outcome {
    let mut together: Vec<Candidate> = Vec::new();
    for codes in globals {
        if codes.len() != index.global_len() {
            return Outcome::LocalizeFailure(LocalizeFailure::WrongProfile);
        }
        let global = GlobalDescriptor::new(codes.iter().map(|code| code.cast_signed()).collect());
        for ranked in index.rank(&global, retrieve) {
            let (region, held) = (ranked.region as u32, ranked.held as u32);
            match together.iter_mut().find(|known| known.region == region) {
                Some(known) => known.held += held,
                None => together.push(Candidate { region, held }),
            }
        }
    }
    // Stable: of equals the one that one image ranked first.
    together.sort_by_key(|candidate| std::cmp::Reverse(candidate.held));
    together.truncate(MOST_REGIONS);
    Outcome::Regions(together)
}

fn pose(
    map: &veiloc_map::MapFile,
    kind: BodyKind,
    body: &[u8],
    near: Option<PositionHint>,
    mut options: LocalizeOptions,
) -> Outcome {
    // The gateway has read it; what cannot be read here is no sealed query of this version.
    let Ok(asked) = DecodedRequest::decode(kind, body) else { return Outcome::Rejected(Why::Unread) };
    if let Some(near) = near {
        let [x, y, z] = near.center();
        options.position = Some(PositionPrior { center: Point3::new(x, y, z), sd: near.sd() });
    }
    match asked.localize(map, &options, 0.0) {
        Ok(LocalizeOutput { answer, .. }) => Outcome::Pose(Box::new(answer)),
        Err(why) => Outcome::LocalizeFailure(why),
    }
}
