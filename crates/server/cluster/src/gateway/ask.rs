//! Asking one group, until somebody answers: the same question again when a member is slow, busy, gone or says nonsense.

use std::time::{Duration, Instant};

use crate::bus::{Bus, BusError, Subject};
use bytes::Bytes;
use futures_util::StreamExt as _;
use futures_util::stream::FuturesUnordered;
use std::num::NonZeroU64;
use tokio::time::sleep_until;
use veiloc_map::regions::ObjectId;
use veiloc_service::Unanswered;
use veiloc_service::telemetry::GatewayCounts;

use super::pace::Pace;
use crate::message::{Reply, Request, RequestName, Said, Wanted, Why};

/// Messages to one group for one question.
const MOST_MESSAGES: usize = 8;

/// The pause after a member that could not, before another one is asked; after each further one twice as long.
const PAUSE: Duration = Duration::from_millis(10);

/// Of the time there is, a second message may always be sent after this part: whoever has not answered then is gone.
const LAST_RESORT: u32 = 4;

/// When to come back when nobody is there.
const COME_BACK: NonZeroU64 = NonZeroU64::MIN;

/// What all questions of a gateway share.
pub(crate) struct Road<'a> {
    pub(crate) bus: &'a Bus,
    pub(crate) counts: &'a GatewayCounts,
    pub(crate) pace: &'a Pace,
}

/// A question to one group.
pub(crate) struct Ask<'a> {
    pub(crate) group: &'a (Subject, ObjectId),
    pub(crate) name: RequestName,
    pub(crate) wanted: Wanted,
    pub(crate) deadline: Instant,
}

/// How a message ended that brought no answer.
enum Failed {
    Nobody,
    TurnedAway(Why),
    NoReply,
    BadReply,
    Closed,
}

impl Road<'_> {
    /// What the group says: regions or a pose, or why there is none.
    pub(crate) async fn ask(&self, ask: &Ask<'_>) -> Result<Said, Unanswered> {
        let begun = Instant::now();
        let time = ask.deadline.saturating_duration_since(begun);
        let last_resort = begun + time / LAST_RESORT;
        let (mut gap, mut pause) = (self.pace.second_after(), PAUSE);
        let (mut sent, mut next) = (0, begun);
        let mut under_way = FuturesUnordered::new();
        let mut why = Unanswered::TimedOut;
        self.pace.first();
        loop {
            tokio::select! {
                Some(end) = under_way.next(), if !under_way.is_empty() => match end {
                    Ok(said) => {
                        // Dropped with the question, which whoever is at them is told.
                        (0..under_way.len()).for_each(|_| self.counts.message("not-needed"));
                        return Ok(said);
                    }
                    Err(failed) => {
                        why = self.of_failed(failed);
                        if sent == MOST_MESSAGES && under_way.is_empty() {
                            return Err(why);
                        }
                        // Others who are at it may still answer; beside them another one is asked.
                        next = next.min(Instant::now() + pause);
                        pause *= 2;
                    }
                },
                () = sleep_until(next.into()), if sent < MOST_MESSAGES => {
                    let now = Instant::now();
                    let is_second = !under_way.is_empty();
                    if !is_second || now >= last_resort || self.pace.may_send_second() {
                        if is_second {
                            self.counts.hedged();
                        }
                        sent += 1;
                        under_way.push(self.send(ask));
                    }
                    next = now + gap;
                    gap *= 2;
                }
                () = sleep_until(ask.deadline.into()) => return Err(why),
            }
        }
    }

    /// Counts it; what the question ends with when nobody does better.
    fn of_failed(&self, failed: Failed) -> Unanswered {
        let (end, why) = match failed {
            Failed::Nobody => ("nobody", Unanswered::Unreached { retry_after: COME_BACK }),
            Failed::TurnedAway(Why::Busy { retry_after }) => {
                ("turned-away", Unanswered::Busy { retry_after })
            }
            // The one that is at it has its own message.
            Failed::TurnedAway(Why::AtIt) => ("turned-away", Unanswered::TimedOut),
            Failed::TurnedAway(Why::Broken) => ("turned-away", Unanswered::Broken),
            Failed::TurnedAway(Why::Leaving | Why::NotHeld | Why::Unread) => {
                ("turned-away", Unanswered::Unreached { retry_after: COME_BACK })
            }
            Failed::NoReply => ("no-reply", Unanswered::TimedOut),
            Failed::BadReply => ("bad-reply", Unanswered::Unreached { retry_after: COME_BACK }),
            Failed::Closed => ("no-reply", Unanswered::Unreached { retry_after: COME_BACK }),
        };
        self.counts.message(end);
        why
    }

    /// One message, and what becomes of it.
    async fn send(&self, ask: &Ask<'_>) -> Result<Said, Failed> {
        let begun = Instant::now();
        let (subject, object) = ask.group;
        let within = ask.deadline.saturating_duration_since(begun);
        let request = Request { name: ask.name, object: *object, within, wanted: ask.wanted.clone() };
        let sent = self.bus.request_cancellable(subject, request.encode(), within).await;
        let reply: Bytes = sent.map_err(|error| match error {
            BusError::Nobody { .. } => Failed::Nobody,
            BusError::TimedOut { .. } => Failed::NoReply,
            _ => Failed::Closed,
        })?;
        let Reply { said, worked, waited, .. } = Reply::decode(reply, &ask.name).map_err(|error| {
            tracing::warn!(%error, %subject, "a worker's reply was not understood");
            Failed::BadReply
        })?;
        let fits = match (&said, &ask.wanted) {
            (Said::Elsewhere(why), _) => return Err(Failed::TurnedAway(*why)),
            // Given up there and not here: somebody else goes on.
            (Said::Unanswered(Unanswered::Stopped), _) => return Err(Failed::TurnedAway(Why::Leaving)),
            (Said::Unanswered(_), Wanted::Search { .. } | Wanted::Pose { .. }) => true,
            (Said::Regions(_), Wanted::Search { .. }) => true,
            (Said::Pose(_), Wanted::Pose { .. }) => true,
            _ => false,
        };
        if !fits {
            return Err(Failed::BadReply);
        }
        let took = begun.elapsed();
        self.pace.took(took);
        self.counts.message("answered");
        self.counts.road(took.saturating_sub(worked).saturating_sub(waited));
        Ok(said)
    }
}
