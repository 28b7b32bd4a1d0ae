"""Tables of docs/results/inversion.md: images made of learned features, of positions, and patches made of single descriptors.

`--networks` is a folder with `NAME.toml`, `NAME.onnx` and `NAME.csv`, as `research/train` writes them: one for each kind of features,
`positions`, `colour` and `invsfm`.
"""

import argparse
import ast
import base64
import importlib
import io
import math
import re
import shutil
import statistics
import string
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from study import server_images  # noqa: F401, with a command of this page
from study.common import MODEL_FILES, PLACES, PYTORCH, ROOT, SCENES, Package, command, names_of, number, one_thread, percent, read_csv
from study.features import number_of
from study.pack_adversaries import similarity
from study.private_rows import by_attack, read_lines

np, cv2, h5py, onnxruntime = Package("numpy"), Package("cv2"), Package("h5py"), Package("onnxruntime")
Image, ImageDraw, ImageFont = Package("PIL.Image"), Package("PIL.ImageDraw"), Package("PIL.ImageFont")
NETWORKS = {"networks": ("networks", "folder of trained networks"), "judges": ("", "folder with st-lpips.onnx (default: no ST-LPIPS)"),
            "limit": (8, "queries of each place, evenly spaced")}  # fmt: skip
TRAINED = "networks of research/train (--networks)"
KINDS = ["compact", "sift", "xfeat", "alike-t", "aliked-t16"]
SCHEMES = "points,random-lines,dcl:paper,dcl"
NAMES = {"points": "points", "unordered": "descriptors without positions", "none": "no descriptor at all"}
ATTACKS = {"none": "", "prior": "prior", "closed-form": "closed form", "graph": "graph", "lines": "none: spread over the lines"}


def remade(run, network: str, kind: str, place: str, k: int, limit: int, attack: str) -> dict:
    """The document of `eval inversion` for the queries of a place."""
    folder = run.place(place)
    judges = ["--perceptual", Path(run.judges).resolve() / "st-lpips.onnx"] if run.judges else []
    detector = run.place("../weights/yolo/yolo11n_int8.onnx")
    return run.document("eval", "inversion", folder / "images", "--list", folder / "query.txt", "--limit", limit, "--schemes", SCHEMES,
                        "--attacks", attack, "--features", kind, "--network", Path(run.networks).resolve() / f"{network}.toml", "-k", k, *judges,
                        *(["--detector", detector] if detector.exists() else []))  # fmt: skip


QUALITY = ["PSNR (dB)", "SSIM", "ST-LPIPS", "objects found again"]


def quality(row: dict) -> list[str]:
    found = f"{row['objects_found']} of {row['objects']}" if row["objects"] is not None else ""
    return [f"{row['psnr']:.2f}", f"{row['ssim']:.3f}", number(row["st_lpips"], ".3f"), found]


@command("inversion/errors.csv", needs=MODEL_FILES, kinds=["compact", "xfeat", "alike-t", "aliked-t16"])
def errors(run):
    """The e_recon of the paper's Table 2 for learned features: what the closed form recovers with 20 and with 100 true neighbours, all queries."""
    table = run.table("inversion/errors.csv", "place", "features", "scheme", "images", "prior (px)",
                      *(f"K = {k}: {mean} (px)" for k in (20, 100) for mean in ("mean", "median")))  # fmt: skip
    for title, place in SCENES.items():
        for kind in run.kinds:
            found = [by_attack(run.document("attack", keypoints_of(run, place, kind), "--schemes", SCHEMES.removeprefix("points,"), "--attacks", "prior,closed-form",
                                            "-k", k)) for k in (20, 100)]  # fmt: skip
            for scheme, rows in found[0].items():
                cells = [f"{of[scheme]['closed-form'][key]:.1f}" for of in found for key in ("mean_px", "median_px")]
                table.add([title, kind, scheme, rows["prior"]["images"], f"{rows['prior']['median_px']:.1f}", *cells])


@command("inversion/features.csv", needs=TRAINED, kinds=KINDS, hundred=(["compact"], "kinds that also get K = 100"),
         slow=(2, "queries of each place that `graph` attacks, beside the true keypoints of the same"), **NETWORKS)  # fmt: skip
