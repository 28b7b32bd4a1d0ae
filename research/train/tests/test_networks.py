"""Networks, their inputs, and interrupted training."""

import argparse
import base64
import gzip
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from veiloc_train import __main__ as command
from veiloc_train import data, inversion, models, neighbours, positions
from veiloc_train.export import export
from veiloc_train.schemes import Scheme

onnxruntime = pytest.importorskip("onnxruntime")
ROOT = Path(__file__).resolve().parents[3]


def line(name="a.png", count=60, dimension=128, size=(96, 64), seed=0):
    rng = np.random.default_rng(seed)
    return {
        "name": name, "width": size[0], "height": size[1],
        "keypoints": (rng.random((count, 2)) * size).round(3).tolist(),
        "descriptors": base64.b64encode(rng.integers(0, 256, count * dimension, dtype=np.uint8).tobytes()).decode(),
        "descriptor_dim": dimension,
        **({} if dimension == 128 else {"features": "own", "descriptor_encoding": "unsigned", "descriptor_norm": 500}),
    }  # fmt: skip


@pytest.fixture
def files(tmp_path):
    """Four images and their keypoints."""
    with gzip.open(tmp_path / "keypoints.jsonl.gz", "wt") as out:
        for i in range(4):
            out.write(json.dumps(line(f"{i}.png", seed=i)) + "\n")
            pixels = np.random.default_rng(i).integers(0, 256, (64, 96, 3), dtype=np.uint8)
            Image.fromarray(pixels).save(tmp_path / f"{i}.png")
    return tmp_path


def known(**more):
    return data.inside(line(**more))


def test_keypoint_files_are_read_and_split(files):
    images = data.read_keypoints([files / "keypoints.jsonl.gz"])
    assert [len(i.keypoints) for i in images] == [60] * 4 and images[0].descriptors.shape == (60, 128)
    training, validation = data.split(images, 1)
    again = data.split(images[::-1], 1)
    assert len(training) == 3 and validation[0].name == again[1][0].name
    outside = line()
    outside["keypoints"][3] = [96.0, 10.0]
    assert len(data.inside(outside).keypoints) == 59


def test_descriptors_of_one_kind_are_read_without_their_offset(tmp_path):
    kind = {"features": "compact", "descriptor_dim": 64, "descriptor_encoding": "coarse", "descriptor_norm": 374}
    compact = line(dimension=64) | kind
    image = data.inside(compact)
    encoded = np.frombuffer(base64.b64decode(compact["descriptors"]), np.uint8).reshape(60, 64)
    assert image.features == "compact" and (image.descriptors == encoded.astype(int) - 128).all()
    assert data.inside(line()).features == "sift"
    for name, fields in {"compact": compact, "sift": line()}.items():
        (tmp_path / name).write_text(json.dumps(fields) + "\n")
    with pytest.raises(SystemExit, match="compact of 64 numbers, sift of 128"):
        data.read_keypoints([tmp_path / "sift", tmp_path / "compact"], most=2)
    del compact["features"], compact["descriptor_encoding"]
    with pytest.raises(SystemExit, match="descriptor_encoding"):
        data.inside(compact)


@pytest.mark.parametrize("kind", ["positions", "inversion"])
def test_only_sift_descriptors_are_mirrored(kind, monkeypatch, tmp_path):
    fields = line(dimension=128) | {"features": "own", "descriptor_encoding": "signed", "descriptor_norm": 500}
    (tmp_path / "own.jsonl").write_text((json.dumps(fields) + "\n") * 2)
    folder = ["--image-folder", str(tmp_path)] if kind == "inversion" else []
    arguments = [kind, str(tmp_path / "own.jsonl"), "-o", str(tmp_path / "own"), "--mirror", *folder]
    monkeypatch.setattr(sys, "argv", ["veiloc_train", *arguments])
    with pytest.raises(SystemExit, match="only for descriptors of kind sift"):
        command.main()


def test_descriptors_have_the_length_that_networks_expect():
    rows = np.array([[3, 4, 0, 0], [0, 0, 0, 0]], np.uint8)
    assert np.allclose(data.scaled(rows), [[1.2, 1.6, 0, 0], [0, 0, 0, 0]])


def test_mirrored_descriptors_mirror_back():
    rows = np.random.default_rng(0).integers(0, 256, (5, 128))
    once = data.mirrored(rows)
    assert (data.mirrored(once) == rows).all()
    # Number of row 0, column 1, direction 1 comes from row 3, column 1, direction 7.
    assert (once[:, 1 * 8 + 1] == rows[:, 3 * 32 + 1 * 8 + 7]).all()


