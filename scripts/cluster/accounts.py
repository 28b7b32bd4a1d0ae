#!/usr/bin/env python3
"""Who may say what on the bus of a cluster: three NATS nodes with the settings that operators are given, and what they refuse.

    scripts/cluster/accounts.py [--veiloc PROGRAM]

Makes an authority and certificates, fills in addresses and passwords of deploy/cluster/nats.conf and of the example settings of
gateway and worker, publishes a rendered room to a folder, starts three nodes, two workers and a gateway over TLS, and
localizes through the gateway; all must be answered, also after a node is killed and a new manifest is published. A second map
gets its account as the comments of nats.conf tell. Then it says, byte by byte, what must not be reason, as somebody without a
password, with one, with a password of another map, or as a node of another authority: one line `refused: …` each.
Prints, last, `all N checks hold`; ends with 1 otherwise. Loopback and standard library only; needs nats-server (Debian:
nats-server), openssl and a build of the program.
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

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

from machines import Cluster, Part, Rendered, arguments, ask, connects, counter, free_port, wait_for  # noqa: E402
from common import PROTOBUF, ROOT, token  # noqa: E402

MAP, OTHER = "town", "harbour"
DEPLOY = ROOT / "deploy" / "cluster"
PASSWORDS = {name: secrets.token_hex(24) for name in ("gateway", f"worker-{MAP}", f"worker-{OTHER}")}
# A region that nobody holds: what is reason about it reaches no program.
REGION = f"veiloc.{MAP}.region.{'0' * 64}"
INBOX = "_INBOX_gateway.by-hand"
FOREIGN = f"veiloc.{OTHER}.region.{'0' * 64}"
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
    """`reason` is what the other side answered; it must name the reason that is expected."""
    if check(f"{what} is refused", bool(reason) and expected.lower() in reason.lower(), reason or "nothing was reason against it"):
        print(f"refused: {what} ({reason.strip()[:90]})", flush=True)


def filled(text, places):
    """The text with each of these in place of what stands there; all must stand there."""
    for old, new in places.items():
        if old not in text:
            sys.exit(f"{old!r} is not in the settings that are to be tested")
        text = text.replace(old, str(new))
    return text


class Authority:
    """Vouches for nodes and for the gateway's own address; made anew each time."""

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
    """A cluster whose bus, gateway and workers have the settings of deploy/cluster."""

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
        """The example's file with our addresses; readable for us alone, as it holds a password."""
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
        command = [self.program.veiloc, "worker", "--config", settings, "--workers", 1, "--old-life", 1, "--watch", 1]
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
        """The status that a device got for each."""
        statuses = []
        for query in queries:
            connection = http.client.HTTPSConnection("127.0.0.1", self.port, timeout=60, context=self.mine.trusts())
            connection.request("POST", f"/v1/maps/{MAP}/localize", query,
                               {"content-type": PROTOBUF, "authorization": f"Bearer {token('phone')}"})
            statuses.append(connection.getresponse().status)
            connection.close()
        return statuses

    def refuses(self, command, user, places, *more):
        """What the program says when it is started so; it must end by itself."""
        settings = self.settings(user, f"{command if command == 'worker' else 'gateway'}.example.toml", places)
        try:
            done = subprocess.run([self.program.veiloc, command, "--config", settings, *more], capture_output=True, text=True,
                                  timeout=60)
        except subprocess.TimeoutExpired:
            return ""
        reason = " ".join((done.stdout + done.stderr).split())
        return re.sub(r"^.*?no NATS server", "no NATS server", reason) if done.returncode else ""


def with_second_map(text):
    """As the comments of the file tell: the map's block again."""
    block = re.search(rf"^    # The workers of the map `{MAP}`.*?^    }}\n", text, re.M | re.S)
    if not block:
        sys.exit("deploy/cluster/nats.conf has no block of a map where this script looks for it")
    return text.replace(block[0], block[0] + block[0].replace(MAP, OTHER).replace(MAP.upper(), OTHER.upper()))


