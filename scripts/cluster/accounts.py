#!/usr/bin/env python3
"""Tests the permissions on the cluster's bus: three NATS nodes with the settings of deploy/cluster, and what they refuse.

    scripts/cluster/accounts.py [--veiloc PROGRAM]

Creates a certificate authority and certificates, fills addresses and passwords into deploy/cluster/nats.conf and the example
settings of gateway and worker, publishes a rendered room to a folder, and starts three nodes, two workers and a gateway with TLS.
All queries through the gateway must be answered, also after a node is killed and a new manifest is published. A second map gets an
account as the comments of nats.conf describe. Then a client that speaks the NATS protocol by hand tries all forbidden operations:
without a password, with one, with the password of another map, and as a node of another authority. Each gives a line `refused: …`.
The last line is `all N checks hold`; otherwise the script exits with 1. Loopback and standard library only; needs nats-server
(Debian: nats-server), openssl and a build of the program.
"""

import http.client
import json
import pathlib
import re
import secrets
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "research")]

from study.loopback import (  # noqa: E402
    PROTOBUF, Cluster, Part, Rendered, arguments, ask, connects, counter, free_port, token, wait_for)

MAP, OTHER = "town", "harbour"
DEPLOY = ROOT / "deploy" / "cluster"
PASSWORDS = {name: secrets.token_hex(24) for name in ("gateway", f"worker-{MAP}", f"worker-{OTHER}")}
# A worker that does not run: messages to it reach no program.
WORKER = f"veiloc.{MAP}.member.{'0' * 32}"
ANNOUNCEMENTS = f"veiloc.{MAP}.members"
REPORTS = "veiloc_gateways.spent"
INBOX = "_INBOX_gateway.by-hand"
FOREIGN = f"veiloc.{OTHER}.member.{'0' * 32}"
TIMEOUT = 5.0

passed, failed = 0, []


def check(what, holds, reason=""):
    global passed
    passed += bool(holds)
    if not holds:
        failed.append(what)
        print(f"FAILED: {what}: {reason}", flush=True)
    return holds


def works(what, holds, reason=""):
    if check(what, holds, reason):
        print(f"works: {what}", flush=True)


def refused(what, reason, expected):
    """Checks that an operation was refused: `reason`, the answer of the other side, must contain `expected`."""
    if check(f"{what} is refused", bool(reason) and expected.lower() in reason.lower(), reason or "it was not refused"):
        print(f"refused: {what} ({reason.strip()[:90]})", flush=True)


def filled(text, replacements):
    """The text with all replacements; each old string must occur."""
    for old, new in replacements.items():
        if old not in text:
            sys.exit(f"{old!r} is not in the settings to test")
        text = text.replace(old, str(new))
    return text


class Authority:
    """A new certificate authority, and a certificate for the nodes and the gateway."""

    def __init__(self, folder):
        self.folder = folder
        folder.mkdir(parents=True)
        self.ca = folder / "ca.crt"
        self.openssl("req", "-x509", *self.key("ca.key"), "-out", self.ca, "-days", 2, "-subj", "/CN=veiloc bus",
                     "-addext", "basicConstraints=critical,CA:TRUE", "-addext", "keyUsage=critical,keyCertSign")
        (folder / "names").write_text("subjectAltName=DNS:nats-0,DNS:nats-1,DNS:nats-2,DNS:localhost,IP:127.0.0.1\n"
                                      "basicConstraints=CA:FALSE\nextendedKeyUsage=serverAuth,clientAuth\n")
        self.openssl("req", *self.key("tls.key"), "-out", folder / "tls.csr", "-subj", "/CN=node")
        self.openssl("x509", "-req", "-in", folder / "tls.csr", "-CA", self.ca, "-CAkey", folder / "ca.key", "-set_serial", 2,
                     "-days", 2, "-extfile", folder / "names", "-out", folder / "tls.crt")

    def key(self, name):
        return "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-keyout", self.folder / name

    @staticmethod
    def openssl(*words):
        done = subprocess.run(["openssl", *map(str, words)], capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"openssl {words[0]}: {done.stderr}")

    def trusts(self):
        return ssl.create_default_context(cafile=self.ca)


