"""Tables of a small document."""

import json

import numpy as np
import pytest

from study import compare, paper


def document(official: bool = True) -> dict:
    """Three queries of two scenes; with `official`, one of the scenes is the complete published one."""
    queries = [{"name": f"{k}.png", "scene": scene, "scheme": scheme, "recipe": "default", "seed": 0,
                "rotation_error_deg": 0.1 * worse if found else None, "translation_error": error * worse if found else None,
                "sealed_bytes": 0 if not found and scheme == "dcl:paper" else 900, "ms": {"match": 2.0, "pose": 3.0}}
               for scene, errors in [("chess", [0.01, 0.02, 0.03]), ("stairs", [0.01, 0.04, np.inf])]
               for scheme, worse in [("points", 1), ("dcl:paper", 2), ("dcl:s=2", 4)]
               for k, error in enumerate(errors) for found in [np.isfinite(error)]]  # fmt: skip
    scenes = [{"name": name, "is_official": official and name == "chess"} for name in ("chess", "stairs")]
    return {"version": 1, "command": "eval dataset 7scenes", "data": ["chess", "stairs"], "scenes": scenes, "queries": queries}


def line(text: str, begin: str) -> str:
    return next(line for line in text.splitlines() if line.startswith(begin))


def test_medians_and_recalls_are_in_their_cells():
    text = paper.tables(document(), paper.markdown)
    assert line(text, "| queries") == "| queries | 3 | 3 |"
    # 1, 2, 3 cm: median 2, all within 5 cm; on the stairs one query is lost.
    assert line(text, "| points") == "| points | 2.00/0.100/100.0 | 4.00/0.100/66.7 |"
    assert line(text, "| dcl:paper") == "| dcl:paper | 4.00/0.200/66.7 | 8.00/0.200/33.3 |"
    # Mean of the medians, and the number of queries that could not be sealed.
    assert "| dcl:paper | 6.00/0.200 | 1 | 6 |" in text and "| dcl:s=2 | 12.00/0.400 | 0 | 6 |" in text


def test_published_figures_are_shown_for_the_same_data_only():
    text = paper.tables(document(), paper.markdown)
    assert line(text, "| DSAC*") == "| DSAC* | 0.5/0.17/100 |  |", "not of a cut of the stairs"
    assert "published figures are not shown: stairs" in text
    assert "DSAC*" not in paper.tables(document(), published=False)
    assert "DSAC*" not in paper.tables(document(official=False))


def test_formats_have_equal_cells():
    latex = paper.tables(document(), paper.latex)
    assert r"points & 2.00/0.100/100.0 & 4.00/0.100/66.7 \\" in latex and r"\begin{tabular}{lcc}" in latex
    assert line(paper.tables(document()), "points").split() == ["points", "2.00/0.100/100.0", "4.00/0.100/66.7"]


def test_documents_without_known_poses_are_refused(tmp_path):
    blind = document()
    for query in blind["queries"]:
        query["has_ground_truth"] = False
    file = tmp_path / "blind.json"
    file.write_text(json.dumps(blind))
    with pytest.raises(SystemExit, match="no query of this document has a known pose"):
        paper.main([str(file)])
    file.write_text(json.dumps(document() | {"command": "eval pose"}))
    with pytest.raises(SystemExit, match="eval pose"):
        paper.main([str(file)])


def test_curves_and_times_are_drawn(tmp_path):
    paper.plot(paper.Results(document()), tmp_path)
    for name in ("position", "orientation", "times"):
        assert "</svg>" in (tmp_path / f"{name}.svg").read_text()


def test_published_rows_have_a_cell_for_every_scene():
    mean = {}
    for data_set, method, cells in paper.PUBLISHED:
        parts = [cell.split("/") for cell in cells.split()]
        assert len(parts) == len(paper.SETS[data_set][3]) and len({len(cell) for cell in parts}) == 1, method
        if method == "DCL, the paper's":
            mean[data_set] = np.mean(np.array(parts, float), axis=0)
    # The averages of Table 6 for the default equal those of the rows.
    assert mean["7scenes"][0] == pytest.approx(5.14, abs=0.05)
    assert mean["cambridge"][:2] == pytest.approx([22.50, 0.50], abs=0.3)


def test_compared_runs_are_named_by_scene():
    assert compare.queries(document()).row.iloc[0] == "points, default, chess"


def inverted(psnr: float) -> dict:
    rows = [("points", "none", 0.0), ("random-lines", "closed-form", 4.5), ("random-lines", "graph", 0.7), ("dcl:paper", "closed-form", 293.1),
            ("unordered", "none", None), ("none", "none", None)]  # fmt: skip
    summary = [{"scheme": scheme, "attack": attack, "mean_px": px, "psnr": psnr, "ssim": 0.5, "st_lpips": None, "objects": 3, "objects_found": 1}
               for scheme, attack, px in rows]  # fmt: skip
    return {"command": "eval inversion", "k": 100, "images": 4, "summary": summary}


def test_sheets_of_privacy_stand_beside_the_papers_rows():
    attacked = {"command": "eval adversaries", "rows": [{"data": "chess", "scheme": "dcl", "adversary": "map-server", "median_px": 36.04,
                                                         "bits_over_prior": 0.62}]}  # fmt: skip
    text = paper.tables(document(), paper.markdown, inverted=inverted(13.5), attacked=attacked)
    assert line(text, "| method | points | random-lines |") == "| method | points | random-lines | dcl:paper | no descriptor | coordinate-permutation |"
    assert line(text, "| e_recon (px)") == "| e_recon (px) |  | 4.5 | 293.1 |  |  |"
    assert line(text, "| the paper, SuperPoint, U-Net: e_recon") == "| the paper, SuperPoint, U-Net: e_recon (px) |  | 6.137 | 330.4 |  | 10.56 |"
    assert "Table 2" in text and "Table 7" in text and "100 true neighbours" in text
    assert line(text, "| chess, dcl") == "| chess, dcl | 36.0 (+0.62) |"
    assert "the paper, SuperPoint" not in paper.tables(document(), published=False, inverted=inverted(13.5))
    with pytest.raises(SystemExit, match="--inversion needs eval inversion"):
        paper.tables(document(), inverted=document())