def features(run):
    """The paper's Table 2 for learned features: images made of what attacks with true neighbours recover."""
    table = run.table("inversion/features.csv", "place", "features", "K", "scheme", "attack", "images", "mean (px)", "median (px)", *QUALITY)
    cases = [(kind, kind, 20) for kind in run.kinds] + [("invsfm", "sift", 20)] + [(kind, kind, 100) for kind in run.hundred]
    for title, place in SCENES.items():
        for network, kind, k in cases:
            name = kind if network == kind else f"{kind}, InvSfM's form"
            for limit, attack in [(run.limit, "closed-form"), *([(run.slow, "graph")] if network == kind and k == 20 else [])]:
                found = remade(run, network, kind, place, k, limit, attack)
                for row in found["summary"]:
                    if attack == "graph" and row["attack"] != "graph" and row["scheme"] != "points":
                        continue
                    pixels = [number(row[key], ".1f") for key in ("mean_px", "median_px")]
                    table.add([title, name, k, NAMES.get(row["scheme"], row["scheme"]), ATTACKS[row["attack"]], found["images"], *pixels, *quality(row)])


def keypoints_of(run, place: str, kind: str) -> Path:
    folder = run.place(place)
    return run.made(run.kept() / f"{place}-{kind}.jsonl.gz", "eval", "keypoints", folder / "images", "--list", folder / "query.txt", "--features", kind,
                    "--max-keypoints", 1024)  # fmt: skip


@command("inversion/inputs.csv", needs=TRAINED, kinds=KINDS, **NETWORKS)
def inputs(run):
    """What a network needs of a keypoint: its position, its colour, its descriptor, of each kind. All queries; kinds without a network are left out."""
    sys.path.append(str(ROOT / "research/train"))
    torch, tools, data = (importlib.import_module(name) for name in ("torch", "veiloc_train.inversion", "veiloc_train.data"))
    session = lambda file: onnxruntime.InferenceSession(str(file), one_thread())
    networks = {file.stem: session(file) for file in Path(run.networks).glob("*.onnx")}
    judge = session(Path(run.judges) / "st-lpips.onnx") if run.judges else None
    table = run.table("inversion/inputs.csv", "place", "features", "given", "images", *QUALITY[:3])
    for title, place in SCENES.items():
        folder, found = [run.place(place) / "images"], {}
        for kind, image in ((kind, image) for kind in run.kinds if kind in networks for image in data.read_keypoints([keypoints_of(run, place, kind)])):
            width, height = tools.grid_size(image.width, image.height, 128, 8)
            cells = torch.from_numpy(tools.cells_of(image.keypoints * [width / image.width, height / image.height], (height, width)))
            photo = tools.pixels(folder, image.name, size=(width, height)).float() / 255

            def grid(name):
                rows = tools.rows_of(image, argparse.Namespace(input=name, image_folder=folder))
                return tools.features(cells, torch.from_numpy(rows), 1, (height, width))

            own, share = grid("descriptors"), len(image.keypoints) / (width * height)
            mean = torch.from_numpy(data.scaled(image.descriptors)).mean(0) * min(1, share)
            everywhere = torch.cat([mean, torch.tensor([math.log1p(share)])])[None, :, None, None].expand_as(own).contiguous()
            given = {"descriptors and positions": (kind, own), NAMES["unordered"]: (kind, everywhere), NAMES["none"]: (kind, torch.zeros_like(own))}
            if kind == run.kinds[0]:
                given |= {f"{'positions and colours' if name == 'colour' else name} without descriptors": (name, grid(name))
                          for name in ("colour", "positions") if name in networks}  # fmt: skip
            for name, (network, cells_of) in given.items():
                made = networks[network].run(["image"], {"features": cells_of.numpy()})[0]
                psnr, ssim = similarity(*(x.transpose(1, 2, 0) for x in (made[0], photo.numpy())))
                far = judge.run(None, {"a": made, "b": photo[None].numpy()})[0].item() if judge else math.nan
                found.setdefault((kind, name), []).append((psnr, ssim, far))
        for names, values in found.items():
            table.add([title, *names, len(values), *(f"{statistics.mean(of):.{digits}f}" for of, digits in zip(zip(*values), (2, 3, 3)))])


