"""The obfuscation schemes, and the candidate positions of a row. All coordinates are pixels from the image corner.

A row has one candidate, or two with `coordinate-permutation`: a segment of a line on which the keypoint lies. For keypoints that are
uniform in the image, the density along the segment is linear: constant on a line of random direction, and proportional to the distance
from the anchor in Dual Convergent Lines. `tests/test_schemes.py` compares this with random keypoints.
"""

import math
from dataclasses import dataclass

import numpy as np

TURN = 2.0 * math.pi
#: Bits of a quantized angle over the half circle.
ANGLE_BITS = 12
#: Lengths are quantized to quarters of a pixel.
STEPS_PER_PIXEL = 4.0
#: If the cosine between an anchor and the optical axis is larger, its angles are measured from the vertical.
MOST_AHEAD = 0.995


@dataclass(frozen=True)
class Scheme:
    """`random-lines`, `coordinate-permutation`, or `dcl` with two halves."""

    kind: str
    #: Angle of the dividing line of `dcl`, from right towards down.
    degrees: float = 90.0
    #: Distance of the anchors from the centre, in half image heights.
    s: float = 1.0

    @staticmethod
    def parse(text: str) -> "Scheme":
        """Parses a name as for the program's `--scheme`; layouts with more than two sectors are not supported."""
        kind, _, layout = text.partition(":")
        if kind in ("random-lines", "coordinate-permutation") and not layout:
            return Scheme(kind)
        if kind != "dcl":
            raise ValueError(f"{text!r} is not random-lines, coordinate-permutation or dcl")
        degrees, s = 90.0, 1.0
        for part in filter(None, layout.replace(",", ":").split(":")):
            name, _, value = part.partition("=")
            if part in ("paper", "vertical"):
                degrees = 90.0
            elif part == "horizontal":
                degrees = 0.0
            elif name == "angle":
                degrees = round(float(value), 2)
            elif name == "s":
                s = round(float(value), 2)
            else:
                raise ValueError(f"{part!r} is not an option of a layout with two halves")
        if not (0.0 <= degrees < 180.0 and 0.1 <= s <= 20.0):
            raise ValueError(f"{text!r}: the angle must be from 0 to below 180 degrees, and s from 0.1 to 20")
        return Scheme("dcl", degrees, s)


@dataclass(frozen=True)
class Candidates:
    """`[N, S]` segments `origin + t direction`, `near <= t <= far`; `near > far` where the line misses the image."""

    origin: np.ndarray  # [N, S, 2]
    direction: np.ndarray  # [N, S, 2], of length 1
    near: np.ndarray
    far: np.ndarray
    #: The density at t is, up to a factor, `growth[0] + growth[1] * t`. `[N, S, 2]`
    growth: np.ndarray
    #: Probability of this candidate of the row.
    share: np.ndarray

    def empty(self) -> np.ndarray:
        """`[N, S]`: whether the line misses the image."""
        return ~((self.near <= self.far) & np.isfinite(self.near) & np.isfinite(self.far))

    def at(self, t: np.ndarray) -> np.ndarray:
        """The position at `t` `[N, S]`, `[N, S, 2]`."""
        return self.origin + t[..., None] * self.direction


def sent(keypoints: np.ndarray, size: tuple[int, int], scheme: Scheme, rng: np.random.Generator) -> Candidates:
    """Obfuscates keypoints as a device does (dither, line, rounding), and returns the candidates of each row, in the same order.

    Keypoints at one position share one line; otherwise their lines would intersect at it."""
    places, of = np.unique(np.asarray(keypoints, dtype=np.float64), axis=0, return_inverse=True)
    dithered = places + rng.random(places.shape) - 0.5
    made = {"random-lines": random_lines, "coordinate-permutation": permuted, "dcl": convergent}[scheme.kind]
    candidates = made(dithered, np.asarray(size, dtype=np.float64), scheme, rng)
    of = of.reshape(-1)
    return Candidates(**{name: value[of] for name, value in vars(candidates).items()})


