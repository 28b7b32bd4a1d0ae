//! What every bus promises, asked of each: the one within a process, and NATS with real servers.
//!
//! The tests of NATS start servers of their own and are ignored where there may be none; `.ci/run cluster` runs them:
//! `cargo test -p veiloc-cluster --test it bus::laws -- --include-ignored`.

use super::servers;

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use servers::Servers;
use veiloc_cluster::ClusterError;
use veiloc_cluster::bus::{Bus, NatsOptions, Subject};

const LONG: Duration = Duration::from_secs(60);

fn subject(word: &str) -> Subject {
    Subject::new(["test", word]).expect("a subject")
}

/// A member that answers with its own name and what it was asked.
async fn echo(bus: &Bus, subject: &Subject, name: &'static str) -> tokio::task::JoinHandle<()> {
    let mut membership = bus.join(subject).await.expect("joined");
    tokio::spawn(async move {
        while let Some(incoming) = membership.next().await {
            let outcome = [name.as_bytes(), b" ", &incoming.payload].concat();
            incoming.answer(outcome.into()).await.expect("sent");
        }
    })
}

async fn all_laws(bus: &Bus) {
    let one = subject("one");
    let nobody = bus.request(&one, "x".into(), LONG).await;
    assert!(matches!(nobody, Err(ClusterError::Nobody { subject }) if subject == one));

    // Each request goes to one member, and all members get some.
    let (first, second) = (echo(bus, &one, "a").await, echo(bus, &one, "b").await);
    let mut by_member: BTreeMap<u8, usize> = BTreeMap::new();
    // Whose turn it is may be chance, but not for ever.
    for i in 0.. {
        let text = i.to_string();
        let reply = bus.request(&one, text.clone().into(), LONG).await.expect("a reply");
        assert_eq!(&reply[2..], text.as_bytes());
        *by_member.entry(reply[0]).or_default() += 1;
        if by_member.len() == 2 && by_member.values().all(|n| *n > 20) {
            break;
        }
        assert!(i < 100_000, "{by_member:?}");
    }
    // Many at once do not mix.
    let at_once = (0..100).map(|i| {
        let (bus, one) = (bus.clone(), one.clone());
        tokio::spawn(async move {
            let text = format!("at once {i}");
            let reply = bus.request(&one, text.clone().into(), LONG).await.expect("a reply");
            assert_eq!(&reply[2..], text.as_bytes());
        })
    });
    for asked in at_once.collect::<Vec<_>>() {
        asked.await.expect("its own reply");
    }
    first.abort();
    second.abort();

    // Who leaves is given what it was asked before, and nothing after.
    let two = subject("two");
    let mut leaving = bus.join(&two).await.expect("joined");
    let asked = {
        let (bus, two) = (bus.clone(), two.clone());
        tokio::spawn(async move { bus.request(&two, "before".into(), LONG).await })
    };
    let incoming = leaving.next().await.expect("asked");
    leaving.leave().await;
    assert_eq!(&incoming.payload[..], b"before");
    incoming.answer("after all".into()).await.expect("sent");
    assert_eq!(asked.await.expect("it ends").expect("a reply"), Bytes::from_static(b"after all"));
    assert!(leaving.next().await.is_none());
    drop(leaving);
    let gone = bus.request(&two, "after".into(), LONG).await;
    assert!(matches!(gone, Err(ClusterError::Nobody { .. })), "{gone:?}");

    // A member that says nothing is nobody's answer; its late word goes to nobody else.
    let three = subject("three");
    let mut silent = bus.join(&three).await.expect("joined");
    let short = Duration::from_millis(50);
    // On a slow machine time may be over before the request is on its way.
    let incoming = loop {
        let timed_out = bus.request(&three, "x".into(), short).await;
        assert!(matches!(timed_out, Err(ClusterError::TimedOut { within, .. }) if within == short));
        if let Ok(incoming) = tokio::time::timeout(short, silent.next()).await {
            break incoming.expect("asked");
        }
    };
    incoming.answer("too late".into()).await.expect("sent");
    let member = tokio::spawn(async move {
        while let Some(incoming) = silent.next().await {
            incoming.answer("in time".into()).await.expect("sent");
        }
    });
    assert_eq!(bus.request(&three, "x".into(), LONG).await.expect("a reply"), Bytes::from_static(b"in time"));
    member.abort();

    // Who no longer waits says so, to the one who was asked and to nobody else; nobody else can say it for him.
    let five = subject("five");
    let mut members = [bus.join(&five).await.expect("joined"), bus.join(&five).await.expect("joined")];
    let ask = || {
        let (bus, five) = (bus.clone(), five.clone());
        tokio::spawn(async move { bus.request_cancellable(&five, "work".into(), LONG).await })
    };
    let (given_up, waited_for) = (ask(), ask());
    let mut asked = Vec::new();
    while asked.len() < 2 {
        let [one, other] = &mut members;
        let incoming =
            tokio::select! { incoming = one.next() => incoming, incoming = other.next() => incoming };
        asked.push(incoming.expect("asked"));
    }
    let said_by_others = Subject::new(["test", "five", "cancel"]).expect("a subject");
    for made_up in ["", "work", "_INBOX.0.1", "\u{0}"] {
        // Nobody answers, whoever hears it.
        assert!(bus.request(&said_by_others, made_up.into(), short).await.is_err());
    }
    for incoming in &mut asked {
        let told = tokio::time::timeout(short, incoming.cancelled()).await;
        assert!(told.is_err(), "both are waited for");
    }
    given_up.abort();
    let mut told = 0;
    let [first, second] = &mut asked[..] else { panic!("two were asked") };
    tokio::select! {
        () = first.cancelled() => told += 1,
        () = second.cancelled() => told += 2,
        () = tokio::time::sleep(LONG) => panic!("the one who works for nobody is not told"),
    }
    let still_waited_for = &mut asked[2 - told];
    assert!(tokio::time::timeout(short, still_waited_for.cancelled()).await.is_err(), "one of two gave up");
    asked.remove(2 - told).answer("done".into()).await.expect("sent");
    assert_eq!(waited_for.await.expect("it ends").expect("a reply"), Bytes::from_static(b"done"));
    asked.remove(0).answer("for nobody".into()).await.expect("sent");
    // Time that is over says it too.
    let [one, other] = &mut members;
    let mut incoming = loop {
        assert!(bus.request_cancellable(&five, "work".into(), short).await.is_err());
        tokio::select! {
            incoming = one.next() => break incoming.expect("asked"),
            incoming = other.next() => break incoming.expect("asked"),
            () = tokio::time::sleep(short) => {}
        }
    };
    tokio::time::timeout(LONG, incoming.cancelled()).await.expect("told");
    drop(members);

    // Messages of all lengths up to the longest, and none beyond.
    let four = subject("four");
    let member = echo(bus, &four, "c").await;
    let longest = bus.max_payload();
    for length in [0, 1, 4096, 1_000_000, longest - 2] {
        let message = Bytes::from(vec![7; length]);
        let reply = bus.request(&four, message.clone(), LONG).await.expect("a reply");
        assert!(reply[2..] == message, "{length} bytes");
    }
    let too_long = bus.request(&four, vec![0; longest + 1].into(), LONG).await;
    assert!(matches!(too_long, Err(ClusterError::MessageTooLong { bytes, .. }) if bytes == longest + 1));
    member.abort();
}

