"""Maps a scene, seals images as a device does, and localizes them: device side and server side in one program.

    python examples/python/map_and_localize.py

The scene is a rendered room; all other steps are the same for real images.
"""

import tempfile
from pathlib import Path

import veiloc


def main(folder: Path) -> list[float]:
    """Runs all steps; returns the position error of each answer, metres."""
    # Names, cameras and poses; for a COLMAP model use `Map.build("sparse/0", "images")`.
    posed, queries = veiloc.render_room(folder)

    # The operator: posed images to a map file.
    veiloc.Map.build(posed, folder, self_test=False).save(folder / "room.vmap")
    room = veiloc.Map.open(folder / "room.vmap")
    print(room)
    # The device needs the map's profile, which holds no map data.
    sealer = veiloc.Sealer(room.profile)

    errors = []
    for name, camera, truth in queries:
        # Only these bytes leave the device.
        query = sealer.seal(sealer.extract(folder / name, camera))
        # The operator.
        try:
            answer = room.localize(query)
        except veiloc.NotLocalizedError as why:
            print(f"{name}: {why}")
            continue
        degrees, metres = answer.pose.error(truth)
        errors.append(metres)
        print(f"{name}: {answer.state}, error {1000 * metres:.1f} mm and {degrees:.2f}°, ± {1000 * answer.position_sd:.1f} mm")
    return errors


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        main(Path(folder))
