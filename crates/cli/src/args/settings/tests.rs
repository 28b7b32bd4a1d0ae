//! Layers of settings, tested on a command with every kind of flag.

use std::collections::BTreeMap;

use clap::{Args as _, FromArgMatches as _, ValueEnum};

use super::*;

#[derive(Debug, Clone, PartialEq, clap::Args)]
struct Sample {
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    #[arg(long, default_value_t = 32, value_name = "N")]
    queue: u32,
    /// Threads. Default: one per core.
    #[arg(long, value_name = "N")]
    workers: Option<u32>,
    #[arg(long, default_value_t = 2.0, value_name = "SECONDS")]
    drain_delay: f64,
    #[arg(long)]
    log_json: bool,
    #[arg(long, default_value = "here", value_name = "WHERE")]
    memory: Memory,
    #[arg(long = "map", required_unless_present = "folder", value_name = "NAME=FILE")]
    maps: Vec<String>,
    #[arg(long = "maps", value_name = "DIR")]
    folder: Option<PathBuf>,
    #[arg(long, requires = "key", value_name = "FILE")]
    cert: Option<PathBuf>,
    #[arg(long, requires = "cert", value_name = "FILE")]
    key: Option<PathBuf>,
    #[arg(long, value_name = "ADDR:PORT|unix:PATH")]
    listen: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum Memory {
    Here,
    There,
}

fn command() -> Command {
    Sample::augment_args(Command::new("serve"))
}

fn merge(flags: &[&str], variables: &[(&str, &str)], text: Option<&str>) -> Result<Settings, SettingsError> {
    let folder = tempfile::tempdir().expect("folder");
    let mut line = vec!["serve".to_owned()];
    if let Some(text) = text {
        let path = folder.path().join("veiloc.toml");
        std::fs::write(&path, text).expect("written");
        line.push(format!("--config={}", path.display()));
    }
    line.extend(flags.iter().map(|flag| (*flag).to_owned()));
    let matches = layered(command()).try_get_matches_from(line).expect("flags");
    let variables: BTreeMap<&str, &str> = variables.iter().copied().collect();
    Settings::of(&command(), &matches, &|name| variables.get(name).map(OsString::from))
}

fn sample(settings: &Settings) -> Result<Sample, clap::Error> {
    let line = std::iter::once("serve".into()).chain(settings.arguments());
    Sample::from_arg_matches(&command().try_get_matches_from(line)?)
}

#[test]
fn later_layers_override_and_switches_turn_off() {
    let file = "queue = 8\ndrain-delay = 1\nlog-json = true\nmap = [\"a=x.vmap\", \"b=/y.vmap\"]\n";
    let of = |flags: &[&str], variables: &[(&str, &str)]| {
        sample(&merge(flags, variables, Some(file)).expect("settings")).expect("complete")
    };
    let plain = of(&[], &[]);
    assert_eq!((plain.queue, plain.drain_delay, plain.log_json), (8, 1.0, true));
    assert!(plain.maps[0].starts_with("a=/") && plain.maps[0].ends_with("/x.vmap"), "{plain:?}");
    assert_eq!(plain.maps[1], "b=/y.vmap");
    let variables = [("VEILOC_QUEUE", "9"), ("VEILOC_LOG_JSON", "0"), ("VEILOC_MAP", "c=z; d=w ;")];
    let other = of(&[], &variables);
    assert_eq!((other.queue, other.log_json, other.maps), (9, false, vec!["c=z".into(), "d=w".into()]));
    let last = of(&["--queue=10", "--log-json", "--map", "e=v", "--memory", "there"], &variables);
    assert_eq!((last.queue, last.log_json, last.maps), (10, true, vec!["e=v".to_owned()]));
    assert_eq!(last.memory, Memory::There);
    assert!(!of(&["--log-json=false"], &[]).log_json);
    assert_eq!(of(&[], &[("VEILOC_QUEUE", "")]).queue, 8, "an empty variable counts as absent");
}

/// Arguments that depend on each other may come from different layers; the command's own parser checks the result.
#[test]
fn dependent_arguments_may_come_from_different_layers() {
    let settings = merge(&["--key=k"], &[], Some("cert = \"c\"\nmaps = \"m\"")).expect("settings");
    let both = sample(&settings).expect("complete");
    assert!(both.cert.is_some_and(|cert| cert.is_absolute()));
    assert_eq!(both.key.as_deref(), Some(Path::new("k")), "a flag's path is relative to the working folder");
    let alone = merge(&[], &[], Some("cert = \"c\"\nmaps = \"m\"")).expect("settings");
    assert!(sample(&alone).expect_err("no key").to_string().contains("--key"));
    assert!(
        sample(&merge(&[], &[], None).expect("settings")).expect_err("no map").to_string().contains("--map")
    );
}

#[test]
fn errors_name_line_and_remedy() {
    for (text, parts) in [
        ("queue = ", &["line 1", "TOML"][..]),
        ("\nqueue = 1\nqueue = 2", &["line 3"]),
        ("# x\nquue = 1", &["line 2", "\"quue\"", "veiloc serve --help"]),
        ("drain_delay = 1", &["line 1", "did you mean `drain-delay`?"]),
        ("[serve]\nqueue = 1", &["line 1", "\"serve\""]),
        ("config = \"other\"", &["\"config\""]),
        ("queue = \"8\"", &["line 1: queue has a text, and needs a whole number"]),
        ("queue = 8.0", &["a number with a point"]),
        ("queue = [8]", &["a list"]),
        ("queue = -1", &["line 1: queue has an invalid value"]),
        ("queue = 99999999999", &["line 1: queue has an invalid value"]),
        ("workers = 1979-05-27", &["a date"]),
        ("log-json = 1", &["`true` or `false`"]),
        ("maps = true", &["a text in quotation marks"]),
        ("map = [1]", &["a list of texts"]),
        ("map = [\"a\", [\"b\"]]", &["a list of texts"]),
        ("memory = \"nowhere\"", &["one of here, there is expected"]),
        ("[queue]\nx = 1", &["a section"]),
    ] {
        let error = merge(&[], &[], Some(text)).expect_err(text).to_string();
        for part in parts.iter().chain(&["veiloc.toml"]) {
            assert!(error.contains(part), "{text}: {error}");
        }
    }
    let hidden =
        merge(&["--queue=1"], &[("VEILOC_QUEUE", "2")], Some("queue = -1")).expect_err("a wrong file");
    assert!(hidden.to_string().contains("line 1: queue has an invalid value"), "{hidden}");
    let error = merge(&[], &[("VEILOC_QUEUE", "many")], None).expect_err("no number").to_string();
    assert!(error.contains("VEILOC_QUEUE: queue has an invalid value: invalid digit"), "{error}");
    let error = merge(&[], &[("VEILOC_LOG_JSON", "yes")], None).expect_err("no switch").to_string();
    assert!(error.contains("`true` or `false`"), "{error}");
    let error = merge(&[], &[("VEILOC_CONFIG", "/none/veiloc.toml")], None).expect_err("no file").to_string();
    assert!(error.contains("/none/veiloc.toml") && error.contains("--config"), "{error}");
}

#[test]
fn printed_settings_round_trip() {
    let odd = "say \"\\\" and\ttab\u{7f}";
    let flags =
        ["--map", "a=x y.vmap", "--map", &format!("b={odd}"), "--listen", "unix:s.sock", "--queue=+7"];
    let settings = merge(&flags, &[("VEILOC_DRAIN_DELAY", "1e-7")], Some("workers = 0x10\nlog-json = true"))
        .expect("settings");
    let printed = settings.to_toml().expect("text");
    for part in [
        "queue = 7 # --queue\n",
        "drain-delay = 1e-7 # VEILOC_DRAIN_DELAY\n",
        "workers = 16 # /",
        "veiloc.toml, line 1\n",
        "memory = \"here\" # default\n",
        "# cert is not given: none\n",
    ] {
        assert!(printed.contains(part), "{part}: {printed}");
    }
    let again = merge(&[], &[], Some(&printed)).expect("settings");
    let values = |text: &str| -> Vec<String> {
        text.lines().map(|line| line.split(" # ").next().expect("a part").to_owned()).collect()
    };
    assert_eq!(values(&again.to_toml().expect("text")), values(&printed));
    let [first, second] = [&settings, &again].map(|settings| sample(settings).expect("complete"));
    assert!(second.maps[1].ends_with(odd) && second.listen[0].ends_with("/s.sock"), "{second:?}");
    assert_eq!(
        (first.queue, first.workers, first.drain_delay),
        (second.queue, second.workers, second.drain_delay)
    );
    assert!(
        merge(&[], &[], None)
            .expect("settings")
            .to_toml()
            .expect("text")
            .contains("# workers is not given: one per core\n")
    );
}
