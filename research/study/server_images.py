"""Table of docs/results/inversion.md: images made of what a server's attacks recover of a region that its map does not show."""

from pathlib import Path

from study.common import SCENES, command, number
from study.private_rows import Place

PAGE = "inversion"
SHOWN = {"matched": "only what the map matches", "server-side": "server-side", "iterative": "iterative", "occlusion": "occlusion of the map",
         "graph": "graph, true neighbours, no server"}  # fmt: skip


@command("inversion/server.csv", needs="a network of compact descriptors (--network)", network=("networks/compact.toml", "network of compact descriptors"),
         queries=4, schemes="random-lines,dcl:paper,dcl", judge=("", "st-lpips.onnx (default: no ST-LPIPS)"))  # fmt: skip
def server(run):
    """The paper's Figures 7 and 8: a server knows the pose and the keypoints that match its map, and attacks those in an upright ellipse that
    it does not know, with 20 true neighbours."""
    table = run.table("inversion/server.csv", "place", "scheme", "recovered by", "in the region, mean (px)", "PSNR in the region (dB)", "PSNR (dB)", "ST-LPIPS")
    judge = ["--perceptual", Path(run.judge).resolve()] if run.judge else []
    for title, name in SCENES.items():
        place = Place(run, name)
        _, private = place.region("ellipses")
        names = run.listed(f"inverted-{name}", [query["name"] for query in place.chosen(2048)])
        found = run.json("eval", "inversion", place.folder / "images", "--list", names, "--keypoints", place.work / "keypoints.jsonl.gz", "--server-matches",
                         place.problems, *private, "--features", "compact", "--network", Path(run.network).resolve(), "--schemes", run.schemes, *judge)  # fmt: skip
        for row in found["summary"]:
            if row["attack"] in SHOWN:
                table.add([title, row["scheme"], SHOWN[row["attack"]], number(row["mean_px"] if row["attack"] != "graph" else None, ".1f"),
                           number(row.get("private_psnr"), ".2f"), f"{row['psnr']:.2f}", number(row["st_lpips"], ".3f")])  # fmt: skip
