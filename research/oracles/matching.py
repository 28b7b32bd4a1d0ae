"""Writes reference nearest neighbours, mutual matches and VLAD by NumPy for the tests of the crate `veiloc-descriptor`.

Writes crates/core/descriptor/tests/data/matching_oracle.json next to this script's folder (or to the path given):

    python3 research/oracles/matching.py [OUT]

The computation is straightforward: all differences in int64 for matching, float64 for VLAD. The random generator is seeded, so the
same NumPy version writes the same file.
"""

import json
import pathlib
import sys

import numpy as np

DIM = 128


def rootsift_like(rng, count):
    """Rows [count, 128] of u8: L1-normalized histograms, square-rooted, times 512."""
    histograms = rng.random((count, DIM)) ** 3
    histograms /= histograms.sum(axis=1, keepdims=True)
    return np.minimum(np.rint(np.sqrt(histograms) * 512), 255).astype(np.uint8)


def noisy(rng, rows, spread):
    noise = rng.integers(-spread, spread + 1, rows.shape)
    return np.clip(rows.astype(int) + noise, 0, 255).astype(np.uint8)


def matching(query, database):
    difference = query[:, None, :].astype(np.int64) - database[None, :, :].astype(np.int64)
    squared = (difference**2).sum(axis=2)
    nearest = squared.argmin(axis=1)  # the first of several equally near ones
    ranked = np.sort(squared, axis=1)
    of_database = squared.argmin(axis=0)
    mutual = [[q, int(d)] for q, d in enumerate(nearest) if of_database[d] == q]
    return {
        "nearest": nearest.tolist(),
        "distance": ranked[:, 0].tolist(),
        "second": ranked[:, 1].tolist(),
        "mutual": mutual,
    }


def vlad(words, rows):
    """Residual sums, intra-normalized, unit length: [K * 128] of float64."""
    words, rows = words.astype(np.float64), rows.astype(np.float64)
    word_of_row = ((rows[:, None, :] - words[None, :, :]) ** 2).sum(axis=2).argmin(axis=1)
    sums = np.zeros_like(words)
    for row, word in zip(rows, word_of_row):
        sums[word] += row - words[word]
    norms = np.linalg.norm(sums, axis=1, keepdims=True)
    sums = np.divide(sums, norms, out=np.zeros_like(sums), where=norms > 0)
    return (sums / np.linalg.norm(sums)).ravel()


def main():
    default = pathlib.Path(__file__).resolve().parents[2] / "crates/core/descriptor/tests/data/matching_oracle.json"
    out = pathlib.Path(sys.argv[1]) if len(sys.argv) > 1 else default
    rng = np.random.default_rng(20260)
    database = rootsift_like(rng, 80)
    database[70:75] = database[10:15]  # rows that occur twice: ties
    # Half of the queries are rows of the database with noise, some of them of the same row; the rest match nothing.
    query = np.concatenate([noisy(rng, database[rng.integers(0, 80, 30)], 40), rootsift_like(rng, 27), database[70:73]])
    query[41:44] = query[3:6]
    words = rootsift_like(rng, 6)
    words[5] = 255  # a word without assigned descriptors
    vectors = [vlad(words, query), vlad(words, database)]
    fixture = {
        "made_by": "research/oracles/matching.py",
        "query": query.tobytes().hex(),
        "database": database.tobytes().hex(),
        **matching(query, database),
        "words": words.tobytes().hex(),
        "vlad_of_query": [round(v, 7) for v in vectors[0].tolist()],
        "vlad_of_database": [round(v, 7) for v in vectors[1].tolist()],
        "vlad_cosine": float(vectors[0] @ vectors[1]),
    }
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(fixture) + "\n")


if __name__ == "__main__":
    main()