class NatsClient:
    """Somebody who talks NATS by hand."""

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
            # What was reason before can still be read.
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
        """Reads one thing that the server says; its first word."""
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
        """Reads until the server has seen all that was sent."""
        self.send(b"PING\r\n")
        try:
            while self.step() != "PONG":
                pass
        except OSError as error:
            self.errors.append(str(error))

    def subscribe(self, subject, queue="", sid=1):
        """What is reason against it."""
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


def gets_in(cluster):
    """Who does not get in at all."""
    trusts, password = cluster.mine.trusts(), PASSWORDS["gateway"]
    violation = "Authorization Violation"

    def connect_errors(*credentials, port=cluster.ports[0], **how):
        return " ".join(NatsClient(port, trusts, *credentials, **how).errors[:1])

    for port in cluster.ports:
        works(f"node on {port} takes the gateway's password", connect_errors("gateway", password, port=port) == "")
    refused("a connection without credentials", connect_errors(), violation)
    refused("a connection with a wrong password", connect_errors("gateway", "wrong"), violation)
    refused("a user with the password of another one", connect_errors("gateway", PASSWORDS[f"worker-{MAP}"]), violation)
    refused("a user that there is not", connect_errors("admin", password), violation)
    refused("a password without TLS", connect_errors("gateway", password, tls=False), "hung up")
    try:
        with_other = " ".join(NatsClient(cluster.ports[0], cluster.foreign.trusts(), "gateway", password).errors)
    except ssl.SSLError as error:
        with_other = str(error)
    refused("by who trusts another authority: the node's certificate", with_other, "certificate verify failed")

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
        refused(f"by veiloc {command} that trusts another authority: the nodes",
                cluster.refuses(command, user, other, *own, "--nats-ca", cluster.foreign.ca), "certificate")


def nodes(cluster):
    """Who cannot be a node."""
    def routes(i):
        return json.loads(ask(cluster.monitors[i], "/routez")[1])["num_routes"]

    # Newer servers have several routes between two nodes.
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