class SecuredCluster(Cluster):
    """A cluster with the settings of deploy/cluster for bus, gateway and workers."""

    def __init__(self, program, map_file, images):
        self.mine, self.foreign = Authority(program.work / "nats-tls"), Authority(program.work / "other-tls")
        super().__init__(program, map_file, workers=2, images=images)

    def bus(self, count):
        self.ports = [free_port() for _ in range(count)]
        self.routes = [free_port() for _ in range(count)]
        self.monitors = [free_port() for _ in range(count + 1)]
        folder = self.work / "etc"
        (folder / "nats-auth").mkdir(parents=True)
        users = {name.upper().replace("-", "_") + "_PASSWORD": password for name, password in PASSWORDS.items()}
        (folder / "nats-auth" / "users.conf").write_text("".join(f'{name}: "{word}"\n' for name, word in users.items()))
        self.nats_conf = with_second_map((DEPLOY / "nats.conf").read_text())
        self.longest = int(re.search(r"^max_payload: (\d+)$", self.nats_conf, re.M)[1])
        return [self.node(i, self.ports[i], self.routes[i], self.mine) for i in range(count)]

    def node(self, i, port, route, authority):
        path = self.work / "etc" / f"nats-{i}.conf"
        path.write_text(filled(self.nats_conf, {
            "listen: 0.0.0.0:4222": f"listen: 127.0.0.1:{port}", "http: 127.0.0.1:8222": f"http: 127.0.0.1:{self.monitors[i]}",
            "listen: 0.0.0.0:6222": f"listen: 127.0.0.1:{route}", "/etc/nats-tls": authority.folder}))
        others = ",".join(f"tls://127.0.0.1:{other}" for other in self.routes)
        command = ["nats-server", "--config", path, "--name", f"nats-{i}", "--routes", others]
        return Part(self, f"nats-{i}", command, lambda: connects(port))

    def publish(self, map_file):
        regions = self.work / "regions"
        self.program.run("map", "split", map_file, "--name", MAP, "--out", regions, "--images", self.images)
        self.program.run("map", "publish", regions, self.store)

    def settings(self, user, example, places):
        """An example file with our addresses; only we can read it, because it holds a password."""
        text = (DEPLOY / example).read_text()
        name = user.upper().replace("-", "_") + "_PASSWORD"
        places = {f"@nats-{i}:4222": f"@127.0.0.1:{port}" for i, port in enumerate(self.ports)} | places
        path = self.work / "etc" / f"{example.split('.')[0]}-{secrets.token_hex(4)}.toml"
        path.touch(0o600)
        path.write_text(filled(text, {name: PASSWORDS[user], "s3://veiloc/maps": self.store,
                                      "/etc/nats-tls/ca.crt": self.mine.ca} | places))
        return path

    def worker(self, i):
        admin = free_port()
        settings = self.settings(f"worker-{MAP}", "worker.example.toml", {
            "127.0.0.1:9100": f"127.0.0.1:{admin}", "/var/cache/veiloc": self.work / f"cache-{i}"})
        command = [self.program.veiloc, "worker", "--config", settings, "--workers", 1, "--drain-after", 1, "--watch", 1]
        part = Part(self, f"worker-{i}", command, lambda: ask(admin, "/readyz")[0] == 200)
        part.admin = admin
        return part

    def serve(self, more=()):
        self.port, self.admin = free_port(), free_port()
        settings = self.settings("gateway", "gateway.example.toml", {
            "127.0.0.1:9100": f"127.0.0.1:{self.admin}", "0.0.0.0:8443": f"127.0.0.1:{self.port}",
            "/var/cache/veiloc": self.work / "cache-gateway", "/etc/veiloc/cert.pem": self.mine.folder / "tls.crt",
            "/etc/veiloc/key.pem": self.mine.folder / "tls.key", "/etc/veiloc/tokens": self.program.tokens(["phone"])})
        command = [self.program.veiloc, "serve", "--config", settings, "--rate", 1000, "--watch", 1, "--drain-delay", 0]
        return Part(self, "gateway", command, lambda: ask(self.admin, "/readyz")[0] == 200)

    def localized(self, queries):
        """HTTP status of each query."""
        statuses = []
        for query in queries:
            connection = http.client.HTTPSConnection("127.0.0.1", self.port, timeout=60, context=self.mine.trusts())
            connection.request("POST", f"/v1/maps/{MAP}/localize", query,
                               {"content-type": PROTOBUF, "authorization": f"Bearer {token('phone')}"})
            statuses.append(connection.getresponse().status)
            connection.close()
        return statuses

    def refuses(self, command, user, places, *more):
        """The error of the program with these settings; it must exit by itself."""
        settings = self.settings(user, f"{command if command == 'worker' else 'gateway'}.example.toml", places)
        try:
            done = subprocess.run([self.program.veiloc, command, "--config", settings, *more], capture_output=True, text=True,
                                  timeout=60)
        except subprocess.TimeoutExpired:
            return ""
        reason = " ".join((done.stdout + done.stderr).split())
        return re.sub(r"^.*?no NATS server", "no NATS server", reason) if done.returncode else ""


