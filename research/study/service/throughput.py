#!/usr/bin/env python3
"""Queries per second of the service, against the rate that its workers would reach if only the library took time.

    research/study/service/throughput.py --data $VEILOC_DATA --csv docs/results/service/overhead.csv [--veiloc PROGRAM] [--seconds 15]

Sends one sealed query of 1024 keypoints repeatedly, with enough clients to keep all workers busy: HTTP/1.1, plain and with TLS.
*Library* is the service's own measurement of retrieval, matching and pose (`veiloc_stage_seconds`). The number of workers over
its mean is an upper bound of the rate; *share* is the fraction of it that is reached. Needs `h2load` (Debian: nghttp2-client)
and `openssl`. Client and service share the machine's cores, so the share is a lower bound.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from common import LOCALIZE, PROTOBUF, RedKitchen, Server, arguments, ask, wait_for  # noqa: E402
from places import write_csv  # noqa: E402


STAGES = ("retrieve", "match", "pose")


def library(server):
    """Seconds spent in the library so far, and number of localizations."""
    text = ask(server.admin, "/metrics")[1].decode()
    read = lambda what, stage: float(re.search(rf'veiloc_stage_seconds_{what}{{stage="{stage}"}} (\S+)', text)[1])
    return sum(read("sum", stage) for stage in STAGES), read("count", "pose")


def load(url, query, seconds, clients):
    """Answers per second, the number of successful ones, and the other statuses."""
    command = ["h2load", "--warm-up-time=2", "-D", str(seconds), "-c", str(clients), "-m", "1", "-d", query,
               "-H", f"content-type: {PROTOBUF}", "--h1", url]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rate = float(re.search(r"finished in [\d.]+\w*, ([\d.]+) req/s", output)[1])
    good, others = re.search(r"status codes: (\d+) 2xx, (.*)", output).groups()
    return rate, int(good), others


def main():
    parser = arguments(__doc__)
    parser.add_argument("--seconds", type=int, default=15, help="duration of each row")
    parser.add_argument("--csv", type=Path)
    args = parser.parse_args()
    scene = RedKitchen(args.veiloc)
    query, cert, key = scene.work / "query", scene.work / "cert.pem", scene.work / "key.pem"
    query.write_bytes(scene.query)
    subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                    "-keyout", key, "-out", cert, "-days", "1", "-subj", "/CN=localhost"], check=True, capture_output=True)
    workers = os.cpu_count()
    rows = []
    for tls in (False, True):
        server = Server(scene, "--log", "error", *(["--cert", cert, "--key", key] if tls else []))
        wait_for(lambda: ask(server.admin, "/readyz")[0] == 200, "readiness")
        url = f"{'https' if tls else 'http'}://127.0.0.1:{server.port}{LOCALIZE}"
        before = library(server)
        rate, good, others = load(url, query, args.seconds, 2 * workers)
        after = library(server)
        if not good:
            sys.exit(f"no answer: {others}")
        each = (after[0] - before[0]) / (after[1] - before[1])
        rows.append(["TLS" if tls else "plain", f"{rate:.1f}", f"{1e3 * each:.1f}", f"{workers / each:.1f}",
                     f"{rate * each / workers:.2f}"])  # fmt: skip
        print(*rows[-1], sep="  ", flush=True)
        server.stop()
    bound = f"answers a second {workers} workers could give"
    write_csv(args.csv, ["connection", "answers a second", "library, a query (ms)", bound, "share"], rows)


if __name__ == "__main__":
    main()
