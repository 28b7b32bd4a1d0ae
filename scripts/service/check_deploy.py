#!/usr/bin/env python3
"""Checks the files of deploy/ against the program and against each other, and lists the checks that it had to skip.

    cargo build --release -p veiloc-cli
    scripts/service/check_deploy.py [--veiloc PROGRAM]

Ports, paths, users, times and settings must agree and be known to the program. The systemd unit is checked by systemd-analyze, the
Kubernetes schema by kubeconform or kubernetes-validate (PyPI), the compose file by `docker compose config`, each if it is
installed. Needs PyYAML. Exits with 1 when a check fails.
"""

import argparse
import importlib.util
import json
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

from study import loopback as common  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
DEPLOY = ROOT / "deploy"
FAULTS, SKIPPED = [], []


def check(holds, what):
    print(("ok     " if holds else "FAULT  ") + what)
    if not holds:
        FAULTS.append(what)


def skip(what, why):
    print(f"not    {what}: {why}")
    SKIPPED.append(what)


def run(*command, **more):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, **more)


def port(address):
    return int(address.rsplit(":", 1)[1])


def settings(veiloc, text, where):
    """The effective settings with this file; an error of the program is a fault."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "veiloc.toml"
        path.write_text(text)
        done = run(veiloc, "serve", "--config", path, "--print-config", env={"PATH": os.environ["PATH"]})
        check(done.returncode == 0, f"{where}: the program accepts these settings {done.stderr.strip()}")
        return tomllib.loads(done.stdout) if done.returncode == 0 else {}


def environment(veiloc, variables, where):
    """Checks that each variable belongs to an option and is accepted."""
    known = {"VEILOC_" + key.upper().replace("-", "_") for key in all_keys(veiloc)}
    for name, value in variables.items():
        check(name in known, f"{where}: {name} belongs to an option")
        done = run(veiloc, "serve", "--maps", "/none", "--print-config", env={"PATH": os.environ["PATH"], name: value})
        check(done.returncode == 0 and f"# {name}\n" in done.stdout, f"{where}: {name}={value} is accepted")


def all_keys(veiloc):
    text = run(veiloc, "serve", "--maps", "/none", "--print-config").stdout
    return set(re.findall(r"^(?:# )?([a-z-]+)(?: =| is not given)", text, re.M))


def stops_in(holds):
    """Seconds that the service may need to stop."""
    return holds["drain-delay"] + holds["grace"]


def container(example):
    text = (DEPLOY / "Containerfile").read_text()
    stages = re.findall(r"^FROM (\S+)", text, re.M)
    check(len(stages) == 2, "Containerfile: two stages")
    manifest = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]
    check(stages[0].startswith(f"rust:{manifest['rust-version']}"), f"Containerfile: {stages[0]} is the project's Rust")
    check(stages[0].rsplit("-", 1)[1] == stages[1].split(":")[1].split("-")[0], "Containerfile: one Debian in both stages")
    user = re.search(r"^USER (\d+):\d+$", text, re.M)
    check(bool(user) and user[1] != "0", "Containerfile: not root")
    check(f"EXPOSE {port(example['listen'][0])}\n" in text, "Containerfile: exposes the port of the settings")
    check("STOPSIGNAL SIGTERM" in text and "HEALTHCHECK" in text, "Containerfile: signal and health")
    check('ENTRYPOINT ["/usr/local/bin/veiloc", "serve"]' in text, "Containerfile: runs the service")
    for source in re.findall(r"^COPY (?!--from)(\S+)", text, re.M):
        check((ROOT / source).exists(), f"Containerfile: {source} exists")
    probe = (DEPLOY / "probe.sh").read_text()
    check(f"PROBE_PORT:-{port(example['admin-listen'])}" in probe, "probe.sh: the admin port")
    check(run("bash", "-n", DEPLOY / "probe.sh").returncode == 0, "probe.sh: valid bash")
    builder = next((tool for tool in ("podman", "buildah") if shutil.which(tool)), None)
    if builder is None and shutil.which("docker"):
        builder = "docker" if run("docker", "info").returncode == 0 else None
    skip("Containerfile: image build", "needs a registry; build it by hand" if builder else "no builder is installed")
    return user[1] if user else None


def compose(veiloc, example, user):
    service = yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"]["veiloc"]
    check(service["user"] == f"{user}:{user}", "compose.yaml: the image's user")
    check(service["read_only"] and service["cap_drop"] == ["ALL"], "compose.yaml: read-only, no capabilities")
    check(str(port(example["listen"][0])) == service["ports"][0].split(":")[-1], "compose.yaml: the port of the settings")
    check(not any(str(port(example["admin-listen"])) in p for p in service["ports"]), "compose.yaml: admin not published")
    check((DEPLOY / service["build"]["context"] / service["build"]["dockerfile"]).exists(), "compose.yaml: builds a file")
    timeout = float(service["stop_grace_period"].rstrip("s"))
    check(timeout > stops_in(example), f"compose.yaml: waits {timeout} s, longer than drain and grace")
    check(service["ulimits"]["nofile"] >= example["connections"] + 192, "compose.yaml: open files for all connections")
    mounts = [volume.split(":")[1] for volume in service["volumes"]]
    for key in ("maps", "cert", "key", "tokens"):
        check(any(example[key].startswith(mount) for mount in mounts), f"compose.yaml: {key} lies in a volume")
    check(all(volume.endswith(":ro") for volume in service["volumes"]), "compose.yaml: volumes are read-only")
    environment(veiloc, service["environment"], "compose.yaml")
    if shutil.which("docker") and run("docker", "compose", "version").returncode == 0:
        done = run("docker", "compose", "-f", DEPLOY / "compose.yaml", "config", "--quiet")
        check(done.returncode == 0, f"compose.yaml: docker compose config {done.stderr.strip()}")
    else:
        skip("compose.yaml: schema", "docker compose is not installed")


def unit(example):
    path = DEPLOY / "veiloc.service"
    text = path.read_text()
    entries = dict(re.findall(r"^(\w+)=(.*)$", text, re.M))
    check(entries["Type"] in ("exec", "simple"), "veiloc.service: does not wait for sd_notify, which the program does not send")
    check(float(entries["TimeoutStopSec"]) > stops_in(example), "veiloc.service: stop timeout is longer than drain and grace")
    check(int(entries["LimitNOFILE"]) >= example["connections"] + 192, "veiloc.service: open files for all connections")
    check(entries["ExecStart"].endswith("serve --config /etc/veiloc/veiloc.toml"), "veiloc.service: the settings")
    check("listen unix:/run/veiloc/" in text and entries["RuntimeDirectory"] == "veiloc", "veiloc.service: a socket's folder")
    if not shutil.which("systemd-analyze"):
        return skip("veiloc.service: by systemd-analyze", "not installed")
    with tempfile.TemporaryDirectory() as folder:
        # The program and its user need not exist on this machine.
        trial = pathlib.Path(folder) / "veiloc.service"
        trial.write_text(text.replace("/usr/local/bin/veiloc", "/bin/true"))
        done = run("systemd-analyze", "verify", trial)
        check(done.returncode == 0 and not done.stderr.strip(), f"veiloc.service: verify {done.stderr.strip()}")
        done = run("systemd-analyze", "security", "--offline=true", trial)
        figure = re.search(r"level for \S+: ([\d.]+)", done.stdout)
        check(bool(figure) and float(figure[1]) < 2, f"veiloc.service: exposure {figure and figure[1]}")
    if pathlib.Path("/run/systemd/system").exists():
        skip("veiloc.service: start", "needs the program installed; start it by hand")
    else:
        skip("veiloc.service: start", "systemd does not run on this machine")


def kubernetes(veiloc, user):
    path = DEPLOY / "kubernetes.yaml"
    documents = {document["kind"]: document for document in yaml.safe_load_all(path.read_text())}
    holds = settings(veiloc, documents["ConfigMap"]["data"]["veiloc.toml"], "kubernetes.yaml")
    if not holds:
        return
    pod = documents["Deployment"]["spec"]["template"]["spec"]
    container = pod["containers"][0]
    ports = {p["name"]: p["containerPort"] for p in container["ports"]}
    check(ports["https"] == port(holds["listen"][0]), "kubernetes.yaml: the port of the settings")
    check(ports["admin"] == port(holds["admin-listen"]), "kubernetes.yaml: the admin port")
    check(not holds["admin-listen"].startswith("127."), "kubernetes.yaml: the kubelet reaches the admin port")
    check(documents["Service"]["spec"]["ports"][0]["targetPort"] == "https", "kubernetes.yaml: the Service targets the https port")
    check(len(documents["Service"]["spec"]["ports"]) == 1, "kubernetes.yaml: the Service does not expose the admin port")
    for probe, wanted in (("startupProbe", "/readyz"), ("readinessProbe", "/readyz"), ("livenessProbe", "/healthz")):
        got = container[probe]["httpGet"]
        check((got["path"], got["port"]) == (wanted, "admin"), f"kubernetes.yaml: {probe}")
    detection = container["readinessProbe"]["periodSeconds"] * container["readinessProbe"]["failureThreshold"]
    check(holds["drain-delay"] > detection, f"kubernetes.yaml: drain-delay is more than the {detection} s of the readiness probe")
    timeout = pod["terminationGracePeriodSeconds"]
    check(timeout > stops_in(holds), f"kubernetes.yaml: waits {timeout} s, more than drain and grace")
    check(str(pod["securityContext"]["runAsUser"]) == user and pod["securityContext"]["runAsNonRoot"],
          "kubernetes.yaml: the image's user")
    check(container["securityContext"]["readOnlyRootFilesystem"], "kubernetes.yaml: read-only root")
    check(pod["enableServiceLinks"] is False, "kubernetes.yaml: no service environment variables")
    mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    volumes = {volume["name"] for volume in pod["volumes"]}
    check(set(mounts.values()) == volumes, "kubernetes.yaml: every volume is mounted")
    check(not any(a != b and a.startswith(b + "/") for a in mounts for b in mounts),
          "kubernetes.yaml: no mount inside another one")
    for key in ("maps", "cert", "key", "tokens"):
        check(any(holds[key].startswith(mount + "/") or holds[key] == mount for mount in mounts),
              f"kubernetes.yaml: {key} lies in a volume")
    selector = documents["Deployment"]["spec"]["selector"]["matchLabels"]
    labels = documents["Deployment"]["spec"]["template"]["metadata"]["labels"]
    check(selector == labels == documents["Service"]["spec"]["selector"], "kubernetes.yaml: labels")
    with tempfile.TemporaryDirectory() as folder:
        tokens = pathlib.Path(folder) / "tokens"
        tokens.write_text(documents["Secret"]["stringData"]["tokens"])
        done = run(veiloc, "token", "list", "--tokens", tokens)
        check(done.returncode == 0 and not done.stdout.strip(), "kubernetes.yaml: the placeholder token gives no access")
    if shutil.which("kubeconform"):
        done = run("kubeconform", "-strict", path)
        check(done.returncode == 0, f"kubernetes.yaml: kubeconform {done.stdout.strip()}")
    elif importlib.util.find_spec("kubernetes_validate"):
        import kubernetes_validate
        for kind, document in documents.items():
            try:
                kubernetes_validate.validate(document, kubernetes_validate.latest_version(), strict=True)
                check(True, f"kubernetes.yaml: {kind} by the schema of {kubernetes_validate.latest_version()}")
            except Exception as error:  # the exception classes differ between versions
                check(False, f"kubernetes.yaml: {kind}: {error}")
    else:
        skip("kubernetes.yaml: schema", "neither kubeconform nor kubernetes-validate is installed")


def probe(veiloc):
    """Runs the container's probe against a service without a map, no service, and a ready service."""
    with tempfile.TemporaryDirectory() as folder:
        admin, listen = common.free_port(), common.free_port()
        tokens = pathlib.Path(folder) / "tokens"
        tokens.write_text("nobody\n")
        process = subprocess.Popen([veiloc, "serve", "--maps", folder, "--tokens", tokens, "--listen",
                                    f"127.0.0.1:{listen}", "--admin-listen", f"127.0.0.1:{admin}"],
                                   stderr=subprocess.DEVNULL)
        try:
            common.wait_for(lambda: common.connects(admin), "the service")
            done = run("bash", DEPLOY / "probe.sh", env={"PATH": os.environ["PATH"], "PROBE_PORT": str(admin)})
            check(done.returncode != 0, "probe.sh: a service without a map is not ready")
        finally:
            process.kill()
            process.wait()
        done = run("bash", DEPLOY / "probe.sh", env={"PATH": os.environ["PATH"], "PROBE_PORT": str(admin)})
        check(done.returncode != 0, "probe.sh: without a service it fails")
        with socket.create_server(("127.0.0.1", 0)) as fake:
            asking = subprocess.Popen(["bash", DEPLOY / "probe.sh"],
                                      env={"PATH": os.environ["PATH"], "PROBE_PORT": str(fake.getsockname()[1])})
            connection, _ = fake.accept()
            connection.recv(1000)
            connection.sendall(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n")
            check(asking.wait(10) == 0, "probe.sh: with status 200 it succeeds")
            connection.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", help="default: the release build of this repository")
    veiloc = pathlib.Path(parser.parse_args().veiloc or common.target_dir() / "release" / "veiloc").resolve()
    example = settings(veiloc, (DEPLOY / "veiloc.example.toml").read_text(), "veiloc.example.toml")
    user = container(example)
    compose(veiloc, example, user)
    unit(example)
    kubernetes(veiloc, user)
    probe(veiloc)
    print(json.dumps({"faults": FAULTS, "not_checked": SKIPPED}))
    sys.exit(1 if FAULTS else 0)


if __name__ == "__main__":
    main()
