"""Maps a place, seals images as a device does, and localizes them: both roads in one program.

    python examples/python/map_and_localize.py

On a room that is rendered here; everything after the renderer is what real images go through.
"""

import tempfile
from pathlib import Path

import veiloc


def main(folder: Path) -> list[float]:
    """Everything; returns how far off each answer was, metres."""
    # Names, cameras and poses, as a COLMAP model has them: `Map.build("sparse/0", "images")`.
    posed, hidden = veiloc.render_place(folder)

    # The operator: posed images to a map file.
    veiloc.Map.build(posed, folder, self_test=False).save(folder / "room.vmap")
    room = veiloc.Map.open(folder / "room.vmap")
    print(room)

    errors = []
    for name, camera, truth in hidden:
        # The device: it needs the map's profile, which holds no map data. The bytes are all that leaves it.
        query = veiloc.seal(folder / name, camera, room.profile)
        # The operator again.
        try:
            answer = room.localize(query)
        except veiloc.NotLocalizedError as why:
            print(f"{name}: {why}")
            continue
        degrees, off = answer.pose.error(truth)
        errors.append(off)
        print(f"{name}: {answer.state}, {1000 * off:.1f} mm and {degrees:.2f}° off, ± {1000 * answer.position_sd:.1f} mm")
    return errors


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(Path(folder))