def with_second_map(text):
    """The settings with a second map, as the comments of the file describe: a copy of the map's block."""
    block = re.search(rf"^    # The workers of the map `{MAP}`.*?^    }}\n", text, re.M | re.S)
    if not block:
        sys.exit("deploy/cluster/nats.conf has no block for the workers of a map")
    return text.replace(block[0], block[0] + block[0].replace(MAP, OTHER).replace(MAP.upper(), OTHER.upper()))


class NatsClient:
    """A client that speaks the NATS protocol by hand."""

    def __init__(self, port, context, user=None, password=None, tls=True):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT)
        self.buffer, self.messages, self.errors = b"", [], []
        self.info = json.loads(self.line().removeprefix(b"INFO "))
        if tls:
            self.socket = context.wrap_socket(self.socket, server_hostname="127.0.0.1")
        options = {"verbose": False, "pedantic": False, "lang": "by hand", "version": "0", "protocol": 1, "headers": True,
                "no_responders": True, "tls_required": tls}
        options |= {"user": user, "pass": password} if user else {}
        self.send(f"CONNECT {json.dumps(options)}\r\n".encode())
        self.settle()

    def send(self, data):
        try:
            self.socket.sendall(data)
        except OSError as error:
            # Earlier messages of the node can still be read.
            self.errors.append(f"the node hung up ({error})")

    def more(self):
        try:
            data = self.socket.recv(65536)
        except ConnectionResetError:
            data = b""
        if not data:
            raise ConnectionError("the node hung up")
        self.buffer += data

    def line(self):
        while b"\r\n" not in self.buffer:
            self.more()
        line, self.buffer = self.buffer.split(b"\r\n", 1)
        return line

    def take(self, count):
        while len(self.buffer) < count + 2:
            self.more()
        data, self.buffer = self.buffer[:count], self.buffer[count + 2:]
        return data

    def step(self):
        """Reads one protocol message of the server; returns its first word."""
        words = self.line().decode().split()
        match words[0].upper():
            case "-ERR":
                self.errors.insert(0, " ".join(words[1:]))
            case "PING":
                self.send(b"PONG\r\n")
            case "MSG" | "HMSG":
                reply = words[3] if len(words) > (4 if words[0] == "MSG" else 5) else ""
                self.messages.append((words[1], reply, self.take(int(words[-1]))))
        return words[0].upper()

    def settle(self):
        """Reads until the server has processed everything that was sent."""
        self.send(b"PING\r\n")
        try:
            while self.step() != "PONG":
                pass
        except OSError as error:
            self.errors.append(str(error))

    def subscribe(self, subject, queue="", sid=1):
        """Subscribes; returns the error, or an empty string."""
        self.errors.clear()
        self.send(f"SUB {subject} {queue} {sid}\r\n".encode())
        self.settle()
        return " ".join(self.errors[:1])

    def publish(self, subject, payload=b"hello", reply=""):
        self.errors.clear()
        self.send(f"PUB {subject} {reply} {len(payload)}\r\n".encode() + payload + b"\r\n")
        self.settle()
        return " ".join(self.errors[:1])

    def hear(self, timeout=TIMEOUT):
        """The next message, or None."""
        deadline = time.monotonic() + timeout
        try:
            while not self.messages and time.monotonic() < deadline:
                self.socket.settimeout(max(0.05, deadline - time.monotonic()))
                self.step()
        except OSError:
            pass
        self.socket.settimeout(TIMEOUT)
        return self.messages.pop(0) if self.messages else None


