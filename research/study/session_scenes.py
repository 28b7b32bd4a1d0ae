#!/usr/bin/env python3
"""Counts what a session recognizes: images of other places after two of one, and images of that place after many of others.

    research/study/session_scenes.py --veiloc target/release/veiloc --data $VEILOC_DATA --map herzjesu.vmap

Two images of Herz-Jesu are sealed in a session, without orientation. A session allows two starts for one place, so:

- other places: each of 60 other images (39 photographs, seven of Fountain, Entry and RedKitchen each), on a copy of the session;
  each that is refused was taken for Herz-Jesu.
- the same place: each other image of Herz-Jesu, on a copy; each that is sealed gets a third start.
- after others: the same once the session has seen the 60 images, in random order; images of Fountain and of Entry beyond the
  second are counted too.
"""

import argparse
import random
import shutil
import subprocess
import tempfile
from pathlib import Path


def names(folder: Path) -> list[Path]:
    lines = (folder / "map.txt").read_text().splitlines()
    return [folder / "images" / line.split()[0] for line in lines if line.strip() and not line.startswith("#")]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--veiloc", default="veiloc")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--map", type=Path, required=True, help="any map, for its profile")
    parser.add_argument("--orders", type=int, default=3, help="random orders of the other images")
    args = parser.parse_args()
    own = names(args.data / "herzjesu")
    spread = {place: names(args.data / place) for place in ("fountain", "entry", "redkitchen")}
    spread = {place: [images[i * len(images) // 7] for i in range(7)] for place, images in spread.items()}
    others = sorted((args.data / "photos").glob("*.jpg")) + [image for images in spread.values() for image in images]
    with tempfile.TemporaryDirectory() as work:
        profile, first, copied = (Path(work) / name for name in ("profile", "session", "copy"))
        subprocess.run([args.veiloc, "map", "profile", args.map, "-o", profile, "--quiet"], check=True)

        def is_sealed(session: Path, image: Path) -> bool:
            found = subprocess.run([args.veiloc, "seal", image, "--profile", profile, "--camera", "unknown", "--session", session,
                                    "-o", Path(work) / "query", "--quiet"], capture_output=True, text=True)  # fmt: skip
            if found.returncode and "images of this scene" not in found.stderr:
                raise RuntimeError(found.stderr)
            return found.returncode == 0

        def on_copies(session: Path, images: list[Path]) -> int:
            sealed = 0
            for image in images:
                shutil.copy(session, copied)
                sealed += is_sealed(copied, image)
            return sealed

        assert all(is_sealed(first, image) for image in (own[0], own[3]))
        rest = [image for image in own if image not in (own[0], own[3])]
        print(f"other places: {len(others) - on_copies(first, others)} of {len(others)} refused", flush=True)
        print(f"the same place: {on_copies(first, rest)} of {len(rest)} sealed", flush=True)
        for seed in range(args.orders):
            going = Path(work) / "going"
            shutil.copy(first, going)
            order, starts, third = others.copy(), {}, 0
            random.Random(seed).shuffle(order)
            for image in order:
                sealed = is_sealed(going, image)
                place = image.parent.parent.name
                if sealed and place in ("fountain", "entry"):
                    starts[place] = starts.get(place, 0) + 1
                    third += starts[place] > 2
            print(f"after others, order {seed}: {on_copies(going, rest)} of {len(rest)} sealed; Fountain and Entry beyond two: "
                  f"{third} sealed; {going.stat().st_size} bytes", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
