//! Maps of an object store: regions that a worker serves, and maps for which a gateway asks workers.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use veiloc_cluster::{Gateway, GatewayOptions, PublishedMaps, StoredRegions, WorkerAccess, Workers};
use veiloc_map::is_map_name;
use veiloc_service::telemetry::{GatewayCounts, RegionCounts};
use veiloc_service::{Regions, RemoteMap, ServerOptions};

use crate::args::localization_args::positive;
use crate::commands::user_folder::user_cache;
use crate::output::exit::Failure;

/// The store, and what to do with its maps.
#[derive(clap::Args)]
pub(crate) struct StoreArgs {
    /// Object store of published maps: file:///PATH or a path, s3://BUCKET/PATH, gs:// or az://. Every region of its maps is
    /// served to gateways (`/v1/maps/NAME/regions/REGION/localize`), or with --workers its maps to devices. Default: none.
    #[arg(long, value_name = "URL")]
    store: Option<String>,
    /// Folder for what is read from the store. Default: veiloc in $XDG_CACHE_HOME or in .cache of your home folder.
    #[arg(long, requires = "store", value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Maximum size of that folder, and of the open regions, in gigabytes; the least recently used go.
    #[arg(long, default_value_t = 50.0, value_parser = positive, value_name = "GB")]
    cache_gb: f64,
    /// Addresses of workers, separated by commas: services with the same --store that compute the poses. A host name with several
    /// addresses stands for several workers. Default: none.
    #[arg(long, value_delimiter = ',', requires_all = ["store", "published"], value_name = "URL[,URL]")]
    workers: Vec<String>,
    /// A published map that is served by asking workers; may be given several times. Default: none.
    #[arg(long, requires = "workers", value_parser = map_name, value_name = "NAME")]
    published: Vec<String>,
    /// File with the token for the workers, of `veiloc token new --gateway`. Default: none.
    #[arg(long, requires = "workers", value_name = "FILE")]
    worker_token: Option<PathBuf>,
    /// CA certificates of the workers, PEM. Default: those of the system.
    #[arg(long, requires = "workers", value_name = "FILE")]
    worker_ca: Option<PathBuf>,
    /// Maximum number of regions per query, with --workers.
    #[arg(long, default_value = "3", value_name = "N")]
    regions: NonZeroUsize,
}

impl StoreArgs {
    /// Whether the service is a worker.
    pub(crate) const fn serves_regions(&self) -> bool {
        self.store.is_some() && self.workers.is_empty()
    }

    /// Adds the regions or maps of the store.
    pub(crate) async fn add_to(
        &self,
        mut options: ServerOptions,
        watch: Duration,
    ) -> Result<ServerOptions, Failure> {
        let Some(store) = &self.store else { return Ok(options) };
        let cache = self.cache.clone().or_else(user_cache).ok_or_else(|| {
            Failure::with_help(
                "there is no cache folder for what is read from the store",
                "give one with --cache",
            )
        })?;
        let published = PublishedMaps::open(store, &cache, (self.cache_gb * 1e9) as u64)?;
        if self.serves_regions() {
            let counts = RegionCounts::default();
            let source = Arc::new(StoredRegions::start(published, watch, counts.clone()));
            options.regions = Some(Regions { source, counts });
            return Ok(options);
        }
        let mut access = WorkerAccess::new(self.workers.clone());
        access.token = self.worker_token.as_ref().map(read_token).transpose()?;
        access.ca.clone_from(&self.worker_ca);
        let counts = GatewayCounts::default();
        let workers = Workers::start(&access, counts.clone()).await?;
        for name in &self.published {
            let mut gateway = GatewayOptions::new(name);
            (gateway.regions, gateway.watch) = (self.regions.get(), watch);
            let gateway = Gateway::start(published.clone(), workers.clone(), gateway, counts.clone()).await?;
            options.remote_maps.push(RemoteMap { name: name.clone(), backend: Arc::new(gateway) });
        }
        options.gateway = Some(counts);
        Ok(options)
    }
}

fn read_token(path: &PathBuf) -> Result<String, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|error| Failure::refused(format!("--worker-token {}: {error}", path.display())))?;
    Ok(text.trim().to_owned())
}

/// Parses the name under which a service serves a map.
fn map_name(text: &str) -> Result<String, String> {
    if is_map_name(text) {
        Ok(text.to_owned())
    } else {
        Err("letters, digits, `-`, `_` and `.` are expected, at most 64".to_owned())
    }
}
