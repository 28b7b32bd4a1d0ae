"""HEIC and WebP files of one drawn picture, and their pixels as libheif and libwebp decode them.

    pip install numpy pillow pillow-heif
    python3 research/oracles/heic.py crates/device/features/tests/data

`rotated.heic` is stored as a phone held upright stores it: landscape pixels, to be rotated for display. Its pixels in `rotated.png`
are the stored ones.
"""

import sys
from pathlib import Path

import numpy as np
import pillow_heif
from PIL import Image, ImageDraw

ROTATE_90 = 6
ORIENTATION, EXIF_IFD, FOCAL_35MM = 0x0112, 0x8769, 0xA405


def drawn() -> Image.Image:
    image = Image.new("RGB", (160, 120), (90, 110, 130))
    draw = ImageDraw.Draw(image)
    random = np.random.default_rng(5)
    for _ in range(60):
        x, y, w, h = random.integers(0, [150, 110, 40, 30])
        draw.rectangle([x, y, x + w, y + h], fill=tuple(int(c) for c in random.integers(0, 256, 3)))
    return image


def main() -> None:
    folder = Path(sys.argv[1])
    pillow_heif.register_heif_opener()
    image = drawn()
    exif = Image.Exif()
    exif[ORIENTATION] = ROTATE_90
    exif.get_ifd(EXIF_IFD)[FOCAL_35MM] = 26
    image.save(folder / "rotated.heic", quality=80, exif=exif.tobytes())
    shown = Image.open(folder / "rotated.heic").convert("RGB")
    assert shown.size == (120, 160), "libheif rotates"
    shown.transpose(Image.Transpose.ROTATE_90).save(folder / "rotated.png")
    image.save(folder / "drawn.webp", quality=80)
    Image.open(folder / "drawn.webp").convert("RGB").save(folder / "drawn_webp.png")


main()