def check_authentication(cluster):
    """Connections that the nodes must refuse."""
    trusts, password = cluster.mine.trusts(), PASSWORDS["gateway"]
    violation = "Authorization Violation"

    def connect_errors(*credentials, port=cluster.ports[0], **how):
        return " ".join(NatsClient(port, trusts, *credentials, **how).errors[:1])

    for port in cluster.ports:
        works(f"node on {port} accepts the gateway's password", connect_errors("gateway", password, port=port) == "")
    refused("a connection without credentials", connect_errors(), violation)
    refused("a connection with a wrong password", connect_errors("gateway", "wrong"), violation)
    refused("a user with the password of another one", connect_errors("gateway", PASSWORDS[f"worker-{MAP}"]), violation)
    refused("an unknown user", connect_errors("admin", password), violation)
    refused("a password without TLS", connect_errors("gateway", password, tls=False), "hung up")
    try:
        with_other = " ".join(NatsClient(cluster.ports[0], cluster.foreign.trusts(), "gateway", password).errors)
    except ssl.SSLError as error:
        with_other = str(error)
    refused("the node's certificate, by a client that trusts another authority", with_other, "certificate verify failed")

    for command, user in (("worker", f"worker-{MAP}"), ("serve", "gateway")):
        own = ["--admin-listen", "127.0.0.1:0"] + (["--listen", "127.0.0.1:0"] if command == "serve" else [])
        other = {"/var/cache/veiloc": cluster.work / "cache-refused"}
        if command == "serve":
            other |= {"/etc/veiloc/cert.pem": cluster.mine.folder / "tls.crt",
                      "/etc/veiloc/key.pem": cluster.mine.folder / "tls.key", "/etc/veiloc/tokens": cluster.work / "tokens"}
        wrong = other | {f":{PASSWORDS[user]}@": ":wrong@"}
        refused(f"veiloc {command} with a wrong password", cluster.refuses(command, user, wrong, *own), "authorization violation")
        none = other | {f"{user}:{PASSWORDS[user]}@": ""}
        refused(f"veiloc {command} without a password", cluster.refuses(command, user, none, *own), "authorization violation")
        refused(f"the nodes, by veiloc {command} that trusts another authority",
                cluster.refuses(command, user, other, *own, "--nats-ca", cluster.foreign.ca), "certificate")


