"""`veiloc.hloc`: reads hloc's files, writes its results file; compared with the same step in pycolmap."""

import pickle
import runpy
from pathlib import Path

import numpy as np
import pytest

import veiloc
from conftest import evenly_spaced
from veiloc.hloc import localize_sfm

h5py = pytest.importorskip("h5py")


@pytest.fixture(scope="session")
def pipeline(redkitchen, tmp_path_factory):
    """hloc's files for a part of RedKitchen: model with points, OpenCV SIFT features and matches, retrieval pairs."""
    cv2, _pycolmap = pytest.importorskip("cv2"), pytest.importorskip("pycolmap")
    root = tmp_path_factory.mktemp("hloc")
    posed = veiloc.ColmapModel.open(redkitchen / "posed")
    mapped = evenly_spaced((redkitchen / "map.txt").read_text().split(), 24)
    queries = evenly_spaced((redkitchen / "query.txt").read_text().split(), 6)
    sift, seen = cv2.SIFT_create(1500), {}
    with h5py.File(root / "features.h5", "w") as file:
        for name in mapped + queries:
            points, descriptors = sift.detectAndCompute(cv2.imread(str(redkitchen / "images" / name), 0), None)
            seen[name] = np.array([p.pt for p in points], np.float32), descriptors
            file.create_group(name)["keypoints"] = seen[name][0]
    matcher = cv2.BFMatcher(crossCheck=True)
    match = lambda a, b: [(m.queryIdx, m.trainIdx) for m in matcher.match(seen[a][1], seen[b][1])]
    center = {name: posed.pose(name).center for name in mapped + queries}
    nearest = {q: sorted(mapped, key=lambda m: np.linalg.norm(center[m] - center[q]))[:5] for q in queries}
    with h5py.File(root / "matches.h5", "w") as file:
        for query, images in nearest.items():
            for image in images:
                partners = np.full(len(seen[query][0]), -1, np.int32)
                for own, other in match(query, image):
                    partners[own] = other
                group = file.create_group("/".join(n.replace("/", "-") for n in (query, image)))
                group["matches0"] = partners
    (root / "pairs.txt").write_text("".join(f"{q} {m}\n" for q, images in nearest.items() for m in images))
    camera = posed.camera(queries[0])
    words = [camera["model"], camera["width"], camera["height"], *camera["params"]]
    (root / "queries.txt").write_text("".join(f"{q} {' '.join(map(str, words))}\n" for q in queries))
    write_model(root / "sfm", posed, mapped, seen, match, camera)
    return root, posed, queries


def write_model(folder, posed, mapped, seen, match, camera):
    """Writes a COLMAP text model whose points are triangulated from pairs of posed images."""
    focal, cx, cy = camera["params"][:3]
    points, of = [], {name: np.full(len(seen[name][0]), -1) for name in mapped}
    for first, second in zip(mapped, mapped[1:]):
        pairs = [(a, b) for a, b in match(first, second) if of[first][a] == of[second][b] == -1]
        for a, b in pairs:
            rows = []
            for name, keypoint in ((first, a), (second, b)):
                x, y = (seen[name][0][keypoint] + 0.5 - [cx, cy]) / focal
                Rt = posed.pose(name).Rt
                rows += [x * Rt[2] - Rt[0], y * Rt[2] - Rt[1]]
            X = np.linalg.svd(np.array(rows))[2][-1]
            X = X[:3] / X[3]
            off = []
            for name, keypoint in ((first, a), (second, b)):
                seen_at = posed.pose(name).R @ X + posed.pose(name).t
                pixel = focal * seen_at[:2] / seen_at[2] + [cx, cy]
                off.append(np.inf if seen_at[2] <= 0 else np.abs(pixel - seen[name][0][keypoint] - 0.5).max())
            if max(off) < 2:
                of[first][a] = of[second][b] = len(points) + 1
                points.append((X, (first, a), (second, b)))
    folder.mkdir()
    ids = {name: i for i, name in enumerate(mapped, 1)}
    numbers = " ".join(map(str, camera["params"]))
    (folder / "cameras.txt").write_text(f"1 {camera['model']} {camera['width']} {camera['height']} {numbers}\n")
    lines = []
    for name in mapped:
        pose = posed.pose(name)
        lines.append(f"{ids[name]} {' '.join(map(str, [*pose.q, *pose.t]))} 1 {name}")
        both = zip(seen[name][0] + 0.5, of[name])
        lines.append(" ".join(f"{x} {y} {point}" for (x, y), point in both))
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [
        f"{i} {' '.join(map(str, X))} 0 0 0 0.5 " + " ".join(f"{ids[n]} {k}" for n, k in track)
        for i, (X, *track) in enumerate(points, 1)
    ]
    (folder / "points3D.txt").write_text("\n".join(rows) + "\n")


def read_results(path):
    poses = {}
    for line in path.read_text().splitlines():
        name, *numbers = line.split()
        numbers = list(map(float, numbers))
        poses[name] = veiloc.CameraPose(numbers[:4], numbers[4:])
    return poses


