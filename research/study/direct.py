"""Table of docs/results/poses.md: matching with all points of a map, without retrieval.

The descriptors of a map are those of its images' keypoints (`veiloc features`), with the points that the map has for them (`map export`).
Each row of a query is compared with all of them: its nearest point, the distance of the nearest row of anything else (ratio), and how many
of the ten nearest rows are of the same point (votes). The ten nearest are exact, or those of an index (HNSW).
"""

import gzip
import json
import time as clock
from pathlib import Path

from study.common import PLACES, RIGHT, Package, cm, command, names_of, percent

PAGE = "poses"
np, h5py, pycolmap, spatial, usearch = Package("numpy"), Package("h5py"), Package("pycolmap"), Package("scipy.spatial"), Package("usearch.index")
NEAREST, PART = 10, 128
#: HNSW: neighbours of a row, and candidates of a search.
CONNECTIONS, CANDIDATES = 16, 128


def unit(rows):
    rows = np.asarray(rows, np.float32)
    return rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)


class Place:
    """The rows of a map with their points, its queries, and the problems by retrieval."""

    def __init__(self, run, name: str):
        folder, kept, lists = run.place(name), run.kept() / "direct" / name, ("map.txt", "query.txt")
        kept.mkdir(parents=True, exist_ok=True)
        features, colmap, keypoints = kept / "features.h5", kept / "colmap", kept / "keypoints.jsonl.gz"
        if not keypoints.exists():
            names = run.listed(f"direct-{name}", [image for own in lists for image in names_of(folder / own)])
            run.run("features", folder / "images", "--list", names, "--out-hloc", features, "--quiet")
            stored = ["--features", "compact", "--features-file", features]
            own_map = run.made(kept / "place.vmap", "map", "build", *run.posed(name), "--list", folder / "map.txt", *stored)
            run.run("map", "export", own_map, "--colmap", colmap, "--quiet")
            run.run("eval", "problems", *run.scene(name), *stored, "-o", kept / "retrieved.jsonl", "--keypoints", keypoints, "--quiet")
        self.folder, self.retrieved = kept, kept / "retrieved.jsonl"
        self.rows, self.points, self.seen, self.lengths = self.of_map(features, colmap)
        with gzip.open(keypoints, "rt") as lines, self.retrieved.open() as problems:
            self.queries = [(json.loads(problem), self.query(json.loads(line))) for problem, line in zip(problems, lines)]

    @staticmethod
    def of_map(features: Path, colmap: Path):
        """Descriptors `[N, D]`, point of each row or -1 `[N]`, positions by point, and lengths of tracks."""
        model, rows, points = pycolmap.Reconstruction(colmap), [], []
        with h5py.File(features) as file:
            for image in model.images.values():
                at = np.array([p.xy for p in image.points2D]).reshape(-1, 2)
                own = np.array([p.point3D_id if p.has_point3D() else -1 for p in image.points2D], np.int64)
                stored = file[image.name]
                away, nearest = spatial.cKDTree(at).query(stored["keypoints"][()] + 0.5)
                rows.append(unit(stored["descriptors"][()].T))
                points.append(np.where(away < 0.05, own[nearest], -1))
        found = {key: (point.xyz, point.track.length()) for key, point in model.points3D.items()}
        return np.vstack(rows), np.concatenate(points), {k: v[0] for k, v in found.items()}, {k: v[1] for k, v in found.items()}

    @staticmethod
    def query(line: dict):
        import base64

        numbers = np.frombuffer(base64.b64decode(line["descriptors"]), np.uint8).reshape(-1, line["descriptor_dim"]).astype(np.int16)
        return np.array(line["keypoints"]).reshape(-1, 2), unit(numbers - (128 if line["descriptor_encoding"] != "unsigned" else 0))


def searched(rows, by_index: bool):
    """Finds the nearest rows of queries: `[N, NEAREST]` rows and squared distances, and for each row the query that is nearest to it of those
    that named it first."""
    rows = np.ascontiguousarray(rows)

    def exactly(query):
        """In parts, which fit in the caches."""
        keys = np.empty((len(query), NEAREST), np.int64)
        for at in range(0, len(query), PART):
            products = query[at : at + PART] @ rows.T
            keys[at : at + PART] = np.argpartition(products, -NEAREST, axis=1)[:, -NEAREST:]
        distances = np.maximum(2 - 2 * np.einsum("nd,nkd->nk", query, rows[keys]), 0)
        order = distances.argsort(axis=1, kind="stable")
        return np.take_along_axis(keys, order, 1), np.take_along_axis(distances, order, 1)

    if by_index:
        index = usearch.Index(ndim=rows.shape[1], metric="ip", connectivity=CONNECTIONS, expansion_search=CANDIDATES)
        index.add(np.arange(len(rows)), rows)

    def search(query):
        if by_index:
            found = index.search(query, NEAREST, threads=1)
            keys, distances = found.keys.astype(np.int64), 2 * found.distances
        else:
            keys, distances = exactly(query)
        best = {}
        for row, (key, distance) in enumerate(zip(keys[:, 0], distances[:, 0])):
            if key not in best or distance < best[key][0]:
                best[key] = (distance, row)
        return keys, distances, {key: row for key, (_, row) in best.items()}

    return search


