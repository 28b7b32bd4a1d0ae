//! `veiloc map publish`, `fetch` and `versions`: regions in object storage.

use std::path::PathBuf;
use std::time::{Duration, SystemTime};

use serde::Serialize;
use veiloc_cluster::ClusterError;
use veiloc_cluster::object_store::{FetchSummary, PublishSummary, RemovalSummary, Storage, fetch_folder};
use veiloc_map::regions::{ObjectId, RegionFolder};
use veiloc_service::auth::Timestamp;

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::progress::Stage;
use crate::output::targets::OutFolder;
use crate::output::ui::Ui;

/// Publish the regions of a map to object storage, for services.
///
/// Uploads the objects, then the manifest, and last the pointer to the manifest: a reader sees either all new regions
/// or all old ones. Existing objects are not uploaded again, and nothing is removed.
#[derive(clap::Args)]
pub(crate) struct PublishArgs {
    /// The folder that `veiloc map split` wrote.
    folder: PathBuf,
    /// Destination: a path, file:///PATH, s3://BUCKET/PATH, gs://BUCKET/PATH or az://CONTAINER/PATH. Cloud storage
    /// needs the cargo feature `clouds`, and takes its credentials from the environment (AWS_…, GOOGLE_…, AZURE_…).
    url: String,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// Fetch and verify the regions of a published map.
///
/// Existing intact files are not fetched again. Services fetch regions themselves; this command is for inspection, and
/// for machines without access to the storage.
#[derive(clap::Args)]
pub(crate) struct FetchArgs {
    /// Source, as in `veiloc map publish`.
    url: String,
    /// Name of the map.
    map: String,
    /// The folder to write.
    #[arg(long, short, value_name = "DIR")]
    out: OutFolder,
    /// Id of the manifest. Default: the current one.
    #[arg(long, value_name = "SHA256")]
    manifest: Option<ObjectId>,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// List the published versions of a map, return to an older one, or remove old ones.
///
/// Every `veiloc map publish` of another content makes a version. Services take the current one within seconds.
#[derive(clap::Args)]
pub(crate) struct VersionsArgs {
    /// Storage, as in `veiloc map publish`.
    url: String,
    /// Name of the map.
    map: String,
    /// Make this version the current one again, after looking for all its objects. Default: the current one stays.
    #[arg(long, value_name = "SHA256")]
    restore: Option<ObjectId>,
    /// Remove the versions that were published longer ago, except the current one, and all objects that no version of
    /// any map needs any more. Do not publish at the same time. Default: nothing is removed.
    #[arg(long, value_name = "DAYS", value_parser = clap::value_parser!(u32).range(1..=36_500))]
    remove_older_than: Option<u32>,
    /// Print one JSON document to stdout.
    #[arg(long)]
    json: bool,
}

/// The published versions of a map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct VersionsDocument<'a> {
    /// 1.
    version: u32,
    /// Storage, as given.
    url: &'a str,
    /// Name of the map.
    map: &'a str,
    /// Number of versions that were removed by this call.
    versions_removed: usize,
    /// Number of objects that were removed by this call.
    objects_removed: usize,
    /// Their bytes.
    bytes_removed: u64,
    /// The versions, newest first.
    versions: Vec<VersionDocument>,
}

/// A published version of a map.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct VersionDocument {
    /// Id of its manifest.
    manifest: String,
    /// When it was published first, UTC.
    published: String,
    /// Number of its regions.
    regions: usize,
    /// Bytes of all its objects; versions share equal ones.
    bytes: u64,
    /// Whether it is the current one.
    current: bool,
}

/// The published objects.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct PublishedDocument<'a> {
    /// 1.
    version: u32,
    /// Destination, as given.
    url: &'a str,
    /// Name of the map.
    map: &'a str,
    /// Id of the manifest, which is now the current one.
    manifest: String,
    /// Number of uploaded objects.
    objects_sent: usize,
    /// Their bytes.
    bytes_sent: u64,
    /// Number of objects that existed already.
    objects_existing: usize,
    /// Their bytes.
    bytes_existing: u64,
}

