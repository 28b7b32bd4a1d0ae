//! Profiles kept on disk: one file a map of a service. The hash of its bytes is its version, as the service names it.

use std::path::{Path, PathBuf};

use sha2::{Digest as _, Sha256};
use veiloc_query::Profile;

use super::client::{Client, Fetched};
use crate::exit::Failure;
use crate::files;
use crate::ui::Ui;

/// The folder.
pub(super) struct ProfileCache {
    folder: Option<PathBuf>,
}

impl ProfileCache {
    /// The folder given, or the user's: `$XDG_CACHE_HOME/veiloc`, or `~/.cache/veiloc`. Without any nothing is kept.
    pub(super) fn new(given: Option<&Path>) -> Self {
        let absolute =
            |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
        let user = || absolute("XDG_CACHE_HOME").or_else(|| Some(absolute("HOME")?.join(".cache")));
        let folder = given.map(Path::to_owned).or_else(|| Some(user()?.join("veiloc")));
        Self { folder: folder.map(|folder| folder.join("profiles")) }
    }

    /// The current profile of a map: the kept one when the service says that it still is.
    pub(super) fn profile(
        &self,
        client: &Client<'_>,
        server: &str,
        map: &str,
        ui: &Ui,
    ) -> Result<Profile, Failure> {
        let file = self.folder.as_ref().map(|folder| folder.join(file_name(server, map)));
        // A kept file that cannot be read, or is damaged, is as good as none.
        let kept = file.as_ref().and_then(|file| std::fs::read(file).ok());
        let kept = kept.and_then(|bytes| Some((hash(&bytes), Profile::decode(&bytes).ok()?)));
        match client.profile(map, kept.as_ref().map(|(hash, _)| hash.as_str()))? {
            Fetched::Unchanged => {
                let kept = kept.map(|(_, profile)| profile);
                kept.ok_or_else(|| {
                    Failure::refused("the service confirmed a profile that was not asked about")
                })
            }
            Fetched::New(bytes) => {
                let profile = Profile::decode(&bytes)?;
                if let Some(file) = file {
                    keep(&file, &bytes, ui);
                }
                Ok(profile)
            }
        }
    }
}

/// A profile that cannot be kept is fetched again next time: no reason to give up.
fn keep(file: &Path, bytes: &[u8], ui: &Ui) {
    let folder = file.parent().unwrap_or(Path::new("."));
    if files::make_folder(folder).and_then(|()| files::write(file, bytes)).is_err() {
        ui.say(format!("{}: the profile could not be kept there", file.display()));
    }
}

/// Names of services and maps may hold anything, the name of a file may not.
fn file_name(server: &str, map: &str) -> String {
    let digits = hash(format!("{}\n{map}", server.trim_end_matches('/')).as_bytes());
    format!("{}.vprofile", &digits[..32])
}

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |text, byte| text + &format!("{byte:02x}"))
}
