//! Addresses and credentials of a cluster: the bus and the object store.

use std::path::PathBuf;
use std::sync::Arc;

use veiloc_cluster::bus::{Bus, NatsOptions};
use veiloc_cluster::{ClusterError, ObjectStoreSource};
use veiloc_map::is_map_name;

use crate::args::localization_args::positive;
use crate::output::exit::Failure;

/// Smallest message size limit that a bus must have, which is the default of NATS. Queries with large descriptors need
/// more; the gateway reports this when it knows the map.
const NEEDED_PAYLOAD: usize = 1 << 20;

/// Access to the bus and to the object store, without their addresses.
#[derive(clap::Args)]
pub(crate) struct ClusterArgs {
    /// Object store of the published maps: file:///PATH or a path, s3://BUCKET/PATH, gs:// or az://. Default: none,
    /// which is only possible without a cluster.
    #[arg(long, value_name = "URL")]
    store: Option<String>,
    /// Folder for fetched objects. Default: veiloc in $XDG_CACHE_HOME or in .cache of your home folder.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// Maximum size of that folder in gigabytes; the least recently used objects are removed.
    #[arg(long, default_value_t = 50.0, value_parser = positive, value_name = "GB")]
    cache_gb: f64,
    /// CA certificates for the NATS servers, PEM; enables TLS.
    #[arg(long, value_name = "FILE")]
    nats_ca: Option<PathBuf>,
    /// Credentials file for NATS, as written by `nsc`; it selects the account of this machine.
    #[arg(long, value_name = "FILE")]
    nats_credentials: Option<PathBuf>,
}

impl ClusterArgs {
    /// Opens the object store.
    pub(crate) fn source(&self) -> Result<Arc<ObjectStoreSource>, Failure> {
        let Some(store) = &self.store else {
            return Err(Failure::with_help(
                "a cluster needs the address of the published maps",
                "give it with --store, for example --store s3://bucket/maps",
            ));
        };
        let cache = self.cache.clone().or_else(own_cache).ok_or_else(|| {
            Failure::with_help("there is no cache folder for fetched objects", "give one with --cache")
        })?;
        let max_bytes = (self.cache_gb * 1e9) as u64;
        Ok(Arc::new(ObjectStoreSource::open(store, &cache, max_bytes)?))
    }

    /// Connects to the servers at these comma-separated addresses.
    pub(crate) async fn bus(&self, servers: &str, name: &str) -> Result<Bus, ClusterError> {
        let options = NatsOptions {
            servers: servers.split(',').map(|server| server.trim().to_owned()).collect(),
            ca: self.nats_ca.clone(),
            credentials: self.nats_credentials.clone(),
            name: name.to_owned(),
            needed_payload: NEEDED_PAYLOAD,
        };
        Bus::nats(&options).await
    }
}

/// A folder that only the user can write to: other users could replace objects in a shared folder.
fn own_cache() -> Option<PathBuf> {
    let named = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    named("XDG_CACHE_HOME")
        .or_else(|| named("HOME").map(|home| home.join(".cache")))
        .map(|cache| cache.join("veiloc"))
}

/// Parses the name under which a service serves a map.
pub(crate) fn map_name(text: &str) -> Result<String, String> {
    if is_map_name(text) {
        Ok(text.to_owned())
    } else {
        Err("letters, digits, `-`, `_` and `.` are expected, at most 64".to_owned())
    }
}
