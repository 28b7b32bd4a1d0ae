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
use veiloc_service::auth::Lane;
use veiloc_service::telemetry::{RequestId, WorkerCounts};
use veiloc_service::worker_api::{JobSpec, Pool, Rejected, with_request};
use veiloc_service::{BodyKind, Clock, DecodedRequest, LocalizeFailure};

use super::holdings::{Content, Holdings};
use crate::message::{
    Candidate, Load, MAX_REGIONS, RejectReason, ReplyOutcome, Request, RequestIdBytes, Task,
};

/// State shared by threads and subscriptions.
pub(crate) struct Executor {
    /// Pool for poses.
    pool: Pool,
    /// Pool for searches: they take less than a millisecond for a town, and must not wait behind poses.
    searches: Pool,
    queue: NonZeroUsize,
    localize: LocalizeOptions,
    counts: Arc<WorkerCounts>,
    /// Requests in the queue or in progress: a second message of one is not worked on.
    in_progress: Arc<Mutex<InProgress>>,
}

type InProgress = HashSet<(RequestIdBytes, ObjectId)>;

/// A request that is to be worked on.
pub(crate) struct Accepted {
    request: Request,
    content: Arc<Content>,
    mark: Mark,
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
            queue,
            localize,
            counts,
            in_progress: Arc::default(),
        })
    }

    /// Queued requests and busy threads.
    pub(crate) fn queued_and_busy(&self) -> (usize, usize) {
        (self.pool.queued(), self.pool.busy())
    }

    /// The load that replies and announcements report.
    pub(crate) fn load(&self) -> Load {
        let (queued, busy) = self.queued_and_busy();
        let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        Load { jobs: number(queued + busy), free: number(self.queue.get().saturating_sub(queued)) }
    }

    /// Finishes accepted jobs and rejects further ones. Blocks.
    pub(crate) fn finish(&self) {
        self.pool.finish();
        self.searches.finish();
    }

    /// Counts a reply by its outcome, unless it is the reply to a ping.
    pub(crate) fn count_reply(&self, outcome: &ReplyOutcome) {
        if !matches!(outcome, ReplyOutcome::Here { .. }) {
            self.counts.reply(outcome.name());
        }
    }

    /// Marks a request as in progress; or the reply, if there is nothing to compute. A worker that is leaving answers only
    /// pings.
    pub(crate) fn accept(
        &self,
        request: Request,
        holdings: &Holdings,
        is_leaving: bool,
    ) -> Result<Accepted, ReplyOutcome> {
        if let Task::Ping { owed } = &request.task {
            self.counts.request("ping");
            return Err(ReplyOutcome::Here { unknown: self.unknown(owed) });
        }
        self.counts.request(if matches!(request.task, Task::Search { .. }) { "search" } else { "pose" });
        if is_leaving {
            return Err(ReplyOutcome::Rejected(RejectReason::Leaving));
        }
        let content = holdings.find(&request.object);
        let content = content.ok_or(ReplyOutcome::Rejected(RejectReason::NotHeld))?;
        let mark = Mark::begin(&self.in_progress, (request.name, request.object));
        let mark = mark.ok_or(ReplyOutcome::Rejected(RejectReason::InProgress))?;
        Ok(Accepted { request, content, mark })
    }

    /// Numbers of the requests that are not in progress.
    fn unknown(&self, owed: &[(RequestIdBytes, ObjectId)]) -> Vec<u32> {
        let in_progress = all(&self.in_progress);
        (0_u32..).zip(owed).filter(|(_, request)| !in_progress.contains(*request)).map(|(i, _)| i).collect()
    }

    /// Computes the result of a request. The mark is to be dropped when the reply was sent, so that a ping never finds the
    /// request gone before its reply.
    pub(crate) async fn work(&self, accepted: Accepted) -> (Done, Mark) {
        let Accepted { request, content, mark } = accepted;
        (self.done(request, content).await, mark)
    }

    async fn done(&self, request: Request, content: Arc<Content>) -> Done {
        let Request { name, within, lane, rows, task, .. } = request;
        let is_session = matches!(task, Task::Pose { kind: BodyKind::Rig, .. });
        let spec = JobSpec { client: lane.map(Lane::key), rows: rows as usize, is_session, limit: within };
        match task {
            Task::Ping { .. } => Done::at_once(ReplyOutcome::Here { unknown: Vec::new() }),
            Task::Search { globals } => {
                let retrieve = self.localize.retrieve;
                let spec = JobSpec { rows: 0, ..spec };
                self.run_queued(&self.searches, name, spec, Stop::default(), move || {
                    let Content::Index(index) = &*content else {
                        return ReplyOutcome::Rejected(RejectReason::NotHeld);
                    };
                    search(index, &globals, retrieve)
                })
                .await
            }
            Task::Pose { kind, body, near } => {
                let mut options = self.localize.clone();
                options.pose.stop = Stop::default();
                let stop = options.pose.stop.clone();
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

fn all(in_progress: &Mutex<InProgress>) -> MutexGuard<'_, InProgress> {
    in_progress.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Marks a request as in progress until it is dropped.
pub(crate) struct Mark {
    in_progress: Arc<Mutex<InProgress>>,
    request: (RequestIdBytes, ObjectId),
}

impl Mark {
    /// `None` if the request is already in progress.
    fn begin(in_progress: &Arc<Mutex<InProgress>>, request: (RequestIdBytes, ObjectId)) -> Option<Self> {
        let is_first = all(in_progress).insert(request);
        // Created only in this case, because dropping the guard removes the mark.
        is_first.then(|| Self { in_progress: in_progress.clone(), request })
    }
}

impl Drop for Mark {
    fn drop(&mut self) {
        all(&self.in_progress).remove(&self.request);
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
        Ok(answer) => ReplyOutcome::Pose(Box::new(answer)),
        Err(why) => ReplyOutcome::Failed(why),
    }
}
