//! The bus over NATS: groups are queue groups, replies come back to an inbox of the connection's own.
//!
//! The inbox is ours and not the library's: the library keeps a note of each request until its reply comes, and of those
//! whose member died none ever does.
//!
//! A cancel message is published on the group's subject with the suffix `.cancel`, to which all members subscribe, because the
//! gateway does not know which member received the request. It carries the reply inbox of the request. Only the gateway and the
//! worker that received the request know this inbox, so a third party that may publish there cannot cancel anything.

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
use crate::bus::open::Open;
use crate::bus::subject::Subject;

/// All members of a subject are in the queue group of this name.
const GROUP: &str = "members";

/// Cancel messages that wait to be published; further ones are dropped.
const UNSAID: usize = 1024;

/// How to reach NATS.
#[derive(Clone, Default)]
pub struct NatsOptions {
    /// Addresses of its servers, `nats://HOST:PORT` or `tls://HOST:PORT`; one is enough to find the others. A user and a password
    /// may stand before the host, `tls://USER:PASSWORD@HOST:PORT`; those of the first address that has them count. Replies
    /// then come to subjects that begin with `_INBOX_USER`, which the servers may let this user alone hear.
    pub servers: Vec<String>,
    /// Certificates of the authorities that vouch for the servers, PEM. With it TLS is spoken, whatever the address says.
    pub ca: Option<PathBuf>,
    /// A file of credentials (`nsc` writes it): which account we are of.
    pub credentials: Option<PathBuf>,
    /// What the connection is called in the server's own reports.
    pub name: String,
    /// Messages must be able to have so many bytes.
    pub needed_payload: usize,
}

impl NatsOptions {
    fn connect_options(&self) -> ConnectOptions {
        let options = ConnectOptions::new()
            .name(&self.name)
            .connection_timeout(Duration::from_secs(5))
            // One that is cut off from its server without a word finds out after two of these.
            .ping_interval(Duration::from_secs(5))
            .reconnect_delay_callback(|attempts| match attempts {
                0 | 1 => Duration::ZERO,
                n => Duration::from_millis(50 * n.min(20) as u64),
            })
            .event_callback(|event| async move {
                match event {
                    Event::Connected => tracing::info!("connected to the bus"),
                    Event::Disconnected => {
                        tracing::warn!("the bus is gone; looking for another server of it");
                    }
                    Event::SlowConsumer(_) => tracing::warn!("the bus brings more than is taken"),
                    // What servers say may hold subjects, and nothing of a message.
                    other => tracing::warn!("the bus: {other}"),
                }
            });
        match &self.ca {
            Some(ca) => options.add_root_certificates(ca.clone()).require_tls(true),
            None => options,
        }
    }
}

/// Passwords may stand in addresses.
impl fmt::Debug for NatsOptions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let servers: Vec<String> = self.servers.iter().map(|server| without_password(server)).collect();
        f.debug_struct("NatsOptions").field("servers", &servers).field("ca", &self.ca).finish_non_exhaustive()
    }
}

/// What stands before an `@` is nobody's.
fn without_password(address: &str) -> String {
    let (scheme, rest) = address.split_once("://").map_or((None, address), |(s, rest)| (Some(s), rest));
    let host = rest.rsplit_once('@').map_or(rest, |(_, host)| host);
    scheme.map_or_else(|| host.to_owned(), |scheme| format!("{scheme}://{host}"))
}

/// What is printed where a password stands.
const MASK: &str = "***";

/// Who we are to the servers.
struct Login {
    user: String,
    password: String,
}

impl Login {
    /// That of the first address which names one: the library does not look there.
    fn of(servers: &[ServerAddr]) -> Result<Option<Self>, ClusterError> {
        let named = servers.iter().find_map(|server| Some((server.username()?, server.password())));
        let Some((user, password)) = named else { return Ok(None) };
        let Some(password) = password else {
            return Err(ClusterError::Login { reason: "the password is missing" });
        };
        // A user is part of a subject, and escapes in addresses are not read.
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
        if user.is_empty() || !user.chars().all(is_plain) {
            return Err(ClusterError::Login {
                reason: "its user has other characters than letters, digits, _ and -",
            });
        }
        if password.contains('%') {
            return Err(ClusterError::Login { reason: "its password has an escape (%), which is not read" });
        }
        if password == MASK {
            return Err(ClusterError::Login {
                reason: "the password is the `***` that --print-config prints in place of one; write the real one there",
            });
        }
        Ok(Some(Self { user: user.to_owned(), password: password.to_owned() }))
    }
}

/// A connection.
#[derive(Clone)]
pub(crate) struct Nats(Arc<Connection>);

struct Connection {
    client: Client,
    /// Replies come to this subject and the number of the request.
    inbox: String,
    next: AtomicU64,
    waiting: Arc<Waiting>,
    cancels: mpsc::Sender<Cancel>,
    _tasks: [Aborted; 2],
}

/// A cancel message to publish: the subject, and the inbox that needs no reply any more.
type Cancel = (String, String);

type Replied = Result<Bytes, Nobody>;