@pytest.mark.parametrize("input", models.INPUTS)
def test_untrained_positions_return_the_prior(input):
    network = models.Positions(128, input, waves=6, width=16, heads=2, layers=1).eval()
    rng = np.random.default_rng(0)
    image = known()
    batch = positions.ObfuscatedBatch([positions.draw(image, 40, True, rng)], Scheme.parse("dcl"), rng)
    assert (network(batch.descriptors, batch.places, batch.guess) == 0).all()
    assert batch.gain(batch.shares(network)).abs().max() < 1e-5


def test_logits_are_sums_of_cosine_products():
    network = models.Positions(4, "row", waves=3, width=8, heads=2, layers=1).eval()
    answers = torch.randn(3, 3)
    torch.nn.init.zeros_(network.encoder.last.weight)
    network.encoder.last.bias.data = answers.flatten()
    places = torch.rand(1, 2, 5, 2)
    logits = network(torch.randn(1, 2, 4), places, torch.zeros(1, 2, 5))
    for b in range(5):
        x, y = places[0, 1, b].tolist()
        wave = lambda i, j: math.cos(math.pi * i * x) * math.cos(math.pi * j * y)
        expected = sum(answers[i, j].item() * wave(i, j) for i in range(3) for j in range(3))
        assert abs(logits[0, 1, b].item() - expected) < 1e-5


def test_padding_rows_have_no_effect():
    torch.manual_seed(1)
    rng = np.random.default_rng(0)
    small, large = (positions.draw(known(count=n, seed=n), 200, False, rng) for n in (30, 55))
    network = models.Positions(128, "set", waves=4, width=16, heads=2, layers=2).eval()
    torch.nn.init.normal_(network.encoder.last.weight)
    both = positions.ObfuscatedBatch([small, large], Scheme.parse("random-lines"), np.random.default_rng(1))
    alone = positions.ObfuscatedBatch([small], Scheme.parse("random-lines"), np.random.default_rng(1))
    assert torch.allclose(both.shares(network)[0, :30], alone.shares(network)[0], atol=1e-4)


def test_targets_are_the_sampled_neighbours():
    keypoints = np.array([[0.0, 0], [1, 0], [10, 0], [11, 0]])
    near = neighbours.nearest(keypoints, 1)
    assert near[:, 0].tolist() == [1, 0, 3, 2]
    shares = neighbours.targets(near, np.array([2, 0, 1]), 4)
    assert shares.tolist() == [[0, 0, 0], [0, 0, 1], [0, 1, 0]]


def test_embeddings_have_length_one():
    network = models.Neighbours(16, outputs=8, width=16, heads=2, layers=1).eval()
    assert torch.allclose(network(torch.randn(1, 9, 16)).norm(dim=-1), torch.ones(1, 9), atol=1e-5)


def test_grid_averages_the_descriptors_of_a_cell():
    places = np.array([[0.2, 0.9], [0.8, 0.1], [2.5, 1.5]])
    one = inversion.cells_of(places, (2, 3))
    assert one.tolist() == [0, 0, 5]
    descriptors = torch.tensor([[2.0, 0], [0, 4], [6, 6]])
    # Two images: the second one has only the last keypoint.
    cells = torch.from_numpy(np.concatenate([one, 6 + one[2:]]))
    grid = inversion.features(cells, descriptors[[0, 1, 2, 2]], 2, (2, 3))
    assert grid.shape == (2, 3, 2, 3)
    assert grid[0, :, 0, 0].tolist() == pytest.approx([1, 2, math.log(3)])
    assert grid[0, :, 1, 2].tolist() == grid[1, :, 1, 2].tolist() == pytest.approx([6, 6, math.log(2)])
    assert grid[0].count_nonzero() == 6 and grid[1].count_nonzero() == 3
    right = inversion.right_share(cells, torch.tensor([True, False, True, False]), 2, (2, 3))
    assert right[0, 0, 0, 0] == 0.5 and right[0, 0, 1, 2] == 1 and right[1, 0, 1, 2] == 0 and right.isnan().sum() == 9


