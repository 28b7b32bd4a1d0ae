//! What cargo knows about the workspace: asked once, read by every check.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// A package of the workspace or a dependency, as `cargo metadata` tells it.
pub(crate) struct Package {
    pub(crate) value: Value,
    pub(crate) is_ours: bool,
}

impl Package {
    /// A field that is a string, or nothing.
    pub(crate) fn text(&self, field: &str) -> &str {
        self.value[field].as_str().unwrap_or_default()
    }

    /// Name and version, for messages.
    pub(crate) fn title(&self) -> String {
        format!("{} {}", self.text("name"), self.text("version"))
    }

    /// The room's name, for a package `veiloc-*` in `crates/`.
    pub(crate) fn room(&self) -> Option<&str> {
        let folder = Path::new(self.text("manifest_path")).parent()?;
        let is_in_crates = folder.parent()?.file_name()? == "crates";
        let name = self.text("name");
        (self.is_ours && is_in_crates).then(|| name.strip_prefix("veiloc-").unwrap_or(name))
    }

    /// Names of the packages it depends on, with the kind of each dependency.
    pub(crate) fn dependencies(&self) -> impl Iterator<Item = &Value> {
        self.value["dependencies"].as_array().into_iter().flatten()
    }
}

/// All packages, and the folder of the workspace.
pub(crate) struct Workspace {
    pub(crate) root: PathBuf,
    pub(crate) packages: Vec<Package>,
}

impl Workspace {
    /// Asks cargo, with every feature on: what no feature brings in is no dependency.
    pub(crate) fn ask(root: &Path) -> Result<Self, String> {
        let metadata = cargo(root, &["metadata", "--format-version", "1", "--all-features", "--locked"])?;
        let metadata: Value =
            serde_json::from_slice(&metadata).map_err(|e| format!("cargo metadata: {e}"))?;
        let built = built(root)?;
        let members = metadata["workspace_members"].as_array().cloned().unwrap_or_default();
        let packages: Vec<Package> = (metadata["packages"].as_array().cloned().unwrap_or_default())
            .into_iter()
            .map(|value| Package { is_ours: members.contains(&value["id"]), value })
            .filter(|p| p.is_ours || built.contains(&p.title()))
            .collect();
        if !packages.iter().any(|p| p.room().is_some()) {
            return Err("cargo metadata names no room at all".to_owned());
        }
        Ok(Self { root: root.to_owned(), packages })
    }

    /// The packages of this repository.
    pub(crate) fn ours(&self) -> impl Iterator<Item = &Package> {
        self.packages.iter().filter(|p| p.is_ours)
    }
}

/// Name and version of everything that some build takes in: the lock file, and with it `cargo metadata`, also names what
/// only features of others would bring in that nobody turns on.
fn built(root: &Path) -> Result<BTreeSet<String>, String> {
    let tree = cargo(
        root,
        &[
            "tree",
            "--workspace",
            "--all-features",
            "--target",
            "all",
            "--edges",
            "normal,build,dev",
            "--prefix",
            "none",
            "--locked",
        ],
    )?;
    let line = |line: &str| {
        let mut words = line.split_whitespace();
        Some(format!("{} {}", words.next()?, words.next()?.strip_prefix('v')?))
    };
    Ok(String::from_utf8_lossy(&tree).lines().filter_map(line).collect())
}

fn cargo(root: &Path, arguments: &[&str]) -> Result<Vec<u8>, String> {
    let name = arguments[0];
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .current_dir(root)
        .output()
        .map_err(|e| format!("cargo {name}: {e}"))?;
    if !output.status.success() {
        return Err(format!("cargo {name}: {}", String::from_utf8_lossy(&output.stderr)));
    }
    Ok(output.stdout)
}
