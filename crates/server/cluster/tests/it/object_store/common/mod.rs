//! A small map, cut into regions, and storage with faults.
#![allow(dead_code, unreachable_pub, reason = "a module of each test program, which takes what it needs")]

use std::fmt;
use std::future::Future;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::StreamExt as _;
use futures_util::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path as Location;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, GetResultPayload, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use veiloc_cluster::object_store::Storage;
use veiloc_map::MapFile;
use veiloc_map::regions::{FolderWriter, RegionFolder, SplitOptions, cut};

/// Regions of a map of two rooms with this many images each, in a folder.
pub fn regions(images: u32, folder: &Path) -> RegionFolder {
    let map = MapFile::of_model(&veiloc_testing::rooms(2, images)).expect("a map");
    let regions = cut(&map, &SplitOptions::default().with_images(6)).expect("regions");
    let writer = FolderWriter::begin(&map, "rooms", folder).expect("a folder");
    let entries = regions.iter().map(|region| writer.region(region).expect("a region")).collect();
    writer.finish(&regions, entries).expect("a manifest");
    RegionFolder::open(folder).expect("what was written")
}

/// Runs a future with a paused clock, which jumps to the next timer when idle, so that pauses take no time.
pub fn run<T>(work: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().start_paused(true).build();
    runtime.expect("a runtime").block_on(work)
}

pub fn no_progress(_: u64, _: u64) {}

/// Faults of storage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StorageFault {
    None,
    /// The first reads and writes fail.
    First(usize),
    /// All writes after this number fail.
    WritesAfter(usize),
    /// Reads never end.
    Endless,
    /// Reads never return data.
    Stalls,
}

/// Storage in memory, with a fault.
#[derive(Debug)]
pub struct FaultyStore {
    pub inner: Arc<InMemory>,
    fault: StorageFault,
    requests: AtomicUsize,
}

impl fmt::Display for FaultyStore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Faulty({:?})", self.fault)
    }
}

/// Storage over this memory with a fault.
pub fn storage(inner: &Arc<InMemory>, fault: StorageFault) -> Storage {
    let store = FaultyStore { inner: inner.clone(), fault, requests: AtomicUsize::new(0) };
    Storage::of(Arc::new(store), Location::from("maps"), "memory://maps").with_retry_policy(
        3,
        Duration::from_millis(500),
        Duration::from_secs(60),
    )
}

impl FaultyStore {
    fn check_fault(&self, is_write: bool) -> Result<()> {
        let requests = self
            .requests
            .fetch_add(usize::from(is_write || self.fault != StorageFault::None), Ordering::SeqCst);
        let fails = match self.fault {
            StorageFault::First(count) => requests < count,
            StorageFault::WritesAfter(count) => is_write && requests >= count,
            _ => false,
        };
        let failed = || Error::Generic { store: "faulty", source: "it broke".into() };
        if fails { Err(failed()) } else { Ok(()) }
    }
}

#[async_trait]
impl ObjectStore for FaultyStore {
    async fn put_opts(
        &self,
        location: &Location,
        payload: PutPayload,
        opts: PutOptions,
    ) -> Result<PutResult> {
        self.check_fault(true)?;
        self.inner.put_opts(location, payload, opts).await
    }

    async fn put_multipart_opts(
        &self,
        location: &Location,
        opts: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        self.check_fault(true)?;
        self.inner.put_multipart_opts(location, opts).await
    }

    async fn get_opts(&self, location: &Location, options: GetOptions) -> Result<GetResult> {
        let is_head = options.head;
        if let StorageFault::First(_) = self.fault {
            self.check_fault(false)?;
        }
        let there = self.inner.get_opts(location, options).await?;
        if is_head {
            return Ok(there);
        }
        let payload = match self.fault {
            StorageFault::Endless => {
                let piece = Bytes::from(vec![7; 1 << 16]);
                GetResultPayload::Stream(futures_util::stream::repeat_with(move || Ok(piece.clone())).boxed())
            }
            StorageFault::Stalls => GetResultPayload::Stream(futures_util::stream::pending().boxed()),
            _ => return Ok(there),
        };
        Ok(GetResult { payload, ..there })
    }

    async fn get_ranges(&self, location: &Location, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        self.inner.get_ranges(location, ranges).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, Result<Location>>,
    ) -> BoxStream<'static, Result<Location>> {
        self.inner.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Location>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.inner.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Location>) -> Result<ListResult> {
        self.inner.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, from: &Location, to: &Location, options: CopyOptions) -> Result<()> {
        self.inner.copy_opts(from, to, options).await
    }
}