def problem(place: Place, line: dict, query, search) -> dict:
    """The matches of a query with all points of the map, mutual ones only, as a problem."""
    keypoints, rows = query
    nearest, distances, best = search(rows)
    points = place.points[nearest]
    of_point = points[:, 0]
    is_other = points != of_point[:, None]
    second = np.where(is_other.any(axis=1), distances[np.arange(len(rows)), is_other.argmax(axis=1)], distances[:, -1])
    kept = [i for i in range(len(rows)) if of_point[i] >= 0 and best[nearest[i, 0]] == i]
    ratio = np.sqrt(np.maximum(distances[:, 0], 0) / np.maximum(second, 1e-12))
    return {key: line[key] for key in ("name", "camera", "cam_from_world", "features") if key in line} | {
        "points2d": keypoints[kept].tolist(), "points3d": [place.seen[of_point[i]].tolist() for i in kept],
        "ratio": np.minimum(ratio[kept], 1).tolist(), "votes": [int((~is_other[i]).sum()) for i in kept],
        "track_length": [place.lengths[of_point[i]] for i in kept]}  # fmt: skip


@command("poses/direct.csv", needs="h5py, pycolmap, scipy and usearch", places=PLACES,
         large=(["redkitchen"], "places with two more rows, among the rows of --others"), others=("training-photos", "images of elsewhere"),
         most=(400, "how many of them"))  # fmt: skip
def direct(run):
    """Matching with all points of the map beside matching with ten retrieved images: recall and time, exact and with an index, also among
    the rows of images of elsewhere."""
    table = run.table("poses/direct.csv", "place", "matched with", "map rows", "ms a query", "matches (median)", "estimator",
                      *(f"{scheme}, {what}" for scheme in ("points", "dcl") for what in ("within 25 cm and 2° (%)", "median error (cm)")))  # fmt: skip
    far = other_rows(run) if set(run.large) & set(run.places) else None
    for name in run.places:
        place = Place(run, name)
        cases = [("10 retrieved images", None, place.rows), ("all rows", False, place.rows), ("all rows, by an index", True, place.rows)]
        if name in run.large:
            together = np.vstack([place.rows, far])
            cases += [("all rows, and others'", False, together), ("all rows, and others', by an index", True, together)]
        own = place.points
        for what, by_index, rows in cases:
            place.points = np.concatenate([own, np.full(len(rows) - len(own), -1, np.int64)])
            file, ms = place.retrieved, ""
            if by_index is not None:
                search, file = searched(rows, by_index), place.folder / f"{what.replace(' ', '-')}.jsonl"
                started = clock.perf_counter()
                lines = [problem(place, line, query, search) for line, query in place.queries]
                ms = f"{1e3 * (clock.perf_counter() - started) / len(lines):.0f}"
                file.write_text("".join(json.dumps(line) + "\n" for line in lines))
            matches = sorted(len(json.loads(line)["points2d"]) for line in file.read_text().splitlines())
            for estimator in ("default", "likelihood"):
                found = run.json("eval", "pose", file, "--schemes", "points,dcl", "--estimator", estimator, "--thresholds", RIGHT)
                cells = [cell for row in found["schemes"] for cell in (percent(row["recall"][RIGHT]), cm(row["median_translation"]))]
                table.add([name, what, len(rows), ms, matches[len(matches) // 2], estimator, *cells])


def other_rows(run):
    """Rows of images of elsewhere."""
    file = run.kept() / "direct" / "others.h5"
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        names = sorted(str(path.relative_to(run.place(run.others))) for path in run.place(run.others).rglob("*.jpg"))
        listed = run.listed("direct-others", names[:: max(1, len(names) // run.most)])
        run.run("features", run.place(run.others), "--list", listed, "--max-keypoints", 1024, "--out-hloc", file, "--quiet")
    found = []
    with h5py.File(file) as stored:
        stored.visititems(lambda _, entry: found.append(unit(entry[()].T)) if entry.name.endswith("/descriptors") else None)
    return np.vstack(found)
