"""A table of docs/results/privacy.md: what is sent of people whom a detector hides, as `--hide people` and `--hide person` do."""

import json
import math
import random
import statistics
from pathlib import Path

from study.common import Package, child_seconds, command
from study.people import pasted
from study.private_rows import POSES, Place, by_attack, median_error, read_lines, write_lines

PAGE = "privacy"
np, Image = Package("numpy"), Package("PIL.Image")
# Heights of the pasted person over the image's, 0 for the image as it is; and those of which rows and poses are measured.
HEIGHTS, MEASURED = [0, 0.15, 0.3, 0.45, 0.6, 0.9], [0, 0.3, 0.6]


class Shown:
    """Queries of a place with a person of one height pasted in."""

    def __init__(self, place: Place, people: list[Path], height: float):
        self.place, self.folder, self.hidden = place, place.work / f"hidden-people/{height:g}", {}
        sizes = {image["name"]: (image["width"], image["height"]) for image in place.chosen(2048)}
        self.names = list(sizes)
        self.person = {}
        for name in self.names:
            with Image.open(place.folder / "images" / name) as image:
                shown = image.convert("RGB")
            mask = Image.new("L", shown.size, 255)
            if height:
                shown, mask = pasted(shown, people, random.Random(f"{height:g} {name}"), (height, height))
            self.person[name] = np.asarray(mask) == 0
            # Keypoints are those of the window that is sent, in the middle of the image.
            corner = [(whole - part) // 2 for whole, part in zip(shown.size, sizes[name])]
            window = mask.crop((*corner, corner[0] + sizes[name][0], corner[1] + sizes[name][1]))
            self.save(window, "person", f"{name}.png")
            self.save(shown, "images", name)
        self.listed("names", self.names)

    def save(self, image, kind: str, name: str):
        path = self.folder / kind / name
        path.parent.mkdir(parents=True, exist_ok=True)
        image.save(path, quality=95)

    def listed(self, name: str, lines: list[str]) -> Path:
        path = self.folder / f"{name}.txt"
        path.write_text("".join(f"{line}\n" for line in lines))
        return path

    def hide(self, *masker) -> float:
        """Hides what a detector finds; milliseconds of one processor an image, reading and writing included."""
        seconds = child_seconds([*masker, self.folder / "images", self.folder / "names.txt", self.folder / "hidden"])
        for name in self.names:
            with Image.open(self.folder / "hidden" / f"{name}.png") as mask:
                self.hidden[name] = np.asarray(mask) == 0
        return 1000 * seconds / len(self.names)

    def coverage(self) -> tuple[list[float], float]:
        """Share of each person that is hidden, and the mean share of the other pixels."""
        pairs = [(self.hidden[name], self.person[name]) for name in self.names]
        other = statistics.mean((hidden & ~person).sum() / (~person).sum() for hidden, person in pairs)
        return [(hidden & person).sum() / person.sum() for hidden, person in pairs if person.any()], other

    def measured(self) -> list:
        """Rows and poses of the queries, with nothing hidden and with people hidden."""
        place = self.place
        whole = place.with_queries(self.names, self.folder / "images")
        with whole.problems.open() as lines:
            before = {problem["name"]: problem for problem in map(json.loads, list(lines)[: len(self.names)])}
        rows, some = {image["name"]: image for image in whole.queries}, [n for n in self.names if self.hidden[n].any()]
        out, keypoints = self.folder / "after.jsonl", self.folder / "after.jsonl.gz"
        if some:
            place.run.run("eval", "problems", "--quiet", *place.run.posed(place.name, self.folder / "images"), "--map-list",
                          place.folder / "map.txt", "--query-list", self.listed("some", some), "--masks", self.folder / "hidden", "-o", out,
                          "--keypoints", keypoints)  # fmt: skip
        after = {problem["name"]: problem for problem in map(json.loads, out.read_text().splitlines()[: len(some)])} if some else {}
        hidden = {image["name"]: image for image in read_lines(keypoints)} if some else {}
        return [self.figures(before, rows), self.figures(before | after, rows | hidden)]

    def figures(self, problems: dict, rows: dict) -> tuple:
        """Rows on the person, other rows, share within 25 cm and 2°, median error with lost queries as infinite, bits of the occlusion."""
        on = {name: self.on_person(rows[name]) for name in self.names}
        path = self.folder / "poses.jsonl"
        path.write_text("".join(json.dumps(problems[name]) + "\n" for name in self.names))
        document = self.place.run.json(*POSES, path, "--schemes", "dcl")
        others = sum(len(rows[name]["keypoints"]) for name in self.names) - sum(on.values())
        bits = self.occlusion(problems, [rows[name] for name in self.names if on[name]])
        return sum(on.values()), others, document["schemes"][0]["recall"]["0.25/2"], median_error(document), bits

    def on_person(self, image: dict) -> int:
        """Number of rows whose keypoint lies on the person."""
        person = self.person[image["name"]]
        off = [(whole - part) // 2 for whole, part in zip(person.shape[::-1], (image["width"], image["height"]))]
        return int(sum(person[int(v) + off[1], int(u) + off[0]] for u, v in image["keypoints"]))

    def occlusion(self, problems: dict, images: list[dict]) -> str:
        """Bits that the occlusion tells about the person's rows, and the images that have some."""
        if not images:
            return ""
        attacked, matches = self.folder / "attacked.jsonl.gz", self.folder / "matches.jsonl"
        write_lines(attacked, images)
        with self.place.problems.open() as lines:
            of_map = list(lines)[len(self.place.queries) :]
        matches.write_text("".join(json.dumps(problems[name]) + "\n" for name in self.names) + "".join(of_map))
        document = self.place.run.json("attack", attacked, "--server-matches", matches, "--private-masks", self.folder / "person",
                                       "--attacks", "occlusion", "--schemes", "dcl")  # fmt: skip
        row = next(iter(by_attack(document).values()))["occlusion"]
        return f"{row['bits_over_prior']:.2f} ({row['images']})"


@command("privacy/hidden-people.csv", needs="a segmentation network", people=("people", "folder, as `study privacy people` makes it"),
         network="selfie_segmentation.tflite", yolo=("yolo11n_int8.onnx", "a detector of boxes, or nothing"),
         masker=("", "the example `people` of veiloc-features (default: built)"),
         place_name=("redkitchen", "the place"), queries=(10, "queries, evenly spaced"))  # fmt: skip
def hidden_people(run):
    """Queries with a person pasted in, of several sizes: what of the person is sent without and with `--hide`."""
    place, people = Place(run, run.place_name), sorted(Path(run.people).glob("*.png"))
    masker = run.masker or run.example("veiloc-features", "people", "--features", "rten")
    table = run.table("privacy/hidden-people.csv", "detector", "person's height (%)", "queries", "person hidden (%)", "worst (%)",
                      "less than half hidden", "other pixels hidden (%)", "processor (ms)", "rows on the person",
                      "hidden: rows on the person", "other rows", "hidden: other rows", "within 25 cm and 2° (%)",
                      "hidden: within 25 cm and 2° (%)", "median error (cm)", "hidden: median error (cm)",
                      "occlusion (bits, images)", "hidden: occlusion (bits, images)")  # fmt: skip
    cm = lambda error: f"{100 * error:.1f}" if math.isfinite(error) else "lost"
    share = lambda value: f"{100 * value:.0f}"
    all_shown = [(height, Shown(place, people, height)) for height in HEIGHTS]
    for name, network, what in (("MediaPipe", run.network, "people"), ("YOLO11n", run.yolo, "person")):
        for height, shown in all_shown if network else []:
            milliseconds = shown.hide(masker, network, what)
            covered, other = shown.coverage()
            cells = [statistics.mean(covered), min(covered)] if covered else []
            figures = shown.measured() if name == "MediaPipe" and height in MEASURED else []
            forms = (str, str, share, cm, str)
            table.add([name, share(height), len(shown.names), *(map(share, cells) if cells else ("", "")), sum(c < 0.5 for c in covered),
                       share(other), f"{milliseconds:.0f}", *(form(x) for form, pair in zip(forms, zip(*figures)) for x in pair),
                       *([""] * (0 if figures else 2 * len(forms)))])  # fmt: skip
