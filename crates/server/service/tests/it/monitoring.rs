//! The dashboard and the alerts of `deploy/` use only existing metrics; every alert has a test and a section of the
//! runbook, and every section has an alert.

use super::common;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use common::{Files, OPERATOR, PHONE, Running, data, truth};
use veiloc_map::regions::ObjectId;
use veiloc_service::telemetry::{GatewayCounts, RegionCounts};
use veiloc_service::{LogQueue, RegionFuture, RegionSource, Regions, TlsFiles};

/// A file of the repository.
fn repository(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(path);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn alerts() -> Vec<String> {
    let text = repository("deploy/prometheus/alerts.yml");
    text.lines().filter_map(|line| line.trim().strip_prefix("- alert: ")).map(str::to_owned).collect()
}

/// A metric in a query, with the label values of its selector; several values where any will do.
#[derive(Debug)]
struct MetricSelector {
    name: String,
    labels: Vec<(String, Vec<String>)>,
}

/// All metrics in a text: words with our prefixes, and their selectors.
fn metrics_in(text: &str) -> Vec<MetricSelector> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let mut all = Vec::new();
    for (at, _) in text.match_indices("veiloc_").chain(text.match_indices("process_")) {
        if text[..at].ends_with(is_word) {
            continue;
        }
        let rest = &text[at..];
        let name = &rest[..rest.find(|c| !is_word(c)).unwrap_or(rest.len())];
        let mut labels = Vec::new();
        if let Some(selector) = rest[name.len()..].strip_prefix('{') {
            let mut selector = selector;
            while let Some((label, rest)) = selector.split_once('"') {
                let (value, rest) = rest.split_once('"').expect("a value ends");
                let equal = label.ends_with('=') || label.ends_with("=~");
                let label = label.trim_matches(|c: char| !is_word(c)).to_owned();
                if equal && !value.contains('$') && !value.contains('*') && !value.contains("..") {
                    labels.push((label, value.split('|').map(str::to_owned).collect()));
                }
                if rest.starts_with('}') {
                    break;
                }
                selector = rest;
            }
        }
        all.push(MetricSelector { name: name.to_owned(), labels });
    }
    all
}

/// All exported series: for each name all labels with all their values.
fn exported(text: &str) -> BTreeMap<String, BTreeMap<String, BTreeSet<String>>> {
    let mut all: BTreeMap<String, BTreeMap<String, BTreeSet<String>>> = BTreeMap::new();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(['{', ' ']).next().unwrap_or_default();
        let labels = all.entry(name.to_owned()).or_default();
        let Some((_, series)) = line.split_once('{') else { continue };
        for (label, rest) in
            series.split("\",").filter_map(|part| part.trim_start_matches(',').split_once("=\""))
        {
            let value = rest.split('"').next().unwrap_or_default();
            labels.entry(label.to_owned()).or_default().insert(value.to_owned());
        }
    }
    all
}

