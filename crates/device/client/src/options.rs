//! Options of a client: limits, retries, and the listener for events.

use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use veiloc_protocol::MessageId;

/// When the same bytes are sent again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RetryPolicy {
    /// Maximum number of retries after the first attempt. Default 4.
    pub retries: u32,
    /// Pause before the first retry when the service gives none; doubled before each further retry. Default half a
    /// second.
    pub pause: Duration,
    /// If the service asks for a longer pause than this, the call fails instead of waiting. Default 20 s: a user should
    /// be informed before.
    pub longest_pause: Duration,
}

impl Default for RetryPolicy {
    fn default() -> Self {
        Self { retries: 4, pause: Duration::from_millis(500), longest_pause: Duration::from_secs(20) }
    }
}

/// An event during a call.
#[derive(Debug, Clone, PartialEq)]
pub enum Notice {
    /// The same bytes are about to be sent again.
    Again {
        /// The message of the service or the system, without control characters.
        reason: String,
        /// The pause before the retry.
        pause: Duration,
    },
    /// The profile or pack of a map is another one than the cached one of an earlier call: the map was replaced, or the
    /// service gives this device one of its own. Compare it with the one that the operator publishes
    /// ([`ClientOptions::profile_ids`], [`ClientOptions::pack_ids`]).
    Changed {
        /// `profile` or `pack`.
        what: &'static str,
        /// Name of the map.
        map: String,
        /// Its id before.
        before: MessageId,
        /// Its id now.
        now: MessageId,
    },
    /// A profile or pack could not be stored on disk; it is fetched again next time.
    CacheWriteFailed {
        /// The file.
        file: PathBuf,
        /// The message of the system.
        reason: String,
    },
}

/// A function that receives events.
pub type NoticeListener = dyn Fn(&Notice) + Send + Sync;

/// A function that returns after the given duration.
pub type Sleep = dyn Fn(Duration) + Send + Sync;

/// How a [`crate::Client`] behaves.
#[derive(Clone)]
#[non_exhaustive]
pub struct ClientOptions {
    /// Certificates to trust instead of the public ones, PEM: for a service with a certificate of its own.
    pub certificates: Option<Vec<u8>>,
    /// Allow plain HTTP to other machines; everyone on the network path can read token and query.
    pub insecure_http: bool,
    /// When the same bytes are sent again.
    pub retry: RetryPolicy,
    /// Waits between retries, on the thread of the call. Default: [`std::thread::sleep`].
    pub sleep: Arc<Sleep>,
    /// Time limit for the connection. Default 10 s.
    pub connect_timeout: Duration,
    /// Time limit from connecting to the last byte of the answer, for each attempt. Default 60 s.
    pub timeout: Duration,
    /// Folder for cached profiles and packs, created when needed. Without one, they are fetched each time.
    pub cache: Option<PathBuf>,
    /// Ids of profiles by the name of their map, as their operator publishes them. A map in this list with another
    /// profile is an error, and nothing is sealed for it: a service could give one user a profile of its own, to
    /// recognize that user. Default: none.
    pub profile_ids: BTreeMap<String, MessageId>,
    /// The same for packs.
    pub pack_ids: BTreeMap<String, MessageId>,
    /// Receives the events of a call, on the thread of the call.
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
            profile_ids: BTreeMap::new(),
            pack_ids: BTreeMap::new(),
            notice: None,
        }
    }
}

impl ClientOptions {
    pub(crate) fn notify(&self, notice: &Notice) {
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
            .field("profile_ids", &self.profile_ids)
            .field("pack_ids", &self.pack_ids)
            .finish_non_exhaustive()
    }
}
