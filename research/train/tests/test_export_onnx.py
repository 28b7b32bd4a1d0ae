"""`scripts/export_onnx.py` against the reference outputs of the program's tests."""

import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

onnxruntime = pytest.importorskip("onnxruntime")

ROOT = Path(__file__).resolve().parents[3]
DATA = ROOT / "crates/device/features/tests/data/learned"


@pytest.fixture(scope="module")
def exports():
    spec = importlib.util.spec_from_file_location("export_onnx", ROOT / "scripts/export_onnx.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["export_onnx"] = module
    spec.loader.exec_module(module)
    return module


def drawn(width: int, height: int) -> np.ndarray:
    """The image of `research/oracles/networks.py`."""
    y, x = np.mgrid[:height, :width]
    a, b = x // 11, y // 13
    return (((a * 7 + b * 11 + (a ^ b) * 37) % 160 + (x * 7 + y * 13 + x * y) % 31 + x % 50) / 255).astype(np.float32)


def continued(gray: np.ndarray, multiple: int, margin: int = 32) -> np.ndarray:
    """Reflected padding to sides that are multiples."""
    whole = [-(-(side + 2 * margin) // multiple) * multiple for side in gray.shape]
    pads = [((w - s) // 2, w - s - (w - s) // 2) for w, s in zip(whole, gray.shape)]
    return np.pad(gray, pads, mode="symmetric")


def written(exports, monkeypatch, path, *arguments):
    monkeypatch.setattr(sys, "argv", ["export_onnx.py", *map(str, arguments), str(path)])
    exports.main()
    return onnxruntime.InferenceSession(str(path))


def weights(name: str) -> Path:
    """A file next to the folder VEILOC_DATA."""
    file = Path(os.environ.get("VEILOC_DATA", "")) / "../weights" / name
    if "VEILOC_DATA" not in os.environ or not file.exists():
        pytest.skip(f"VEILOC_DATA names no folder with ../weights/{name} beside it")
    return file


def test_netvlad_matches_the_reference(exports, monkeypatch, tmp_path):
    pytest.importorskip("scipy")
    session = written(exports, monkeypatch, tmp_path / "netvlad.onnx", "netvlad", DATA / "netvlad.mat")
    known = json.loads((DATA / "netvlad.json").read_text())
    image = np.repeat(drawn(*known["size"])[None, None], 3, axis=1)
    assert np.allclose(session.run(["vector"], {"image": image})[0][0], known["vector"], atol=2e-5)


@pytest.mark.parametrize("name, file", [("alike", "alike/alike-n.npz"), ("alike-t", "alike/alike-t.pth")])
def test_alike_layers_match_the_reference(exports, monkeypatch, tmp_path, name, file):
    session = written(exports, monkeypatch, tmp_path / "alike.onnx", "alike", weights(file))
    known = json.loads((DATA / "oracle.json").read_text())[name]
    gray = continued(drawn(*known["size"]), 32)
    for layer in ("scores", "level1", "level2", "level3", "level4"):
        value = session.run([layer], {"image": np.repeat(gray[None, None], 3, axis=1)})[0]
        entry = known["layers"][layer]
        assert list(value.shape) == entry["shape"]
        assert np.abs(value.ravel()[entry["at"]] - entry["values"]).max() < 1e-4 * max(entry["largest"], 1.0), layer
    head = session.run(["head"], {"image": np.zeros((1, 3, 32, 32), np.float32)})[0]
    assert head.shape[0] == head.shape[1] == 4 * known["layers"]["level1"]["shape"][1]


def test_alike_dense_descriptors_equal_head_of_upsampled_levels(exports, monkeypatch, tmp_path):
    session = written(exports, monkeypatch, tmp_path / "alike.onnx", "alike", "--dense", weights("alike/alike-t.pth"))
    image = np.repeat(drawn(96, 64)[None, None], 3, axis=1)
    names = ["level1", "level2", "level3", "level4", "head", "descriptors"]
    *levels, head, dense = (torch.from_numpy(x) for x in session.run(names, {"image": image}))
    size = image.shape[-2:]
    joined = torch.cat([torch.nn.functional.interpolate(x, size, mode="bilinear", align_corners=True) for x in levels], 1)
    assert (torch.einsum("od,bdhw->bohw", head, joined) - dense).abs().max() < 1e-3


def test_aliked_matches_torchvision(exports, monkeypatch, tmp_path):
    pytest.importorskip("torchvision")
    monkeypatch.syspath_prepend(str(ROOT / "research/oracles"))
    import aliked

    tensors = aliked.made_up()
    reference = aliked.Reference(tensors)
    torch.save(tensors, tmp_path / "made-up.pth")
    session = written(exports, monkeypatch, tmp_path / "aliked.onnx", "aliked", tmp_path / "made-up.pth")
    image = np.repeat(drawn(160, 128)[None, None], 3, axis=1)
    maps = session.run(["scores", "features"], {"image": image})
    with torch.no_grad():
        for own, theirs in zip(maps, reference.maps(torch.from_numpy(image))):
            assert np.abs(own - theirs.numpy()).max() < 1e-4
        points = np.random.default_rng(0).uniform([40, 40], [120, 90], (9, 2)).astype(np.float32)
        expected = reference.descriptors(torch.from_numpy(maps[1]), points)
    head = onnxruntime.InferenceSession(str(tmp_path / "aliked-head.onnx"))
    own = head.run(None, {"features": maps[1], "keypoints": points[None]})[0][0]
    assert np.abs(own - expected).max() < 1e-4


def test_superpoint_layers_match_the_reference(exports, monkeypatch, tmp_path):
    # Its detector head has invented weights, because no published ones may be used for tests.
    folder = weights("superpoint/superpoint_v1_encoder_desc.npz").parents[1]
    monkeypatch.syspath_prepend(str(ROOT / "research/oracles"))
    from beside import superpoint_weights

    np.savez(tmp_path / "superpoint.npz", **superpoint_weights(folder))
    session = written(exports, monkeypatch, tmp_path / "s.onnx", "superpoint", tmp_path / "superpoint.npz")
    known = json.loads((DATA / "oracle.json").read_text())["superpoint"]
    gray = continued(drawn(*known["size"]), 8)
    for layer in ("scores", "descriptors"):
        value = session.run([layer], {"image": gray[None, None]})[0]
        entry = known["layers"][layer]
        assert list(value.shape) == entry["shape"]
        assert np.abs(value.ravel()[entry["at"]] - entry["values"]).max() < 1e-4 * max(entry["largest"], 1.0), layer


def test_weights_of_another_network_are_refused(exports, monkeypatch, tmp_path):
    torch.save({"conv1a.weight": torch.zeros(1)}, tmp_path / "other.pth")
    monkeypatch.setattr(sys, "argv", ["export_onnx.py", "superpoint", str(tmp_path / "other.pth"), str(tmp_path / "o.onnx")])
    with pytest.raises(SystemExit, match="lacks"):
        exports.main()