#[test]
fn selectors_and_series_are_parsed() {
    let selectors =
        metrics_in(r#"rate(veiloc_a_total{job="$job", kind="x", b=~"y|z"}[5m]) / up{c="d"} > veiloc_b"#);
    assert_eq!(selectors.iter().map(|a| a.name.as_str()).collect::<Vec<_>>(), ["veiloc_a_total", "veiloc_b"]);
    let label =
        |name: &str, values: &[&str]| (name.to_owned(), values.iter().map(ToString::to_string).collect());
    assert_eq!(selectors[0].labels, [label("kind", &["x"]), label("b", &["y", "z"])]);
    let exported =
        exported("# TYPE x counter\nx_total{a=\"1\",b=\"{n}\"} 3\nx_total{a=\"2\",b=\"\"} 4\ny 1\n");
    assert_eq!(exported["x_total"]["a"].len(), 2);
    assert!(exported["x_total"]["b"].contains("{n}") && exported["y"].is_empty());
}

struct NoRegions;

impl RegionSource for NoRegions {
    fn region<'a>(&'a self, _: &'a str, _: ObjectId) -> RegionFuture<'a> {
        unreachable!("no region is asked for")
    }
}

#[test]
fn dashboard_and_alerts_use_existing_metrics() {
    let files = Files::new();
    let mut options = files.options();
    options.log = Some(LogQueue::start(std::io::sink()).expect("a thread"));
    options.watch = Some(std::time::Duration::from_secs(3600));
    options.gateway = Some(GatewayCounts::default());
    options.regions = Some(Regions { source: Arc::new(NoRegions), counts: RegionCounts::default() });
    let server = Running::start(options);
    assert_eq!(server.localize(&files.scene.sealed(&truth()), PHONE).status, 200);
    let exported = exported(&server.get("/metrics", OPERATOR).text());
    // Labels that Prometheus adds, and labels whose values appear only with requests.
    let open = ["job", "instance", "status", "token"];
    // The dashboard stores its queries as JSON strings.
    let dashboard = repository("deploy/grafana/veiloc.json").replace("\\\"", "\"");
    for (what, text) in [("dashboard", dashboard), ("alerts", repository("deploy/prometheus/alerts.yml"))] {
        let selectors = metrics_in(&text);
        assert!(selectors.len() >= 15, "{what}: {selectors:?}");
        for MetricSelector { name, labels } in selectors {
            let series = exported.get(&name).unwrap_or_else(|| panic!("{what}: {name} is not exported"));
            for (label, values) in labels.iter().filter(|(label, _)| !open.contains(&label.as_str())) {
                let there =
                    series.get(label).unwrap_or_else(|| panic!("{what}: {name} has no label {label}"));
                for value in values {
                    assert!(there.contains(value), "{what}: no {name} has {label}=\"{value}\": {there:?}");
                }
            }
        }
    }
}

/// The end of the certificate is exported for the alerts.
#[test]
fn end_of_certificate_is_exported() {
    let files = Files::new();
    let mut options = files.options();
    options.tls = Some(TlsFiles { cert: data("cert.pem"), key: data("key.pem"), client_ca: None });
    let server = Running::start(options);
    let admin = server.listening.admin.expect("a listener for the operator");
    let text = common::http::Request::get("/metrics").send(admin).text();
    assert!(text.contains("veiloc_certificate_expiry_timestamp_seconds 4948872643\n"), "{text}");
}

#[test]
fn every_alert_has_a_runbook_section_and_a_test() {
    let alerts = alerts();
    assert!(alerts.len() >= 10);
    let runbook = repository("docs/guide/runbook.md");
    let sections: Vec<&str> = runbook
        .lines()
        .filter_map(|line| line.strip_prefix("## "))
        .filter(|s| s.starts_with("Veiloc"))
        .collect();
    assert_eq!(sections, alerts, "a section for each alert, in its order");
    for section in runbook.split("\n## ").filter(|section| section.starts_with("Veiloc")) {
        for part in ["\n*", "\n- Look", "Do: ", "- Silence: "] {
            let part = if part == "Do: " && section.contains("Look and do: ") { "do: " } else { part };
            assert!(section.contains(part), "{part:?} is missing:\n{section}");
        }
    }
    let rules = repository("deploy/prometheus/alerts.yml");
    let tests = repository("deploy/prometheus/alerts_test.yml");
    for alert in &alerts {
        let link = format!("runbook: docs/guide/runbook.md#{}\n", alert.to_lowercase());
        assert_eq!(rules.matches(&link).count(), 1, "{alert} names its section");
        assert!(tests.contains(&link), "{alert} is tested to fire");
    }
}

/// All refusals in the table of `docs/reference/http.md` have a counter from the start.
#[test]
fn documented_refusals_have_counters_from_the_start() {
    let files = Files::new();
    let server = Running::start(files.options());
    let text = server.get("/metrics", OPERATOR).text();
    let document = repository("docs/reference/http.md");
    let (_, table) = document.split_once("### Refusals").expect("the section");
    let (table, _) = table.split_once("\n###").expect("its end");
    let mut named = BTreeSet::new();
    for row in table
        .lines()
        .filter_map(|line| line.strip_prefix("| "))
        .filter(|row| row.as_bytes()[0].is_ascii_digit())
    {
        let (status, rest) = row.split_once(" | ").expect("a status");
        let names = rest.split_once(" | ").expect("names").0;
        named.extend(names.split('`').skip(1).step_by(2).map(|name| (status.to_owned(), name.to_owned())));
    }
    // These belong to other addresses.
    let others = [
        ("400", "bad-anchor"),
        ("403", "anchors-read-only"),
        ("403", "forbidden"),
        ("403", "not-owner"),
        ("404", "no-anchors"),
        ("404", "no-pack"),
        ("404", "not-found"),
        ("404", "unknown-anchor"),
        ("409", "anchors-full"),
        ("412", "precondition-failed"),
        ("503", "anchors-unavailable"),
        ("503", "other-frame"),
    ];
    for other in others {
        assert!(named.remove(&(other.0.to_owned(), other.1.to_owned())), "{other:?}");
    }
    for route in ["/v1/maps/{name}/localize", "/v1/maps/{name}/localize-rig", "/geopose"] {
        let start = format!("veiloc_requests_total{{route=\"{route}\",status=\"");
        let counted: BTreeSet<_> = text
            .lines()
            .filter_map(|line| line.strip_prefix(&start)?.strip_suffix("\"} 0")?.split_once("\",problem=\""))
            .filter(|(_, problem)| !problem.is_empty())
            .map(|(status, problem)| (status.to_owned(), problem.to_owned()))
            .collect();
        assert_eq!(counted, named, "{route}");
    }
}
