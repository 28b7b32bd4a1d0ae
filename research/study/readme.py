"""The animated image of the README: half-lines leave a device, and a pose comes back."""

from pathlib import Path

from study.common import ROOT, Package, command
from study.tilt import ANCHORS

np, veiloc = Package("numpy"), Package("veiloc")
Image, ImageDraw, ImageFont = Package("PIL.Image"), Package("PIL.ImageDraw"), Package("PIL.ImageFont")

WIDTH, HEIGHT = 960, 414
SAVED = 760, 328
PANEL = 440, 330
LEFT, RIGHT, TOP = 14, WIDTH - 14 - PANEL[0], 46
DARK, CARD, INK, MUTED = (13, 16, 20), (22, 27, 34), (230, 237, 243), (139, 148, 158)
LINE, POINT, GOOD = (140, 205, 245), (255, 200, 87), (86, 211, 100)
SHOWN = 110  # keypoints and lines that are drawn
STEPS = {"keypoints": 4, "lines": 9, "hold": 4, "send": 9, "match": 5, "pose": 5, "answer": 8, "end": 14}


def mix(a, b, share):
    return tuple(round(x + (y - x) * share) for x, y in zip(a, b))


def ease(share):
    return share * share * (3 - 2 * share)


def segments_of(points, anchors, size):
    """Half-lines of the default layout, clipped to the image: [N, 2, 2] pixels."""
    places, ends = size / 2 + np.array(ANCHORS) * size[1], []
    for point, anchor in zip(points, anchors):
        start = places[anchor]
        along = start + np.linspace(0, 3 * np.hypot(*size) / np.linalg.norm(point - start), 8000)[:, None] * (point - start)
        inside = along[np.all((along >= 0) & (along <= size), axis=1)]
        ends.append([inside[0], inside[-1]])
    return np.array(ends)