def check_nodes(cluster):
    """Nodes that must not join the cluster."""
    def routes(i):
        return json.loads(ask(cluster.monitors[i], "/routez")[1])["num_routes"]

    # Newer servers open several routes between two nodes.
    wait_for(lambda: all(routes(i) >= 2 for i in range(3)), "routes between all nodes")
    rogue = cluster.node(3, free_port(), free_port(), cluster.foreign)
    time.sleep(3)
    joined, log = routes(3), rogue.log.read_text()
    rogue.stop(5)
    reason = next((line.split("] ", 1)[-1] for line in log.splitlines() if "TLS route handshake error" in line), "")
    refused("a node with a certificate of another authority", reason if joined == 0 else "", "certificate")
    plain = socket.create_connection(("127.0.0.1", cluster.routes[0]), timeout=TIMEOUT)
    context = cluster.mine.trusts()
    try:
        bare = context.wrap_socket(plain, server_hostname="127.0.0.1")
        bare.sendall(b'CONNECT {"name":"rogue","cluster":"veiloc"}\r\nPING\r\n')
        reason = "" if b"PONG" in bare.recv(65536) else "hung up"
    except OSError as error:
        reason = str(error)
    refused("a node without a certificate", reason, "certificate")


def check_permissions(cluster):
    """Operations that authenticated users must not do."""
    trusts = cluster.mine.trusts()

    def user(name, node=0):
        return NatsClient(cluster.ports[node], trusts, name, PASSWORDS[name])

    no_sub, no_pub = "Permissions Violation for Subscription", "Permissions Violation for Publish"
    workers = f"veiloc.{MAP}.member.*"
    gateway = user("gateway")
    for what, subject, queue in (
            ("subscribes to the queries of a worker", WORKER, ""), ("subscribes to those of all workers", workers, ""),
            ("joins the workers' queue group", workers, "members"), ("subscribes to all of veiloc", "veiloc.>", ""),
            ("subscribes to everything", ">", ""), ("subscribes to replies to workers", f"_INBOX_worker-{MAP}.>", ""),
            ("subscribes to cancel messages of other gateways", f"{workers}.cancel", ""),
            ("subscribes to inboxes of no user", "_INBOX.>", ""), ("subscribes to all inboxes", "*.>", ""),
            ("subscribes to the system account", "$SYS.>", "")):
        refused(f"the gateway's user {what}", gateway.subscribe(subject, queue), no_sub)
    for what, subject in (("publishes to an unknown subject", f"veiloc.{MAP}.other"), ("answers instead of a worker", f"{INBOX}.1"),
                          ("sends a request to the system account", "$SYS.REQ.SERVER.PING"),
                          ("publishes to an unknown subject of a worker", f"{WORKER}.other"),
                          ("announces a worker", ANNOUNCEMENTS), ("reports to gateways of another system", "veiloc_gateways.other"),
                          ("sends a request to JetStream", "$JS.API.INFO")):
        refused(f"the gateway's user {what}", gateway.publish(subject), no_pub)
    works("the gateway's user receives its own replies", gateway.subscribe(f"{INBOX}.*") == "")
    works("it receives the announcements of workers", gateway.subscribe(ANNOUNCEMENTS, sid=2) == "")
    gateway.messages.clear()
    heard = gateway.hear()
    works("workers announce themselves", heard is not None and heard[0] == ANNOUNCEMENTS, heard)
    gateway.send(b"UNSUB 2\r\n")
    gateway.settle()
    gateway.messages.clear()
    works("it receives the reports of gateways", gateway.subscribe(REPORTS, sid=2) == "")
    heard = gateway.hear()
    works("gateways report what clients spend", heard is not None and heard[0] == REPORTS, heard)
    works("it reports itself", gateway.publish(REPORTS, b"no report") == "")
    gateway.send(b"UNSUB 2\r\n")
    gateway.settle()
    gateway.messages.clear()
    gateway.publish(FOREIGN, reply=f"{INBOX}.1")
    heard = gateway.hear()
    works("it is notified at once that a worker does not run", heard is not None and b" 503" in heard[2], heard)

    worker = user(f"worker-{MAP}", 1)
    for what, subject, queue in (
            ("subscribes to the queries of all workers outside the queue group", workers, ""),
            ("subscribes to those of one worker outside the queue group", WORKER, ""),
            ("joins a queue group of its own", workers, "spies"), ("subscribes to all of veiloc", "veiloc.>", ""),
            ("subscribes to everything", ">", ""), ("subscribes to reports of gateways", REPORTS, ""), ("subscribes to replies to gateways", "_INBOX_gateway.>", ""),
            ("subscribes to one gateway's replies", f"{INBOX}.*", ""), ("subscribes to inboxes of no user", "_INBOX.>", ""),
            ("subscribes to all inboxes", "*.>", ""), ("subscribes to the system account", "$SYS.>", ""),
            ("subscribes to replies to workers of another map", f"_INBOX_worker-{OTHER}.>", ""),
            ("subscribes to queries for another map", FOREIGN, "members"),
            ("subscribes to cancel messages of another map", f"{FOREIGN}.cancel", ""),
            ("subscribes to announcements of another map", f"veiloc.{OTHER}.members", ""),
            ("subscribes to all queries for another map", f"veiloc.{OTHER}.member.*", "members")):
        refused(f"a worker's user {what}", worker.subscribe(subject, queue), no_sub)
    for what, subject in (
            ("sends a pose to a gateway that did not request it", f"{INBOX}.1"),
            ("cancels a request of a gateway", f"{WORKER}.cancel"), ("sends a request to a worker", WORKER),
            ("sends a request to another map", FOREIGN), ("reports what clients spend", REPORTS), ("announces a worker of another map", f"veiloc.{OTHER}.members"),
            ("sends a request to JetStream", "$JS.API.INFO")):
        refused(f"a worker's user {what}", worker.publish(subject), no_pub)
    other = user(f"worker-{OTHER}", 2)
    refused("a worker of the other map sends a request to this map", other.publish(WORKER), no_pub)
    refused("a worker of the other map receives queries for this map", other.subscribe(workers, "members"), no_sub)

    # A gateway, a worker that answers, and a worker that listens, on different nodes.
    listener = user(f"worker-{MAP}", 2)
    listener.subscribe(f"_INBOX_worker-{MAP}.>")
    works("a worker receives its requests", worker.subscribe(WORKER, "members") == "")
    works("it subscribes to its cancel messages", worker.subscribe(f"{WORKER}.cancel", sid=2) == "")
    reached, deadline = None, time.monotonic() + TIMEOUT
    while reached is None and time.monotonic() < deadline:
        # It takes a moment until the other nodes know the subscription.
        gateway.publish(WORKER, reply=f"{INBOX}.2")
        reached = worker.hear(0.5)
    works("the gateway sends it a request", reached is not None and reached[2] == b"hello", reached)
    gateway.messages.clear()
    if reached:
        refused("a worker answers a request to another worker", listener.publish(reached[1], b"pose"), no_pub)
        works("the worker answers", worker.publish(reached[1], b"pose") == "")
        heard = gateway.hear()
        works("the gateway receives the answer", heard is not None and heard[0] == f"{INBOX}.2" and heard[2] == b"pose", heard)
        refused("a worker answers a second time", worker.publish(reached[1], b"another pose"), no_pub)
    works("the gateway sends a cancel message", gateway.publish(f"{WORKER}.cancel", f"{INBOX}.2".encode()) == "")
    heard = worker.hear()
    while heard is not None and heard[0] == WORKER:
        # The request was sent several times above.
        heard = worker.hear()
    works("the worker receives it", heard is not None and heard[:2] == (f"{WORKER}.cancel", ""), heard)
    longest = cluster.longest
    works(f"the nodes accept {longest} bytes", gateway.publish(WORKER, bytes(longest), f"{INBOX}.3") == "", gateway.errors)
    heard = worker.hear()
    works("the worker receives them", heard is not None and len(heard[2]) == longest)
    works("a worker announces itself", worker.publish(ANNOUNCEMENTS, b"no announcement") == "")
    # The first line is enough: the node closes the connection before the payload.
    gateway.send(f"PUB {WORKER} {longest + 1}\r\n".encode())
    gateway.settle()
    refused("a message of one byte more than max_payload", " ".join(gateway.errors[:1]), "Maximum Payload Violation")


