//! The threads of a worker, and the tasks that they execute.

use std::collections::HashSet;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bytes::Bytes;
use veiloc_descriptor::GlobalDescriptor;
use veiloc_geometry::Point3;
use veiloc_localization::LocalizeOptions;
use veiloc_map::regions::{ObjectId, RegionIndex};
use veiloc_pose::{PositionPrior, Stop};
use veiloc_protocol::PositionHint;
use veiloc_service::telemetry::{RequestId, WorkerCounts};
use veiloc_service::worker_api::{JobSpec, Pool, Rejected, with_request};
use veiloc_service::{BodyKind, Clock, DecodedRequest, LocalizeFailure, LocalizeOutput};

use super::content::Content;
use crate::message::{Candidate, MAX_REGIONS, RejectReason, ReplyOutcome, Request, RequestIdBytes, Task};

/// Approximate bytes per row of a query: the cost of a job is estimated before the query is decoded.
const ROW_BYTES: usize = 132;

/// State shared by threads and subscriptions.
pub(crate) struct Executor {
    /// Pool for poses.
    pool: Pool,
    /// Pool for searches: they take less than a millisecond for a town, and must not wait behind poses.
    searches: Pool,
    localize: LocalizeOptions,
    counts: Arc<WorkerCounts>,
    /// Requests in the queue or in progress: a second message of one is meant for another worker.
    in_progress: Mutex<HashSet<(RequestIdBytes, ObjectId)>>,
}

/// Result of a request.
pub(crate) struct Done {
    pub(crate) outcome: ReplyOutcome,
    pub(crate) worked: Duration,
    pub(crate) waited: Duration,
}

impl Done {
    /// A result that needed no work.
    pub(crate) const fn at_once(outcome: ReplyOutcome) -> Self {
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
            searches: Pool::start(NonZeroUsize::MIN, SEARCH_QUEUE, Clock::default())?,
            localize,
            counts,
            in_progress: Mutex::default(),
        })
    }

    /// Queued requests and busy threads.
    pub(crate) fn load(&self) -> (usize, usize) {
        (self.pool.queued(), self.pool.busy())
    }

    /// Finishes accepted jobs and rejects further ones. Blocks.
    pub(crate) fn finish(&self) {
        self.pool.finish();
        self.searches.finish();
    }

    /// Counts a reply by its outcome.
    pub(crate) fn count_reply(&self, outcome: &ReplyOutcome) {
        self.counts.reply(match outcome {
            ReplyOutcome::Here | ReplyOutcome::Regions(_) | ReplyOutcome::Pose(_) => "answered",
            ReplyOutcome::Failed(_) => "no-pose",
            ReplyOutcome::Rejected(RejectReason::Busy { .. } | RejectReason::Leaving) => "busy",
            ReplyOutcome::Rejected(RejectReason::InProgress) => "duplicate",
            ReplyOutcome::Rejected(RejectReason::NotHeld | RejectReason::Undecodable) => "rejected",
            ReplyOutcome::Rejected(RejectReason::Broken) => "internal-error",
        });
    }

    /// Executes a task on this object.
    pub(crate) async fn work(self: &Arc<Self>, request: Request, content: &Arc<Content>) -> Done {
        let Request { name, object, within, task } = request;
        match task {
            Task::Ping => {
                self.counts.request("ping");
                Done::at_once(ReplyOutcome::Here)
            }
            Task::Search { globals } => {
                self.counts.request("search");
                let content = content.clone();
                let retrieve = self.localize.retrieve;
                let spec = JobSpec { client: None, rows: 0, is_session: false, limit: within };
                self.run_queued(&self.searches, name, spec, Stop::default(), move || {
                    let Content::Index(index) = &*content else {
                        return ReplyOutcome::Rejected(RejectReason::NotHeld);
                    };
                    search(index, &globals, retrieve)
                })
                .await
            }
            Task::Pose { kind, body, near } => {
                self.counts.request("pose");
                let Some(_here) = InProgress::begin(self, name, object) else {
                    return Done::at_once(ReplyOutcome::Rejected(RejectReason::InProgress));
                };
                let spec = JobSpec {
                    client: None,
                    rows: body.len() / ROW_BYTES,
                    is_session: kind == BodyKind::Rig,
                    limit: within,
                };
                let mut options = self.localize.clone();
                options.pose.stop = Stop::default();
                let stop = options.pose.stop.clone();
                let content = content.clone();
                self.run_queued(&self.pool, name, spec, stop, move || {
                    let Content::Region(map) = &*content else {
                        return ReplyOutcome::Rejected(RejectReason::NotHeld);
                    };
                    pose(map, kind, &body, near, options)
                })
                .await
            }
        }
    }

    /// Runs a job on a thread of this pool within its time limit. If the future is dropped, the job is skipped or
    /// stopped.
    async fn run_queued(
        &self,
        pool: &Pool,
        name: RequestIdBytes,
        spec: JobSpec,
        stop: Stop,
        work: impl FnOnce() -> ReplyOutcome + Send + 'static,
    ) -> Done {
        let counts = self.counts.clone();
        let begun = Arc::new(AtomicBool::new(false));
        let mut cancel_on_drop =
            CancelOnDrop { stop, begun: begun.clone(), counts: &self.counts, ended: false };
        let job = move |waited: Duration| {
            begun.store(true, Ordering::Relaxed);
            let started = Instant::now();
            let outcome = with_request(RequestId::from_bytes(name), work);
            let worked = started.elapsed();
            counts.add_busy_time(worked);
            // The times in an answer are those of the worker; the gateway adds its own.
            Done { outcome: with_wait(outcome, waited), worked, waited }
        };
        let limit = spec.limit;
        let result = match pool.submit(spec, job) {
            Ok(result) => result,
            Err(refused) => {
                cancel_on_drop.ended = true;
                return Done::at_once(ReplyOutcome::Rejected(match refused {
                    Rejected::Full { retry_after } | Rejected::Late { retry_after } => {
                        RejectReason::Busy { retry_after }
                    }
                    Rejected::Closed => RejectReason::Leaving,
                }));
            }
        };
        let ended = tokio::time::timeout(limit, result).await;
        cancel_on_drop.ended = true;
        match ended {
            Ok(Ok(done)) => done,
            Ok(Err(_)) => {
                tracing::error!(
                    "localization panicked; this is a bug in veiloc, the line before has the location"
                );
                Done::at_once(ReplyOutcome::Rejected(RejectReason::Broken))
            }
            Err(_) => Done::at_once(ReplyOutcome::Failed(LocalizeFailure::TimedOut)),
        }
    }

    fn in_progress(&self) -> MutexGuard<'_, HashSet<(RequestIdBytes, ObjectId)>> {
        self.in_progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Guard of a job: dropping it stops the job, and counts it as cancelled unless it had ended or timed out. A queued