/// Who waits for a reply, by the number of the request.
#[derive(Default)]
struct Waiting(Mutex<HashMap<u64, oneshot::Sender<Replied>>>);

/// The server says that nobody is in the group.
struct Nobody;

impl Waiting {
    fn all(&self) -> MutexGuard<'_, HashMap<u64, oneshot::Sender<Replied>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A task that ends with its owner.
struct Aborted(tokio::task::JoinHandle<()>);

impl Drop for Aborted {
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
        let waiting = Arc::new(Waiting::default());
        let replies = Aborted(tokio::spawn(hand_out(replies, waiting.clone())));
        let (cancels, unsaid) = mpsc::channel(UNSAID);
        let tasks = [replies, Aborted(tokio::spawn(say_cancels(client.clone(), unsaid)))];
        let next = AtomicU64::new(0);
        Ok(Self(Arc::new(Connection { client, inbox, next, waiting, cancels, _tasks: tasks })))
    }

    /// Another server may take other lengths than the first.
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
        let _forgotten = Forgotten { connection, number, cancel };
        let sent = connection.client.publish_with_reply(subject.as_str().to_owned(), to, payload).await;
        sent.map_err(|_| ClusterError::BusClosed)?;
        match answer.await {
            Ok(Ok(bytes)) => Ok(bytes),
            Ok(Err(Nobody)) => Err(ClusterError::Nobody { subject: subject.clone() }),
            Err(_) => Err(ClusterError::BusClosed),
        }
    }

    pub(crate) async fn join(&self, subject: &Subject) -> Result<Membership, ClusterError> {
        let client = self.0.client.clone();
        let joined = client.queue_subscribe(subject.as_str().to_owned(), GROUP.to_owned()).await;
        let asked = joined.map_err(|_| ClusterError::BusClosed)?;
        let cancels = client.subscribe(subject.of_cancels()).await.map_err(|_| ClusterError::BusClosed)?;
        let open = Arc::new(Open::default());
        let cancels = Aborted(tokio::spawn(hear_cancels(cancels, open.clone())));
        // The NATS server has the subscription before the membership is announced.
        client.flush().await.map_err(|_| ClusterError::BusClosed)?;
        Ok(Membership { client, asked, open, _cancels: cancels })
    }
}

/// Removes a waiting request, and publishes a cancel message if it was not answered and may be cancelled.
struct Forgotten<'a> {
    connection: &'a Connection,
    number: u64,
    cancel: Option<Cancel>,
}

impl Drop for Forgotten<'_> {
    fn drop(&mut self) {
        let unanswered = self.connection.waiting.all().remove(&self.number).is_some();
        if let Some(cancel) = self.cancel.take().filter(|_| unanswered) {
            // Where too much is unsaid the member works in vain, as it would without all this.
            let _ = self.connection.cancels.try_send(cancel);
        }
    }
}

/// Says what is no longer waited for, as long as the connection lives.
async fn say_cancels(client: Client, mut unsaid: mpsc::Receiver<Cancel>) {
    while let Some((subject, inbox)) = unsaid.recv().await {
        if client.publish(subject, inbox.into()).await.is_err() {
            return;
        }
    }
}

/// Gives replies to those who wait. One that nobody waits for is late, or nobody's.
async fn hand_out(mut replies: Subscriber, waiting: Arc<Waiting>) {
    while let Some(message) = replies.next().await {
        let number = message.subject.rsplit_once('.').and_then(|(_, number)| number.parse().ok());
        let Some(reply) = number.and_then(|number: u64| waiting.all().remove(&number)) else { continue };
        let nobody = message.status == Some(StatusCode::NO_RESPONDERS);
        let _ = reply.send(if nobody { Err(Nobody) } else { Ok(message.payload) });
    }
}

pub(crate) struct Membership {
    client: Client,
    asked: Subscriber,
    open: Arc<Open>,
    _cancels: Aborted,
}

/// Tells those who work for nobody. What names no inbox that we have is another member's, made up, or a question's that
/// is still to come.
async fn hear_cancels(mut cancels: Subscriber, open: Arc<Open>) {
    while let Some(message) = cancels.next().await {
        let Ok(inbox) = std::str::from_utf8(&message.payload) else { continue };
        open.not_waited_for(inbox);
    }
}

impl Membership {
    /// What comes without a way back was not asked.
    pub(crate) async fn next(&mut self) -> Option<(Bytes, Reply)> {
        loop {
            let message = self.asked.next().await?;
            if let Some(to) = message.reply {
                let cancelled = self.open.asked(&to);
                let (client, open) = (self.client.clone(), self.open.clone());
                return Some((message.payload, Reply { client, open, to, cancelled }));
            }
        }
    }

    pub(crate) async fn leave(&mut self) {
        // Fails only when the connection is gone, and the membership with it.
        let _ = self.asked.drain().await;
    }
}

/// The way back.
pub(crate) struct Reply {
    client: Client,
    open: Arc<Open>,
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
            // Nobody can say it any more.
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
    fn a_user_and_a_password_are_those_of_the_first_address_that_names_them() {
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
    fn passwords_are_not_repeated() {
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
