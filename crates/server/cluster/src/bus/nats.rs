//! The bus over NATS: groups are queue groups, and replies come to one inbox per connection.
//!
//! The inbox is managed here, because the library keeps an entry per request until its reply comes, and the entry of
//! a request whose member died would stay for ever.
//!
//! A cancel message is published on the group's subject with the suffix `.cancel`, to which all members subscribe,
//! because the gateway does not know which member received the request. It carries the reply inbox of the request.
//! Only the gateway and the worker that received the request know this inbox, so a third party that may publish there
//! cannot cancel anything.

use std::collections::HashMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use async_nats::connection::State;
use async_nats::{Client, ConnectOptions, Event, ServerAddr, StatusCode, Subscriber};
use bytes::Bytes;
use futures_util::StreamExt as _;
use tokio::sync::{mpsc, oneshot};

use crate::ClusterError;
use crate::bus::open_requests::OpenRequests;
use crate::bus::subject::Subject;

/// Name of the queue group of all members of a subject.
const GROUP: &str = "members";

/// Cancel messages that wait to be published; further ones are dropped.
const CANCEL_QUEUE: usize = 1024;

/// How to reach NATS.
#[derive(Clone, Default)]
pub struct NatsOptions {
    /// Addresses of the servers, `nats://HOST:PORT` or `tls://HOST:PORT`; one is enough to find the others. A user
    /// and a password may precede the host, `tls://USER:PASSWORD@HOST:PORT`; the first address that has them counts.
    /// Replies then come to subjects that begin with `_INBOX_USER`, which the servers may restrict to this user.
    pub servers: Vec<String>,
    /// Certificate authorities of the servers, PEM. If given, TLS is used whatever the address says.
    pub ca: Option<PathBuf>,
    /// A credentials file as written by `nsc`, which selects the account.
    pub credentials: Option<PathBuf>,
    /// Name of the connection in reports of the server.
    pub name: String,
    /// Required maximum length of a message, bytes.
    pub needed_payload: usize,
}

impl NatsOptions {
    fn connect_options(&self) -> ConnectOptions {
        let options = ConnectOptions::new()
            .name(&self.name)
            .connection_timeout(Duration::from_secs(5))
            // A silently broken connection is detected after two missed pings.
            .ping_interval(Duration::from_secs(5))
            .reconnect_delay_callback(|attempts| match attempts {
                0 | 1 => Duration::ZERO,
                n => Duration::from_millis(50 * n.min(20) as u64),
            })
            .event_callback(|event| async move {
                match event {
                    Event::Connected => tracing::info!("connected to NATS"),
                    Event::Disconnected => {
                        tracing::warn!("the connection to NATS is lost; trying other servers");
                    }
                    Event::SlowConsumer(_) => {
                        tracing::warn!("NATS: slow consumer, messages arrive faster than they are read");
                    }
                    // Server messages may contain subjects, but nothing of a payload.
                    other => tracing::warn!("NATS: {other}"),
                }
            });
        match &self.ca {
            Some(ca) => options.add_root_certificates(ca.clone()).require_tls(true),
            None => options,
        }
    }
}

/// Addresses may contain passwords, which must not be printed.
impl fmt::Debug for NatsOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let servers: Vec<String> = self.servers.iter().map(|server| without_password(server)).collect();
        f.debug_struct("NatsOptions").field("servers", &servers).field("ca", &self.ca).finish_non_exhaustive()
    }
}

/// Removes user and password from an address.
fn without_password(address: &str) -> String {
    let (scheme, rest) = address.split_once("://").map_or((None, address), |(s, rest)| (Some(s), rest));
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    scheme.map_or_else(|| host.to_owned(), |scheme| format!("{scheme}://{host}"))
}

/// Printed in place of a password.
const MASK: &str = "***";

/// User and password for the servers.
struct Login {
    user: String,
    password: String,
}

