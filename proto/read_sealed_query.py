"""Reads a sealed query with nothing but docs/reference/wire-format.md and Python's standard library, and prints its content.

python3 proto/read_sealed_query.py FILE.vquery [ROWS]

Written from the document, not from the Rust code: the known answers of crates/core/protocol/tests/it/known_answers.rs come from
here, so the test compares the two.
"""

import hashlib
import math
import struct
import sys

VERSION = 1
NAMES = [
    "version", "profile_id", "scheme", "dividing_angle", "anchor_distance", "angle_bits", "camera_focal",
    "camera_width", "camera_height", "rows", "descriptor_name", "descriptor_dim", "descriptor_encoding",
    "descriptor_norm", "positions", "descriptors", "global", "focal_known", "gravity", "layout", "turn_x",
    "turn_y", "turn_z", "pack_id", "pack_points", "candidates",
]
KNOWN = {1: "calibrated", 2: "from EXIF", 3: "unknown"}


def varint(data, at):
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def fields(data):
    """Field name -> number or bytes."""
    found, at = {}, 0
    (version,) = struct.unpack_from("<I", data, 1)
    if version != VERSION:
        raise ValueError(f"a sealed query of version {version}; this reader reads version {VERSION}")
    while at < len(data):
        key, at = varint(data, at)
        name = NAMES[(key >> 3) - 1]
        if key & 7 == 5:
            (found[name],), at = struct.unpack_from("<I", data, at), at + 4
        elif key & 7 == 2:
            length, at = varint(data, at)
            found[name], at = data[at : at + length], at + length
        else:
            raise ValueError(f"wire type {key & 7}")
    return found


def cross(a, b):
    return tuple(a[i - 2] * b[i - 1] - a[i - 1] * b[i - 2] for i in range(3))


def unit(v):
    norm = math.sqrt(sum(x * x for x in v))
    return tuple(x / norm for x in v)


def anchors(message):
    """Direction of each anchor, and the directions of the angles 0 and a quarter turn about it, in the camera's axes."""
    height, focal = 32 * message["camera_height"], 2 ** (message["camera_focal"] / 4)
    layout, found = message["layout"], []
    if not layout:
        delta, s = math.radians(message["dividing_angle"] / 100), message["anchor_distance"] / 100
        places = [(-math.cos(delta) * s / 2, -math.sin(delta) * s / 2), (math.cos(delta) * s / 2, math.sin(delta) * s / 2)]
        found = [unit((x * height / focal, y * height / focal, 1)) for x, y in places]
    else:
        for k in range(layout[0]):
            x, y = struct.unpack_from("<hh", layout, 2 + 4 * k)
            if x == -32768:
                found.append((math.cos(math.radians(y / 100)), math.sin(math.radians(y / 100)), 0))
            else:
                found.append(unit((x / 1000 * height / focal, y / 1000 * height / focal, 1)))
    turn = [struct.unpack("<i", struct.pack("<I", message["turn_" + axis]))[0] / 1e6 for axis in "xyz"]
    angle = math.sqrt(sum(x * x for x in turn))

    def turned(v):
        if angle == 0:
            return v
        axis = unit(turn)
        along, across = sum(a * x for a, x in zip(axis, v)), cross(axis, v)
        return tuple(
            math.cos(angle) * x + math.sin(angle) * c + (1 - math.cos(angle)) * along * a
            for x, c, a in zip(v, across, axis)
        )

    frames = []
    for d in found:
        start = (0, 1, 0) if abs(d[2]) > 0.995 else (0, 0, 1)
        along = sum(a * b for a, b in zip(d, start))
        zero = unit(tuple(b - along * a for a, b in zip(d, start)))
        frames.append([turned(v) for v in (d, zero, cross(d, zero))])
    return frames


def rows(message):
    """The obfuscated position of each row, as the document defines it."""
    bits, scheme = message["angle_bits"], message["scheme"]
    frames = anchors(message) if scheme == 4 else []
    width, height = 32 * message["camera_width"], 32 * message["camera_height"]
    packed, at = int.from_bytes(message["positions"], "big"), 8 * len(message["positions"])

    def take(n):
        nonlocal at
        at -= n
        return (packed >> at) & ((1 << n) - 1)

    def length():
        return (take(16) - 32768) / 4

    for _ in range(message["rows"]):
        if scheme in (1, 3):
            yield length() + width / 2, length() + height / 2
        elif scheme == 2:
            theta, offset = (take(bits) + 0.5) * math.pi / 2**bits, length()
            a, b = -math.sin(theta), math.cos(theta)
            yield a, b, -offset - a * width / 2 - b * height / 2
        else:
            d, zero, quarter = frames[take(1 if len(frames) == 2 else 2)]
            phi = (take(bits + 1) + 0.5) * math.pi / 2**bits
            inward = tuple(math.cos(phi) * a + math.sin(phi) * b for a, b in zip(zero, quarter))
            yield *cross(d, inward), *inward


def candidates(message):
    """The point that each row is taken for, with the probability, of a match query."""
    width = max(1, (message["pack_points"] - 1).bit_length())
    bits, at = int.from_bytes(message["candidates"], "big"), 8 * len(message["candidates"])
    for _ in range(message["rows"]):
        at -= width + 4
        point, weight = divmod((bits >> at) & ((1 << (width + 4)) - 1), 16)
        yield point, 1 / (1 + math.exp(-(weight - 8) / 2))


def down(code):
    """Down in the camera's axes and its deviation in degrees, of a code above 0."""
    code, b = divmod(code - 1, 256)
    k, a = divmod(code, 256)
    x, y = (a + 0.5) / 128 - 1, (b + 0.5) / 128 - 1
    z = 1 - abs(x) - abs(y)
    if z < 0:
        x, y = math.copysign(1 - abs(y), x), math.copysign(1 - abs(x), y)
    norm = math.sqrt(x * x + y * y + z * z)
    return x / norm, y / norm, z / norm, 0.5 * 2**k


def main():
    data = open(sys.argv[1], "rb").read()
    message = fields(data)
    print("bytes", len(data), "sha256", hashlib.sha256(data).hexdigest())
    for name, value in message.items():
        text = value.decode() if name == "descriptor_name" else None
        print(name, text or (value if isinstance(value, int) else f"{len(value)} bytes {value[:16].hex()}"))
    print("focal", 2 ** (message["camera_focal"] / 4), KNOWN[message["focal_known"]])
    if message["gravity"]:
        print("down", *(f"{value:.9f}" for value in down(message["gravity"])))
    for index, row in enumerate(rows(message)):
        if index < (int(sys.argv[2]) if len(sys.argv) > 2 else 3) or index == message["rows"] - 1:
            print(index, *(f"{value:.9f}" for value in row))


if __name__ == "__main__":
    main()
