"""Regions the shape of people, for `veiloc attack --private-masks`: ellipses, silhouettes of one parametric shape, and people cut out of
photographs."""

from __future__ import annotations

import math
import random
from pathlib import Path

from study.common import Package, command

PAGE = "privacy"
np, Image, ImageDraw = Package("numpy"), Package("PIL.Image"), Package("PIL.ImageDraw")

# Height of a region over the image's.
HEIGHTS = (0.3, 0.6)
UPRIGHT = 2.5  # height over width of an ellipse
# Photograph, and the box of the person in it as shares of its width and height: left, top, right, bottom.
PEOPLE = {
    "nature/146074.jpg": (0.67, 0.19, 0.95, 0.99),
    "nature/170057.jpg": (0.60, 0.30, 0.77, 0.96),
    "nature/250087.jpg": (0.43, 0.23, 0.78, 0.83),
    "nature/267036.jpg": (0.11, 0.49, 0.34, 1.00),
    "nature/277053.jpg": (0.44, 0.08, 0.65, 0.96),
    "nature/285022.jpg": (0.30, 0.25, 0.49, 0.83),
    "nature/286092.jpg": (0.23, 0.21, 0.37, 0.88),
    "nature/292066.jpg": (0.47, 0.41, 0.64, 0.83),
    "nature/368078.jpg": (0.24, 0.47, 0.45, 0.92),
    "nature/372047.jpg": (0.17, 0.33, 0.44, 0.93),
    "nature/388016.jpg": (0.23, 0.13, 0.78, 0.93),
    "nature/388067.jpg": (0.22, 0.10, 0.75, 1.00),
    "nature/64061.jpg": (0.20, 0.34, 0.47, 0.96),
    "nature/89072.jpg": (0.42, 0.16, 0.97, 0.91),
    "objects/n03141823_crutch.jpg": (0.55, 0.22, 0.70, 0.76),
    "objects/n04540053_volleyball.jpg": (0.61, 0.47, 0.83, 0.85),
}  # fmt: skip
# Head, torso with arms, legs: centre and half axes of ellipses, corners of polygons, in units of the height.
HEAD = ((0.0, 0.07), (0.05, 0.07))
TORSO = ((-0.05, 0.14), (0.05, 0.14), (0.13, 0.19), (0.15, 0.48), (0.10, 0.50), (0.10, 0.54), (-0.10, 0.54), (-0.10, 0.50),
         (-0.15, 0.48), (-0.13, 0.19))  # fmt: skip
LEGS = ((-0.10, 0.53), (0.10, 0.53), (0.10, 1.0), (0.02, 1.0), (0.0, 0.62), (-0.02, 1.0), (-0.10, 1.0))


def ellipse(size: tuple[int, int], draw: random.Random) -> Image.Image:
    """White with a black upright ellipse, wholly inside the image."""
    tall = draw.uniform(*HEIGHTS) * size[1]
    mask = Image.new("L", size, 255)
    u, v = place((tall / UPRIGHT, tall), size, draw)
    ImageDraw.Draw(mask).ellipse((u, v, u + tall / UPRIGHT, v + tall), fill=0)
    return mask


def silhouette(size: tuple[int, int], draw: random.Random) -> Image.Image:
    """White with a black standing person of simple parts."""
    tall = draw.uniform(*HEIGHTS) * size[1]
    mask = Image.new("L", size, 255)
    u, v = place((0.3 * tall, tall), size, draw)
    at = lambda x, y: (u + (x + 0.15) * tall, v + y * tall)
    canvas = ImageDraw.Draw(mask)
    (x, y), (a, b) = HEAD
    canvas.ellipse((*at(x - a, y - b), *at(x + a, y + b)), fill=0)
    for part in (TORSO, LEGS):
        canvas.polygon([at(*corner) for corner in part], fill=0)
    return mask


def place(region: tuple[float, float], size: tuple[int, int], draw: random.Random) -> tuple[float, float]:
    """A random top left corner for a region inside the image."""
    return draw.uniform(0, max(0.0, size[0] - region[0])), draw.uniform(0, max(0.0, size[1] - region[1]))


def pasted(image: Image.Image, people: list[Path], draw: random.Random, heights=HEIGHTS) -> tuple[Image.Image, Image.Image]:
    """The image with a random one of the people in front, and a mask that is black where the person is."""
    with Image.open(draw.choice(people)) as file:
        person = file.convert("RGBA")
    tall = draw.uniform(*heights) * image.height
    wide = tall * person.width / person.height
    person = person.resize((max(1, round(wide)), max(1, round(tall))), Image.LANCZOS)
    corner = tuple(math.floor(x) for x in place(person.size, image.size, draw))
    shown, mask = image.convert("RGB"), Image.new("L", image.size, 255)
    shown.paste(person, corner, person)
    mask.paste(0, corner, person.getchannel("A").point(lambda alpha: 255 * (alpha > 127)))
    return shown, mask


@command(photos=("", "folder of the photographs (default: training-photos of the data)"), network="selfie_segmentation.tflite",
         into=("people", "folder of the people"))  # fmt: skip
def people(run):
    """Cuts the people out of the photographs of PEOPLE, with transparent surroundings, for `persons` and `person-defences`.

    The network is MediaPipe's person segmentation (Apache-2.0), run by `ai-edge-litert`; the boxes were found by YOLO11n."""
    photos, out = Path(run.photos or run.place("training-photos")), Path(run.into)
    interpreter = Package("ai_edge_litert.interpreter").Interpreter(run.network)
    interpreter.allocate_tensors()
    given, found = interpreter.get_input_details()[0]["index"], interpreter.get_output_details()[0]["index"]
    out.mkdir(parents=True, exist_ok=True)
    for name, (left, top, right, bottom) in PEOPLE.items():
        with Image.open(photos / name) as file:
            photo = file.convert("RGB")
        margin = 0.1 * (bottom - top) * photo.height
        box = (left * photo.width - margin, top * photo.height - margin, right * photo.width + margin,
               bottom * photo.height + margin)  # fmt: skip
        photo = photo.crop(tuple(round(min(max(x, 0), photo.size[i % 2])) for i, x in enumerate(box)))
        interpreter.set_tensor(given, np.asarray(photo.resize((256, 256)), np.float32)[None] / 255)
        interpreter.invoke()
        share = Image.fromarray((interpreter.get_tensor(found)[0, :, :, 0] * 255).astype(np.uint8))
        alpha = largest(np.asarray(share.resize(photo.size, Image.BILINEAR)) > 127)
        photo.putalpha(Image.fromarray(255 * alpha.astype(np.uint8)))
        photo.crop(photo.getchannel("A").getbbox()).save(out / f"{Path(name).stem}.png")


def largest(mask: np.ndarray) -> np.ndarray:
    """The largest connected part of a mask."""
    label, best = np.zeros(mask.shape, int), (0, 0)
    for start in zip(*np.nonzero(mask)):
        if label[start]:
            continue
        number, found, left = label.max() + 1, 0, [start]
        label[start] = number
        while left:
            row, column = left.pop()
            found += 1
            for at in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                inside = 0 <= at[0] < mask.shape[0] and 0 <= at[1] < mask.shape[1]
                if inside and mask[at] and not label[at]:
                    label[at] = number
                    left.append(at)
        best = max(best, (found, number))
    return label == best[1]