impl Login {
    /// The login of the first address that has one: the library does not read it.
    fn of(servers: &[ServerAddr]) -> Result<Option<Self>, ClusterError> {
        let named = servers.iter().find_map(|server| Some((server.username()?, server.password())));
        let Some((user, password)) = named else { return Ok(None) };
        let Some(password) = password else {
            return Err(ClusterError::Login { reason: "the password is missing" });
        };
        // The user becomes a part of a subject, and escapes in addresses are not decoded.
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if user.is_empty() || !user.chars().all(is_plain) {
            return Err(ClusterError::Login {
                reason: "the user has other characters than letters, digits, _ and -",
            });
        }
        if password.contains('%') {
            return Err(ClusterError::Login {
                reason: "the password has an escape (%), which is not decoded",
            });
        }
        if password == MASK {
            return Err(ClusterError::Login {
                reason: "the password is the `***` that --print-config prints in its place; write the real one",
            });
        }
        Ok(Some(Self { user: user.to_owned(), password: password.to_owned() }))
    }
}

/// A connection to NATS; clones share it.
#[derive(Clone)]
pub(crate) struct Nats(Arc<Connection>);

struct Connection {
    client: Client,
    /// Prefix of the reply subjects; the number of the request follows.
    inbox: String,
    next: AtomicU64,
    waiting: Arc<PendingReplies>,
    cancels: mpsc::Sender<Cancel>,
    _tasks: [AbortOnDrop; 2],
}

/// A cancel message to publish: its subject, and the inbox of the cancelled request.
type Cancel = (String, String);

type ReplyResult = Result<Bytes, NoResponders>;

/// Requests that wait for a reply, by number.
#[derive(Default)]
struct PendingReplies(Mutex<HashMap<u64, oneshot::Sender<ReplyResult>>>);

/// The server reports that the group is empty.
struct NoResponders;

impl PendingReplies {
    fn all(&self) -> MutexGuard<'_, HashMap<u64, oneshot::Sender<ReplyResult>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A task that is aborted when its owner is dropped.
struct AbortOnDrop(tokio::task::JoinHandle<()>);

impl Drop for AbortOnDrop {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Nats {
    pub(crate) async fn connect(options: &NatsOptions) -> Result<Self, ClusterError> {
        let servers: Vec<ServerAddr> = options
            .servers
            .iter()
            .map(|text| {
                text.parse().map_err(|_| ClusterError::BusAddress { address: without_password(text) })
            })
            .collect::<Result<_, _>>()?;
        let mut connect = options.connect_options();
        if let Some(login) = Login::of(&servers)? {
            let inbox = format!("_INBOX_{}", login.user);
            connect = connect.user_and_password(login.user, login.password).custom_inbox_prefix(inbox);
        }
        if let Some(path) = &options.credentials {
            let wrong = |e: std::io::Error| ClusterError::Credentials {
                path: path.display().to_string(),
                reason: e.to_string(),
            };
            connect = connect.credentials_file(path).await.map_err(wrong)?;
        }
        let names = || options.servers.iter().map(|s| without_password(s)).collect::<Vec<_>>().join(", ");
        let wrong = |reason: String| ClusterError::Connect { servers: names(), reason };
        let client = connect.connect(servers).await.map_err(|e| wrong(e.to_string()))?;
        let longest = client.server_info().max_payload;
        if longest < options.needed_payload {
            return Err(ClusterError::SmallPayload { longest, needed: options.needed_payload });
        }
        let inbox = client.new_inbox();
        let replies = client.subscribe(format!("{inbox}.*")).await.map_err(|e| wrong(e.to_string()))?;
        let waiting = Arc::new(PendingReplies::default());
        let replies = AbortOnDrop(tokio::spawn(dispatch_replies(replies, waiting.clone())));
        let (cancels, cancel_queue) = mpsc::channel(CANCEL_QUEUE);
        let tasks = [replies, AbortOnDrop(tokio::spawn(publish_cancels(client.clone(), cancel_queue)))];
        let next = AtomicU64::new(0);
        Ok(Self(Arc::new(Connection { client, inbox, next, waiting, cancels, _tasks: tasks })))
    }

