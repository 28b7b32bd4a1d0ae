//! The guarantees of the bus, tested for each transport: within one process, and NATS with real servers.
//!
//! The NATS tests start their own servers and are ignored by default; `.ci/run cluster` runs them: `cargo test -p
//! veiloc-cluster --test it bus::laws -- --include-ignored`.

use super::servers;

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use servers::Servers;
use veiloc_cluster::ClusterError;
use veiloc_cluster::bus::{Bus, NatsOptions, Subject};

const STEP_TIMEOUT: Duration = Duration::from_secs(60);

fn subject(word: &str) -> Subject {
    Subject::new(["test", word]).expect("a subject")
}

/// A member that replies with its name and the payload.
async fn echo(bus: &Bus, subject: &Subject, name: &'static str) -> tokio::task::JoinHandle<()> {
    let mut membership = bus.join(subject).await.expect("joined");
    tokio::spawn(async move {
        while let Some(incoming) = membership.next().await {
            let outcome = [name.as_bytes(), b" ", &incoming.payload].concat();
            incoming.answer(outcome.into()).await.expect("sent");
        }
    })
}

async fn check_guarantees(bus: &Bus) {
    let one = subject("one");
    let empty_group = bus.request(&one, "x".into(), STEP_TIMEOUT).await;
    assert!(matches!(empty_group, Err(ClusterError::NoResponders { subject }) if subject == one));

    // Each request goes to one member, and all members get some.
    let (first, second) = (echo(bus, &one, "a").await, echo(bus, &one, "b").await);
    let mut by_member: BTreeMap<u8, usize> = BTreeMap::new();
    // The choice of the member may be random, but must reach all.
    for i in 0.. {
        let text = i.to_string();
        let reply = bus.request(&one, text.clone().into(), STEP_TIMEOUT).await.expect("a reply");
        assert_eq!(&reply[2..], text.as_bytes());
        *by_member.entry(reply[0]).or_default() += 1;
        if by_member.len() == 2 && by_member.values().all(|n| *n > 20) {
            break;
        }
        assert!(i < 100_000, "{by_member:?}");
    }
    // Concurrent replies are not mixed up.
    let at_once = (0..100).map(|i| {
        let (bus, one) = (bus.clone(), one.clone());
        tokio::spawn(async move {
            let text = format!("at once {i}");
            let reply = bus.request(&one, text.clone().into(), STEP_TIMEOUT).await.expect("a reply");
            assert_eq!(&reply[2..], text.as_bytes());
        })
    });
    for received in at_once.collect::<Vec<_>>() {
        received.await.expect("its own reply");
    }
    first.abort();
    second.abort();

    // A leaving member gets earlier requests and no later ones.
    let two = subject("two");
    let mut leaving = bus.join(&two).await.expect("joined");
    let received = {
        let (bus, two) = (bus.clone(), two.clone());
        tokio::spawn(async move { bus.request(&two, "before".into(), STEP_TIMEOUT).await })
    };
    let incoming = leaving.next().await.expect("a request");
    leaving.leave().await;
    assert_eq!(&incoming.payload[..], b"before");
    incoming.answer("after all".into()).await.expect("sent");
    assert_eq!(received.await.expect("it ends").expect("a reply"), Bytes::from_static(b"after all"));
    assert!(leaving.next().await.is_none());
    drop(leaving);
    let gone = bus.request(&two, "after".into(), STEP_TIMEOUT).await;
    assert!(matches!(gone, Err(ClusterError::NoResponders { .. })), "{gone:?}");

    // A silent member gives a timeout; its late reply reaches no other request.
    let three = subject("three");
    let mut silent = bus.join(&three).await.expect("joined");
    let short = Duration::from_millis(50);
    // On a slow machine the timeout may pass before the request is sent.
    let incoming = loop {
        let timed_out = bus.request(&three, "x".into(), short).await;
        assert!(matches!(timed_out, Err(ClusterError::TimedOut { within, .. }) if within == short));
        if let Ok(incoming) = tokio::time::timeout(short, silent.next()).await {
            break incoming.expect("a request");
        }
    };
    incoming.answer("too late".into()).await.expect("sent");
    let member = tokio::spawn(async move {
        while let Some(incoming) = silent.next().await {
            incoming.answer("in time".into()).await.expect("sent");
        }
    });
    assert_eq!(
        bus.request(&three, "x".into(), STEP_TIMEOUT).await.expect("a reply"),
        Bytes::from_static(b"in time")
    );
    member.abort();

    // A cancellation reaches the member that received the request and no other; a third party cannot cancel it.
    let five = subject("five");
    let mut members = [bus.join(&five).await.expect("joined"), bus.join(&five).await.expect("joined")];
    let ask = || {
        let (bus, five) = (bus.clone(), five.clone());
        tokio::spawn(async move { bus.request_cancellable(&five, "work".into(), STEP_TIMEOUT).await })
    };
    let (abandoned, awaited) = (ask(), ask());
    let mut received = Vec::new();
    while received.len() < 2 {
        let [one, other] = &mut members;
        let incoming =
            tokio::select! { incoming = one.next() => incoming, incoming = other.next() => incoming };
        received.push(incoming.expect("a request"));
    }
    let cancel_subject = Subject::new(["test", "five", "cancel"]).expect("a subject");
    for forged in ["", "work", "_INBOX.0.1", "\u{0}"] {
        // No member replies to cancel messages.
        assert!(bus.request(&cancel_subject, forged.into(), short).await.is_err());
    }
    for incoming in &mut received {
        let cancelled = tokio::time::timeout(short, incoming.cancelled()).await;
        assert!(cancelled.is_err(), "both requests are awaited");
    }
    abandoned.abort();
    let mut cancelled = 0;
    let [first, second] = &mut received[..] else { panic!("two were received") };
    tokio::select! {
        () = first.cancelled() => cancelled += 1,
        () = second.cancelled() => cancelled += 2,
        () = tokio::time::sleep(STEP_TIMEOUT) => panic!("the cancelled member was not notified"),
    }
    let still_awaited = &mut received[2 - cancelled];
    assert!(tokio::time::timeout(short, still_awaited.cancelled()).await.is_err(), "only one was cancelled");
    received.remove(2 - cancelled).answer("done".into()).await.expect("sent");
    assert_eq!(awaited.await.expect("it ends").expect("a reply"), Bytes::from_static(b"done"));
    received.remove(0).answer("unused".into()).await.expect("sent");
    // A timeout also cancels.
    let [one, other] = &mut members;
    let mut incoming = loop {
        assert!(bus.request_cancellable(&five, "work".into(), short).await.is_err());
        tokio::select! {
            incoming = one.next() => break incoming.expect("a request"),
            incoming = other.next() => break incoming.expect("a request"),
            () = tokio::time::sleep(short) => {}
        }
    };
    tokio::time::timeout(STEP_TIMEOUT, incoming.cancelled()).await.expect("cancelled");
    drop(members);

    // Messages of all lengths up to the maximum, and none beyond.
    let four = subject("four");
    let member = echo(bus, &four, "c").await;
    let longest = bus.max_payload();
    for length in [0, 1, 4096, 1_000_000, longest - 2] {
        let message = Bytes::from(vec![7; length]);
        let reply = bus.request(&four, message.clone(), STEP_TIMEOUT).await.expect("a reply");
        assert!(reply[2..] == message, "{length} bytes");
    }
    let too_long = bus.request(&four, vec![0; longest + 1].into(), STEP_TIMEOUT).await;
    assert!(matches!(too_long, Err(ClusterError::MessageTooLong { bytes, .. }) if bytes == longest + 1));
    member.abort();
}

