"""The study of the Cramér–Rao bound needs the Python package `veiloc`."""

import numpy as np
import pytest

pytest.importorskip("veiloc")
from study import bound  # noqa: E402


@pytest.mark.parametrize("scheme", bound.SCHEMES)
def test_errors_come_close_to_the_bound(scheme):
    trials = [bound.trial("deep", 1.0, 0.5, scheme, index, seed=0) for index in range(40)]
    assert all(one["found"] for one in trials)
    predicted = np.median(np.concatenate([one["predicted"] for one in trials]), axis=0)
    ratios = np.median([one["error"] for one in trials], axis=0) / predicted
    assert ((0.75 < ratios) & (ratios < 1.4)).all(), ratios
    again = bound.trial("deep", 1.0, 0.5, scheme, 3, seed=0)
    assert again["error"] == trials[3]["error"], "equal seeds give equal results"
    twice = np.median([bound.trial("deep", 2.0, 0.5, scheme, index, seed=0)["predicted"] for index in range(40)], axis=(0, 1))
    assert twice / predicted == pytest.approx(1.9, abs=0.35), "the bound grows with the noise"