    /// Servers may have different limits, so ask the current one.
    pub(crate) fn max_payload(&self) -> usize {
        self.0.client.server_info().max_payload
    }

    pub(crate) fn is_connected(&self) -> bool {
        self.0.client.connection_state() == State::Connected
    }

    pub(crate) async fn flush(&self) {
        let _ = tokio::time::timeout(Duration::from_secs(2), self.0.client.flush()).await;
    }

    pub(crate) async fn request(
        &self,
        subject: &Subject,
        payload: Bytes,
        cancellable: bool,
    ) -> Result<Bytes, ClusterError> {
        let connection = &*self.0;
        let number = connection.next.fetch_add(1, Ordering::Relaxed);
        let (reply, answer) = oneshot::channel();
        connection.waiting.all().insert(number, reply);
        let to = format!("{}.{number}", connection.inbox);
        let cancel = cancellable.then(|| (subject.of_cancels(), to.clone()));
        let _pending = PendingRequest { connection, number, cancel };
        let sent = connection.client.publish_with_reply(subject.as_str().to_owned(), to, payload).await;
        sent.map_err(|_| ClusterError::BusClosed)?;
        match answer.await {
            Ok(Ok(bytes)) => Ok(bytes),
            Ok(Err(NoResponders)) => Err(ClusterError::NoResponders { subject: subject.clone() }),
            Err(_) => Err(ClusterError::BusClosed),
        }
    }

    pub(crate) async fn publish(&self, subject: &Subject, payload: Bytes) -> Result<(), ClusterError> {
        let sent = self.0.client.publish(subject.as_str().to_owned(), payload).await;
        sent.map_err(|_| ClusterError::BusClosed)
    }

    pub(crate) async fn listen(&self, subject: &Subject) -> Result<Subscriber, ClusterError> {
        let client = &self.0.client;
        let messages = client.subscribe(subject.as_str().to_owned()).await;
        let messages = messages.map_err(|_| ClusterError::BusClosed)?;
        // The NATS server has the subscription before this returns.
        client.flush().await.map_err(|_| ClusterError::BusClosed)?;
        Ok(messages)
    }

    pub(crate) async fn join(&self, subject: &Subject) -> Result<Membership, ClusterError> {
        let client = self.0.client.clone();
        let joined = client.queue_subscribe(subject.as_str().to_owned(), GROUP.to_owned()).await;
        let requests = joined.map_err(|_| ClusterError::BusClosed)?;
        let cancels = client.subscribe(subject.of_cancels()).await.map_err(|_| ClusterError::BusClosed)?;
        let open = Arc::new(OpenRequests::default());
        let cancels = AbortOnDrop(tokio::spawn(receive_cancels(cancels, open.clone())));
        // The NATS server has the subscription before the membership is announced.
        client.flush().await.map_err(|_| ClusterError::BusClosed)?;
        Ok(Membership { client, requests, open, _cancels: cancels })
    }
}

/// Removes a waiting request, and publishes a cancel message if it was not answered and may be cancelled.
struct PendingRequest<'a> {
    connection: &'a Connection,
    number: u64,
    cancel: Option<Cancel>,
}

impl Drop for PendingRequest<'_> {
    fn drop(&mut self) {
        let unanswered = self.connection.waiting.all().remove(&self.number).is_some();
        if let Some(cancel) = self.cancel.take().filter(|_| unanswered) {
            // If the queue is full, the member works in vain, as it would without cancellation.
            let _ = self.connection.cancels.try_send(cancel);
        }
    }
}

/// Publishes cancel messages until the connection is closed.
async fn publish_cancels(client: Client, mut cancel_queue: mpsc::Receiver<Cancel>) {
    while let Some((subject, inbox)) = cancel_queue.recv().await {
        if client.publish(subject, inbox.into()).await.is_err() {
            return;
        }
    }
}

