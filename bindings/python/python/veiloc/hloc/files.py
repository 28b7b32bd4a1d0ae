"""Reads hloc's files: lists of images with intrinsics, retrieval pairs, and features and matches in HDF5."""

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from veiloc.errors import InputError

if TYPE_CHECKING:
    from veiloc._native import CameraModel, _CameraFields as Camera


def read_queries(path: Path) -> "list[tuple[str, Camera]]":
    """Names and cameras of a list `NAME MODEL WIDTH HEIGHT PARAMS...`; `path` may be a pattern (`queries_*.txt`).

    Raises:
        InputError: the file does not exist or has no query, or a line has no valid camera.
    """
    files = sorted(path.parent.glob(path.name))
    if not files:
        raise InputError(f"{path}: no such list of queries")
    queries: list[tuple[str, Camera]] = []
    for file in files:
        for number, line in enumerate(file.read_text().splitlines(), 1):
            line = line.strip()
            if not line or line.startswith("#"):
                continue
            try:
                name, model, width, height, *params = line.split()
                camera: Camera = {
                    "model": cast("CameraModel", model),
                    "width": int(width),
                    "height": int(height),
                    "params": np.array(params, dtype=float),
                }
            except ValueError:
                raise InputError(f"{file}:{number}: must be NAME MODEL WIDTH HEIGHT PARAMS...") from None
            queries.append((name, camera))
    if not queries:
        raise InputError(f"{path}: the list holds no query")
    return queries


def read_retrieval(path: Path) -> dict[str, list[str]]:
    """Retrieved map images of each query, best first, from a file of pairs `QUERY IMAGE`.

    Raises:
        InputError: the file does not exist, or a line is not a pair.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file of retrieval pairs")
    pairs = defaultdict(list)
    for number, line in enumerate(path.read_text().splitlines(), 1):
        words = line.split()
        if not words:
            continue
        if len(words) != 2:
            raise InputError(f"{path}:{number}: must be a pair of names, QUERY IMAGE")
        pairs[words[0]].append(words[1])
    return dict(pairs)


class Hdf5:
    """Features or matches of hloc, open for reading.

    Raises:
        ImportError: h5py is not installed.
        InputError: the file cannot be read, or does not hold the requested data.
    """

    def __init__(self, path: Path) -> None:
        try:
            import h5py
        except ImportError as error:
            raise ImportError("veiloc.hloc reads HDF5 with h5py: pip install veiloc[hloc]") from error
        self._path = path
        try:
            self._file = h5py.File(str(path), "r", libver="latest")
        except OSError as error:
            raise InputError(f"{path}: {error}") from error

    def __enter__(self) -> "Hdf5":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def keypoints(self, name: str) -> npt.NDArray[np.float64]:
        """Keypoints of an image, `[N, 2]`, COLMAP's pixels (in the file the first pixel's centre is (0, 0))."""
        if name not in self._file or "keypoints" not in self._file[name]:
            raise InputError(f"{self._path}: no keypoints of {name}")
        keypoints = np.asarray(self._file[name]["keypoints"], dtype=np.float64)
        if keypoints.ndim != 2 or keypoints.shape[1] < 2:
            raise InputError(f"{self._path}: the keypoints of {name} are not an array [N, 2]")
        return keypoints[:, :2] + 0.5

    def matches(self, query: str, image: str) -> npt.NDArray[np.int64]:
        """Matches of a pair, `[M, 2]`: keypoint indices in the query and in the map image."""
        for first, second, flip in ((query, image, False), (image, query, True)):
            a, b = first.replace("/", "-"), second.replace("/", "-")
            for key in (f"{a}/{b}", f"{a}_{b}"):
                if key in self._file:
                    partners = np.asarray(self._file[key]["matches0"], dtype=np.int64).ravel()
                    own = np.flatnonzero(partners != -1)
                    pairs = np.stack([own, partners[own]], -1)
                    return pairs[:, ::-1] if flip else pairs
        raise InputError(f"{self._path}: no matches of {query} with {image}; match the pairs of the retrieval first")
