"""Builds a map on several machines: extraction, matching and the self-test run as Ray tasks.

    python -m veiloc.ray POSED IMAGES -o town.vmap --work FOLDER [--address auto]

All machines must see the image folder and the work folder under the same paths. Tasks cache their results in the work folder,
and the final build reads them. The map is byte-identical to a map that one machine builds. Ray repeats a task whose machine
fails, and the final build computes missing results itself.

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
class BuildResult:
    """A map, and the time of each stage of its build."""

    map: veiloc.Map
    #: Seconds of each stage, in the order of execution.
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
) -> BuildResult:
    """Builds a map with all processors of the Ray cluster, and writes it.

    Args:
        posed: folder of a COLMAP model with cameras and poses.
        images: folder of the images.
        out: the map file to write.
        work: folder that caches the results of tasks between calls. It holds keypoints and descriptors of the images.
        names, features, down, self_test, skip_bad: as for `veiloc.Map.build`.
        shares: tasks per stage. Default: four for each processor, so that a failed task costs little.
        retries: how many times to repeat a task whose machine or process failed.
        progress: a callable of (stage, done, total); it counts tasks.

    Raises:
        veiloc.Error: as for `veiloc.Map.build`.
        ray.exceptions.RayError: a task failed more often than `retries`.
    """
    started_here = not ray.is_initialized()
    if started_here:
        ray.init(log_to_driver=False, include_dashboard=False)
    try:
        resources: dict[str, float] = ray.cluster_resources()  # type: ignore[no-untyped-call]
        parts = shares or 4 * max(1, int(resources.get("CPU", 1)))
        out, work = Path(out).resolve(), Path(work).resolve()
        folders = (str(Path(posed).resolve()), str(Path(images).resolve()), str(work))
        options: dict[str, Any] = {"names": None if names is None else list(names), "features": features, "skip_bad": skip_bad}
        work.mkdir(parents=True, exist_ok=True)
        seconds: dict[str, float] = {}

        def timed(stage: str, call: Callable[[], Any]) -> Any:
            started = time.monotonic()
            result = call()
            seconds[stage] = time.monotonic() - started
            return result

        arguments = ray.put((folders, options))
        for stage in STAGES:
            tasks = _prepare.options(max_retries=retries)
            timed(stage, lambda: _wait_all(stage, [tasks.remote(arguments, stage, (part, parts)) for part in range(parts)], progress))
        result: veiloc.Map = timed(
            "build",
            lambda: veiloc.Map.build(posed, images, down=down, self_test=False, work=work, progress=progress, **options),
        )
        if self_test:
            result = timed("self-test", lambda: _with_self_test(result, work, parts, retries, progress))
        timed("write", lambda: result.save(out))
        return BuildResult(result, seconds)
    finally:
        if started_here:
            ray.shutdown()


def _with_self_test(
    built: veiloc.Map, work: Path, parts: int, retries: int, progress: Callable[[str, int, int], object] | None
) -> veiloc.Map:
    """The map with a self-test that all processors ran."""
    untested = work / "untested.vmap"
    built.save(untested)
    try:
        tasks = _test.options(max_retries=retries)
        shares = [tasks.remote(str(untested), (part, parts)) for part in range(parts)]
        return built.with_self_test(_wait_all("self-test", shares, progress))
    finally:
        untested.unlink(missing_ok=True)


def _wait_all(stage: str, shares: list[Any], progress: Callable[[str, int, int], object] | None) -> list[Any]:
    """Waits for all tasks and reports progress."""
    waiting = list(shares)
    while waiting:
        done, waiting = ray.wait(waiting, num_returns=1)
        try:
            ray.get(done)
        except ray.exceptions.RayTaskError as error:
            for share in waiting:
                ray.cancel(share)
            # Raise veiloc's own exception, without Ray's wrapper.
            raise error.as_instanceof_cause() from None  # type: ignore[no-untyped-call]
        if progress is not None:
            progress(stage, len(shares) - len(waiting), len(shares))
    return list(ray.get(shares))


def _one_thread() -> None:
    """Limits the library to the one processor of the task; the library reads the variable at its first call."""
    os.environ["RAYON_NUM_THREADS"] = "1"


@ray.remote(num_cpus=1)
def _prepare(arguments: tuple[tuple[str, str, str], dict[str, Any]], stage: str, share: tuple[int, int]) -> tuple[int, int]:
    _one_thread()
    (posed, images, work), options = arguments
    return veiloc.prepare(posed, images, work, stage, share, **options)


@ray.remote(num_cpus=1)
def _test(untested: str, share: tuple[int, int]) -> list[Any]:
    _one_thread()
    return veiloc.Map.open(untested).self_test_share(share)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m veiloc.ray", description="Build a map with all processors of a Ray cluster.")
    parser.add_argument("posed", help="folder of a COLMAP model with cameras and poses, on a path that all machines see")
    parser.add_argument("images", help="folder of the images, on a path that all machines see")
    parser.add_argument("-o", "--out", required=True, help="the map file to write")
    parser.add_argument("--work", required=True, help="folder that caches results, on a path that all machines see")
    parser.add_argument("--list", help="file with the names of the images to use, one on each line (default: every image of the model)")
    parser.add_argument("--features", default="compact", help="compact or sift (default: compact)")
    parser.add_argument("--no-self-test", action="store_true", help="skip the self-test, which localizes some of the map's own images")
    parser.add_argument("--skip-bad", action="store_true", help="skip images that cannot be used (default: stop with an error)")
    parser.add_argument("--address", help="address of the Ray cluster, or auto (default: start one on this machine)")
    parser.add_argument("--shares", type=int, help="tasks per stage (default: four for each processor)")
    parser.add_argument("--retries", type=int, default=3, help="how many times to repeat a task whose machine failed (default: 3)")
    parser.add_argument("--regions", help="split the map into regions, in this new folder (default: do not split)")
    parser.add_argument("--json", action="store_true", help="print the seconds of each stage as JSON")
    args = parser.parse_args()
    if args.address:
        ray.init(address=args.address, log_to_driver=False)
    names = None
    try:
        if args.list:
            names = [line.strip() for line in Path(args.list).read_text().splitlines() if line.strip()]
        built = build_map(
            args.posed,
            args.images,
            args.out,
            work=args.work,
            names=names,
            features=args.features,
            self_test=not args.no_self_test,
            skip_bad=args.skip_bad,
            shares=args.shares,
            retries=args.retries,
            progress=_print_progress,
        )
    except (veiloc.Error, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    if args.regions:
        started = time.monotonic()
        code = _split(args.out, args.regions)
        if code != 0:
            return code
        built.seconds["cut"] = time.monotonic() - started
    if args.json:
        print(json.dumps({"images": len(built.map), "seconds": built.seconds}))
    return 0


def _split(path: str, folder: str) -> int:
    from veiloc._native import run_program

    return run_program(["veiloc", "map", "split", path, "--out", folder])


def _print_progress(stage: str, done: int, total: int) -> None:
    end = "\n" if done >= total else ""
    print(f"\r{stage} {done}/{total}", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
