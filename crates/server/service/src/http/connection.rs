//! One connection: HTTP/1.1 or HTTP/2, over TLS or plain, with a limit to every way of being slow.

use std::sync::Arc;
use std::time::Duration;

use crate::queue::{Guest, Place};
use crate::telemetry::ConnectionFault;
use hyper::body::{Body, Incoming};
use hyper::service::{Service, service_fn};
use hyper::{Request, Response};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::watch;

use crate::http::answering::Answering;
use crate::http::faults::fault_of;
use crate::http::heads::Heads;
use crate::http::patient::{Activity, Patient};
use crate::http::preface::Rewound;
use crate::http::protocol::{Protocol, Running, http1, http2};
use crate::http::stream::Peer;

/// How long the first bytes of a connection are waited for when the service stops.
const FIRST_BYTES: Duration = Duration::from_millis(100);

/// How long a connection may take, and be.
#[derive(Debug, Clone, Copy)]
pub struct Conduct {
    /// Head of a request, and pause between two requests.
    pub head: Duration,
    /// Reading of an answer, as long as nothing is taken; of HTTP/2 also the pause between two requests.
    pub write: Duration,
    /// All of it, as long as it brings no token.
    pub unknown_life: Duration,
    /// All of it.
    pub life: Duration,
    /// What is being answered when the connection has to end.
    pub last: Duration,
}

/// Whether the service is about to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ending {
    /// It is not.
    Serving,
    /// It says that it will: connections of HTTP/2 that are there are told to go elsewhere (GOAWAY), as `connection: close`
    /// tells those of HTTP/1.1.
    Leaving,
    /// What is being answered is finished.
    Closing,
}

/// Answers the requests of one connection until the client leaves, is too slow, has been there for too long, has to make
/// room for another, or `ending` says so. What is being answered then is finished, and the connection closed. Tells what went
/// wrong, if it did not end well.
///
/// Every request carries the connection's `Arc<Guest>` among its extensions.
pub async fn serve_connection<I, S, B>(
    stream: I,
    peer: Peer,
    protocol: Protocol,
    service: S,
    place: &Place,
    conduct: Conduct,
    mut ending: watch::Receiver<Ending>,
) -> Option<ConnectionFault>
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: Service<Request<Incoming>, Response = Response<B>> + Send + Sync + 'static,
    S::Error: Into<Fault> + Send,
    S::Future: Send + 'static,
    B: Body + Unpin + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    let guest = place.guest().clone();
    let activity = Activity::now();
    let stream = Patient::new(stream, conduct.write, guest.clone(), activity.clone());
    let mut stream = Rewound::fresh(stream);
    // What was already said when it came was said to others.
    let at_first = *ending.borrow();
    let is_http2 = match protocol {
        Protocol::Http1 => false,
        Protocol::Http2 => true,
        Protocol::Unknown => tokio::select! {
            biased;
            told = stream.is_http2() => match told {
                Ok(told) => told,
                Err(_) => return None,
            },
            () = guest.told_to_leave() => return None,
            () = guest.thrown_out() => return None,
            () = tokio::time::sleep(conduct.head) => return (!guest.is_idle()).then_some(ConnectionFault::HeadTimeout),
            // First bytes may be on their way.
            () = closing(ending.clone()) => return None,
        },
    };
    let mut connection = run(stream, is_http2, service, &guest, &activity, conduct);
    // An error here is a client that broke off or spoke no HTTP. It is counted by its kind; its text could hold what was
    // sent.
    let told_early = if is_http2 && at_first == Ending::Serving { Ending::Leaving } else { Ending::Closing };
    tokio::select! {
        biased;
        ended = connection.as_mut() => return fault_of(&guest, ended),
        () = guest.thrown_out() => return None,
        () = peer.left_while(|| guest.is_busy()) => return Some(ConnectionFault::Left),
        () = guest.told_to_leave() => {
            // Others wait for its place.
            if guest.is_idle() {
                return None;
            }
        }
        () = life(&guest, conduct) => {}
        () = quiet(&guest, &activity, conduct.write), if is_http2 => {}
        _ = ending.wait_for(|ending| *ending >= told_early) => {}
    }
    // One that is idle ends with that, but for one that never sent anything. Its first bytes may be on their way; they
    // are waited for a moment, and not until its time for a head is over.
    connection.as_mut().end();
    let first = async {
        tokio::time::sleep(FIRST_BYTES).await;
        // A connection of HTTP/2 is never without bytes: what counts is whether a request came.
        while is_http2 && !guest.can_go() {
            tokio::time::sleep(FIRST_BYTES).await;
        }
    };
    tokio::select! {
        biased;
        ended = connection.as_mut() => return fault_of(&guest, ended),
        () = guest.thrown_out() => return None,
        () = peer.left_while(|| guest.is_busy()) => return Some(ConnectionFault::Left),
        // Whoever takes back what it began, or begins ever more, is not waited for for ever.
        () = tokio::time::sleep(conduct.last) => return None,
        () = first => {}
    }
    if !is_http2 && !guest.is_idle() {
        tokio::select! {
            ended = connection => return fault_of(&guest, ended),
            () = guest.thrown_out() => {}
            () = peer.left_while(|| guest.is_busy()) => return Some(ConnectionFault::Left),
        }
    }
    None
}

