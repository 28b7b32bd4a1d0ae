//! How machines of a cluster find each other and what is published.

use std::path::PathBuf;
use std::sync::Arc;

use veiloc_cluster::bus::{Bus, NatsOptions};
use veiloc_cluster::{ClusterError, ObjectStoreSource};
use veiloc_map::is_map_name;

use crate::args::localization_args::positive;
use crate::exit::Failure;

/// The shortest longest message of a bus: what NATS takes when nobody says otherwise. Queries with large descriptors need
/// more, which the gateway says when it knows the map.
const NEEDED_PAYLOAD: usize = 1 << 20;

/// The way to the bus and to what is published, but for their addresses.
#[derive(clap::Args)]
pub(crate) struct ClusterArgs {
    /// Where maps are published: file:///PATH or a path, s3://BUCKET/PATH, gs:// or az://. Default: none, which goes
    /// without a cluster only.
    #[arg(long, value_name = "URL")]
    store: Option<String>,
    /// Folder for what was fetched from there. Default: veiloc in $XDG_CACHE_HOME or in .cache of your home.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
    /// How much that folder may hold, in gigabytes; what was used least recently goes.
    #[arg(long, default_value_t = 50.0, value_parser = positive, value_name = "GB")]
    cache_gb: f64,
    /// Certificates of the authorities that vouch for the NATS servers, PEM; with it TLS is spoken.
    #[arg(long, value_name = "FILE")]
    nats_ca: Option<PathBuf>,
    /// Credentials for NATS, as `nsc` writes them: which account this machine is of.
    #[arg(long, value_name = "FILE")]
    nats_credentials: Option<PathBuf>,
}

impl ClusterArgs {
    /// Where maps are published.
    pub(crate) fn source(&self) -> Result<Arc<ObjectStoreSource>, Failure> {
        let Some(store) = &self.store else {
            return Err(Failure::with_help(
                "a cluster needs the place where maps are published",
                "name it with --store, for example --store s3://bucket/maps",
            ));
        };
        let cache = self.cache.clone().or_else(own_cache).ok_or_else(|| {
            Failure::with_help("there is no folder for what is fetched", "name one with --cache")
        })?;
        let most_bytes = (self.cache_gb * 1e9) as u64;
        Ok(Arc::new(ObjectStoreSource::open(store, &cache, most_bytes)?))
    }

    /// Connects to the servers at these addresses, with commas between them.
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

/// A folder of the user's own: what lies in one that others may write into could be exchanged.
fn own_cache() -> Option<PathBuf> {
    let named = |name| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    named("XDG_CACHE_HOME")
        .or_else(|| named("HOME").map(|home| home.join(".cache")))
        .map(|cache| cache.join("veiloc"))
}

/// The name of a map, as a service serves it.
pub(crate) fn map_name(text: &str) -> Result<String, String> {
    if is_map_name(text) {
        Ok(text.to_owned())
    } else {
        Err("letters, digits, `-`, `_` and `.` are expected, at most 64".to_owned())
    }
}