def hloc_reference(root, queries):
    """The steps of hloc's `pose_from_cluster` with pycolmap, for all queries."""
    import pycolmap
    from veiloc.hloc.files import Hdf5, read_queries, read_retrieval

    model = pycolmap.Reconstruction(str(root / "sfm"))
    by_name = {image.name: image for image in model.images.values()}
    retrieval, poses = read_retrieval(root / "pairs.txt"), {}
    with Hdf5(root / "features.h5") as features, Hdf5(root / "matches.h5") as matches:
        for name, camera in read_queries(root / "queries.txt"):
            kpq, pairs = features.keypoints(name), {}
            for db in retrieval[name]:
                ids = [p.point3D_id if p.has_point3D() else -1 for p in by_name[db].points2D]
                for own, other in matches.matches(name, db):
                    if ids[other] != -1:
                        pairs.setdefault((own, ids[other]))
            own = np.array([p[0] for p in pairs])
            xyz = np.array([model.points3D[p[1]].xyz for p in pairs])
            camera = pycolmap.Camera(**{**camera, "params": list(camera["params"])})
            options = {"ransac": {"max_error": 12}}
            found = pycolmap.estimate_and_refine_absolute_pose(
                kpq[own], xyz, camera, estimation_options=options
            )
            if found is not None:
                rigid = found["cam_from_world"]
                poses[name] = veiloc.CameraPose(R=rigid.rotation.matrix(), t=rigid.translation)
    return poses


@pytest.mark.parametrize("scheme", ["points", "dcl", "random-lines", "coordinate-permutation"])
def test_accuracy_matches_hloc(pipeline, tmp_path, scheme):
    root, posed, queries = pipeline
    files = [root / "sfm", root / "queries.txt", root / "pairs.txt", root / "features.h5", root / "matches.h5"]
    results = tmp_path / "results.txt"
    returned = localize_sfm.main(*files, results, scheme=scheme)
    written = read_results(results)
    assert set(returned) == set(queries) and len(written) == len(queries)
    theirs = hloc_reference(root, queries)
    errors = []
    for query in queries:
        ours = written[query.rsplit("/", 1)[-1]]
        assert max(ours.error(returned[query])) < 1e-6, "the file holds what was returned"
        errors.append((*ours.error(posed.pose(query)), *theirs[query].error(posed.pose(query))))
    degrees, metres, their_degrees, their_metres = np.median(errors, axis=0)
    assert their_metres < 0.1, "hloc's own steps work on these files"
    # Points give the same information as in hloc; lines give half of it.
    cost = 0.005 if scheme == "points" else 0.02
    assert metres < cost + 2 * their_metres and degrees < 10 * cost + 2 * their_degrees
    logs = pickle.loads((tmp_path / "results.txt_logs.pkl").read_bytes())
    log = logs["loc"][queries[0]]
    assert log["PnP_ret"]["num_inliers"] > 0 and log["num_matches"] >= len(log["points3D_ids"])
    assert len(log["keypoints_query"]) == len(log["points3D_ids"])


def test_hloc_options(pipeline, tmp_path):
    root, posed, queries = pipeline
    files = [root / "sfm", root / "quer*.txt", root / "pairs.txt", root / "features.h5", root / "matches.h5"]
    results = tmp_path / "results.txt"
    localize_sfm.main(
        *files,
        results,
        ransac_thresh=8,
        covisibility_clustering=True,
        prepend_camera_name=False,
        config={"ransac_opt": {"score": "msac"}},
    )
    assert len(read_results(results)) == len(queries)
    logs = pickle.loads((tmp_path / "results.txt_logs.pkl").read_bytes())
    assert all(log["covisibility_clustering"] for log in logs["loc"].values())


def test_hloc_example_runs(pipeline, capsys):
    root, _, queries = pipeline
    example = Path(__file__).parents[3] / "examples/python/hloc_pipeline.py"
    runpy.run_path(str(example))["main"](root)
    assert capsys.readouterr().out.count("points and lines are") == len(queries)


def test_inconsistent_files_are_refused(pipeline, tmp_path):
    root, _, queries = pipeline
    files = [root / "sfm", root / "queries.txt", root / "pairs.txt", root / "features.h5", root / "matches.h5"]

    def call(changed, **options):
        localize_sfm.main(*[changed.get(i, f) for i, f in enumerate(files)], tmp_path / "r.txt", **options)

    (tmp_path / "bad.txt").write_text("one two three\n")
    with pytest.raises(veiloc.MapError):
        call({0: tmp_path / "nothing"})
    with pytest.raises(veiloc.InputError, match="bad.txt:1"):
        call({1: tmp_path / "bad.txt"})
    with pytest.raises(veiloc.InputError, match="bad.txt:1"):
        call({2: tmp_path / "bad.txt"})
    with pytest.raises(veiloc.InputError, match="bad.txt"):
        call({3: tmp_path / "bad.txt"})
    with pytest.raises(veiloc.InputError, match="no matches"):
        call({4: root / "features.h5"})
    with pytest.raises(veiloc.InputError, match="max_error"):
        call({}, config={"max_error": 3})
    with pytest.raises(veiloc.QueryError, match="scheme"):
        call({}, scheme="lines")