def test_window_shows_its_box():
    across = np.linspace(0, 255, 60).astype(np.uint8)
    photo = torch.from_numpy(np.stack([np.tile(across, (40, 1)), np.tile(across[:40, None], (1, 60)), np.zeros((40, 60), np.uint8)]))
    box = np.array([0.25, 0.5, 0.75, 1.0])
    shown = inversion.window(photo, box, 8)[0]
    assert shown.shape == (3, 8, 8) and shown[0, 0].tolist() == pytest.approx(np.linspace(0.281, 0.719, 8), abs=0.01)
    assert shown[1, :, 0].tolist() == pytest.approx((0.5 + (np.arange(8) + 0.5) / 16) * across[39] / 255, abs=0.01)
    assert torch.allclose(inversion.window(photo, box[[2, 1, 0, 3]], 8)[0], shown.flip(-1), atol=1e-6)


def test_windows_hold_descriptors_at_their_pixels():
    """A keypoint on a bright spot stays on it in every window, also in a mirrored one."""
    arguments = argparse.Namespace(side=96, window=48, zoom=1.25, drop=0.0, wrong=0.0, mirror=True, batch=16, device="cpu", input="descriptors")
    fields = line(count=1) | {"keypoints": [[50.0, 30.0]]}
    sampler = inversion.WindowSampler([data.inside(fields)], arguments, 16)
    sampler.descriptors = torch.from_numpy(data.scaled(data.inside(fields).descriptors)).half()
    photo = torch.zeros(3, 64, 96, dtype=torch.uint8)
    photo[:, 28:32, 48:52] = 255
    sampler.pixels = [photo]
    drawn = sampler.batch(np.random.default_rng(0))
    grid, right, images = sampler.on_device(drawn)
    held = grid[:, -1] > 0
    assert held.sum() == len(drawn.cells) > 8 and drawn.mirrored.any() and not drawn.mirrored.all()
    assert (images[:, 0][held] > 0.9).all() and (images[:, 0] > 0.5).float().mean() < 0.02
    assert (right[:, 0][held] == 1).all()
    rows = [grid[i, :-1][:, held[i]].T[0] for i in range(16) if held[i].any()]
    for row, is_mirrored in zip(rows, drawn.mirrored):
        own = data.inside(fields).descriptors
        assert np.allclose(row, data.scaled(data.mirrored(own) if is_mirrored else own)[0], atol=5e-3)


def test_grid_size_is_the_nearest_multiple():
    assert inversion.grid_size(640, 480, 256, 16) == (256, 192)
    assert inversion.grid_size(100, 1000, 128, 16) == (16, 128)
    assert inversion.grid_size(1000, 10, 128, 16) == (128, 16)


def test_rows_of_the_other_inputs(files):
    """Nothing, or the colour of the pixel that holds the keypoint, also where the file's image is smaller than the stored one."""
    red = np.zeros((64, 96, 3), np.uint8)
    red[30, 50] = 255, 0, 51
    Image.fromarray(red).save(files / "0.png")
    for size, at in [((96, 64), [50.9, 30.0]), ((48, 32), [25.4, 15.1])]:
        image = data.inside(line("0.png", count=1, size=size) | {"keypoints": [at]})
        arguments = argparse.Namespace(input="colour", image_folder=[files])
        assert inversion.rows_of(image, arguments).tolist() == [pytest.approx([1.0, -1.0, -0.6], abs=1e-6)]
        arguments.input = "positions"
        assert inversion.rows_of(image, arguments).shape == (1, 0)
    grid = inversion.features(torch.tensor([1]), torch.zeros(1, 0), 1, (1, 2))
    assert grid[0, :, 0].tolist() == [[0.0, pytest.approx(math.log(2))]]


@pytest.mark.parametrize("form", models.FORMS)
def test_default_networks_have_the_channels_of_the_papers(form):
    network = models.inversion(form, 128, 64, 5)
    unet = network.network if form == "unet" else network.coarse
    assert [stage[0].out_channels for stage in unet.down] == [64, 128, 256, 512, 1024]


def test_exported_inversion_accepts_other_sizes(tmp_path):
    network = models.InvSfm(8, width=4, levels=3).eval()
    export(network, tmp_path / "x", "inversion", "sift", 8, side=32, multiple=4, visible=True)
    grid = torch.randn(1, 9, 12, 20)
    session = onnxruntime.InferenceSession(str(tmp_path / "x.onnx"))
    found = session.run(["image", "visible"], {"features": grid.numpy()})
    for own, other in zip(network(grid), found):
        assert np.allclose(own.detach().numpy(), other, atol=1e-5)


