"""The frames of a video that `map build` takes: `video.py` of veiloc-mapping, on moving textures and on a real video."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[3] / "crates/tools/mapping/src/structure_from_motion/video.py"
spec = importlib.util.spec_from_file_location("video", SCRIPT)
video = importlib.util.module_from_spec(spec)
spec.loader.exec_module(video)

TEXTURE = np.kron(np.random.default_rng(1).integers(0, 256, (30, 600)), np.ones((4, 4))).astype(np.uint8)


def view(x, blur=0):
    """A window of a large texture, blurred by some passes."""
    image = TEXTURE[:, x : x + video.WIDTH].astype(int)
    for _ in range(blur):
        image[:, 1:-1] = (image[:, :-2] + 2 * image[:, 1:-1] + image[:, 2:]) // 4
    return image.astype(np.uint8)


def chosen(frames):
    chooser = video.Chooser()
    for frame in frames:
        chooser.push(frame)
    return chooser.finish()


def test_camera_that_rests_gives_one_frame():
    assert chosen(view(40) for _ in range(50)) == [0]
    assert chosen(np.full((120, 160), 7, np.uint8) for _ in range(5)) == [0], "no texture"


def test_sharpest_frame_of_a_rest_is_kept():
    assert chosen([view(0), view(100, 3), view(101, 2), *(view(102) for _ in range(9))]) == [0, 3]


def test_kept_frames_are_one_step_of_the_image_apart():
    # Two pixels of 160 a frame: 1.25 % of the width.
    kept = chosen(view(2 * i) for i in range(80))
    moved = 0.0125 * np.diff(kept)
    assert len(kept) > 8 and (moved >= video.MIN_MOVED - 0.01).all() and (moved <= video.MAX_MOVED + 0.01).all(), kept


def test_sharpest_frame_of_a_step_is_kept():
    # Every fourth frame is sharp, and the video ends just after one.
    kept = chosen(view(2 * i, 0 if i % 4 == 0 else 3) for i in range(78))
    assert len(kept) > 5 and not any(number % 4 for number in kept), kept


def test_frame_of_another_view_is_kept_at_once():
    assert chosen([view(0), view(900), view(900), view(1800)]) == [0, 1, 3]


def test_frames_of_a_video_are_written(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    raw = b"".join(view(2 * i).tobytes() for i in range(60))
    size = f"{video.WIDTH}x{TEXTURE.shape[0]}"
    walk = tmp_path / "walk.mp4"
    encode = [ffmpeg, "-v", "error", "-f", "rawvideo", "-pix_fmt", "gray", "-s", size, "-i", "-", "-pix_fmt", "yuv420p", walk]
    subprocess.run(encode, input=raw, check=True)

    def run(file):
        task = json.dumps({"video": str(file), "folder": str(tmp_path / "frames")})
        return subprocess.run([sys.executable, SCRIPT], input=task, capture_output=True, text=True)

    last = json.loads(run(walk).stdout.splitlines()[-1])
    assert last["fault"] == ""
    assert last["of"] == 60 and len(last["frames"]) > 6
    assert [path.name for path in sorted((tmp_path / "frames").iterdir())] == [f"{i + 1:06}.jpg" for i in range(len(last["frames"]))]
    # A copy that ends early, with its index at the start: the frames that are there are used, and the fault is named. A % in the path
    # is no pattern.
    fast = tmp_path / "fast.mp4"
    subprocess.run([ffmpeg, "-v", "error", "-i", walk, "-c", "copy", "-movflags", "+faststart", fast], check=True)
    fast.write_bytes(fast.read_bytes()[: fast.stat().st_size * 7 // 10])
    task = json.dumps({"video": str(fast), "folder": str(tmp_path / "100%d done")})
    cut = subprocess.run([sys.executable, SCRIPT], input=task, capture_output=True, text=True)
    last = json.loads(cut.stdout.splitlines()[-1])
    assert last["of"] < 60 and last["fault"], cut
    assert len(list((tmp_path / "100%d done").iterdir())) == len(last["frames"]) > 3
    walk.write_bytes(walk.read_bytes()[:500])
    assert run(walk).returncode != 0
