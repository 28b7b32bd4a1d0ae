"""Workers on Ray: serves the regions of published maps, as `veiloc serve --store` does, and Ray places them.

    python -m veiloc.ray_serve STORE --tokens workers.tokens --replicas 3 --listen 127.0.0.1:8080

Gateways (`veiloc serve --workers http://127.0.0.1:8080`) need no other setting: path, headers and answers are those of a worker. Each
region is a multiplexed model, so Ray sends a query to a replica that has its region open; replicas, health checks, autoscaling and
updates are Ray's. STORE is a folder that all machines see, as `veiloc map publish` wrote it. Of a cloud's storage, mount it or copy it.

Needs Ray Serve (`pip install "ray[serve]"`); `import veiloc` does not.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import hashlib
import hmac
import json
import os
import re
import struct
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import ray
from ray import serve
from ray.serve.exceptions import BackPressureError
from starlette.requests import Request
from starlette.responses import Response

import veiloc

PATH = re.compile(r"/v1/maps/([^/]+)/regions/([0-9a-f]{64})/(localize|localize-rig)")
# Answers have one length, so that it does not tell whether there is a pose.
LENGTH = 4096
# Seconds until a query is sent again, to a replica that Ray chooses anew, and how often.
PATIENCE, TRIES = 3.0, 4
#: Status and detail of what a worker refuses, by its name.
PROBLEMS = {
    "unauthenticated": (401, "send a token that this service knows, as `Authorization: Bearer TOKEN`"),
    "unknown-map": (404, "no such region of a published map of this name"),
    "not-found": (404, "no such address"),
    "malformed-query": (400, "not a sealed query"),
    "bad-option": (400, "veiloc-near: four numbers, X,Y,Z,SD"),
    "wrong-profile": (409, "the query was sealed for another map or with an old profile"),
    "not-localized": (422, "no pose is supported by the query"),
    "queue-full": (503, "all workers are busy; send the same bytes again in 1 s"),
    "unreached": (503, "the region cannot be read at the moment; send the same bytes again"),
}


def application(
    store: str | os.PathLike[str],
    *,
    tokens: str | os.PathLike[str] | None = None,
    replicas: int | tuple[int, int] = 1,
    ingresses: int = 1,
    regions: int = 16,
    **options: Any,
) -> serve.Application:
    """The deployment, for `serve.run`.

    Args:
        store: folder that `veiloc map publish` wrote, on a path that all machines see.
        tokens: file with the tokens of gateways (`veiloc token new gateway --gateway --tokens FILE`), which is read now; without one,
            everybody may ask.
        replicas: processes with one thread each, or the least and the most of them for Ray's autoscaling.
        ingresses: processes that receive queries and pass them on; two or more, so that one may fail.
        regions: most regions that a replica holds open.
        options: further options of `serve.deployment`.
    """
    if isinstance(replicas, tuple):
        least, most = replicas
        options["autoscaling_config"] = {"min_replicas": least, "max_replicas": most, "target_ongoing_requests": 2}
    else:
        options["num_replicas"] = replicas
    known = _known_tokens(Path(tokens).read_text()) if tokens else None
    folder = Path(store).resolve()

    # `serve.multiplexed` needs the number when the class is made. One query is computed, and the next one waits in the replica.
    @serve.deployment(**{"name": "regions", "max_ongoing_requests": 2, "health_check_period_s": 1, "health_check_timeout_s": 1, **options})
    class Regions:
        def __init__(self) -> None:
            os.environ["RAYON_NUM_THREADS"] = "1"
            self.compute = asyncio.Lock()

        @serve.multiplexed(max_num_models_per_replica=regions)  # type: ignore[untyped-decorator]
        async def region(self, name: str) -> veiloc.Map:
            return await asyncio.to_thread(_open, folder, *name.split("/"))

        async def localize(self, body: bytes, is_rig: bool, near: tuple[float, ...] | None, is_json: bool) -> bytes | str:
            """The answer, or the name of the problem."""
            arrived = time.monotonic()
            try:
                region = await self.region(serve.get_multiplexed_model_id())
                frames = _frames(body) if is_rig else None
                async with self.compute:
                    waited = 1e3 * (time.monotonic() - arrived)
                    answer = await asyncio.to_thread(
                        lambda: region.localize(body, position=near) if frames is None else region.localize_rig(frames, position=near)
                    )
            except _Refused as refused:
                return str(refused)
            except veiloc.NotLocalizedError:
                return "not-localized"
            except veiloc.WrongProfileError:
                return "wrong-profile"
            except (veiloc.QueryError, veiloc.InputError):
                return "malformed-query"
            return answer.to_json().encode().ljust(LENGTH) if is_json else answer_bytes(answer, waited)

    @serve.deployment(
        name="ingress",
        num_replicas=ingresses,
        max_ongoing_requests=1000,
        health_check_period_s=1,
        health_check_timeout_s=1,
        ray_actor_options={"num_cpus": 0.1},
    )
    class Ingress:
        def __init__(self, regions: serve.handle.DeploymentHandle[Any]) -> None:
            self.regions = regions

        async def __call__(self, request: Request) -> Response:
            found = PATH.fullmatch(request.url.path)
            if request.url.path in ("/readyz", "/healthz"):
                return Response()
            if known is not None and not _is_known(request.headers.get("authorization", ""), known):
                return _refusal("unauthenticated")
            if not found or request.method != "POST":
                return _refusal("not-found")
            is_json = "application/x-protobuf" not in request.headers.get("accept", "")
            try:
                near = _near(request.headers.get("veiloc-near"))
                handle = self.regions.options(multiplexed_model_id=f"{found[1]}/{found[2]}")
                asked = (await request.body(), found[3] == "localize-rig", near, is_json)
                answer: bytes | str = "unreached"
                for _ in range(TRIES):
                    # A replica that hangs is replaced by Ray only after some seconds.
                    with contextlib.suppress(asyncio.TimeoutError):
                        answer = await asyncio.wait_for(handle.localize.remote(*asked), PATIENCE)
                        break
            except _Refused as refused:
                return _refusal(str(refused))
            except BackPressureError:
                return _refusal("queue-full")
            if isinstance(answer, str):
                return _refusal(answer)
            return Response(answer, media_type="application/json" if is_json else "application/x-protobuf")

    return Ingress.bind(Regions.bind())  # type: ignore[attr-defined, no-any-return]


class _Refused(Exception):
    """Its text is a name of `PROBLEMS`."""


def _refusal(name: str) -> Response:
    status, detail = PROBLEMS[name]
    document = {"type": f"urn:veiloc:problem:{name}", "title": name.replace("-", " ").capitalize(), "status": status, "detail": detail}
    headers = {}
    if name == "not-localized":
        document["state"] = "not-found"
    if status == 503:
        document["retry_after"], headers["retry-after"] = 1, "1"
    return Response(json.dumps(document).encode().ljust(LENGTH), status, headers, "application/problem+json")


def _known_tokens(text: str) -> set[bytes]:
    """SHA-256 of each token of a gateway. Tokens with an end, or for some maps only, are not among them."""
    lines = (line.split() for line in text.splitlines())
    return {bytes.fromhex(words[1]) for words in lines if words[2:] == ["gateway"]}


def _is_known(header: str, known: Iterable[bytes]) -> bool:
    digest = hashlib.sha256(header.removeprefix("Bearer ").encode()).digest()
    return any([hmac.compare_digest(digest, one) for one in known])


def _open(store: Path, name: str, region: str) -> veiloc.Map:
    """A region of a published map, verified: any manifest of the map may have it, because gateways change over one by one."""
    if "/" in name or name.startswith("."):
        raise _Refused("unknown-map")
    try:
        current = json.loads((store / f"{name}.json").read_text())["manifest"]
        others = sorted((store / "manifests").glob("*.json"), key=lambda path: path.stem != current)
        if not any(region in _regions_of(path, name) for path in others):
            raise _Refused("unknown-map")
        path = store / "objects" / region
        if hashlib.sha256(path.read_bytes()).hexdigest() != region:
            raise _Refused("unreached")
        return veiloc.Map.open(path)
    except FileNotFoundError:
        raise _Refused("unreached" if store.is_dir() and (store / f"{name}.json").exists() else "unknown-map") from None
    except (OSError, veiloc.MapError):
        raise _Refused("unreached") from None


def _regions_of(manifest: Path, name: str) -> set[str]:
    document = json.loads(manifest.read_text())
    return {region["sha256"] for region in document["regions"]} if document["map"] == name else set()


def _near(header: str | None) -> tuple[float, ...] | None:
    if header is None:
        return None
    try:
        x, y, z, sd = map(float, header.split(","))
    except ValueError:
        raise _Refused("bad-option") from None
    return x, y, z, sd


def _frames(body: bytes) -> list[Any]:
    """The frames of a rig message (docs/reference/http.md, several images at once)."""
    if body[:7] != b"vqrig1\n" or len(body) < 8:
        raise _Refused("malformed-query")
    frames, at = [], 8
    for _ in range(body[7]):
        if at + 76 > len(body):
            raise _Refused("malformed-query")
        w, x, y, z, *rest, length = struct.unpack_from("<9dI", body, at)
        at += 76
        pose = veiloc.CameraPose(q=[w, x, y, z], t=rest[:3])
        frames.append((body[at : at + length], pose, *rest[3:]) if any(rest[3:]) else (body[at : at + length], pose))
        at += length
    if at != len(body):
        raise _Refused("malformed-query")
    return frames


DOUBTS = ("other", "weak-evidence", "ambiguous", "imprecise", "one-sided")


def answer_bytes(answer: veiloc.Answer, queue_ms: float = 0.0) -> bytes:
    """An answer as a message `veiloc.v1.Answer` (proto/veiloc/v1/answer.proto), padded."""

    def key(field: int, wire: int) -> bytes:
        number = field << 3 | wire
        return bytes([number]) if number < 128 else bytes([number & 127 | 128, number >> 7])

    def block(field: int, data: bytes) -> bytes:
        count, length = len(data), b""
        while count > 127:
            length, count = length + bytes([count & 127 | 128]), count >> 7
        return key(field, 2) + length + bytes([count]) + data

    def fixed32(field: int, value: int) -> bytes:
        return key(field, 5) + struct.pack("<I", value)

    def double(field: int, value: float | None) -> bytes:
        return b"" if value is None else key(field, 1) + struct.pack("<d", value)

    def doubles(field: int, values: Any) -> bytes:
        numbers = [] if values is None else [float(value) for value in values]
        return block(field, struct.pack(f"<{len(numbers)}d", *numbers)) if numbers else b""

    # Not `answer.pose`, which normalizes the quaternion again.
    pose, ms = answer.to_dict().get("cam_from_world"), answer.ms
    doubts = (fixed32(1, DOUBTS.index(doubt.kind)) + block(2, doubt.text.encode()) for doubt in answer.doubts)
    covariance = answer.covariance
    before = b"".join(
        [
            fixed32(1, 1),
            *([] if pose is None else [doubles(2, pose["q"]), doubles(3, pose["t"])]),
            doubles(4, None if covariance is None else covariance.ravel()),
            *(block(5, doubt) for doubt in doubts),
            double(6, answer.log_evidence),
            double(7, answer.margin),
            fixed32(8, answer.inliers),
            fixed32(9, answer.matches),
            fixed32(10, answer.hypotheses),
            doubles(11, [queue_ms, ms["retrieve"], ms["match"], ms["pose"]]),
            fixed32(12, {None: 0, "used": 1, "unused": 2}[answer.gravity]),
            double(13, answer.metres_per_unit),
            doubles(14, answer.down),
        ]
    )
    after = double(16, answer.noise_px) + double(17, answer.focal_scale) + doubles(18, answer.principal_shift_px)
    # The padding has at least 128 bytes, so its length takes two.
    without = len(before) + len(after) + 3
    return before + block(15, bytes(-(without + 128) % LENGTH + 128)) + after


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m veiloc.ray_serve", description="Serve the regions of published maps with Ray Serve.")
    parser.add_argument("store", help="folder that `veiloc map publish` wrote, on a path that all machines see")
    parser.add_argument("--tokens", help="file with the tokens of gateways (default: everybody may ask)")
    parser.add_argument("--replicas", default="1", help="processes with one thread each, or LEAST-MOST for autoscaling (default: 1)")
    parser.add_argument("--ingresses", type=int, default=1, help="processes that receive queries and pass them on (default: 1)")
    parser.add_argument("--regions", type=int, default=16, help="most regions that a replica holds open (default: 16)")
    parser.add_argument("--listen", default="127.0.0.1:8080", help="address for gateways (default: 127.0.0.1:8080)")
    parser.add_argument("--address", help="address of the Ray cluster, or auto (default: start one on this machine)")
    parser.add_argument("--processors", type=int, help="without --address: how many processors Ray may assume (default: those of this machine)")
    args = parser.parse_args()
    ray.init(address=args.address, num_cpus=args.processors, log_to_driver=False, include_dashboard=False)
    host, _, port = args.listen.rpartition(":")
    serve.start(http_options={"host": host, "port": int(port)})
    count, _, most = args.replicas.partition("-")
    replicas = (int(count), int(most)) if most else int(count)
    served = application(args.store, tokens=args.tokens, replicas=replicas, ingresses=args.ingresses, regions=args.regions)
    print(f"regions of {args.store} will be served on {args.listen}; Ctrl-C stops it", file=sys.stderr, flush=True)
    serve.run(served, name="veiloc", route_prefix="/", blocking=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
