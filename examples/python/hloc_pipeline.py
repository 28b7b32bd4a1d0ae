"""The last step of an hloc pipeline with obfuscated keypoints, by changing one import.

    python examples/python/hloc_pipeline.py OUTPUTS

`OUTPUTS` holds the files of hloc's earlier steps: `sfm/`, `queries.txt`, `pairs.txt`, `features.h5` and `matches.h5`.
"""

import logging
import sys
from pathlib import Path

# from hloc import localize_sfm
from veiloc.hloc import localize_sfm


def main(outputs: Path) -> None:
    """Localizes from points and from lines, and prints the distance of both poses."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    files = [outputs / name for name in ("sfm", "queries.txt", "pairs.txt", "features.h5", "matches.h5")]
    points = localize_sfm.main(*files, outputs / "results_points.txt")
    lines = localize_sfm.main(*files, outputs / "results_dcl.txt", scheme="dcl")
    for name, pose in points.items():
        degrees, apart = pose.error(lines[name])
        print(f"{name}: points and lines are {apart:.4f} and {degrees:.2f}° apart")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
