"""Maps that many machines build: extraction, matching and the self-test as Ray tasks.

    python -m veiloc.ray POSED IMAGES -o town.vmap --work FOLDER [--address auto]

The folders of the images and of the work must be seen by all machines under the same names. What a task computes is kept in the
work folder, and the map is built of that at the end: it is the map that one machine would have built, to the byte. A task whose
machine dies is done again by another one; what is lost all the same, the build computes by itself.

Needs Ray (`pip install ray`); `import veiloc` does not.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import ray

import veiloc

STAGES = ("features", "first-pairs", "pairs")


@dataclass
class Built:
    """A map, and how long each part of it took."""

    map: veiloc.Map
    #: Seconds of each stage, in order.
    seconds: dict[str, float] = field(default_factory=dict)


def build_map(
    posed: str | os.PathLike[str],
    images: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    work: str | os.PathLike[str],
    names: Sequence[str] | None = None,
    features: str = "compact",
    down: Any = None,
    self_test: bool = True,
    skip_bad: bool = False,
    shares: int | None = None,
    retries: int = 3,
    progress: Callable[[str, int, int], object] | None = None,
) -> Built:
    """Builds a map with all processors that Ray has, and writes it.

    Args:
        posed: the folder of a COLMAP model with cameras and poses.
        images: the folder of the images.
        out: the map's file.
        work: the folder of what tasks compute; it may have been used before. It holds keypoints and descriptors of the images.
        names, features, down, self_test, skip_bad: as of `veiloc.Map.build`.
        shares: parts of each stage. Default: four times as many as there are processors, so that one that dies costs little.
        retries: how often a share is done again whose machine or process dies.
        progress: a callable of (stage, done, total), total being shares.

    Raises:
        veiloc.Error: as `veiloc.Map.build`; ray.exceptions.RayError: more deaths than retries.
    """
    started_here = not ray.is_initialized()
    if started_here:
        ray.init(log_to_driver=False, include_dashboard=False)
    try:
        resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
        parts = shares or 4 * max(1, int(resources.get("CPU", 1)))
        out, work = Path(out).resolve(), Path(work).resolve()
        where = (str(Path(posed).resolve()), str(Path(images).resolve()), str(work))
        options: dict[str, Any] = {"names": None if names is None else list(names), "features": features, "skip_bad": skip_bad}
        work.mkdir(parents=True, exist_ok=True)
        seconds: dict[str, float] = {}

        def timed(stage: str, done: Callable[[], Any]) -> Any:
            started = time.monotonic()
            result = done()
            seconds[stage] = time.monotonic() - started
            return result

        given = ray.put((where, options))
        for stage in STAGES:
            tasks = _prepare.options(max_retries=retries)
            timed(stage, lambda: _all(stage, [tasks.remote(given, stage, (part, parts)) for part in range(parts)], progress))
        result: veiloc.Map = timed(
            "build",
            lambda: veiloc.Map.build(posed, images, down=down, self_test=False, work=work, progress=progress, **options),
        )
        if self_test:
            result = timed("self-test", lambda: _tested(result, work, parts, retries, progress))
        timed("write", lambda: result.save(out))
        return Built(result, seconds)
    finally:
        if started_here:
            ray.shutdown()


def _tested(
    built: veiloc.Map, work: Path, parts: int, retries: int, progress: Callable[[str, int, int], object] | None
) -> veiloc.Map:
    """The map with its self-test, made by all."""
    untested = work / "untested.vmap"
    built.save(untested)
    try:
        tasks = _test.options(max_retries=retries)
        shares = [tasks.remote(str(untested), (part, parts)) for part in range(parts)]
        return built.with_self_test(_all("self-test", shares, progress))
    finally:
        untested.unlink(missing_ok=True)


def _all(stage: str, shares: list[Any], progress: Callable[[str, int, int], object] | None) -> list[Any]:
    """Waits for all shares, telling how many are done."""
    waiting = list(shares)
    while waiting:
        done, waiting = ray.wait(waiting, num_returns=1)
        try:
            ray.get(done)
        except ray.exceptions.RayTaskError as error:
            for share in waiting:
                ray.cancel(share)
            # What veiloc said, as it said it.
            raise error.as_instanceof_cause() from None  # type: ignore[no-untyped-call]
        if progress is not None:
            progress(stage, len(shares) - len(waiting), len(shares))
    return list(ray.get(shares))


def _one_thread() -> None:
    """A share has one processor; what the library computes with is decided at its first call."""
    os.environ["RAYON_NUM_THREADS"] = "1"


@ray.remote(num_cpus=1)
def _prepare(given: tuple[tuple[str, str, str], dict[str, Any]], stage: str, share: tuple[int, int]) -> tuple[int, int]:
    _one_thread()
    (posed, images, work), options = given
    return veiloc.prepare(posed, images, work, stage, share, **options)


@ray.remote(num_cpus=1)
def _test(untested: str, share: tuple[int, int]) -> list[Any]:
    _one_thread()
    return veiloc.Map.open(untested).self_test_share(share)


def main() -> int:
    words = argparse.ArgumentParser(prog="python -m veiloc.ray", description="Build a map with all processors of a Ray cluster.")
    words.add_argument("posed", help="folder of a COLMAP model with cameras and poses, seen by all machines")
    words.add_argument("images", help="folder of the images, seen by all machines")
    words.add_argument("-o", "--out", required=True, help="the map file to write")
    words.add_argument("--work", required=True, help="folder for what tasks compute, seen by all machines")
    words.add_argument("--list", help="names of the images to use, one a line (default: every image of the model)")
    words.add_argument("--features", default="compact", help="compact or sift (default: compact)")
    words.add_argument("--no-self-test", action="store_true", help="do not let the map localize some of its own images")
    words.add_argument("--skip-bad", action="store_true", help="leave out images that cannot be used (default: refuse)")
    words.add_argument("--address", help="of the Ray cluster, or auto (default: one that is started on this machine)")
    words.add_argument("--shares", type=int, help="parts of each stage (default: four times as many as processors)")
    words.add_argument("--retries", type=int, default=3, help="how often a share is done again whose machine dies (default: 3)")
    words.add_argument("--regions", help="cut the map into regions, in this new folder (default: it stays whole)")
    words.add_argument("--json", action="store_true", help="print the seconds of each stage as JSON")
    asked = words.parse_args()
    if asked.address:
        ray.init(address=asked.address, log_to_driver=False)
    names = None
    try:
        if asked.list:
            names = [line.strip() for line in Path(asked.list).read_text().splitlines() if line.strip()]
        built = build_map(
            asked.posed,
            asked.images,
            asked.out,
            work=asked.work,
            names=names,
            features=asked.features,
            self_test=not asked.no_self_test,
            skip_bad=asked.skip_bad,
            shares=asked.shares,
            retries=asked.retries,
            progress=_told,
        )
    except (veiloc.Error, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if asked.regions:
        started = time.monotonic()
        code = _split(asked.out, asked.regions)
        if code != 0:
            return code
        built.seconds["cut"] = time.monotonic() - started
    if asked.json:
        print(json.dumps({"images": len(built.map), "seconds": built.seconds}))
    return 0


def _split(path: str, folder: str) -> int:
    from veiloc._native import run_program

    return run_program(["veiloc", "map", "split", path, "--out", folder])


def _told(stage: str, done: int, total: int) -> None:
    end = "\n" if done >= total else ""
    print(f"\r{stage} {done}/{total}", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
