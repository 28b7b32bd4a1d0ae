//! Tests every option of `serve` in a file and in the environment.

use std::collections::BTreeMap;
use std::ffi::OsString;

use crate::args::settings::{SettingOrigin, Settings, is_setting, layered, variable};
use clap::FromArgMatches as _;

use super::*;
use crate::commands::with_config;

fn serve_command() -> clap::Command {
    with_config::full_command::<Args>("serve")
}

/// A value for each option, other than its default, in TOML and in the environment.
const VALUES: &[(&str, &str, &str)] = &[
    ("map", "[\"a=/a.vmap\", \"b=/b.vmap\"]", "a=/a.vmap;b=/b.vmap"),
    ("maps", "\"/maps\"", "/maps"),
    ("geo-reference", "[\"a=47.3,8.5,455\", \"b=-1,-2,3,90\"]", "a=47.3,8.5,455;b=-1,-2,3,90"),
    ("packs", "true", "true"),
    ("map-memory", "\"mapped\"", "mapped"),
    #[cfg(feature = "cluster")]
    ("store", "\"s3://bucket/maps\"", "s3://bucket/maps"),
    #[cfg(feature = "cluster")]
    ("cache", "\"/cache\"", "/cache"),
    #[cfg(feature = "cluster")]
    ("cache-gb", "7.5", "7.5"),
    #[cfg(feature = "cluster")]
    ("workers", "[\"http://a:8080\", \"https://b\"]", "http://a:8080;https://b"),
    #[cfg(feature = "cluster")]
    ("published", "[\"town\"]", "town"),
    #[cfg(feature = "cluster")]
    ("worker-token", "\"/gateway.token\"", "/gateway.token"),
    #[cfg(feature = "cluster")]
    ("worker-ca", "\"/workers.pem\"", "/workers.pem"),
    #[cfg(feature = "cluster")]
    ("regions", "2", "2"),
    ("listen", "[\"127.0.0.1:9000\", \"unix:/v.sock\"]", "127.0.0.1:9000;unix:/v.sock"),
    ("socket-mode", "\"600\"", "600"),
    ("admin-listen", "\"127.0.0.1:9001\"", "127.0.0.1:9001"),
    ("cert", "\"/c.pem\"", "/c.pem"),
    ("key", "\"/k.pem\"", "/k.pem"),
    ("client-ca", "\"/ca.pem\"", "/ca.pem"),
    ("insecure-http", "true", "true"),
    ("cors-origin", "[\"https://app.example\"]", "https://app.example"),
    ("tokens", "\"/tokens\"", "/tokens"),
    ("tokens-max-stale", "7", "7"),
    ("allow-anonymous", "true", "true"),
    ("rate", "7", "7"),
    ("burst", "8", "8"),
    ("threads", "3", "3"),
    ("queue", "9", "9"),
    ("connections", "10", "10"),
    ("connections-per-address", "11", "11"),
    ("reserved-connections", "4", "4"),
    ("unauthenticated-max-age", "12.5", "12.5"),
    ("connection-max-age", "13", "13"),
    ("request-timeout", "14", "14"),
    ("answer-quantum", "0.75", "0.75"),
    ("body-timeout", "16", "16"),
    ("drain-delay", "0", "0"),
    ("grace", "17", "17"),
    ("watch", "18", "18"),
    ("page", "true", "true"),
    ("page-folder", "\"/page\"", "/page"),
    ("page-points", "21", "21"),
    ("log", "\"debug\"", "debug"),
    ("log-json", "true", "1"),
    ("otlp", "\"http://127.0.0.1:4318\"", "http://127.0.0.1:4318"),
];

fn merge(line: &[OsString], variables: &BTreeMap<String, String>) -> Settings {
    let first = layered(serve_command()).try_get_matches_from(line).expect("flags");
    Settings::of(&serve_command(), &first, &|name| variables.get(name).map(OsString::from)).expect("settings")
}

/// Removes the origins from printed settings.
fn values(settings: &Settings) -> Vec<String> {
    let printed = settings.to_toml().expect("text");
    printed.lines().map(|line| line.split(" # ").next().expect("a part").to_owned()).collect()
}

#[test]
fn every_option_round_trips_through_file_and_environment() {
    let options: Vec<String> = serve_command()
        .get_arguments()
        .filter(|argument| is_setting(argument))
        .map(|argument| argument.get_long().expect("a flag").to_owned())
        .collect();
    let known: Vec<&str> = VALUES.iter().map(|(key, _, _)| *key).collect();
    assert_eq!(options, known, "an option without a test value, or a test value without an option");

    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("veiloc.toml");
    let line = ["serve".into(), format!("--config={}", path.display()).into()];
    let lines: Vec<String> = VALUES.iter().map(|(key, value, _)| format!("{key} = {value}")).collect();
    std::fs::write(&path, lines.join("\n")).expect("written");
    let by_file = merge(&line, &BTreeMap::new());
    for (i, (key, origin)) in by_file.origins().enumerate() {
        assert_eq!(*origin, SettingOrigin::File { path: path.clone(), line: i + 1 }, "{key}");
    }

    let variables: BTreeMap<String, String> =
        VALUES.iter().map(|(key, _, value)| (variable(key), (*value).to_owned())).collect();
    let by_variables = merge(&line[..1], &variables);
    for (key, origin) in by_variables.origins() {
        assert_eq!(*origin, SettingOrigin::Variable(variable(key)), "{key}");
    }
    assert_eq!(values(&by_file), values(&by_variables));
    let by_default = merge(&line[..1], &BTreeMap::new());
    for ((theirs, ours), (key, _, _)) in values(&by_default).iter().zip(values(&by_file)).zip(VALUES) {
        assert_ne!(*theirs, ours, "{key}: the test value is the default");
    }

    // Printed settings can be read again: all options, and none.
    for settings in [&by_file, &by_default] {
        std::fs::write(&path, settings.to_toml().expect("text")).expect("written");
        assert_eq!(values(&merge(&line, &BTreeMap::new())), values(settings));
    }
}

#[test]
fn environment_sets_server_options() {
    let variables = [("VEILOC_MAP", "a=/a.vmap"), ("VEILOC_QUEUE", "9"), ("VEILOC_LOG_JSON", "true")];
    let variables = variables.iter().map(|(k, v)| ((*k).to_owned(), (*v).to_owned())).collect();
    let settings = merge(&["serve".into(), "--log-json=false".into(), "--grace=3".into()], &variables);
    let line = std::iter::once("serve".into()).chain(settings.arguments());
    let matches = serve_command().try_get_matches_from(line).expect("complete");
    let args = Args::from_arg_matches(&matches).expect("complete");
    assert_eq!((args.queue.get(), args.log.log_json, args.grace), (9, false, 3.0));
    let Ok(options) = options(&args) else { panic!("no options") };
    assert_eq!(options.maps[0].name, "a");
}
