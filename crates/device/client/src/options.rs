//! How a client behaves: limits, retries, and whom it tells what happens meanwhile.

use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// When the same bytes are sent again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RetryPolicy {
    /// How often at most, after the first time. Default 4.
    pub retries: u32,
    /// Pause before the first retry where the service names none; before the second twice as long, and so on. Default
    /// half a second.
    pub pause: Duration,
    /// A service that asks for a longer pause than this is not waited for. Default 20 s: a device would rather tell its
    /// user.
    pub longest_pause: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self { retries: 4, pause: Duration::from_millis(500), longest_pause: Duration::from_secs(20) }
    }
}

/// What happens while a call is under way.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// The same bytes are about to be sent again.
    Again {
        /// Why: what the service or the system said, fit for a screen.
        reason: String,
        /// After how long.
        pause: Duration,
    },
    /// A profile could not be kept on disk; it is fetched again next time.
    NotKept {
        /// The file it was to be in.
        file: PathBuf,
        /// What the system said.
        reason: String,
    },
}

/// Who is told of what happens.
pub type NoticeListener = dyn Fn(&Notice) + Send + Sync;

/// Returns after so long.
pub type Sleep = dyn Fn(Duration) + Send + Sync;

/// How a [`crate::Client`] behaves.
#[derive(Clone)]
#[non_exhaustive]
pub struct ClientOptions {
    /// Certificates to trust instead of the public ones, PEM: for a service with a certificate of its own.
    pub certificates: Option<Vec<u8>>,
    /// Speak plain HTTP beyond this machine, where everybody on the way can read token and query.
    pub insecure_http: bool,
    /// When the same bytes are sent again.
    pub retry: RetryPolicy,
    /// Makes the pauses between retries, on the thread of the call. Default: [`std::thread::sleep`].
    pub sleep: Arc<Sleep>,
    /// To reach the service. Default 10 s.
    pub connect_timeout: Duration,
    /// From connecting to the last byte of the answer, for each attempt. Default 60 s.
    pub timeout: Duration,
    /// Folder to keep profiles in, made when needed. Without one they are fetched each time.
    pub cache: Option<PathBuf>,
    /// Is told what happens while a call is under way, on the thread of the call.
    pub notice: Option<Arc<NoticeListener>>,
}

impl Default for ClientOptions {
    fn default() -> Self {
        Self {
            certificates: None,
            insecure_http: false,
            retry: RetryPolicy::default(),
            sleep: Arc::new(std::thread::sleep),
            connect_timeout: Duration::from_secs(10),
            timeout: Duration::from_secs(60),
            cache: None,
            notice: None,
        }
    }
}

impl ClientOptions {
    pub(crate) fn tell(&self, notice: &Notice) {
        if let Some(listener) = &self.notice {
            listener(notice);
        }
    }
}

impl fmt::Debug for ClientOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ClientOptions")
            .field("certificates", &self.certificates.is_some())
            .field("insecure_http", &self.insecure_http)
            .field("retry", &self.retry)
            .field("connect_timeout", &self.connect_timeout)
            .field("timeout", &self.timeout)
            .field("cache", &self.cache)
            .finish_non_exhaustive()
    }
}