/// Body errors as hyper wants them.
type Fault = Box<dyn std::error::Error + Send + Sync>;

/// The connection, nothing of it read yet.
fn run<I, S, B>(
    stream: Rewound<Patient<I>>,
    is_http2: bool,
    service: S,
    guest: &Arc<Guest>,
    activity: &Activity,
    conduct: Conduct,
) -> Running
where
    I: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    S: Service<Request<Incoming>, Response = Response<B>> + Send + Sync + 'static,
    S::Error: Into<Fault> + Send,
    S::Future: Send + 'static,
    B: Body + Unpin + Send + 'static,
    B::Data: Send,
    B::Error: Into<Fault>,
{
    let (guest, activity) = (guest.clone(), activity.clone());
    let heads = is_http2.then(|| Arc::new(Heads::default()));
    let service = service_fn(move |mut request: Request<Incoming>| {
        let answering = Answering::begin(guest.clone(), activity.clone());
        request.extensions_mut().insert(guest.clone());
        let heads = heads.clone();
        let answer = service.call(request);
        async move {
            let mut answer = answer.await?;
            if let Some(heads) = heads {
                heads.fill(&mut answer);
            }
            Ok::<_, S::Error>(answer.map(|body| answering.with_body(body)))
        }
    });
    if is_http2 { http2(stream, service) } else { http1(stream, service, conduct.head) }
}

/// Until the service takes no more, and a moment for what is on its way.
async fn closing(mut ending: watch::Receiver<Ending>) {
    let _ = ending.wait_for(|ending| *ending == Ending::Closing).await;
    tokio::time::sleep(FIRST_BYTES).await;
}

/// Until the connection has been there for as long as it may.
async fn life(guest: &Guest, conduct: Conduct) {
    let first = conduct.unknown_life.min(conduct.life);
    tokio::time::sleep(first).await;
    if guest.is_known() {
        tokio::time::sleep(conduct.life.saturating_sub(first)).await;
    }
}

/// Until nothing has been going on for so long. Of HTTP/1.1 hyper sees to it.
async fn quiet(guest: &Guest, activity: &Activity, patience: Duration) {
    loop {
        let until = activity.last() + patience;
        tokio::time::sleep_until(until).await;
        if !guest.is_busy() && activity.last() + patience <= tokio::time::Instant::now() {
            return;
        }
        // While it is busy nothing needs to move; there are other limits to that.
        if guest.is_busy() {
            tokio::time::sleep(FIRST_BYTES).await;
        }
    }
}
