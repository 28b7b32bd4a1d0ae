#!/usr/bin/env python3
"""A map of a video: frames that are taken, registered images, hold-outs.

    python -m venv venv && venv/bin/pip install numpy pycolmap pillow imageio-ffmpeg
    venv/bin/python research/study/video_map.py VEILOC DATA/redkitchen WORK OUT.csv

The video is made here (H.264, 20 frames a second) of the map images in the order of the walk: each one once blurred along a line
of 7 pixels, as by a moving hand, and once as it is, and every tenth one for a second more, as by a hand that rests. The
hold-outs are localized with the camera that the map estimated; poses are moved by the similarity that fits the centres of the map's
images to the given ones.
"""

import json
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from images_alone import arguments, errors, given_poses, place_of, run, summary, write_rows
from geometry import center, similarity
from PIL import Image

RATE = 20


def blurred(image):
    pixels = np.asarray(image, dtype=float)
    return Image.fromarray(np.mean([np.roll(pixels, shift, axis=1) for shift in range(-3, 4)], axis=0).astype(np.uint8))


def main():
    veiloc, place, work, out = arguments(__doc__, "veiloc", "place", "work", "out")
    place, work = Path(place), Path(work)
    _, truth, names, held_out = place_of(place)
    frames = work / "video"
    frames.mkdir(parents=True, exist_ok=True)
    # Of each frame of the video, the image and whether it is sharp.
    shown = []
    for at, name in enumerate(sorted(names)):
        image = Image.open(place / "images" / name).convert("RGB")
        for frame, is_sharp in [(blurred(image), False)] + [(image, True)] * (1 + RATE * (at % 10 == 9)):
            frame.save(frames / f"{len(shown):05}.png")
            shown.append((name, is_sharp))
    video = work / "walk.mp4"
    ffmpeg = imageio_ffmpeg.get_ffmpeg_exe()
    encode = ["-framerate", str(RATE), "-i", frames / "%05d.png", "-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", video]
    subprocess.run([ffmpeg, "-v", "error", "-y", *map(str, encode)], check=True)
    built = work / "walk.vmap"
    _, seconds = run([veiloc, "map", "build", "--images", video, "--python", sys.executable, "-o", built])
    taken = json.loads((work / "walk.sfm/frames/video.json").read_text())["frames"]
    run([veiloc, "map", "export", built, "--colmap", work / "export", "--text"])
    posed = given_poses(work / "export")
    pairs = []
    for name, (_, r, t) in posed.items():
        pairs.append((center(r, t), center(*truth[shown[taken[int(Path(name).stem) - 1]][0]][1:])))
    x, y = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
    moved = similarity(x, y)
    s, r, t = moved
    apart = np.linalg.norm(s * x @ r.T + t - y, axis=1)
    (estimated,) = {camera for camera, _, _ in posed.values()}
    queries = work / "queries.txt"
    queries.write_text("".join(f"{name} {estimated}\n" for name in held_out))
    found = errors(veiloc, built, queries, place / "images", truth, moved)
    row = {
        "place": place.name,
        "frames of the video": len(shown),
        "frames taken": len(taken),
        "of these blurred": sum(not shown[number][1] for number in taken),
        "registered": len(posed),
        "processor time (s)": round(seconds),
        "centres of map images, RMS (map units)": f"{np.sqrt((apart**2).mean()):.4f}",
        **summary(found),
    }
    print(row, file=sys.stderr)
    write_rows(out, [row])


if __name__ == "__main__":
    main()