/// The fetched objects.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct FetchedDocument<'a> {
    /// 1.
    version: u32,
    /// Source, as given.
    url: &'a str,
    /// Name of the map.
    map: &'a str,
    /// Id of the manifest.
    manifest: String,
    /// The written folder, as given.
    folder: String,
    /// Number of fetched objects.
    objects_fetched: usize,
    /// Their bytes.
    bytes_fetched: u64,
    /// Number of intact objects that existed already.
    objects_existing: usize,
    /// Their bytes.
    bytes_existing: u64,
}

pub(super) fn publish(args: &PublishArgs, ui: &Ui) -> Outcome {
    let folder = RegionFolder::open(&args.folder)?;
    let storage = Storage::create(&args.url)?;
    let stage = ui.stage("Publishing, MB", 0);
    let published = awaited(storage.publish(&folder, &watched(&stage)))?;
    stage.finish();
    let map = &folder.manifest().map;
    let PublishSummary { manifest, sent, sent_bytes, there, there_bytes, .. } = published;
    if args.json {
        ui.json(&PublishedDocument {
            version: 1,
            url: &args.url,
            map,
            manifest: manifest.to_string(),
            objects_sent: sent,
            bytes_sent: sent_bytes,
            objects_existing: there,
            bytes_existing: there_bytes,
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
    let FetchSummary { manifest, fetched, fetched_bytes, there, there_bytes, .. } = fetched;
    if args.json {
        ui.json(&FetchedDocument {
            version: 1,
            url: &args.url,
            map: &args.map,
            manifest: manifest.to_string(),
            folder: args.out.display().to_string(),
            objects_fetched: fetched,
            bytes_fetched: fetched_bytes,
            objects_existing: there,
            bytes_existing: there_bytes,
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

pub(super) fn versions(args: &VersionsArgs, ui: &Ui) -> Outcome {
    let storage = Storage::open(&args.url)?;
    let (removed, versions) = awaited(async {
        if let Some(id) = args.restore {
            storage.restore(&args.map, id).await?;
        }
        let removed = match args.remove_older_than {
            Some(days) => {
                let age = Duration::from_secs(u64::from(days) * 86_400);
                storage.remove_older(&args.map, age, SystemTime::now()).await?
            }
            None => RemovalSummary::default(),
        };
        Ok::<_, ClusterError>((removed, storage.versions(&args.map).await?))
    })?;
    let versions: Vec<VersionDocument> = versions
        .into_iter()
        .map(|version| VersionDocument {
            manifest: version.manifest.to_string(),
            published: Timestamp::of(version.published).to_string(),
            regions: version.regions,
            bytes: version.bytes,
            current: version.is_current,
        })
        .collect();
    if args.json {
        ui.json(&VersionsDocument {
            version: 1,
            url: &args.url,
            map: &args.map,
            versions_removed: removed.versions,
            objects_removed: removed.objects,
            bytes_removed: removed.bytes,
            versions,
        })?;
        return Ok(Exit::Success);
    }
    for version in versions {
        ui.print(format!(
            "{} {}  {}  {} regions, {:.1} MB\n",
            if version.current { "*" } else { " " },
            version.published,
            version.manifest,
            version.regions,
            version.bytes as f64 / 1e6,
        ));
    }
    if args.remove_older_than.is_some() {
        ui.info(format!(
            "Removed {} versions and {} objects, {:.1} MB.",
            removed.versions,
            removed.objects,
            removed.bytes as f64 / 1e6
        ));
    }
    Ok(Exit::Success)
}

/// Reports bytes as megabytes of a stage.
fn watched(stage: &Stage) -> impl Fn(u64, u64) + Send + Sync {
    |done, total| stage.set_position(done / 1_000_000, total.div_ceil(1_000_000))
}

fn awaited<T, E: Into<Failure>>(work: impl Future<Output = Result<T, E>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(work).map_err(Into::into)
}