class Scene:
    """The map's points and a camera, seen from above at a slant."""

    def __init__(self, points, down, center):
        up = -np.array(down) / np.linalg.norm(down)
        east = np.cross(up, [0.3, 0.1, 1.0])
        east /= np.linalg.norm(east)
        self.axes = east, np.cross(up, east), up
        self.middle = np.median(points, axis=0)
        near = np.linalg.norm(points - self.middle, axis=1)
        points = points[near < np.quantile(near, 0.98)]
        self.points = points[:: max(1, len(points) // 2500)]
        self.size = max(np.quantile(near, 0.95), np.linalg.norm(center - self.middle)) * 1.25

    def project(self, points):
        east, north, up = ((np.atleast_2d(points) - self.middle) @ np.array(self.axes).T).T
        x = PANEL[0] / 2 + east / self.size * PANEL[1] * 0.62
        y = PANEL[1] / 2 - (0.75 * north + 0.6 * up) / self.size * PANEL[1] * 0.62
        return np.stack([x, y], 1)


@command(demo=("out/demo", "folder that `veiloc demo` wrote"), query="query-01.png", into=str(ROOT / "docs/images/query.gif"))
def animation(run):
    """Draws docs/images/query.gif.

    All that is drawn comes from a run: the keypoints of a query image of the demo, the half-lines with which they are replaced, the map's
    points, and the answer of the map to the sealed query with its ±. Needs the packages veiloc, numpy and pillow."""
    demo, out = Path(run.demo), Path(run.into)
    place = veiloc.Map.open(demo / "place.vmap")
    model = veiloc.ColmapModel.open(demo / "posed")
    file, camera = demo / "images" / run.query, model.camera(run.query)
    sealer = veiloc.Sealer(place.profile)
    query = sealer.seal(sealer.extract(file, camera))
    answer = place.localize(query)
    image = Image.open(file).convert("RGB")
    size = np.array(image.size, float)
    points = veiloc.extract(file, max_keypoints=SHOWN)["keypoints"]
    anchors, _ = veiloc.anchored_lines(points, camera, "dcl")
    scale = min(PANEL[0] / size[0], PANEL[1] / size[1])
    shift = (np.array(PANEL) - scale * size) / 2
    segments = segments_of(points, anchors, size) * scale + shift
    dots = points * scale + shift
    small = image.resize((round(size[0] * scale), round(size[1] * scale)), Image.Resampling.LANCZOS)
    scene = Scene(place.points, place.down or [0, 1, 0], answer.center)
    text, bold = ImageFont.load_default(17), ImageFont.load_default(19)

    def frame(keypoints=0.0, lines=0.0, sent=0.0, matched=0.0, pose=0.0, back=0.0):
        canvas = Image.new("RGB", (WIDTH, HEIGHT), DARK)
        draw = ImageDraw.Draw(canvas, "RGBA")
        for x, title in ((LEFT, "On the device"), (RIGHT, "On the server")):
            draw.rounded_rectangle((x, TOP, x + PANEL[0], TOP + PANEL[1]), 8, fill=CARD)
            draw.text((x + 4, 14), title, fill=INK, font=bold)
        faded = Image.blend(small, Image.new("RGB", small.size, CARD), 0.82 * lines)
        canvas.paste(faded, (LEFT + round(shift[0]), TOP + round(shift[1])))
        corner = np.array([LEFT, TOP])
        for x, y in dots + corner if keypoints and lines < 1 else ():
            draw.ellipse((x - 2.5, y - 2.5, x + 2.5, y + 2.5), fill=(*POINT, round(255 * keypoints * (1 - lines))))
        target = np.array([RIGHT, TOP])
        if lines:
            grown = dots[:, None] + (segments - dots[:, None]) * ease(lines)
            for a, b in grown + corner:
                draw.line((*a, *b), fill=(*LINE, 120), width=1)
        if 0 < sent < 1:
            for a, b in segments + corner + (target - corner) * ease(sent):
                draw.line((*a, *b), fill=(*LINE, 90), width=1)
        if sent >= 1 and pose < 1:
            for a, b in segments + target:
                draw.line((*a, *b), fill=(*LINE, round(90 * (1 - matched))), width=1)
        if matched:
            for x, y in scene.project(scene.points) + target:
                if RIGHT < x < RIGHT + PANEL[0] and TOP < y < TOP + PANEL[1]:
                    draw.ellipse((x - 1, y - 1, x + 1, y + 1), fill=(*mix(CARD, INK, 0.75), round(255 * matched)))
        if pose:
            r, center = np.array(answer.pose.R), np.array(answer.center)
            reach = 0.16 * scene.size
            corners = [center + reach * r.T @ [x, y, 1.4] for x, y in ((-0.7, -0.5), (0.7, -0.5), (0.7, 0.5), (-0.7, 0.5))]
            corners = [tuple(p) for p in scene.project(np.array(corners)) + target]
            at = tuple(scene.project(center)[0] + target)
            colour = (*GOOD, round(255 * pose))
            draw.polygon(corners, outline=colour, fill=(*GOOD, round(50 * pose)), width=2)
            for corner_at in corners:
                draw.line((*at, *corner_at), fill=colour, width=2)
            draw.ellipse((at[0] - 5, at[1] - 5, at[0] + 5, at[1] + 5), fill=colour)
        below = TOP + PANEL[1] + 8
        if 0 < sent:
            draw.text((LEFT + 10, below), f"sent: {place.profile.max_keypoints} half-lines with descriptors, {len(query) / 1000:.0f} kB",
                      fill=mix(DARK, INK, min(1, 2 * sent)), font=text)  # fmt: skip
        elif lines:
            draw.text((LEFT + 10, below), "each keypoint becomes a half-line; the image stays here", fill=mix(DARK, INK, lines), font=text)
        elif keypoints:
            draw.text((LEFT + 10, below), "keypoints", fill=INK, font=text)
        if back:
            digits = ", ".join(f"{v:.3f}" for v in answer.center)
            words = f"you are at {digits} ± {answer.position_sd:.3f} m"
            length = draw.textlength(words, font=bold)
            start, end = RIGHT + (PANEL[0] - length) / 2, LEFT + (PANEL[0] - length) / 2
            x, y = start + (end - start) * ease(back), TOP + PANEL[1] / 2 - 14
            draw.rounded_rectangle((x - 12, y - 8, x + length + 12, y + 30), 8, fill=(*GOOD, 235))
            draw.text((x, y), words, fill=DARK, font=bold)
        return canvas.resize(SAVED, Image.Resampling.LANCZOS)

    frames, state = [frame()] * 4, {}
    for key, steps in [("keypoints", STEPS["keypoints"]), ("lines", STEPS["lines"]), (None, STEPS["hold"]), ("sent", STEPS["send"]),
                       ("matched", STEPS["match"]), ("pose", STEPS["pose"]), ("back", STEPS["answer"]), (None, STEPS["end"])]:  # fmt: skip
        for i in range(steps):
            if key:
                state[key] = (i + 1) / steps
            frames.append(frame(**state))
    # Colours of the image and of the end together.
    both = Image.new("RGB", (SAVED[0], 2 * SAVED[1]))
    for i, of in enumerate((frames[0], frames[-1])):
        both.paste(of, (0, i * SAVED[1]))
    palette = both.quantize(48)
    flat = [f.quantize(palette=palette, dither=Image.Dither.NONE) for f in frames]
    flat[0].save(out, save_all=True, append_images=flat[1:], duration=130, loop=0, optimize=True)
    print(f"{out}: {len(frames)} frames, {out.stat().st_size / 1000:.0f} kB; {run.query}: {answer.state}, ± {answer.position_sd:.4f}")
