//! `veiloc map publish` and `veiloc map fetch`: regions to object storage, and back.

use std::path::PathBuf;

use serde::Serialize;
use veiloc_cluster::object_store::{Fetched, Published, Storage, fetch_folder};
use veiloc_map::regions::{Folder, ObjectId};

use crate::exit::{Exit, Failure, Outcome};
use crate::output::progress::Stage;
use crate::ui::Ui;

/// Publish the regions of a map, so that services take them.
///
/// Objects go first, then the manifest, last the pointer that names it: whoever reads finds the new regions, all of them, or
/// the old ones. Objects that are there already are not sent again, and nothing is removed.
#[derive(clap::Args)]
pub(crate) struct PublishArgs {
    /// The folder that `veiloc map split` wrote.
    folder: PathBuf,
    /// Where to: a path, file:///PATH, s3://BUCKET/PATH, gs://BUCKET/PATH or az://CONTAINER/PATH. Those of clouds take the
    /// cargo feature `clouds`, and their credentials from the environment (AWS_…, GOOGLE_…, AZURE_…).
    url: String,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// Fetch the regions of a map that was published into a folder, verified.
///
/// Files that are there already and sound are not fetched again. Services fetch by themselves; this is for looking at what
/// was published, and for machines that reach no storage.
#[derive(clap::Args)]
pub(crate) struct FetchArgs {
    /// Where from, as of `veiloc map publish`.
    url: String,
    /// Name of the map.
    map: String,
    /// The folder to write.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Id of the manifest. Default: the current one.
    #[arg(long, value_name = "SHA256")]
    manifest: Option<ObjectId>,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// What was published.
#[derive(Serialize)]
struct PublishedDocument<'a> {
    version: u32,
    url: &'a str,
    map: &'a str,
    manifest: String,
    objects_sent: usize,
    bytes_sent: u64,
    objects_there: usize,
    bytes_there: u64,
}

/// What was fetched.
#[derive(Serialize)]
struct FetchedDocument<'a> {
    version: u32,
    url: &'a str,
    map: &'a str,
    manifest: String,
    folder: String,
    objects_fetched: usize,
    bytes_fetched: u64,
    objects_there: usize,
    bytes_there: u64,
}

pub(super) fn publish(args: &PublishArgs, ui: &Ui) -> Outcome {
    let folder = Folder::open(&args.folder)?;
    let storage = Storage::create(&args.url)?;
    let stage = ui.stage("Publishing, MB", 0);
    let published = awaited(storage.publish(&folder, &watched(&stage)))?;
    stage.finish();
    let map = &folder.manifest().map;
    let Published { manifest, sent, sent_bytes, there, there_bytes, .. } = published;
    if args.json {
        ui.json(&PublishedDocument {
            version: 1,
            url: &args.url,
            map,
            manifest: manifest.to_string(),
            objects_sent: sent,
            bytes_sent: sent_bytes,
            objects_there: there,
            bytes_there: there_bytes,
        })?;
    } else {
        ui.print(format!(
            "{}: {map} is now manifest {manifest}\n  sent        {sent} objects, {:.1} MB\n  there       {there} objects, {:.1} MB\n",
            args.url,
            sent_bytes as f64 / 1e6,
            there_bytes as f64 / 1e6,
        ));
    }
    Ok(Exit::Success)
}

pub(super) fn fetch(args: &FetchArgs, ui: &Ui) -> Outcome {
    let storage = Storage::open(&args.url)?;
    let stage = ui.stage("Fetching, MB", 0);
    let fetched = awaited(async {
        let id = match args.manifest {
            Some(id) => id,
            None => storage.current(&args.map).await?,
        };
        fetch_folder(&storage, &args.map, id, &args.out, &watched(&stage)).await
    })?;
    stage.finish();
    let Fetched { manifest, fetched, fetched_bytes, there, there_bytes, .. } = fetched;
    if args.json {
        ui.json(&FetchedDocument {
            version: 1,
            url: &args.url,
            map: &args.map,
            manifest: manifest.to_string(),
            folder: args.out.display().to_string(),
            objects_fetched: fetched,
            bytes_fetched: fetched_bytes,
            objects_there: there,
            bytes_there: there_bytes,
        })?;
    } else {
        ui.print(format!(
            "{}: {} of manifest {manifest}\n  fetched     {fetched} objects, {:.1} MB\n  there       {there} objects, {:.1} MB\n",
            args.out.display(),
            args.map,
            fetched_bytes as f64 / 1e6,
            there_bytes as f64 / 1e6,
        ));
    }
    Ok(Exit::Success)
}

/// Bytes as megabytes of a stage.
fn watched(stage: &Stage) -> impl Fn(u64, u64) + Send + Sync {
    |done, total| stage.reach(done / 1_000_000, total.div_ceil(1_000_000))
}

fn awaited<T, E: Into<Failure>>(work: impl Future<Output = Result<T, E>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(work).map_err(Into::into)
}
