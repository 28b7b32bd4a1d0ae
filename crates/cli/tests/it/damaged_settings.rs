//! A damaged settings file is either refused, or read and printed consistently.
#![allow(missing_docs, unreachable_pub, dead_code, reason = "shared with fuzz/")]

#[path = "../../../../fuzz/src/damage.rs"]
mod damage;

use std::path::Path;

use clap::{Arg, ArgAction, Command, value_parser};
use veiloc_cli::args::settings::{Settings, layered};

/// A settings file for a command with every kind of option: if it is accepted, its printed form gives the same
/// settings. Whether it is accepted.
fn settings(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Some(settings) = merge(text) else { return false };
    let printed = settings.to_toml().expect("accepted settings are text");
    let again = merge(&printed).expect("printed settings can be read");
    let again = again.to_toml().expect("accepted settings are text");
    assert_eq!(values(&again), values(&printed), "{printed}");
    // No accepted value may look like another option on the command line.
    let line = std::iter::once("serve".into()).chain(settings.arguments());
    options().try_get_matches_from(line).expect("accepted settings give a valid command line");
    true
}

fn merge(text: &str) -> Option<Settings> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("veiloc.toml");
    std::fs::write(&path, text).expect("room in memory");
    let line = ["serve".into(), format!("--config={}", path.display())];
    let matches = layered(options()).try_get_matches_from(line).expect("a command line");
    Settings::of(&options(), &matches, &|_| None).ok()
}

/// Removes the origins from printed settings.
fn values(printed: &str) -> Vec<&str> {
    printed.lines().map(|line| line.split(" # ").next().unwrap_or_default()).collect()
}

fn options() -> Command {
    let option = |name: &'static str, value: &'static str| Arg::new(name).long(name).value_name(value);
    Command::new("serve")
        .arg(option("config", "FILE").value_parser(value_parser!(std::path::PathBuf)))
        .arg(option("queue", "N").value_parser(value_parser!(std::num::NonZeroUsize)).default_value("32"))
        .arg(option("rate", "N").value_parser(value_parser!(u32)))
        .arg(option("grace", "SECONDS").value_parser(value_parser!(f64)).default_value("30"))
        .arg(Arg::new("log-json").long("log-json").action(ArgAction::SetTrue))
        .arg(option("memory", "WHERE").value_parser(["copied", "mapped"]).default_value("copied"))
        .arg(option("maps", "DIR").value_parser(value_parser!(std::path::PathBuf)))
        .arg(option("map", "NAME=FILE").action(ArgAction::Append))
        .arg(
            option("listen", "ADDR:PORT|unix:PATH").action(ArgAction::Append).default_value("127.0.0.1:8080"),
        )
        .arg(option("hypotheses", "N").default_value("adaptive"))
}

#[test]
fn damaged_settings_are_refused_or_round_trip() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/args");
    damage::check(&damage::files(&folder, "toml"), 1000, settings);
}
