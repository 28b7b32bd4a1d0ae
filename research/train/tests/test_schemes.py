"""Candidates and bins against random keypoints and closed forms."""

import numpy as np
import pytest

from veiloc_train import bins as cuts
from veiloc_train.schemes import Scheme, exchanged, pencil, sent

SIZE = (640, 480)
SCHEMES = ["random-lines", "coordinate-permutation", "dcl", "dcl:horizontal", "dcl:angle=37,s=2.5"]


def spread(count, seed=0, size=SIZE):
    return np.random.default_rng(seed).random((count, 2)) * size


def nearest(candidates, keypoints):
    """Distance of each keypoint from the nearest of its segments."""
    t = ((keypoints[:, None] - candidates.origin) * candidates.direction).sum(-1)
    empty = candidates.empty()
    t = np.clip(t, np.where(empty, 0, candidates.near), np.where(empty, 0, candidates.far))
    away = np.linalg.norm(candidates.at(t) - keypoints[:, None], axis=-1)
    return np.where(empty, np.inf, away).min(axis=1)


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("size", [(640, 480), (333, 500)])
def test_keypoints_lie_on_their_candidates(name, size):
    keypoints = spread(3000, 1, size)
    sent_rows = sent(keypoints, size, Scheme.parse(name), np.random.default_rng(2))
    away = nearest(sent_rows, keypoints)
    # Dither of half a pixel, rounding, and keypoints on a border.
    assert np.quantile(away, 0.99) < 1.1, np.quantile(away, 0.99)
    assert np.isfinite(away).mean() > 0.998


@pytest.mark.parametrize("name", SCHEMES)
def test_mean_over_bins_is_the_expected_position(name):
    candidates = sent(spread(500, 3), SIZE, Scheme.parse(name), np.random.default_rng(4))
    bins = cuts.cut(candidates, 64)
    share = np.exp(bins.guess.astype(np.float64))
    assert np.allclose(share.sum(axis=1), 1.0, atol=1e-5)
    mean = (share[..., None] * bins.places).sum(axis=1)
    # With many points of each segment instead of the closed form.
    k = (np.arange(20_000) + 0.5) / 20_000
    whole, weight = 0.0, 0.0
    for s in range(candidates.near.shape[1]):
        empty = candidates.empty()[:, s]
        near, far = (np.where(empty, 0, x[:, s])[:, None] for x in (candidates.near, candidates.far))
        t = near + k * (far - near)
        w = candidates.growth[:, s, 0, None] + candidates.growth[:, s, 1, None] * t
        at = (w * t).sum(1) / np.where(empty, 1, w.sum(1))
        place = candidates.origin[:, s] + at[:, None] * candidates.direction[:, s]
        whole = whole + candidates.share[:, s, None] * place
        weight = weight + candidates.share[:, s, None]
    assert np.abs(mean - whole / weight).max() < 1e-2


@pytest.mark.parametrize("name", SCHEMES)
def test_bins_are_equally_likely(name):
    keypoints = spread(200_000, 5)
    bins = cuts.cut(sent(keypoints, SIZE, Scheme.parse(name), np.random.default_rng(6)), 8)
    held = bins.holding(keypoints)
    assert (held >= 0).mean() > 0.999
    counts = np.bincount(held[held >= 0], minlength=8)
    if name == "coordinate-permutation":
        # Both lines are equally likely, and so are the bins of a line.
        assert np.allclose(counts.reshape(2, 4).sum(1) / counts.sum(), 0.5, atol=0.01)
    assert np.allclose(counts / counts.sum(), 1 / 8, atol=0.008), counts


def test_keypoint_is_near_its_bin():
    keypoints = spread(2000, 7)
    for name in SCHEMES:
        bins = cuts.cut(sent(keypoints, SIZE, Scheme.parse(name), np.random.default_rng(8)), 64)
        held = np.maximum(bins.holding(keypoints), 0)
        own = np.linalg.norm(bins.places[np.arange(2000), held] - keypoints, axis=1)
        best = np.linalg.norm(bins.places - keypoints[:, None], axis=2).min(axis=1)
        assert (own > best + 12).mean() < 0.05, name


