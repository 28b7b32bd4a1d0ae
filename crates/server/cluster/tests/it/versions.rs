//! Machines of the release before, and of later ones, in one cluster.

use super::common;

use std::time::Duration;

use common::service::truth;
use common::{
    MAP, PublishedMap, STEP_TIMEOUT, TestCluster, eventually, fake_member_of_versions, reply, subject_of,
    worker_options,
};
use tokio::sync::mpsc::unbounded_channel;
use veiloc_cluster::bus::Bus;
use veiloc_cluster::message::{RejectReason, Reply, ReplyOutcome, Request, Task};
use veiloc_cluster::{FrameVersions, VERSION};
use veiloc_service::{LocalizeFailure, NoPose};

fn versions(oldest: u32, newest: u32) -> FrameVersions {
    FrameVersions::new(oldest, newest).expect("a range")
}

fn members(state: &str) -> String {
    format!("veiloc_cluster_members{{map=\"{MAP}\",state=\"{state}\"}}")
}

#[tokio::test(flavor = "multi_thread")]
async fn worker_without_a_common_version_is_counted_and_not_asked() {
    for foreign in [versions(VERSION + 1, VERSION + 2), versions(VERSION - 1, VERSION - 1)] {
        let published = PublishedMap::new(10);
        let bus = Bus::in_process();
        let cluster = TestCluster::start_with(&published, bus.clone(), vec![]).await;
        let (asked, mut received) = unbounded_channel();
        let objects = [published.region(0), published.index()];
        let mut member = fake_member_of_versions(&bus, foreign, &objects, move |_| {
            asked.send(()).expect("the test receives");
            async {}
        })
        .await;
        eventually("it is noticed", || cluster.metric(&members("version")) == 1).await;
        assert_eq!((cluster.metric(&members("answering")), cluster.metric(&members("out"))), (0, 0));
        cluster.add(&published, "all").await;
        cluster.knows(1).await;
        for query in published.queries(6) {
            assert!(cluster.ask(&query).await.expect("a pose").trusted());
        }
        member.shutdown().await;
        received.try_recv().expect_err("it was asked");
    }
}

/// A worker of the next release speaks this version too, and is asked in it.
#[tokio::test(flavor = "multi_thread")]
async fn worker_of_a_neighbouring_release_is_asked_in_the_common_version() {
    for neighbour in [versions(VERSION, VERSION + 1), versions(VERSION - 1, VERSION)] {
        let published = PublishedMap::new(10);
        let bus = Bus::in_process();
        let cluster = TestCluster::start_with(&published, bus.clone(), vec![worker_options("999")]).await;
        let (asked, mut received) = unbounded_channel();
        let _member = fake_member_of_versions(&bus, neighbour, &[published.region(0)], move |incoming| {
            let request = Request::decode(incoming.payload.clone()).expect("a request");
            asked.send(request.version).expect("the test receives");
            let outcome = ReplyOutcome::Failed(LocalizeFailure::NoPose(NoPose::TooFew));
            async move { incoming.answer(reply(request.name, outcome)).await.expect("sent") }
        })
        .await;
        cluster.knows(2).await;
        cluster.ask(&published.query(&truth())).await.expect_err("no pose");
        assert_eq!(received.recv().await, Some(VERSION), "{neighbour}");
    }
}

/// A worker refuses requests of other versions; its gateway asks another one.
#[tokio::test(flavor = "multi_thread")]
async fn worker_refuses_requests_of_other_versions() {
    let published = PublishedMap::new(10);
    let cluster = TestCluster::start(&published, Bus::in_process(), &["all"]).await;
    let subject = subject_of(&cluster.handle().member());
    for version in [VERSION - 1, VERSION + 1] {
        let task = Task::Ping { owed: Vec::new() };
        let (object, within) = (published.region(0), Duration::from_secs(1));
        let request =
            Request { version, name: [1; 16], object, lane: None, rows: 0, within, span: None, task };
        let answer = cluster.bus.request(&subject, request.encode(), STEP_TIMEOUT).await.expect("a reply");
        // The name of a request that cannot be read is not known.
        let answer = Reply::decode(answer, &[0; 16]).expect("a reply in its own version");
        assert_eq!(answer.outcome, ReplyOutcome::Rejected(RejectReason::Undecodable));
    }
}