@command("inversion/trainings.csv", needs=TRAINED, networks=NETWORKS["networks"], images=(1526, "images that they learned from"))
def trainings(run):
    """The networks: their size and training, from what `research/train` wrote."""
    torch = importlib.import_module("torch")
    table = run.table("inversion/trainings.csv", "network", "input", "parameters", "cells along the longer side", "images", "steps", "windows a step",
                      "minutes", "validation PSNR (dB)")  # fmt: skip
    for file in sorted(Path(run.networks).glob("*.pt"), key=lambda file: file.stat().st_mtime):
        saved, curve = torch.load(file, map_location="cpu", weights_only=False), read_csv(file.with_suffix(".csv"))
        options, weights = dict(ast.literal_eval(saved["identity"])), saved["state"]["weights"]
        size = sum(value.numel() for name, value in weights.items() if "running" not in name and "num_batches" not in name)
        of = options["input"] if options["input"] != "descriptors" else tomllib.loads(file.with_suffix(".toml").read_text())["features"]
        table.add([options["form"], of, size, options["side"], run.images, curve[-1]["step"], options["batch"],
                   f"{float(curve[-1]['minutes']):.0f}", f"{max(float(row['psnr']) for row in curve):.2f}"])  # fmt: skip


@command(needs=TRAINED, network=("networks/compact.toml", "network of compact descriptors"), picture=(ROOT / "docs/images/inversion-wide.webp", "the file"))
def picture(run):
    """The picture of the page: the wide view of a rendered place, from the report of `eval inversion` (the paper's Figure 10)."""
    scene, report = run.scene("rendered"), run.kept() / "inversion-wide.html"
    if not report.exists():
        queries = run.listed("rendered-first", Path(scene[7]).read_text().split()[:1])
        run.run("eval", "inversion", scene[3], "--list", queries, "--schemes", "points,random-lines,dcl", "--network", run.network, "--show", 1,
                "--quiet", "--report", report)  # fmt: skip
    wide = re.findall(r'alt="twice the view of [^":]*: ([^"]*)" src="data:image/png;base64,([^"]*)"', report.read_text())
    shown = [("original", wide[0][1])] + [(name, data) for name, data in wide[1:] if name.startswith("Points") or "true neighbours" in name]
    sheet, font = Image.new("RGB", (3 * 400, 2 * 324), "white"), ImageFont.load_default(15)
    for i, (name, data) in enumerate(shown):
        at = (400 * (i % 3), 324 * (i // 3))
        sheet.paste(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB").resize((394, 296)), at)
        ImageDraw.Draw(sheet).text((at[0] + 4, at[1] + 300), name.rstrip("."), fill=0, font=font)
    sheet.save(run.picture, quality=70)


# Patches of 32 x 32 pixels with the same mean and contrast: descriptors do not have them.
SIDE, MEAN, CONTRAST = 32, 0.5, 0.2
# Photographs that the attacker learns from, keypoints of each, judged keypoints of each kind of content.
LEARNED, OF_IMAGE, JUDGED = 300, 120, 1000
PROJECTION = ROOT / "crates/device/features/src/compact/projection.bin"
CONTENTS = ["photographs", "text", "faces"]


@dataclass
class Patches:
    """Descriptors in numbers of their kind, the patches of their keypoints, and the letter under each, where there is one."""

    rows: object
    patches: object
    letters: object


def sift_rows(gray):
    """OpenCV's SIFT keypoints: position, side of the described region, angle in degrees; RootSIFT in the program's bytes."""
    keypoints, rows = cv2.SIFT_create(1024).detectAndCompute(gray, None)
    frames = np.array([(*point.pt, 6 * point.size, point.angle) for point in keypoints]).reshape(-1, 4)
    rows = np.zeros((0, 128)) if rows is None else rows
    return frames, np.minimum(np.rint(512 * np.sqrt(rows / np.maximum(rows.sum(1, keepdims=True), 1e-9))), 255)


def compact_rows(sift):
    """The program's compact descriptors of RootSIFT: 64 numbers, the middles of 16 steps."""
    weights = np.frombuffer(PROJECTION.read_bytes()[: 64 * 128 * 2], "<i2").reshape(64, 128).astype(np.int64)
    offsets = np.frombuffer(PROJECTION.read_bytes()[64 * 128 * 2 :], "<i4")
    return 16 * np.clip((sift.astype(np.int64) @ weights.T + offsets) >> 18, -8, 7) + 8


def cut(gray, frame):
    """The patch of a keypoint in its own frame; None outside of the image or without contrast."""
    x, y, side, angle = frame
    turn, scale = math.radians(angle), side / SIDE
    along, down = scale * np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    reach = side * 0.71
    if not (reach <= x <= gray.shape[1] - reach and reach <= y <= gray.shape[0] - reach):
        return None
    middle = (SIDE - 1) / 2
    matrix = np.array([[*along, x - along.sum() * middle], [*down, y - down.sum() * middle]])
    patch = cv2.warpAffine(gray, matrix, (SIDE, SIDE), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP).astype(np.float32)
    return None if patch.std() < 2 else np.clip(MEAN + CONTRAST * (patch - patch.mean()) / patch.std(), 0, 1)


def text_image(number: int, file: Path) -> list:
    """Writes an image of random letters, with the box of each: left, top, right, bottom, letter."""
    draw, boxes = np.random.default_rng(number), []
    size = int(draw.integers(12, 40))
    image, font = Image.new("L", (512, 384), 235), ImageFont.load_default(size)
    pen = ImageDraw.Draw(image)
    for y in range(8, 376 - size, int(1.4 * size)):
        x = 8.0
        while x < 500 - size:
            letter = str(draw.choice(list(string.ascii_lowercase + "    ")))
            width = font.getlength(letter)
            pen.text((x, y), letter, fill=30, font=font)
            boxes += [(x, y, x + width, y + 1.3 * size, letter)] if letter != " " else []
            x += width
    image.save(file)
    return boxes


def faces(session, image) -> list:
    """Boxes of faces: left, top, right, bottom."""
    height, width = (-(-side // 32) * 32 for side in image.shape[:2])
    padded = np.zeros((height, width, 3), np.float32)
    padded[: image.shape[0], : image.shape[1]] = image[..., ::-1]
    heat, size, offset = session.run(None, {session.get_inputs()[0].name: padded.transpose(2, 0, 1)[None]})[:3]
    boxes = []
    for row, column in np.argwhere(heat[0, 0] > 0.8):
        h, w = 4 * np.exp(size[0, :, row, column])
        y, x = 4 * (row + offset[0, 0, row, column] + 0.5), 4 * (column + offset[0, 1, row, column] + 0.5)
        boxes.append((x - w / 2, y - h / 2, x + w / 2, y + h / 2))
    return boxes


def images_of(run) -> dict:
    """Files and boxes of the images by their part: `learned`, and the kinds of content, of which the attacker has learned none."""
    folder = run.kept() / "text"
    folder.mkdir(exist_ok=True)
    text = {folder / f"{number:03}.png": text_image(number, folder / f"{number:03}.png") for number in range(80)}
    model = onnxruntime.InferenceSession(resized(run.place("../weights/centerface/centerface.onnx"), run.kept() / "centerface.onnx"), one_thread())
    photos = sorted(run.place("training-photos").glob("*/*.jpg"), key=lambda file: number_of(file.name))[: 2 * LEARNED]
    with_faces = {file: faces(model, cv2.imread(str(file))) for file in photos}
    others = [file for file, boxes in with_faces.items() if not boxes]
    texts = list(text)
    return {"learned": dict.fromkeys(others[:LEARNED]) | {file: text[file] for file in texts[:60]}, "photographs": dict.fromkeys(others[-100:]),
            "text": {file: text[file] for file in texts[60:]}, "faces": {file: boxes for file, boxes in with_faces.items() if boxes}}  # fmt: skip


def resized(model: Path, into: Path) -> str:
    """The face detector with inputs of any size."""
    onnx = importlib.import_module("onnx")
    graph = onnx.load(model)
    for axis, name in enumerate(("images", "channels", "height", "width")):
        graph.graph.input[0].type.tensor_type.shape.dim[axis].dim_param = name
    for value in graph.graph.output:
        value.type.tensor_type.ClearField("shape")
    onnx.save(graph, into)
    return str(into)


def described(run, kind: str, parts: dict) -> dict[str, Patches]:
    """Descriptors and patches of each part."""
    found = {}
    if kind not in ("sift", "compact"):
        rows = {}
        for folder in (run.kept() / "text", run.place("training-photos")):
            for image in read_lines(run.made(run.kept() / f"{folder.name}-{kind}.jsonl.gz", "eval", "keypoints", folder, "--features", kind,
                                             "--max-keypoints", 1024)):  # fmt: skip
                rows[folder / image["name"]] = image
    for part, files in parts.items():
        all_rows, patches, letters, draw = [], [], [], np.random.default_rng(1)
        for file, boxes in files.items():
            gray = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            if kind in ("sift", "compact"):
                frames, own = sift_rows(gray)
            elif file in rows:
                at = np.asarray(rows[file]["keypoints"]).reshape(-1, 2)
                frames, own = np.column_stack([at - 0.5, np.full(len(at), SIDE), np.zeros(len(at))]), decoded(rows[file])
            else:
                continue
            order = draw.permutation(len(frames))[:OF_IMAGE] if part == "learned" else range(len(frames))
            for i in order:
                inside = [box for box in boxes or [] if box[0] <= frames[i, 0] < box[2] and box[1] <= frames[i, 1] < box[3]]
                patch = cut(gray, frames[i]) if inside or boxes is None or part == "learned" else None
                if patch is not None:
                    all_rows.append(own[i])
                    patches.append(patch)
                    letters.append(inside[0][4] if inside and len(inside[0]) > 4 else "")
        chosen = np.sort(draw.permutation(len(all_rows))[: None if part == "learned" else JUDGED])
        found[part] = Patches(*(np.asarray(values)[chosen] for values in (all_rows, patches, letters)))
        if kind == "compact":
            found[part].rows = compact_rows(found[part].rows)
    return found


def decoded(image: dict):
    """Descriptors of a line of a keypoint file, in numbers of their kind."""
    rows = np.frombuffer(base64.b64decode(image["descriptors"]), np.uint8).reshape(-1, image["descriptor_dim"])
    return rows.astype(np.float32) - (0 if image.get("descriptor_encoding", "unsigned") == "unsigned" else 128)


def unit(rows):
    return (rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9)).astype(np.float32)


def decoder(rows, patches):
    """A network of three layers from a descriptor to its patch."""
    torch = importlib.import_module("torch")
    torch.manual_seed(0)
    linear, relu = torch.nn.Linear, torch.nn.GELU
    network = torch.nn.Sequential(linear(rows.shape[1], 512), relu(), linear(512, 512), relu(), linear(512, SIDE * SIDE))
    inputs, targets = torch.from_numpy(unit(rows) * rows.shape[1] ** 0.5), torch.from_numpy(patches.reshape(len(patches), -1))
    steps = 6 * len(rows) // 256
    optimizer = torch.optim.AdamW(network.parameters(), 1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 2e-3, total_steps=steps)
    network[-1].bias.data = targets.mean(0)
    for _ in range(steps):
        batch = torch.randint(len(rows), (256,))
        loss = (network(inputs[batch]) - targets[batch]).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()

    def decode(given):
        with torch.no_grad():
            return network(torch.from_numpy(unit(given) * given.shape[1] ** 0.5)).numpy().reshape(-1, SIDE, SIDE)

    return decode


def nearest_of(rows, database):
    """Number of the nearest row of the database, by the angle."""
    return np.concatenate([(unit(part) @ unit(database).T).argmax(1) for part in np.array_split(rows, max(1, len(rows) // 256))])


def scores(made, true) -> list[str]:
    """Mean PSNR and SSIM; equal patches, such as letters of one font, count as 48 dB."""
    rgb = lambda patch: np.repeat(patch[..., None], 3, 2)
    psnr, ssim = zip(*((48.0, 1.0) if np.array_equal(a, b) else similarity(rgb(a), rgb(b)) for a, b in zip(made, true)))
    return [f"{statistics.mean(psnr):.2f}", f"{statistics.mean(ssim):.3f}"]


@command("inversion/patches.csv", needs=PYTORCH, kinds=KINDS)
def patches(run):
    """Patches made of single descriptors: by a network, and by the most similar descriptor of other photographs."""
    parts = images_of(run)
    table = run.table("inversion/patches.csv", "features", "content", "patches", *(f"{what}: {score}" for what in ("mean patch", "database", "network")
                      for score in ("PSNR (dB)", "SSIM")), "letters named by the database (%)")  # fmt: skip
    for kind in run.kinds:
        found = described(run, kind, parts)
        learned = found["learned"]
        decode = decoder(learned.rows, learned.patches)
        for content in CONTENTS:
            own = found[content]
            nearest = nearest_of(own.rows, learned.rows)
            made = [np.repeat(learned.patches.mean(0)[None], len(own.rows), 0), learned.patches[nearest], decode(own.rows)]
            named = percent((learned.letters[nearest] == own.letters).mean()) if content == "text" else ""
            table.add([kind, content, len(own.rows), *(score for images in made for score in scores(images, own.patches)), named])


# Words of the dictionary from which sets are sent, instead of a descriptor.
WORDS = 16384
# What is sent: bits of a number, numbers, length of the noise over the descriptor's, words of a set and its epsilon.
DEFENCES = {
    "none: 64 numbers of 4 bits": {},
    "64 numbers of 2 bits": {"bits": 2},
    "64 numbers of 1 bit": {"bits": 1},
    "16 numbers of 4 bits": {"numbers": 16},
    "noise, 0.5 of the length": {"noise": 0.5},
    "noise, 1 of the length": {"noise": 1.0},
    "noise, 2 of the length": {"noise": 2.0},
    "noise, 4 of the length": {"noise": 4.0},
    "a set of four words": {"words": 4, "epsilon": 10},
}
DELTA = 1e-5


def epsilon(noise: float, numbers: int = 64) -> float:
    """Epsilon of Gaussian noise on unit vectors at DELTA: two of them are at most 2 apart (zero-concentrated differential privacy)."""
    rho = 2**2 / (2 * (noise / numbers**0.5) ** 2)
    return rho + 2 * math.sqrt(rho * math.log(1 / DELTA))


def defended(rows, draw, dictionary, bits: int = 4, numbers: int = 64, noise: float = 0.0, **of_set):
    """Compact descriptors as they would be sent. `[N, rows of a keypoint, 64]`"""
    if of_set:
        count, share = of_set["words"], math.exp(of_set["epsilon"])
        sent = np.stack([draw.choice(len(dictionary), count, replace=False) for _ in range(len(rows))])
        has_own = draw.random(len(rows)) < count * share / (count * share + len(dictionary) - count)
        # The set has the nearest word with this probability, and otherwise random other words.
        sent[:, 0] = np.where(has_own, nearest_of(rows, dictionary), sent[:, 0])
        return dictionary[sent]
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows + draw.normal(size=rows.shape) * noise * lengths / rows.shape[1] ** 0.5
    step = 256 >> bits
    rows = np.clip(np.floor(rows / step) * step + step / 2, -128 + step / 2, 128 - step / 2)
    return np.where(np.arange(rows.shape[1]) < numbers, rows, 0)[:, None]


@command("inversion/defences.csv", needs=PYTORCH, places=PLACES)
def defences(run):
    """Compact descriptors with fewer bits or numbers, with noise, or as sets of words: poses, and what a network and a database make of them."""
    found = described(run, "compact", images_of(run))
    learned, draw = found["learned"], np.random.default_rng(5)
    words = learned.rows[draw.choice(len(learned.rows), WORDS, replace=False)]
    table = run.table("inversion/defences.csv", "sent", "bytes a keypoint", "epsilon", *(f"{place} (%)" for place in run.places), "mean of places (%)",
                      *(f"{content}, {what}: {score}" for content in CONTENTS for what in ("network", "database") for score in ("PSNR (dB)", "SSIM")),
                      "letters named by the database (%)")  # fmt: skip
    found_poses = [recalls(run, place, words) for place in run.places]
    for (name, how), of_places in zip(DEFENCES.items(), zip(*found_poses)):
        rows = defended(learned.rows, draw, words, **how).mean(1)
        decode, cells = decoder(rows, learned.patches), []
        for content in CONTENTS:
            own = found[content]
            sent = defended(own.rows, draw, words, **how).mean(1)
            nearest = nearest_of(sent, learned.rows)
            cells += [*scores(decode(sent), own.patches), *scores(learned.patches[nearest], own.patches)]
            named = percent((learned.letters[nearest] == own.letters).mean())
            if content == "text":
                letters = named
        size = 14 * how["words"] / 8 if "words" in how else how.get("numbers", 64) * how.get("bits", 4) / 8
        private = how.get("epsilon") or (epsilon(how["noise"]) if "noise" in how else None)
        table.add([name, f"{size:.0f}", number(private, ".0f"), *map(percent, of_places), percent(statistics.mean(of_places)), *cells, letters])


def recalls(run, place: str, words) -> list[float]:
    """Shares of the queries within 25 cm and 2° under `dcl`, by defence. The map has the program's own descriptors, and the queries stand in
    the scene once for each defence."""
    folder, copies = run.place(place), run.kept() / "defended" / place
    clean, changed = copies / "clean.h5", copies / "changed.h5"
    if not clean.exists():
        copies.mkdir(parents=True)
        run.run("features", folder / "images", "--max-keypoints", 2048, "--max-size", 1600, "--quiet", "--out-hloc", clean)
    queries, draw, listed = names_of(folder / "query.txt"), np.random.default_rng(6), []
    (copies / "posed").mkdir(exist_ok=True)
    for part in (folder / "posed").iterdir():
        (copies / "posed" / part.name).write_bytes(part.read_bytes())
    shutil.copytree(folder / "images", copies / "copies", dirs_exist_ok=True)
    shutil.copy(clean, changed)
    heads = {line.split()[-1]: line.split() for line in (folder / "posed/images.txt").read_text().splitlines() if line and line[0] != "#"}
    with h5py.File(changed, "r+") as file, (copies / "posed/images.txt").open("a") as images:
        for i, how in enumerate(DEFENCES.values()):
            for name in queries:
                sets = defended(np.asarray(file[name]["descriptors"], np.float64).T[:1024] * 374, draw, words, **how)
                group = file.create_group(f"{i}-{name}")
                group["image_size"], group["descriptors"] = file[name]["image_size"][()], (sets.reshape(-1, 64).T / 374).astype(np.float16)
                for key in ("keypoints", "scores"):
                    group[key] = np.repeat(file[name][key][:1024], sets.shape[1], 0)
                listed.append(f"{i}-{name}")
                shutil.copy(folder / "images" / name, copies / "copies" / listed[-1])
                images.write(" ".join([str(10**6 + len(listed)), *heads[name][1:9], listed[-1]]) + "\n\n")
    document = run.json("eval", "scene", "--posed", copies / "posed", "--images", copies / "copies", "--map-list", folder / "map.txt", "--query-list",
                        run.listed(f"{place}-defended", listed), "--schemes", "dcl", "--features", "compact", "--features-file", changed,
                        "--max-keypoints", 2048, "--query-keypoints", 4096)  # fmt: skip
    found = {query["name"]: query["translation_error"] is not None and query["translation_error"] <= 0.25 and query["rotation_error_deg"] <= 2
             for query in document["queries"]}  # fmt: skip
    return [statistics.mean(found[f"{i}-{name}"] for name in queries) for i in range(len(DEFENCES))]