def test_committed_networks_reproduce_pytorch():
    folder = ROOT / "crates/research/attacks/tests/data/networks"
    for name, entry in json.loads((folder / "expected.json").read_text()).items():
        session = onnxruntime.InferenceSession(str(folder / f"{name}.onnx"))
        tensor = lambda t: np.array(t["data"], np.float32).reshape(t["shape"])
        found = session.run(list(entry["outputs"]), {k: tensor(v) for k, v in entry["inputs"].items()})
        for value, expected in zip(found, entry["outputs"].values()):
            assert np.allclose(value, tensor(expected), atol=2e-5), name


SMALL = ["--validation", "1", "--batch", "2", "--every", "2", "--device", "cpu"]
KINDS = {
    "positions": ["--width", "8", "--heads", "2", "--layers", "1", "--waves", "3", "--rows", "30", "--mirror"],
    "neighbours": ["--width", "8", "--heads", "2", "--layers", "1", "--rows", "30", "--nearest", "5"],
    "inversion": ["--width", "2", "--levels", "2", "--side", "32", "--form", "invsfm", "--wrong", "0.5", "--mirror"],
}


def run(monkeypatch, kind, files, stem, *more):
    folder = ["--image-folder", str(files)] if kind == "inversion" else []
    arguments = [kind, str(files / "keypoints.jsonl.gz"), "-o", str(stem), *SMALL, *KINDS[kind], *folder, *more]
    monkeypatch.setattr(sys, "argv", ["veiloc_train", *arguments])
    command.main()


@pytest.mark.parametrize("kind", KINDS)
def test_interrupted_training_resumes_identically(kind, files, monkeypatch):
    run(monkeypatch, kind, files, files / "whole", "--steps", "4")
    # Interrupted after the second step.
    real = torch.optim.AdamW.step
    calls = []

    def interrupted(self, *args, **kwargs):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return real(self, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(torch.optim.AdamW, "step", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run(patch, kind, files, files / "part", "--steps", "4")
    run(monkeypatch, kind, files, files / "part", "--steps", "4", "--resume", "--workers", "0")
    curves = [[row.split(",")[0::2] for row in (files / f"{n}.csv").read_text().splitlines()] for n in ("whole", "part")]
    assert curves[0] == curves[1] and len(curves[0]) == 4
    assert f'kind = "{kind}"' in (files / "part.toml").read_text()
    with pytest.raises(SystemExit, match="other options"):
        run(monkeypatch, kind, files, files / "part", "--steps", "6", "--resume")


@pytest.mark.parametrize("input, dimension", [("positions", 0), ("colour", 3)])
def test_networks_of_the_other_inputs_are_described(input, dimension, files, monkeypatch):
    run(monkeypatch, "inversion", files, files / "x", "--steps", "2", "--input", input)
    described = (files / "x.toml").read_text()
    assert f'input = "{input}"' in described and f"dimension = {dimension}\n" in described
    session = onnxruntime.InferenceSession(str(files / "x.onnx"))
    assert session.run(["image"], {"features": np.zeros((1, dimension + 1, 32, 48), np.float32)})[0].shape == (1, 3, 32, 48)


def test_positions_learn_positions_encoded_in_descriptors(monkeypatch, files):
    """The descriptors encode the positions of their keypoints."""
    with gzip.open(files / "encoded.jsonl.gz", "wt") as out:
        for i in range(12):
            fields = line(f"{i}.png", count=100, dimension=16, size=(400, 300), seed=i)
            places = np.array(fields["keypoints"]) / [400, 300]
            encoded = np.clip(255 * np.concatenate([np.cos(np.pi * k * places) * 0.5 + 0.5 for k in range(1, 9)], axis=1), 0, 255)
            fields["descriptors"] = base64.b64encode(encoded.astype(np.uint8).tobytes()).decode()
            out.write(json.dumps(fields) + "\n")
    options = "--steps 150 --every 150 --batch 4 --rows 60 --width 48 --heads 4 --layers 2 --dropout 0 --rate 3e-3"
    arguments = ["positions", str(files / "encoded.jsonl.gz"), "-o", str(files / "encoded"), "--validation", "2", "--device", "cpu"]
    monkeypatch.setattr(sys, "argv", ["veiloc_train", *arguments, *options.split()])
    command.main()
    header, first, last = (row.split(",") for row in (files / "encoded.csv").read_text().splitlines())
    bits = -float(last[header.index("minus_bits")])
    assert float(first[header.index("minus_bits")]) == pytest.approx(0, abs=1e-4) and bits > 0.5, bits