def check_cancellation(cluster, scene):
    """A request to a worker that hangs is hedged to another worker; the job of the first worker is cancelled."""
    def cancelled():
        text = ask(cluster.workers[0].admin, "/metrics")[1].decode()
        return sum(counter(text, "veiloc_worker_cancellations_total", f'state="{state}"') for state in ("queued", "running"))

    def hedges():
        return counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_hedges_total")

    def localize_while_hung():
        """Sends queries while the worker hangs; when it resumes, it finds requests and their cancel messages."""
        answered = []
        asking = threading.Thread(target=lambda: answered.extend(cluster.localized(scene.queries * 2)))
        hung.send_signal(signal.SIGSTOP)
        sent = hedges()
        asking.start()
        # At most 6 s, or its node closes the connection, and its replies after a reconnect reach no gateway.
        deadline = time.monotonic() + 6
        while hedges() == sent and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.5)
        hung.send_signal(signal.SIGCONT)
        asking.join()
        return answered

    before, hung, rounds, answered = cancelled(), cluster.workers[0].process, 0, []
    # A round may send this worker only a search, which ends before the cancel, or nothing, because it is the slower one.
    while cancelled() == before and rounds < 30:
        rounds += 1
        answered += localize_while_hung()
        deadline = time.monotonic() + 2
        while cancelled() == before and time.monotonic() < deadline:
            time.sleep(0.05)
    works("queries are answered while a worker hangs", answered.count(200) == rounds * 2 * len(scene.queries), answered)
    works("its requests are cancelled", cancelled() > before, f"nothing in {rounds} rounds")
    works("it continues", ask(cluster.workers[0].admin, "/readyz")[0] == 200)


