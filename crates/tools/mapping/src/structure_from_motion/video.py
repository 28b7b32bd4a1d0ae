"""Chooses the frames of a video for structure from motion, run by veiloc: reads a JSON document on stdin, prints one JSON object a line.

A frame is kept when the image has moved by a few percent of its width since the last kept frame: a camera that rests gives one frame,
its sharpest, a fast one many. Of the frames within that range the sharpest is kept. The movement is the median displacement of blocks of
a small grey image; it counts rotations, too, because frames must overlap to be matched.

Input: video (file), folder (of the frames: 000001.jpg, …). Output lines: {"stage": name, "total": 0}, {"done": n}, and at last
{"frames": [their numbers in the video, from 0], "of": n, "fault": what ffmpeg says about damage, or ""}. Needs NumPy, and ffmpeg of the PATH or of the package imageio-ffmpeg.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

WIDTH = 160  # of the grey images that decide, pixels
MIN_MOVED, MAX_MOVED = 0.03, 0.10  # a frame may be kept from there on, and must be at the second; widths of the image
BLOCK, REACH = 8, 12  # side of a block, and largest displacement that is searched, pixels of the half-sized image
TEXTURE = 4.0  # mean absolute deviation from which a block has texture, grey levels
NUMBERS = 1000  # frames that one command line names
# The shortest first: of equal ones, as repeated texture has them, it counts.
SHIFTS = sorted(((x, y) for y in range(-REACH, REACH + 1) for x in range(-REACH, REACH + 1)), key=lambda s: s[0] ** 2 + s[1] ** 2)


def blocks(image):
    """`[rows, columns, BLOCK, BLOCK]` of an image; what does not fill a block is left out."""
    rows, columns = image.shape[0] // BLOCK, image.shape[1] // BLOCK
    cut = image[: rows * BLOCK, : columns * BLOCK]
    return cut.reshape(rows, BLOCK, columns, BLOCK).swapaxes(1, 2)


def halved(image):
    rows, columns = image.shape[0] // 2, image.shape[1] // 2
    quads = image[: 2 * rows, : 2 * columns].astype(np.int32).reshape(rows, 2, columns, 2)
    return (quads.sum(axis=(1, 3)) + 2) // 4


def sharpness(image):
    """Mean square of the Laplacian."""
    i = image.astype(np.int64)
    around = i[:-2, 1:-1] + i[2:, 1:-1] + i[1:-1, :-2] + i[1:-1, 2:]
    return float(((around - 4 * i[1:-1, 1:-1]) ** 2).mean()) if min(i.shape) > 2 else 0.0


def moved(start, end):
    """Median displacement of the textured blocks of one half-sized image in another, in widths of the image.

    None if most of them are not found: the camera moved farther, or the view is another one. 0 without texture.
    """
    own = blocks(start).astype(float)
    texture = np.abs(own - own.mean(axis=(2, 3), keepdims=True)).mean(axis=(2, 3))
    textured = texture >= TEXTURE
    if not textured.any():
        return 0.0
    best = np.full(texture.shape, np.inf)
    length = np.zeros(texture.shape)
    outside = 1_000_000  # a block that leaves the image differs by more than any inside of it
    padded = np.pad(end.astype(np.int64), REACH, constant_values=outside)
    height, width = start.shape
    for x, y in SHIFTS:
        other = padded[REACH + y : REACH + y + height, REACH + x : REACH + x + width]
        difference = blocks(np.abs(start - other)).mean(axis=(2, 3))
        closer = difference < best
        best[closer], length[closer] = difference[closer], np.hypot(x, y)
    found = np.sort(length[textured & (best < 0.6 * texture)])
    return None if 2 * len(found) < textured.sum() else float(found[len(found) // 2]) / width


class Chooser:
    """Chooses frames as they come."""

    def __init__(self):
        self.count, self.kept, self.sharpness = 0, [], 0.0
        self.key = None  # the half-sized image from which movement counts: of the last kept frame, or of the first of its rest
        self.waiting = []  # frames since then that moved far enough: number, sharpness, half-sized image

    def push(self, image):
        queue = [(self.count, sharpness(image), halved(image))]
        self.count += 1
        while queue:
            frame = queue.pop(0)
            far = None if self.key is None else moved(self.key, frame[2])
            if self.key is not None and far is not None and far < MIN_MOVED:
                # While the camera rests, a sharper frame takes the place of the kept one, which is often blurred by the movement before.
                if not self.waiting and frame[1] > self.sharpness:
                    self.kept[-1], self.sharpness = frame[0], frame[1]
            elif self.key is not None and far is not None and far < MAX_MOVED:
                self.waiting.append(frame)
            elif not self.waiting:
                self.keep(frame)
            else:
                # Those after the kept one are judged again, from it.
                queue = [*self.keep_sharpest(), frame, *queue]

    def keep(self, frame):
        self.kept.append(frame[0])
        _, self.sharpness, self.key = frame
        self.waiting = []

    def keep_sharpest(self):
        """Keeps the sharpest waiting frame, the first of equally sharp ones; returns those after it."""
        waiting = self.waiting
        at = max(range(len(waiting)), key=lambda i: waiting[i][1])
        self.keep(waiting[at])
        return waiting[at + 1 :]

    def finish(self):
        """The numbers of the kept frames, ascending."""
        while self.waiting:
            later = [(frame, moved(self.key, frame[2])) for frame in self.keep_sharpest()]
            self.waiting = [frame for frame, far in later if far is None or far >= MIN_MOVED]
        return self.kept


def find_ffmpeg():
    if found := shutil.which("ffmpeg"):
        return found
    try:
        import imageio_ffmpeg
    except ImportError:
        sys.exit("a video needs ffmpeg: install it with the packages of your system, or: python3 -m pip install imageio-ffmpeg")
    return imageio_ffmpeg.get_ffmpeg_exe()


def frames(ffmpeg, video, log):
    """Each frame as a small grey image. ffmpeg writes binary PGM files, one after another; it turns frames as the file says, and it
    goes on after damage, which is in its log."""
    command = [ffmpeg, "-nostdin", "-v", "error", "-i", video, "-an", "-fps_mode", "passthrough", "-vf", f"scale={WIDTH}:-2",
               "-pix_fmt", "gray", "-f", "image2pipe", "-c:v", "pgm", "-"]  # fmt: skip
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as process:
        while line := process.stdout.readline():
            size = process.stdout.readline().split() if line == b"P5\n" else []
            if len(size) != 2 or process.stdout.readline() != b"255\n":
                sys.exit("ffmpeg's output cannot be read")
            width, height = map(int, size)
            pixels = process.stdout.read(width * height)
            if len(pixels) < width * height:
                break
            yield np.frombuffer(pixels, np.uint8).reshape(height, width)
    if process.returncode:
        sys.exit(f"ffmpeg cannot decode it ({process.returncode}): {said(log)}")


def said(log):
    """The first line of a log of ffmpeg, without the addresses in it."""
    log.seek(0)
    lines = [re.sub(r"^\[[^]]*\] *", "", line.strip()) for line in log.read().decode(errors="replace").splitlines()]
    return next((line for line in lines if line), "")


def extract(ffmpeg, video, kept, folder):
    """Writes the frames of these numbers as JPEG files."""
    for start in range(0, len(kept), NUMBERS):
        chosen = "+".join(rf"eq(n\,{number})" for number in kept[start : start + NUMBERS])
        done = subprocess.run(
            [ffmpeg, "-nostdin", "-v", "error", "-y", "-i", video, "-an", "-fps_mode", "passthrough", "-vf", f"select='{chosen}'",
             "-q:v", "2", "-start_number", str(start + 1), f"{str(folder).replace('%', '%%')}/%06d.jpg"], capture_output=True, text=True, check=False)  # fmt: skip
        if done.returncode:
            sys.exit(f"ffmpeg cannot write the frames: {done.stderr.strip()}")


def main():
    task = json.load(sys.stdin)
    ffmpeg, chooser = find_ffmpeg(), Chooser()
    print(json.dumps({"stage": "frames of the video", "total": 0}), flush=True)
    with tempfile.TemporaryFile() as log:
        for frame in frames(ffmpeg, task["video"], log):
            chooser.push(frame)
            print(json.dumps({"done": chooser.count}), flush=True)
        fault = said(log)
    kept = chooser.finish()
    if len(kept) < 3:
        damage = f" (ffmpeg: {fault})" if fault else ""
        sys.exit(f"its {chooser.count} frames show fewer than three different views{damage}; move through the place")
    folder = Path(task["folder"])
    folder.mkdir(parents=True, exist_ok=True)
    # Only what an earlier run wrote: the folder may be one of the user's.
    for name in folder.glob("[0-9]" * 6 + ".jpg"):
        name.unlink()
    extract(ffmpeg, task["video"], kept, folder)
    print(json.dumps({"frames": kept, "of": chooser.count, "fault": fault}), flush=True)


if __name__ == "__main__":
    main()