def rounded(lengths: np.ndarray) -> np.ndarray:
    return np.floor(lengths * STEPS_PER_PIXEL + 0.5) / STEPS_PER_PIXEL


def chords(points: np.ndarray, directions: np.ndarray, size: np.ndarray, share: float) -> Candidates:
    """Lines through these points `[N, S, 2]`, clipped to the image."""
    center = size / 2.0
    normals = np.stack([-directions[..., 1], directions[..., 0]], axis=-1)
    offset = ((points - center) * normals).sum(axis=-1, keepdims=True)
    origin = center + offset * normals
    near, far = clipped(origin, directions, size)
    growth = np.broadcast_to(np.array([1.0, 0.0]), directions.shape).copy()
    return Candidates(origin, directions, near, far, growth, np.full(near.shape, share))


def clipped(origin: np.ndarray, direction: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The interval of each line inside the image."""
    flat = np.abs(direction) < 1e-12
    step = np.where(flat, 1.0, direction)
    a, b = -origin / step, (size - origin) / step
    outside = flat & ((origin < -1e-9) | (origin > size + 1e-9))
    low = np.where(flat, -np.inf, np.minimum(a, b)).max(axis=-1)
    high = np.where(flat, np.inf, np.maximum(a, b)).min(axis=-1)
    return low, np.where(outside.any(axis=-1), -np.inf, high)


def random_lines(places: np.ndarray, size: np.ndarray, _: Scheme, rng: np.random.Generator) -> Candidates:
    """A line of random direction."""
    code = rng.integers(1 << ANGLE_BITS, size=len(places))
    angle = (code + 0.5) * math.pi / (1 << ANGLE_BITS)
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
    return lines_of_rows(code, rounded(((places - size / 2.0) * normal).sum(axis=-1)), size)


def lines_of_rows(code: np.ndarray, offset: np.ndarray, size: np.ndarray) -> Candidates:
    """Candidates of `random-lines` rows: `-sin u + cos v = offset` from the centre, pixels."""
    angle = (code + 0.5) * math.pi / (1 << ANGLE_BITS)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    normal = np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
    points = size / 2.0 + offset[:, None] * normal
    return chords(points[:, None], directions[:, None], size, 1.0)


def permuted(places: np.ndarray, size: np.ndarray, _: Scheme, rng: np.random.Generator) -> Candidates:
    """Pairs exchange one coordinate: the keypoint is on the horizontal or the vertical line through the sent position."""
    return crosses_of_rows(rounded(exchanged(places - size / 2.0, size / 2.0, rng)), size)


def crosses_of_rows(from_center: np.ndarray, size: np.ndarray) -> Candidates:
    """Candidates of `coordinate-permutation` rows: positions from the centre, pixels."""
    points = from_center + size / 2.0
    directions = np.broadcast_to(np.array([[1.0, 0.0], [0.0, 1.0]]), (len(points), 2, 2)).copy()
    return chords(np.repeat(points[:, None], 2, axis=1), directions, size, 0.5)


def exchanged(places: np.ndarray, half: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Positions from the centre, each with one coordinate of its partner; with an odd number, the last three form a cycle."""
    count = len(places)
    result = places.copy()
    if count == 1:
        axis = rng.integers(2)
        result[0, axis] = (2.0 * rng.random() - 1.0) * half[axis]
        return result
    order = rng.permutation(count)
    pairs, ring = (order, order[:0]) if count % 2 == 0 else (order[:-3], order[-3:])
    first, second = pairs[0::2], pairs[1::2]
    axis = rng.integers(2, size=len(first))
    result[first, axis], result[second, axis] = places[second, axis], places[first, axis]
    if len(ring):
        axis = rng.integers(2)
        result[ring, axis] = places[np.roll(ring, -1), axis]
    return result


def convergent(places: np.ndarray, size: np.ndarray, scheme: Scheme, _: np.random.Generator) -> Candidates:
    """The half-line from the anchor of the keypoint's half; its angle covers the whole circle and has one more bit.

    An anchor is a direction in space, for a camera whose focal length is the image's longer side. The quantized angle is that of the
    plane through the anchor and the keypoint. Functionals act on `(u, v, 1)`.
    """
    focal, levels = size.max(), 2 << ANGLE_BITS
    homogeneous = np.concatenate([places, np.ones((len(places), 1))], axis=1)
    first = (places - size / 2.0) @ side_of(scheme) >= 0.0
    code = np.zeros(len(places), np.int64)
    for chosen, anchor in zip((first, ~first), anchors(scheme, size)):
        zero, quarter = pencil(anchor, size, focal)
        angle = np.mod(np.arctan2(homogeneous[chosen] @ quarter, homogeneous[chosen] @ zero), TURN)
        code[chosen] = np.clip(np.floor(angle / TURN * levels), 0, levels - 1)
    return half_lines_of_rows(first, code, size, scheme, focal)


def half_lines_of_rows(first: np.ndarray, code: np.ndarray, size: np.ndarray, scheme: Scheme, focal: float) -> Candidates:
    """Candidates of `dcl` rows, from the anchor (`first`: whether it is the first one) and the quantized angle `code`."""
    angle = (code + 0.5) * TURN / (2 << ANGLE_BITS)
    origin, direction = np.empty((len(code), 2)), np.empty((len(code), 2))
    for chosen, anchor in zip((first, ~first), anchors(scheme, size)):
        zero, quarter = pencil(anchor, size, focal)
        cos, sin = np.cos(angle[chosen])[:, None], np.sin(angle[chosen])[:, None]
        normal, ahead = quarter * cos - zero * sin, zero * cos + quarter * sin
        line = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        line /= np.linalg.norm(line, axis=1, keepdims=True)
        backwards = (ahead[:, :2] * line).sum(axis=1) < 0.0
        direction[chosen] = np.where(backwards[:, None], -line, line)
        origin[chosen] = size / 2.0 + anchor
    near, far = clipped(origin, direction, size)
    near = np.maximum(near, 0.0)
    # A half-line that starts on the dividing line lies in one half; if rounding moved it to the other half, no candidate remains.
    across = (direction @ side_of(scheme)) * np.where(first, 1.0, -1.0) < 0.0
    far = np.where(across | (far - near <= 1e-9), -np.inf, far)
    growth = np.broadcast_to(np.array([0.0, 1.0]), (len(code), 2)).copy()
    fields = dict(origin=origin, direction=direction, near=near, far=far, growth=growth, share=np.ones(len(code)))
    return Candidates(**{name: value[:, None] for name, value in fields.items()})


def anchors(scheme: Scheme, size: np.ndarray) -> list[np.ndarray]:
    """The two anchors of `dcl`, from the centre."""
    far = 0.5 * scheme.s * size[1] * exact(scheme.degrees)
    return [-far, far]


def side_of(scheme: Scheme) -> np.ndarray:
    """Normal of the dividing line, towards the half of the first anchor."""
    along = exact(scheme.degrees)
    return np.array([-along[1], along[0]])


def exact(degrees: float) -> np.ndarray:
    """Cosine and sine, exact for multiples of 90 degrees."""
    both = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
    return np.where(np.abs(both) < 1e-15, 0.0, both)


def pencil(anchor: np.ndarray, size: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """Functionals of the angles 0 and 90 degrees about an anchor, given from the centre, pixels."""
    toward = np.append(anchor / focal, 1.0)
    toward /= np.linalg.norm(toward)
    start = np.array([0.0, 1.0, 0.0]) if toward[2] > MOST_AHEAD else np.array([0.0, 0.0, 1.0])
    zero = start - toward * toward.dot(start)
    zero /= np.linalg.norm(zero)
    quarter = np.cross(toward, zero)
    bearing = np.array([[1.0, 0.0, -size[0] / 2.0], [0.0, 1.0, -size[1] / 2.0], [0.0, 0.0, focal]])
    return bearing.T @ zero, bearing.T @ quarter