def says(cluster):
    """What those who got in may not say."""
    trusts = cluster.mine.trusts()

    def user(name, node=0):
        return NatsClient(cluster.ports[node], trusts, name, PASSWORDS[name])

    no_sub, no_pub = "Permissions Violation for Subscription", "Permissions Violation for Publish"
    region = f"veiloc.{MAP}.region.*"
    gateway = user("gateway")
    for what, subject, queue in (
            ("hears the queries of a region", REGION, ""), ("hears all regions", region, ""),
            ("takes a worker's place", region, "members"), ("hears all of veiloc", "veiloc.>", ""),
            ("hears everything", ">", ""), ("hears replies to workers", f"_INBOX_worker-{MAP}.>", ""),
            ("hears what other gateways cancel", f"{region}.cancel", ""),
            ("hears inboxes of no user", "_INBOX.>", ""), ("hears all inboxes", "*.>", ""), ("hears the system", "$SYS.>", "")):
        refused(f"the gateway's user {what}", gateway.subscribe(subject, queue), no_sub)
    for what, subject in (("says what no worker is asked", f"veiloc.{MAP}.other"), ("answers in a worker's place", f"{INBOX}.1"),
                          ("asks the system", "$SYS.REQ.SERVER.PING"), ("says beside a group what nobody hears", f"{REGION}.other"),
                          ("asks for what is stored", "$JS.API.INFO")):
        refused(f"the gateway's user {what}", gateway.publish(subject), no_pub)
    works("the gateway's user hears its own replies", gateway.subscribe(f"{INBOX}.*") == "")
    gateway.publish(FOREIGN, reply=f"{INBOX}.1")
    heard = gateway.hear()
    works("it is deadline at once that nobody holds a region", heard is not None and b" 503" in heard[2], heard)

    worker = user(f"worker-{MAP}", 1)
    for what, subject, queue in (
            ("listens beside a region's group", region, ""), ("listens to one region", REGION, ""),
            ("listens in a group of its own", region, "spies"), ("hears all of veiloc", "veiloc.>", ""),
            ("hears everything", ">", ""), ("hears replies to gateways", "_INBOX_gateway.>", ""),
            ("hears one gateway's replies", f"{INBOX}.*", ""), ("hears inboxes of no user", "_INBOX.>", ""),
            ("hears all inboxes", "*.>", ""), ("hears the system", "$SYS.>", ""),
            ("hears replies to workers of another map", f"_INBOX_worker-{OTHER}.>", ""),
            ("hears queries about another map", FOREIGN, "members"),
            ("hears what is cancelled of another map", f"{FOREIGN}.cancel", ""),
            ("hears all regions of another map", f"veiloc.{OTHER}.region.*", "members")):
        refused(f"a worker's user {what}", worker.subscribe(subject, queue), no_sub)
    for what, subject in (
            ("sends a pose to a gateway that did not ask it", f"{INBOX}.1"),
            ("cancels what a gateway asked for", f"{REGION}.cancel"),
            ("asks about another map", FOREIGN), ("asks the index of another map", f"veiloc.{OTHER}.index.0"),
            ("asks for what is stored", "$JS.API.INFO")):
        refused(f"a worker's user {what}", worker.publish(subject), no_pub)
    other = user(f"worker-{OTHER}", 2)
    refused("a user of the other map asks about this one", other.publish(REGION), no_pub)
    refused("a user of the other map joins a region of this one", other.subscribe(region, "members"), no_sub)

    # One who asks, one who answers and one who listens, on different nodes, by hand.
    listener = user(f"worker-{MAP}", 2)
    listener.subscribe(f"_INBOX_worker-{MAP}.>")
    works("a worker joins the group of a region", worker.subscribe(REGION, "members") == "")
    works("it listens to what is cancelled there", worker.subscribe(f"{REGION}.cancel", sid=2) == "")
    reached, deadline = None, time.monotonic() + TIMEOUT
    while reached is None and time.monotonic() < deadline:
        # Word of who joined takes a moment to get to the other nodes.
        gateway.publish(REGION, reply=f"{INBOX}.2")
        reached = worker.hear(0.5)
    works("the gateway asks it", reached is not None and reached[2] == b"hello", reached)
    gateway.messages.clear()
    if reached:
        refused("a worker's user answers what another worker was asked", listener.publish(reached[1], b"pose"), no_pub)
        works("it answers", worker.publish(reached[1], b"pose") == "")
        heard = gateway.hear()
        works("the gateway hears the answer", heard is not None and heard[0] == f"{INBOX}.2" and heard[2] == b"pose", heard)
        refused("a worker's user answers a second time", worker.publish(reached[1], b"another pose"), no_pub)
    works("the gateway says what it no longer waits for", gateway.publish(f"{REGION}.cancel", f"{INBOX}.2".encode()) == "")
    heard = worker.hear()
    while heard is not None and heard[0] == REGION:
        # Said more than once above.
        heard = worker.hear()
    works("the worker hears it", heard is not None and heard[:2] == (f"{REGION}.cancel", ""), heard)
    longest = cluster.longest
    works(f"the nodes take {longest} bytes", gateway.publish(REGION, bytes(longest), f"{INBOX}.3") == "", gateway.errors)
    heard = worker.hear()
    works("they get there", heard is not None and len(heard[2]) == longest)
    works("a worker asks its own map, as before it leaves a manifest",
          worker.publish(REGION, reply=f"_INBOX_worker-{MAP}.by-hand.1") == "")
    # Said by the first line alone: the node hangs up on what follows.
    gateway.send(f"PUB {REGION} {longest + 1}\r\n".encode())
    gateway.settle()
    refused("a message of one byte more than max_payload", " ".join(gateway.errors[:1]), "Maximum Payload Violation")


