#!/usr/bin/env python3
"""Checks dashboard, alerts and metrics with Prometheus against a running service.

    scripts/service/check_monitoring.py [--veiloc PROGRAM]

Starts `veiloc serve` with a rendered scene, a cluster with a gateway and two workers, and Prometheus. Fails when

- `promtool check metrics`, `check rules` or `test rules` finds a fault;
- the dashboard or an alert names a metric that neither the service nor the gateway exports;
- Prometheus cannot evaluate a query of the dashboard, or the result is empty where data is expected;
- Prometheus cannot evaluate an alert, or an alert fires for a healthy service or cluster.

Uses Prometheus from PATH, or downloads Debian's package `prometheus` (`apt-get download`) and unpacks it into a temporary folder.
Loopback only; standard library only; needs nats-server (Debian: nats-server) and the cargo feature `cluster`.
"""

import json
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "research"))

from study.loopback import LOCALIZE, ROOT, Cluster, RenderedScene, Server, arguments, ask, free_port, wait_for  # noqa: E402

DASHBOARD = ROOT / "deploy" / "grafana" / "veiloc.json"
ALERTS = ROOT / "deploy" / "prometheus" / "alerts.yml"
TESTS = ROOT / "deploy" / "prometheus" / "alerts_test.yml"
# Without TLS there is no certificate.
MAY_BE_EMPTY = {"Certificate"}


def prometheus_programs(folder):
    """Paths of promtool and prometheus."""
    found = [shutil.which(name) for name in ("promtool", "prometheus")]
    if all(found):
        return found
    subprocess.run(["apt-get", "download", "prometheus"], cwd=folder, check=True, capture_output=True)
    package = next(folder.glob("prometheus_*.deb"))
    subprocess.run(["dpkg-deb", "-x", package, folder / "unpacked"], check=True)
    return [str(folder / "unpacked" / "usr" / "bin" / name) for name in ("promtool", "prometheus")]


def plain_text(openmetrics):
    """Converts OpenMetrics to the older text format that `promtool check metrics` reads: there the help and type lines of a
    counter name its samples, with the suffix `_total`."""
    lines = openmetrics.splitlines()
    counters = {line.split()[2] for line in lines if line.startswith("# TYPE ") and line.endswith(" counter")}
    out = []
    for line in lines:
        words = line.split(" ", 3)
        if line == "# EOF" or words[:2] == ["#", "UNIT"]:
            continue
        if words[0] == "#" and words[2] in counters:
            words[2] += "_total"
        out.append(" ".join(words))
    return "\n".join(out) + "\n"


def names_in(text):
    return set(re.findall(r"\b(?:veiloc|process)_[a-z_]+", text))


def check(faults, what, command, **more):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **more)
    print(f"{what}: {'ok' if done.returncode == 0 else 'FAULTS'}")
    if done.returncode != 0:
        faults.append(f"{what}:\n{done.stdout}{done.stderr}")


def dashboard_queries(dashboard):
    """Title and query of each panel and annotation of the dashboard."""
    for panel in dashboard["panels"]:
        for target in panel.get("targets", []):
            yield panel["title"], target["expr"]
    for note in dashboard["annotations"]["list"]:
        yield f"note {note['name']}", note["expr"]


class Prometheus:
    """Prometheus, which scrapes service and gateway and evaluates the alerts each second."""

    def __init__(self, program, folder, *admins):
        self.port = free_port()
        configuration = folder / "prometheus.yml"
        configuration.write_text(json.dumps({
            "global": {"scrape_interval": "1s", "evaluation_interval": "1s"},
            "rule_files": [str(ALERTS)],
            "scrape_configs": [{"job_name": "veiloc", "static_configs": [
                {"targets": [f"127.0.0.1:{admin}" for admin in admins]}]}],
        }))
        self.process = subprocess.Popen(
            [program, f"--config.file={configuration}", f"--storage.tsdb.path={folder / 'tsdb'}",
             f"--web.listen-address=127.0.0.1:{self.port}", "--log.level=error"])

    def get(self, path, **query):
        url = f"http://127.0.0.1:{self.port}/api/v1/{path}?{urllib.parse.urlencode(query)}"
        try:
            with urllib.request.urlopen(url, timeout=10) as answer:
                return json.load(answer)
        except urllib.error.HTTPError as refused:
            body = refused.read()
            # While it starts, its answer is not JSON.
            return json.loads(body) if body.startswith(b"{") else {"status": "error", "error": body.decode()}

    def up(self):
        try:
            answer = self.get("query", query='up{job="veiloc"}')
        except OSError:
            return False
        targets = answer.get("data", {}).get("result", [])
        return bool(targets) and all(series["value"][1] == "1" for series in targets)

    def stop(self):
        self.process.terminate()
        self.process.wait(30)