/// Delivers replies to waiting requests. A reply without a waiting request is late or forged, and is dropped.
async fn dispatch_replies(mut replies: Subscriber, waiting: Arc<PendingReplies>) {
    while let Some(message) = replies.next().await {
        let number = message.subject.rsplit_once('.').and_then(|(_, number)| number.parse().ok());
        let Some(reply) = number.and_then(|number: u64| waiting.all().remove(&number)) else { continue };
        let is_empty = message.status == Some(StatusCode::NO_RESPONDERS);
        let _ = reply.send(if is_empty { Err(NoResponders) } else { Ok(message.payload) });
    }
}

pub(crate) struct Membership {
    client: Client,
    requests: Subscriber,
    open: Arc<OpenRequests>,
    _cancels: AbortOnDrop,
}

/// Notifies cancelled requests. An unknown inbox belongs to another member, is forged, or belongs to a request that
/// is still to arrive.
async fn receive_cancels(mut cancels: Subscriber, open: Arc<OpenRequests>) {
    while let Some(message) = cancels.next().await {
        let Ok(inbox) = std::str::from_utf8(&message.payload) else { continue };
        open.cancel(inbox);
    }
}

impl Membership {
    /// Messages without a reply subject are not requests.
    pub(crate) async fn next(&mut self) -> Option<(Bytes, Reply)> {
        loop {
            let message = self.requests.next().await?;
            if let Some(to) = message.reply {
                let cancelled = self.open.received(&to);
                let (client, open) = (self.client.clone(), self.open.clone());
                return Some((message.payload, Reply { client, open, to, cancelled }));
            }
        }
    }

    pub(crate) async fn leave(&mut self) {
        // Fails only if the connection is closed, and the membership with it.
        let _ = self.requests.drain().await;
    }
}

/// Reply channel of a request.
pub(crate) struct Reply {
    client: Client,
    open: Arc<OpenRequests>,
    to: async_nats::Subject,
    cancelled: oneshot::Receiver<()>,
}

impl Drop for Reply {
    fn drop(&mut self) {
        self.open.ended(&self.to);
    }
}

impl Reply {
    pub(crate) async fn cancelled(&mut self) {
        if (&mut self.cancelled).await.is_err() {
            // The sender is gone, so no cancel message can arrive.
            std::future::pending::<()>().await;
        }
    }

    pub(crate) async fn send(self, payload: Bytes) -> Result<(), ClusterError> {
        let longest = self.client.server_info().max_payload;
        if payload.len() > longest {
            return Err(ClusterError::MessageTooLong { bytes: payload.len(), longest });
        }
        self.client.publish(self.to.clone(), payload).await.map_err(|_| ClusterError::BusClosed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn login_is_read_from_the_first_address_that_has_one() {
        let login = |text: &str| {
            let servers: Vec<ServerAddr> = text.split(',').map(|s| s.parse().expect("an address")).collect();
            Login::of(&servers).map(|login| login.map(|login| (login.user, login.password)))
        };
        assert!(matches!(login("nats://a:4222"), Ok(None)));
        let named = login("nats://a:4222,tls://worker-town:secret@b:4222,tls://other:word@c:4222");
        assert_eq!(named.expect("read"), Some(("worker-town".to_owned(), "secret".to_owned())));
        for wrong in [
            "nats://me:***@a",
            "nats://me@a",
            "nats://me.too:secret@a",
            "nats://m%2a:secret@a",
            "nats://me:se%63ret@a",
        ] {
            let error = login(wrong).expect_err(wrong).to_string();
            assert!(error.contains("NATS") && !error.contains("secret"), "{error}");
        }
    }

    #[test]
    fn passwords_are_not_printed() {
        for (address, shown) in [
            ("nats://user:secret@host:4222", "nats://host:4222"),
            ("secret@host", "host"),
            ("tls://host:4222", "tls://host:4222"),
        ] {
            assert_eq!(without_password(address), shown);
            let options = NatsOptions { servers: vec![address.to_owned()], ..NatsOptions::default() };
            assert!(!format!("{options:?}").contains("secret"));
        }
    }
}