def main():
    args = arguments(__doc__).parse_args()
    if not shutil.which("openssl"):
        sys.exit("openssl is missing: apt-get install openssl")
    scene = Rendered(args.veiloc)
    cluster = SecuredCluster(scene, scene.map, scene.images)
    count = len(scene.queries)

    def all_answered(when):
        answered = cluster.localized(scene.queries).count(200)
        works(f"{count} of {count} queries are answered {when}", answered == count, f"{answered} of {count}")

    all_answered("through gateway and workers, over TLS")
    check_authentication(cluster)
    check_nodes(cluster)
    check_permissions(cluster)
    check_cancellation(cluster, scene)
    # A worker checks that others have the new manifest before it drops the old one; its account must allow this.
    cluster.publish(scene.smaller)
    objects = 1 + len(json.loads((cluster.work / "regions" / "manifest.json").read_text())["regions"])

    def holds(worker):
        return counter(ask(worker.admin, "/metrics")[1].decode(), "veiloc_objects_loaded")

    wait_for(lambda: all(worker.log.read_text().count("were left") for worker in cluster.workers),
             "the end of the old manifest")
    works("workers leave an old manifest", all(holds(worker) == objects for worker in cluster.workers))
    cluster.publish(scene.map)
    wait_for(lambda: all(worker.log.read_text().count("were left") > 1 for worker in cluster.workers),
             "the end of the smaller manifest")
    cluster.nats[0].kill()
    wait_for(lambda: ask(cluster.admin, "/readyz")[0] == 200, "readiness")
    all_answered("after a node was killed")
    codes = cluster.stop()
    works("gateway and workers exit with 0", not any(codes), codes)
    logs = {part.name: part.log.read_text() for part in (cluster.gateway, *cluster.workers)}
    works("no operation of the programs was refused", not any("violation" in log.lower() for log in logs.values()),
          [line for log in logs.values() for line in log.splitlines() if "violation" in line.lower()][:2])
    works("no password is in a log", not any(password in log for log in logs.values() for password in PASSWORDS.values()))
    if failed:
        print(f"{len(failed)} of {passed + len(failed)} checks do not hold; logs: {cluster.work}")
        sys.exit(1)
    shutil.rmtree(cluster.work)
    print(f"all {passed} checks hold")


if __name__ == "__main__":
    main()