def static_checks(faults, promtool):
    check(faults, "promtool check rules", [promtool, "check", "rules", ALERTS])
    check(faults, "promtool test rules", [promtool, "test", "rules", TESTS])


def ask_for_a_while(server, cluster, scene):
    """Sends requests of each kind over several scrapes, so that each panel has data."""
    for _ in range(6):
        for body in (scene.query, scene.query, scene.query[:100]):
            ask(server.port, LOCALIZE, body, user="phone")
        ask(cluster.port, LOCALIZE, scene.query)
        ask(server.port, LOCALIZE, scene.query, user="unknown")
        with socket.create_connection(("127.0.0.1", server.port)) as noise:
            noise.sendall(b"this is no HTTP\r\n\r\n")
            noise.recv(1024)
        time.sleep(1.0)


def check_names(faults, shown):
    for what, path in (("dashboard", DASHBOARD), ("alerts", ALERTS)):
        named = names_in(path.read_text())
        missing = sorted(named - shown)
        print(f"metrics in the {what}: {len(named)}, of which nothing exports {len(missing)}")
        faults += [f"the {what} names {name}, which nothing exports" for name in missing]


def check_dashboard(faults, prometheus):
    queries = 0
    for title, query in dashboard_queries(json.loads(DASHBOARD.read_text())):
        for variable, value in (("$__rate_interval", "5s"), ("$job", "veiloc"), ("$instance", ".*")):
            query = query.replace(variable, value)
        answer = prometheus.get("query", query=query)
        queries += 1
        if answer["status"] != "success":
            faults.append(f"{title}: {answer.get('error')}\n{query}")
        elif not answer["data"]["result"] and title not in MAY_BE_EMPTY and not title.startswith("note "):
            faults.append(f"{title}: the result is empty\n{query}")
    print(f"queries of the dashboard, evaluated by Prometheus: {queries}")


def check_alerts(faults, prometheus):
    rules = [rule for group in prometheus.get("rules")["data"]["groups"] for rule in group["rules"]]
    for rule in rules:
        if rule["health"] != "ok":
            faults.append(f"{rule['name']}: {rule.get('lastError', rule['health'])}")
        if rule["state"] == "firing":
            faults.append(f"{rule['name']} fires for a healthy service")
    print(f"alerts, evaluated by Prometheus: {len(rules)}")


def main():
    scene = RenderedScene(arguments(__doc__).parse_args().veiloc)
    faults = []
    folder = pathlib.Path(tempfile.mkdtemp(prefix="veiloc-monitoring-"))
    promtool, program = prometheus_programs(folder)
    static_checks(faults, promtool)
    server = Server(scene, "--tokens", scene.tokens(["phone", "operator!"]))
    cluster, prometheus = Cluster(scene, scene.map, workers=2, nats=1), None
    try:
        for admin in (server.admin, cluster.admin, cluster.workers[0].admin):
            text = ask(admin, "/metrics")[1].decode()
            check(faults, "promtool check metrics", [promtool, "check", "metrics"], input=plain_text(text))
        prometheus = Prometheus(program, folder, server.admin, cluster.admin)
        wait_for(prometheus.up, "Prometheus")
        ask_for_a_while(server, cluster, scene)
        check_names(faults, names_in("".join(ask(admin, "/metrics")[1].decode() for admin in (server.admin, cluster.admin))))
        check_dashboard(faults, prometheus)
        check_alerts(faults, prometheus)
    finally:
        if prometheus:
            prometheus.stop()
        cluster.stop()
        ended = server.stop()
        shutil.rmtree(folder, ignore_errors=True)
    if ended != 0:
        faults.append("the service did not exit with 0")
    print(f"{len(faults)} faults")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
