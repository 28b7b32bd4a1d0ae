"""Comparisons of synthetic runs with known differences.

PYTHONPATH=research python3 -m pytest research/study/tests
"""

import copy
import json

import numpy as np
import pytest

from study import compare


def run(scheme: str, errors, seeds: int = 1) -> dict:
    """A run of one row; an infinite error is a query without a pose."""
    finite = lambda x: x if np.isfinite(x) else None
    queries = [{"name": str(k), "scheme": scheme, "recipe": "default", "seed": seed,
                "rotation_error_deg": finite(10 * e), "translation_error": finite(e), "ms": {"match": 2.0, "pose": 3.0}}
               for k, e in enumerate(errors) for seed in range(seeds)]  # fmt: skip
    recall = {"0.05/5": 1.0, "0.25/2": 1.0}
    return {"version": 1, "command": "eval scene", "data": ["place"], "schemes": [{"scheme": scheme, "recall": recall}], "queries": queries}


def compared(a: dict, b: dict, draws: int = 2000):
    return compare.compare(compare.queries(a), compare.queries(b), compare.thresholds(a), draws)[0].set_index("figure")


def test_small_gain_on_every_query_is_significant():
    # Difficult queries are difficult for both: the gain is detected in spite of a spread a hundred times as large.
    a, b = run("dcl", [0.01 * (k + 1) for k in range(12)]), run("dcl", [0.0099 * (k + 1) for k in range(12)])
    translation = compared(a, b).loc["median translation"]
    assert translation.result == "B is better" and translation.A == pytest.approx(0.065) and translation["B - A"] < 0
    assert translation.low <= translation.high
    assert compared(a, b).loc["median time, ms"].result == "not shown"
    assert compared(a, b).loc["recall 0.05/5"].A == pytest.approx(5 / 12)
    assert compared(b, a).loc["median translation"].result == "A is better"


def test_symmetric_noise_is_not_significant():
    a, b = run("dcl", [0.01 + 0.001 * (k % 5) for k in range(12)]), run("dcl", [0.01 + 0.001 * ((k * 7 + 3) % 5) for k in range(12)])
    assert (compared(a, b).result == "not shown").all()
    assert (compared(a, a)[["low", "high"]] == 0).all(axis=None)


def test_intervals_have_nominal_coverage():
    random = np.random.default_rng(1)
    noise = lambda: run("dcl", random.uniform(0.01, 0.03, 40))
    held = sum(compared(noise(), noise(), 200).loc["median translation"].result == "not shown" for _ in range(60))
    assert 52 <= held <= 59


def test_missing_poses_are_never_better():
    found = compared(run("dcl", [0.5] * 12), run("dcl", [np.inf] * 8 + [0.001] * 4)).loc["median translation"]
    assert found.B == found["B - A"] == found.high == np.inf and found.result != "B is better"


def test_seeds_of_a_query_are_resampled_together():
    def width(seeds: int) -> float:
        of = lambda scale: run("dcl", [scale * (0.01 + 0.003 * (k * 5 % 12)) for k in range(12)], seeds)
        found = compared(of(1.0), of(1.1)).loc["median translation"]
        return found.high - found.low

    assert width(1) == pytest.approx(width(8), abs=1e-12)


def test_rows_are_paired_by_name_or_option():
    a, b = compare.queries(run("points", [0.01] * 3)), compare.queries(run("dcl", [0.02] * 3))
    only = [("points, default", "dcl, default")]
    assert compare.pairs(a, b, None, None) == compare.pairs(a, b, "points", "dcl, default") == only
    with pytest.raises(SystemExit, match="the first has points, default; the second has dcl, default"):
        compare.pairs(a, b, "dcl", None)
    other = a.assign(name="elsewhere")
    with pytest.raises(SystemExit, match="points, default: the runs have no query in common"):
        compare.compare(a, other, ["0.05/5"])


def test_other_documents_are_refused(tmp_path):
    file = tmp_path / "run.json"
    good = run("dcl", [0.01])

    def refused(text: str) -> str:
        file.write_text(text)
        with pytest.raises(SystemExit) as error:
            compare.queries(compare.read(file))
        return str(error.value)

    assert "not a document" in refused(json.dumps(good)[:-9]) and "not a document" in refused("[]")
    assert "eval adversaries" in refused(json.dumps(good | {"command": "eval adversaries"}))
    assert "version 2" in refused(json.dumps(good | {"version": 2}))
    twice = copy.deepcopy(good)
    twice["queries"] *= 2
    assert "appears twice" in refused(json.dumps(twice))
    with pytest.raises(ValueError):
        compare.threshold("near")


def test_printed_comparison_has_names_and_equal_seeds_are_equal(tmp_path, capsys):
    file = tmp_path / "run.json"
    both = run("dcl", [0.02, 0.03, 0.04])
    both["queries"] += run("points", [0.01, 0.03, 0.02])["queries"]
    file.write_text(json.dumps(both))
    arguments = [str(file), str(file), "--row", "dcl", "--against", "points", "--bootstrap-samples", "500"]
    printed = [(compare.main(arguments), capsys.readouterr().out)[1] for _ in range(2)]
    assert printed[0] == printed[1] and "B nearer in 2, farther in 0" in printed[0] and "recall 0.25/2" in printed[0]
