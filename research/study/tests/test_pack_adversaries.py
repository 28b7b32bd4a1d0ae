"""Measures and forged packs of the study of packs."""

import base64

import numpy as np
import pytest
from study import pack_adversaries as study
from study.packs import fields_of, pack_of


def small_pack(path):
    """Two images of three points, with rows that differ."""
    points, rows = np.array([0, 2, 0, 1]), np.arange(4 * 32, dtype=np.uint8).reshape(4, 32)
    bits = np.packbits((points[:, None] >> np.arange(2)[::-1] & 1).astype(np.uint8)).tobytes()
    fields = [1, b"profile", 3, np.array([2, 2], "<u4").tobytes(), bits, rows.tobytes(), bytes(16)]
    path.write_bytes(b"".join(study.field(i + 1, value) for i, value in enumerate(fields)))
    return path


def test_a_forged_pack_has_the_picture_in_each_image(tmp_path):
    pack, forged = small_pack(tmp_path / "a.vpack"), tmp_path / "b.vpack"
    picture = {"descriptors": base64.b64encode(bytes(range(0, 128))).decode()}
    assert study.forge(pack, picture, forged) == 3
    found = pack_of(forged)
    assert (found["points"], list(found["images"]), list(found["of rows"])) == (5, [4, 4], [0, 2, 3, 4, 0, 1, 3, 4])
    assert (found["rows"][2] == found["rows"][6]).all() and (found["rows"][0] == pack_of(pack)["rows"][0]).all()
    assert len(fields_of(forged)[7]) == 16


def test_area_under_the_curve_counts_ties_half():
    real = np.array([True, False, True, False])
    assert study.auc(np.array([3, 1, 2, 0]), real) == 1
    assert study.auc(np.array([1, 1, 1, 1]), real) == 0.5
    assert study.auc(np.array([0, 3, 1, 1]), real) == pytest.approx(0.125)


def test_information_of_equal_and_of_independent_values():
    draw = np.random.default_rng(1).integers(0, 4, (400, 2)).tolist()
    assert study.information([(a, a) for a, _ in draw]) == pytest.approx(2, abs=0.05)
    assert study.information([tuple(pair) for pair in draw]) < 0.03


def test_candidates_and_weights():
    # Three points in two bits, then four bits of the weight; two rows.
    fields = {10: 2, 25: 3, 26: np.packbits([1, 0, 1, 0, 0, 0, 0, 1, 1, 1, 1, 1]).tobytes()}
    assert study.candidates_of(fields) == [(2, 8), (1, 15)]
    assert (study.code_of(0.5), study.code_of(0.9), study.code_of(0.001)) == (8, 12, 1)
