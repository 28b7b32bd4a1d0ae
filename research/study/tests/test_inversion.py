"""What hides single descriptors, and patches in the frames of keypoints."""

import numpy as np
import pytest
from study import inversion as study


def test_fewer_bits_and_numbers():
    rows = np.tile(np.arange(-120, 121, 16.0), 4)[None]
    draw = np.random.default_rng(0)
    assert (study.defended(rows, draw, rows)[:, 0] == rows).all()
    assert set(study.defended(rows, draw, rows, bits=1)[0, 0]) == {-64, 64}
    assert set(study.defended(rows, draw, rows, bits=2)[0, 0]) == {-96, -32, 32, 96}
    assert np.flatnonzero(study.defended(rows, draw, rows, numbers=16)[0, 0]).tolist() == list(range(16))


def test_sets_have_the_true_word_as_often_as_epsilon_allows():
    draw = np.random.default_rng(0)
    words = draw.normal(size=(64, 8))
    sets = study.defended(words[np.zeros(4000, int)], draw, words, words=2, epsilon=3)
    share = (sets[:, 0] == words[0]).all(1).mean()
    assert sets.shape == (4000, 2, 8) and share == pytest.approx(2 * np.exp(3) / (2 * np.exp(3) + 62), abs=0.05)


def test_epsilon_falls_with_noise():
    assert study.epsilon(8) == pytest.approx(2 + 2 * (2 * np.log(1e5)) ** 0.5)
    assert study.epsilon(1) > study.epsilon(2) > study.epsilon(4)


def test_a_patch_lies_in_the_frame_of_its_keypoint():
    cv2 = pytest.importorskip("cv2")
    gray = np.tile(np.arange(200, dtype=np.uint8), (200, 1))
    upright, rotated = (study.cut(gray, (100, 100, 40, angle)) for angle in (0, 90))
    assert upright.mean() == pytest.approx(study.MEAN, abs=0.01) and upright.std() == pytest.approx(study.CONTRAST, abs=0.01)
    assert (np.diff(upright[16]) >= 0).all() and np.ptp(upright[:, 16]) == 0 and np.ptp(rotated[16]) == 0
    assert study.cut(gray, (10, 100, 40, 0)) is None and cv2.__version__