#[tokio::test(start_paused = true)]
async fn in_process_bus_keeps_guarantees() {
    check_guarantees(&Bus::in_process()).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn nats_bus_keeps_guarantees() {
    let servers = Servers::start(1, 8 << 20);
    check_guarantees(&Bus::nats(&servers.options()).await.expect("connected")).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn needed_payload_must_fit() {
    let servers = Servers::start(1, 1 << 20);
    let options = NatsOptions { needed_payload: 4 << 20, ..servers.options() };
    let refused = Bus::nats(&options).await.expect_err("too small");
    assert!(
        matches!(refused, ClusterError::SmallPayload { longest: 1_048_576, needed: 4_194_304 }),
        "{refused}"
    );
    assert!(refused.to_string().contains("max_payload: 4194304"));
}

/// When a server dies, clients and members reconnect to another one of its cluster.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn clients_survive_the_death_of_a_server() {
    let mut servers = Servers::start(3, 8 << 20);
    let asking = Bus::nats(&servers.options()).await.expect("connected");
    let answering = Bus::nats(&servers.options()).await.expect("connected");
    let subject = subject("survivors");
    let _member = echo(&answering, &subject, "d").await;
    for dies in [0, 1] {
        servers.kill(dies);
        let mut replies = 0;
        for _ in 0..600 {
            let reply = asking.request(&subject, "still there?".into(), Duration::from_secs(1)).await;
            replies += usize::from(reply.is_ok());
            if replies == 20 {
                break;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(replies, 20, "after server {dies} died");
        // The clients may be on the next server that dies; in a cluster of three, one is always left.
        servers.restart(dies);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn unreachable_servers_are_named_without_password() {
    let options = |server: &str| NatsOptions { servers: vec![server.to_owned()], ..NatsOptions::default() };
    let empty_group =
        Bus::nats(&options("nats://me:secret@127.0.0.1:1")).await.expect_err("no server").to_string();
    assert!(empty_group.contains("127.0.0.1:1") && !empty_group.contains("secret"), "{empty_group}");
    let wrong = Bus::nats(&options("nats://me:secret@:::")).await.expect_err("no address");
    assert!(!wrong.to_string().contains("secret"), "{wrong}");
    let no_file = NatsOptions { credentials: Some("/nowhere/file.creds".into()), ..options("127.0.0.1:1") };
    let no_file = Bus::nats(&no_file).await.expect_err("no file").to_string();
    assert!(no_file.contains("/nowhere/file.creds"), "{no_file}");
}
