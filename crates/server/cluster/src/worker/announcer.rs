//! Announces a worker: periodically, and at once when what it holds changed or when it leaves.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::watch;
use tokio::time::{Instant, sleep_until};

use super::executor::Executor;
use super::holdings::Holdings;
use crate::announcement::{Announcement, MemberId};
use crate::bus::{Bus, Subject};
use crate::frame_version::FrameVersions;
use crate::placement::Placed;

/// What is announced, and where.
pub(super) struct Announcer {
    pub(super) bus: Bus,
    pub(super) subject: Subject,
    pub(super) member: MemberId,
    pub(super) period: Duration,
    pub(super) threads: u32,
    pub(super) executor: Arc<Executor>,
    pub(super) holdings: Arc<Holdings>,
    pub(super) placed: Option<Placed>,
}

impl Announcer {
    /// Announces the worker once. While there is no connection nothing is sent, so that nothing piles up.
    pub(super) async fn announce(&self, leaving: bool) {
        if !self.bus.is_connected() {
            return;
        }
        let announcement = Announcement {
            versions: FrameVersions::OWN,
            member: self.member,
            period: self.period,
            leaving,
            threads: self.threads,
            load: self.executor.load(),
            objects: self.holdings.objects(),
            placed: self.placed.clone(),
        };
        if let Err(error) = self.bus.publish(&self.subject, announcement.encode()).await {
            tracing::warn!(%error, "the worker cannot be announced");
        }
    }

    /// Announces the worker until it leaves, and then that it leaves.
    pub(super) async fn run(self, mut leaving: watch::Receiver<bool>) {
        let mut changes = self.holdings.changes();
        loop {
            changes.mark_unchanged();
            self.announce(false).await;
            let next = Instant::now() + self.period;
            tokio::select! {
                () = sleep_until(next) => {}
                _ = changes.changed() => {}
                // A dropped sender also means leaving: the worker was dropped.
                _ = leaving.wait_for(|leaving| *leaving) => break,
            }
        }
        self.announce(true).await;
    }
}