#[tokio::test(start_paused = true)]
async fn within_a_process_all_laws_hold() {
    all_laws(&Bus::in_process()).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn over_nats_all_laws_hold() {
    let servers = Servers::start(1, 8 << 20);
    all_laws(&Bus::nats(&servers.options()).await.expect("connected")).await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn messages_that_are_needed_must_fit() {
    let servers = Servers::start(1, 1 << 20);
    let options = NatsOptions { needed_payload: 4 << 20, ..servers.options() };
    let refused = Bus::nats(&options).await.expect_err("too small");
    assert!(
        matches!(refused, ClusterError::SmallPayload { longest: 1_048_576, needed: 4_194_304 }),
        "{refused}"
    );
    assert!(refused.to_string().contains("max_payload: 4194304"));
}

/// Clients of a server that dies go to another one of its cluster, and so do the members of a group.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "starts nats-server: run with --include-ignored where there is one"]
async fn a_server_may_die() {
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
        // The next one that dies may be the one it went to: as a cluster of three has it, one is always left.
        servers.restart(dies);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn who_cannot_be_reached_is_named_without_a_password() {
    let options = |server: &str| NatsOptions { servers: vec![server.to_owned()], ..NatsOptions::default() };
    let nobody =
        Bus::nats(&options("nats://me:secret@127.0.0.1:1")).await.expect_err("nobody there").to_string();
    assert!(nobody.contains("127.0.0.1:1") && !nobody.contains("secret"), "{nobody}");
    let wrong = Bus::nats(&options("nats://me:secret@:::")).await.expect_err("no address");
    assert!(!wrong.to_string().contains("secret"), "{wrong}");
    let no_file = NatsOptions { credentials: Some("/nowhere/file.creds".into()), ..options("127.0.0.1:1") };
    let no_file = Bus::nats(&no_file).await.expect_err("no file").to_string();
    assert!(no_file.contains("/nowhere/file.creds"), "{no_file}");
}