def test_half_line_of_the_paper_matches_closed_form():
    # Left of the midline: from the middle of the top edge through the keypoint to the border, divided into halves by area.
    keypoint = np.array([[200.0, 240.0]])
    candidates = sent(keypoint, SIZE, Scheme.parse("dcl"), np.random.default_rng(0))
    assert np.allclose(candidates.origin[0, 0], [320, 0])
    toward = np.array([-120.0, 240.0]) / np.hypot(120, 240)
    assert np.allclose(candidates.direction[0, 0], toward, atol=5e-3)
    length = 480 / candidates.direction[0, 0, 1]
    assert np.isclose(candidates.far[0, 0], length) and candidates.near[0, 0] == 0
    bins = cuts.cut(candidates, 2)
    t = np.linalg.norm(bins.places[0] - [320, 0], axis=1)
    middle = length / np.sqrt(2)
    assert np.allclose(t, [2 / 3 * middle, 2 / 3 * (length**3 - middle**3) / (length**2 - middle**2)])


def test_right_half_belongs_to_the_second_anchor():
    candidates = sent(np.array([[500.0, 100.0], [100.0, 100.0]]), SIZE, Scheme.parse("dcl"), np.random.default_rng(0))
    assert np.allclose(candidates.origin[:, 0], [[320, 480], [320, 0]])
    candidates = sent(np.array([[500.0, 100.0], [100.0, 400.0]]), SIZE, Scheme.parse("dcl:horizontal"), np.random.default_rng(0))
    assert np.allclose(candidates.origin[:, 0], [[560, 240], [80, 240]])


def test_pencil_angles_by_hand():
    # The anchor (320, 0) of a camera with focal length 640: direction (0, -240, 640). Straight below it, in the plane
    # through the axis of sight, is angle 0; a pixel to the right of it is about the axis by the sine of its offset.
    zero, quarter = pencil(np.array([0.0, -240.0]), np.array([640.0, 480.0]), 640.0)
    below = np.array([320.0, 300.0, 1.0])
    assert abs(quarter @ below) < 1e-9 and zero @ below > 0
    right = np.array([400.0, 240.0, 1.0])
    norm = np.hypot(240, 640)
    # Bearing (80, 0, 640): along the pencil's zero axis 640 * 240 / norm, along its quarter axis 80 either way.
    assert np.isclose(zero @ right, 640 * 240 / norm) and np.isclose(abs(quarter @ right), 80)


def test_permutation_exchanges_one_coordinate_within_pairs():
    for count in (1, 2, 3, 9, 10):
        places = spread(count, count) - 320
        got = exchanged(places, np.array([320.0, 240.0]), np.random.default_rng(1))
        same = got == places
        assert (same.sum(axis=1) == 1).all()
        if count > 1:
            for axis in (0, 1):
                assert sorted(got[:, axis]) == sorted(places[:, axis])


def test_keypoints_at_one_position_share_a_line():
    keypoints = np.repeat(spread(20, 1), 2, axis=0)
    for name in SCHEMES:
        rows = sent(keypoints, SIZE, Scheme.parse(name), np.random.default_rng(1))
        assert (rows.direction[0::2] == rows.direction[1::2]).all() and (rows.far[0::2] == rows.far[1::2]).all()


def test_unsupported_schemes_are_refused():
    for text in ["points", "dcl:axis=138:sectors=24", "random-lines:3", "dcl:s=0.01", "dcl:angle=180"]:
        with pytest.raises(ValueError):
            Scheme.parse(text)


def test_rows_that_miss_the_image_have_one_bin():
    rows = sent(spread(4, 2), SIZE, Scheme.parse("random-lines"), np.random.default_rng(1))
    rows.far[1] = -np.inf
    bins = cuts.cut(rows, 16)
    assert list(bins.counts) == [16, 1, 16, 16] and bins.holding(spread(4, 2))[1] == -1
    assert bins.guess[1, 0] == 0 and (bins.guess[1, 1:] == np.float32(cuts.NEVER)).all()
    assert (bins.places[1] == rows.origin[1, 0]).all()