/// job is skipped, because its receiver is gone.
struct CancelOnDrop<'a> {
    stop: Stop,
    begun: Arc<AtomicBool>,
    counts: &'a WorkerCounts,
    ended: bool,
}

impl Drop for CancelOnDrop<'_> {
    fn drop(&mut self) {
        self.stop.set();
        if !self.ended {
            self.counts.cancelled(if self.begun.load(Ordering::Relaxed) { "running" } else { "queued" });
        }
    }
}

/// Capacity of the queue of searches.
const SEARCH_QUEUE: NonZeroUsize = NonZeroUsize::MIN.saturating_add(255);

/// Marks a request as in progress until it is dropped.
struct InProgress<'a> {
    executor: &'a Executor,
    request: (RequestIdBytes, ObjectId),
}

impl<'a> InProgress<'a> {
    /// `None` if the request is already in progress.
    fn begin(executor: &'a Executor, name: RequestIdBytes, object: ObjectId) -> Option<Self> {
        let request = (name, object);
        let is_first = executor.in_progress().insert(request);
        // Created only in this case, because dropping the guard removes the mark.
        is_first.then(|| Self { executor, request })
    }
}

impl Drop for InProgress<'_> {
    fn drop(&mut self) {
        self.executor.in_progress().remove(&self.request);
    }
}

fn with_wait(outcome: ReplyOutcome, waited: Duration) -> ReplyOutcome {
    match outcome {
        ReplyOutcome::Pose(mut answer) => {
            answer.times.queue_ms = waited.as_secs_f64() * 1e3;
            ReplyOutcome::Pose(answer)
        }
        other => other,
    }
}

/// The regions for these images; for several images the sums of retrieved images.
fn search(index: &RegionIndex, globals: &[Bytes], retrieve: usize) -> ReplyOutcome {
    let mut candidates: Vec<Candidate> = Vec::new();
    for codes in globals {
        if codes.len() != index.global_len() {
            return ReplyOutcome::Failed(LocalizeFailure::WrongProfile);
        }
        let global = GlobalDescriptor::new(codes.iter().map(|code| code.cast_signed()).collect());
        for ranked in index.rank(&global, retrieve) {
            let (region, held) = (ranked.region as u32, ranked.held as u32);
            match candidates.iter_mut().find(|known| known.region == region) {
                Some(known) => known.held += held,
                None => candidates.push(Candidate { region, held }),
            }
        }
    }
    // The sort is stable: equal regions keep the order of the first image.
    candidates.sort_by_key(|candidate| std::cmp::Reverse(candidate.held));
    candidates.truncate(MAX_REGIONS);
    ReplyOutcome::Regions(candidates)
}

fn pose(
    map: &veiloc_map::MapFile,
    kind: BodyKind,
    body: &[u8],
    near: Option<PositionHint>,
    mut options: LocalizeOptions,
) -> ReplyOutcome {
    // The gateway has decoded it; otherwise the versions differ.
    let Ok(request) = DecodedRequest::decode(kind, body) else {
        return ReplyOutcome::Rejected(RejectReason::Undecodable);
    };
    if let Some(near) = near {
        let [x, y, z] = near.center();
        options.position = Some(PositionPrior { center: Point3::new(x, y, z), sd: near.sd() });
    }
    match request.localize(map, &options, 0.0) {
        Ok(LocalizeOutput { answer, .. }) => ReplyOutcome::Pose(Box::new(answer)),
        Err(why) => ReplyOutcome::Failed(why),
    }
}
