//! Retries of transient errors with exponential backoff.

use std::time::Duration;

use crate::ClusterError;

/// Number of attempts, pauses, and stall timeout.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RetryPolicy {
    pub(crate) attempts: u32,
    /// Pause before the second attempt; doubles before each further one.
    pub(crate) pause: Duration,
    /// Maximum wait between two pieces of a response.
    pub(crate) stall: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self { attempts: 4, pause: Duration::from_millis(500), stall: Duration::from_secs(60) }
    }
}

impl RetryPolicy {
    /// Returns the first success, or the last failure.
    pub(crate) async fn attempt<T>(
        &self,
        act: impl AsyncFn() -> Result<T, ClusterError>,
    ) -> Result<T, ClusterError> {
        let mut pause = self.pause;
        for _ in 1..self.attempts {
            match act().await {
                Err(error) if error.is_transient() => tokio::time::sleep(pause).await,
                decided => return decided,
            }
            pause *= 2;
        }
        act().await
    }

    /// Awaits a future with the stall timeout.
    pub(crate) async fn await_next<T>(
        &self,
        next: impl Future<Output = T>,
        address: &str,
    ) -> Result<T, ClusterError> {
        tokio::time::timeout(self.stall, next)
            .await
            .map_err(|_| ClusterError::Stalled { address: address.to_owned(), seconds: self.stall.as_secs() })
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use tokio::time::Instant;

    use super::*;

    fn stalled() -> ClusterError {
        ClusterError::Stalled { address: "memory://maps".to_owned(), seconds: 60 }
    }

    #[tokio::test(start_paused = true)]
    async fn pauses_double_until_the_last_attempt() {
        for (failures, attempts, waited_ms) in [(0, 1, 0), (1, 2, 500), (3, 4, 3500), (9, 4, 3500)] {
            let (begun, tried) = (Instant::now(), Cell::new(0));
            let done = RetryPolicy::default()
                .attempt(async || {
                    tried.set(tried.get() + 1);
                    if tried.get() > failures { Ok(()) } else { Err(stalled()) }
                })
                .await;
            assert_eq!((done.is_ok(), tried.get()), (failures < 4, attempts));
            assert_eq!(begun.elapsed(), Duration::from_millis(waited_ms), "{failures} failures");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn stalled_reads_time_out() {
        let begun = Instant::now();
        let stalled = RetryPolicy::default().await_next(std::future::pending::<()>(), "memory://maps").await;
        assert!(matches!(stalled, Err(ClusterError::Stalled { seconds: 60, .. })));
        assert_eq!(begun.elapsed(), Duration::from_secs(60));
    }
}