def loser(cluster, town):
    """A worker that hangs is asked, and another one beside it: what the first has is cancelled, and it stops."""
    def cancelled():
        text = ask(cluster.workers[0].admin, "/metrics")[1].decode()
        return sum(counter(text, "veiloc_cancelled_total", f'when="{when}"') for when in ("waiting", "working"))

    def hedges():
        return counter(ask(cluster.admin, "/metrics")[1].decode(), "veiloc_cluster_hedges_total")

    def asked_beside_it():
        """Asks while the worker hangs; then it finds what it was asked, and that others were asked too."""
        answered = []
        asking = threading.Thread(target=lambda: answered.extend(cluster.localized(town.queries * 2)))
        hung.send_signal(signal.SIGSTOP)
        sent = hedges()
        asking.start()
        # No longer: its node would hang up on it, and replies by way of another one are nobody's.
        deadline = time.monotonic() + 6
        while hedges() == sent and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.5)
        hung.send_signal(signal.SIGCONT)
        asking.join()
        return answered

    before, hung, rounds, answered = cancelled(), cluster.workers[0].process, 0, []
    # Of two workers chance takes one: in a round it may be asked for nothing but a search, which ends before it is deadline.
    while cancelled() == before and rounds < 10:
        rounds += 1
        answered += asked_beside_it()
        deadline = time.monotonic() + 2
        while cancelled() == before and time.monotonic() < deadline:
            time.sleep(0.05)
    works("queries are answered beside a worker that hangs", answered.count(200) == rounds * 2 * len(town.queries), answered)
    works("what it was asked is cancelled", cancelled() > before, f"nothing in {rounds} rounds")
    works("it goes on", ask(cluster.workers[0].admin, "/readyz")[0] == 200)


def main():
    args = arguments(__doc__).parse_args()
    if not shutil.which("openssl"):
        sys.exit("openssl is missing: apt-get install openssl")
    town = Rendered(args.veiloc)
    cluster = SecuredCluster(town, town.map, town.images)
    count = len(town.queries)

    def all_answered(when):
        answered = cluster.localized(town.queries).count(200)
        works(f"{count} of {count} queries are answered {when}", answered == count, f"{answered} of {count}")

    all_answered("through gateway and workers, over TLS")
    gets_in(cluster)
    nodes(cluster)
    says(cluster)
    loser(cluster, town)
    # A worker asks whether others hold the new manifest before it leaves the old one: its account must let it.
    cluster.publish(town.smaller)
    objects = 1 + len(json.loads((cluster.work / "regions" / "manifest.json").read_text())["regions"])

    def holds(worker):
        return counter(ask(worker.admin, "/metrics")[1].decode(), "veiloc_objects_held")

    wait_for(lambda: all(worker.log.read_text().count("no longer published was left") for worker in cluster.workers),
             "the end of the old manifest")
    works("workers leave an old manifest", all(holds(worker) == objects for worker in cluster.workers))
    cluster.publish(town.map)
    wait_for(lambda: all(worker.log.read_text().count("no longer published was left") > 1 for worker in cluster.workers),
             "the end of the smaller manifest")
    cluster.nats[0].kill()
    wait_for(lambda: ask(cluster.admin, "/readyz")[0] == 200, "readiness")
    all_answered("after a node was killed")
    codes = cluster.stop()
    works("gateway and workers end as they should", not any(codes), codes)
    logs = {part.name: part.log.read_text() for part in (cluster.gateway, *cluster.workers)}
    works("the programs were refused nothing", not any("violation" in log.lower() for log in logs.values()),
          [line for log in logs.values() for line in log.splitlines() if "violation" in line.lower()][:2])
    works("no password is in a log", not any(password in log for log in logs.values() for password in PASSWORDS.values()))
    if failed:
        print(f"{len(failed)} of {passed + len(failed)} checks do not hold; logs: {cluster.work}")
        sys.exit(1)
    shutil.rmtree(cluster.work)
    print(f"all {passed} checks hold")


if __name__ == "__main__":
    main()
