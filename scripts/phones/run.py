"""Runs the bindings for phones on this machine, language by language.

In each language a program seals real and rendered frames with given seeds, and every query must equal, bit for bit, the one that the
library makes of the image file. Then it seals rendered frames, asks `veiloc serve`, and brings the answers into the world of an AR
framework whose transform is known here.

    VEILOC_DATA=../shared/data scripts/phones/run.py --veiloc target/debug/veiloc --libraries target/debug [c cpp cs kotlin aarch64]

`--libraries` is the folder of `cargo build -p veiloc-c --features seeded --lib --example reference` and `cargo build -p veiloc-mobile
--features seeded --lib`. C and C++ run under the address and undefined behaviour sanitizers. Without VEILOC_DATA only rendered frames
are used, and this is printed. For the figures of docs/guide/phone.md: `--frames 63 --repeat 10000`.
Languages whose tools are missing fail; name those to run. Standard library only.
"""

import argparse
import json
import math
import os
import pathlib
import re
import shutil
import subprocess
import sys
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
C = ROOT / "bindings/c"
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g", "-O1"]
WARNINGS = ["-Wall", "-Wextra", "-Werror"]
# Repeated seals in languages with a garbage collector, which no leak checker follows.
FEW = 20
# The world of the AR framework in these runs: a turn about a slanted axis, and a step.
AR_FROM_MAP = ((0.8, 0.36, -0.42, 0.23), (2.0, -1.0, 3.5))


def quaternion(q):
    """A unit quaternion w x y z as a matrix by rows."""
    norm = math.sqrt(sum(c * c for c in q))
    w, x, y, z = (c / norm for c in q)
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def product(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def transposed(a):
    return [list(row) for row in zip(*a)]


def applied(a, v):
    return [sum(a[i][k] * v[k] for k in range(3)) for i in range(3)]


def to_quaternion(m):
    """x y z w of a rotation matrix, by its largest component."""
    squares = [1 + m[0][0] - m[1][1] - m[2][2], 1 - m[0][0] + m[1][1] - m[2][2], 1 - m[0][0] - m[1][1] + m[2][2],
               1 + m[0][0] + m[1][1] + m[2][2]]
    at = max(range(4), key=squares.__getitem__)
    s = 2 * math.sqrt(squares[at])
    rows = [[s / 4, (m[0][1] + m[1][0]) / s, (m[0][2] + m[2][0]) / s, (m[2][1] - m[1][2]) / s],
            [(m[0][1] + m[1][0]) / s, s / 4, (m[1][2] + m[2][1]) / s, (m[0][2] - m[2][0]) / s],
            [(m[0][2] + m[2][0]) / s, (m[1][2] + m[2][1]) / s, s / 4, (m[1][0] - m[0][1]) / s],
            [(m[2][1] - m[1][2]) / s, (m[0][2] - m[2][0]) / s, (m[1][0] - m[0][1]) / s, s / 4]]
    return rows[at]


def poses_of(images):
    """Rotation and translation, world to camera, by name, of a COLMAP images.txt."""
    poses = {}
    for line in images.read_text().splitlines():
        words = line.split()
        if len(words) == 10 and not line.startswith("#"):
            numbers = [float(word) for word in words[1:8]]
            poses[words[9]] = (quaternion(numbers[:4]), numbers[4:])
    return poses


def in_world(pose):
    """What ARKit would report for a camera: position and x y z w in its world."""
    rotation, translation = pose
    turn, step = quaternion(AR_FROM_MAP[0]), AR_FROM_MAP[1]
    centre = [-c for c in applied(transposed(rotation), translation)]
    position = [a + b for a, b in zip(applied(turn, centre), step)]
    world_from_cam = product(turn, transposed(rotation))
    # COLMAP's camera has y down and z forward, ARKit's y up and z back.
    axes = [[1, 0, 0], [0, -1, 0], [0, 0, -1]]
    return position + to_quaternion(product(world_from_cam, axes)), centre


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, **options)
    if done.returncode != 0:
        sys.exit(f"{command[0]}: status {done.returncode}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}")
    return done.stdout


class Place:
    """A rendered place with its map, its service, and frames with known poses."""

    def __init__(self, veiloc, work, libraries, frames):
        self.work, self.libraries = work, libraries
        place, self.map = work / "place", work / "place.vmap"
        if not self.map.exists():
            shutil.rmtree(place, ignore_errors=True)
            run(veiloc, "synth", "city", "--rooms", 1, "--map-views", 24, "--query-views", 18, "--width", 640, "--seed", 3, "--quiet",
                "--out", place)
            run(veiloc, "map", "build", "--posed", place / "posed", "--images", place / "images", "--list", place / "map.txt", "--metres",
                "--quiet", "-o", self.map)
        self.profile = work / "place.profile"
        run(veiloc, "map", "profile", self.map, "--out", self.profile, "--quiet")
        self.pack = work / "place.vpack"
        run(veiloc, "map", "pack", self.map, "--out", self.pack, "--quiet")
        camera = (place / "posed/cameras.txt").read_text().splitlines()[-1].split()
        self.model, self.size_and_params = camera[1], ",".join(camera[2:])
        queries = (place / "query.txt").read_text().split()
        self.reference("rendered", ",".join(camera[1:]), [place / "images" / query for query in queries])
        poses = poses_of(place / "posed/images.txt")
        worlds = [in_world(poses[query]) for query in queries]
        self.centres = [centre for _, centre in worlds]
        self.poses = work / "poses.txt"
        # A second has three frames, which give one answer.
        lines = [[0.4 * i, *pose] for i, (pose, _) in enumerate(worlds)]
        self.poses.write_text("".join(" ".join(f"{c:.12f}" for c in line) + "\n" for line in lines))
        self.frames = [work / "rendered" / f"{i}.pgm" for i in range(len(queries))]
        self.sets = ["rendered"]
        data = os.environ.get("VEILOC_DATA")
        if data:
            kitchen = sorted(pathlib.Path(data, "redkitchen/images").glob("*.jpg"))[:max(1, frames * 4 // 5)]
            self.reference("redkitchen", "SIMPLE_PINHOLE,640,480,525.505,320,240", kitchen)
            photos = sorted(pathlib.Path(data, "photos").glob("*.jpg"))[:max(1, frames - len(kitchen))]
            self.reference("photos", "unknown", photos)
            self.sets += ["redkitchen", "photos"]
        else:
            print("VEILOC_DATA is not set: no real frames")
        log = open(work / "serve.log", "w+")
        self.service = subprocess.Popen([veiloc, "serve", "--map", f"place={self.map}", "--listen", "127.0.0.1:0",
                                         "--rate", "1000", "--burst", "1000", "--answer-quantum", "0"], stdout=log, stderr=log)
        for _ in range(600):
            found = re.search(r"serving place on http://127\.0\.0\.1:(\d+)", (work / "serve.log").read_text())
            if found:
                self.port = found.group(1)
                return
            time.sleep(0.1)
        sys.exit("veiloc serve did not start: " + (work / "serve.log").read_text())

    def reference(self, name, camera, images):
        """Raw frames and the queries that the library makes of the files."""
        run(self.libraries / "examples/reference", self.pack, camera, self.work / name, *images)
        # An answer and its document, which each language must give to the byte.
        for known, copy in (("doubtful.answer", "answer"), ("doubtful.json", "answer.json")):
            shutil.copyfile(ROOT / "crates/core/protocol/tests/data" / known, self.work / name / copy)
        # In each language the first frame is sealed with the pack, too.
        shutil.copyfile(self.pack, self.work / name / "pack")
        if name == "rendered" and not (self.work / name / "matched").read_bytes():
            sys.exit("the pack does not explain a frame of its place")

    def locate(self, *program, **options):
        """Runs an example of a language against the service, and checks its poses."""
        out = run(*program, "127.0.0.1", self.port, "place", self.model, self.size_and_params, self.poses, *self.frames, **options)
        trusted = 0
        for line in out.splitlines():
            words = line.split()
            if len(words) >= 5 and words[1] == "trusted":
                off = math.dist([float(c) for c in words[2:5]], self.centres[int(words[0])])
                if off > 0.05:
                    sys.exit(f"frame {words[0]} is {off} from where it was taken\n{out}")
                trusted += 1
        anchor = [float(c) for c in re.search(r"anchor (.*)", out).group(1).split()]
        turn, step = quaternion(AR_FROM_MAP[0]), AR_FROM_MAP[1]
        off = math.dist(anchor[:3], step)
        expected = to_quaternion(turn)
        cosine = abs(sum(a * b for a, b in zip(anchor[3:], expected)))
        angle = math.degrees(2 * math.acos(min(1.0, cosine)))
        bursts = len(self.frames) // 3
        if trusted < bursts * 2 // 3 or off > 0.05 or angle > 0.5 or "state 2" not in out or "distances 1" not in out:
            sys.exit(f"{trusted} trusted, anchor {off} and {angle}° off\n{out}")
        return f"{trusted} of {bursts} bursts localized, anchor {off * 1000:.1f} mm and {angle:.2f}° off"

    def seals(self, *program, repeat=0, **options):
        """Runs the comparing program of a language for all frames."""
        counts = []
        for i, name in enumerate(self.sets):
            out = run(*program, self.profile, self.work / name, repeat if i == 0 else 0, **options)
            counts.append(int(re.match(r"(\d+) queries equal", out).group(1)))
        return f"{sum(counts)} queries equal to the bit" + (f", and {repeat} more seals" if repeat else "")


def c(place, repeat):
    static = [place.libraries / "libveiloc_c.a", "-lpthread", "-ldl", "-lm"]
    seals, locate = place.work / "seals", place.work / "locate"
    run("gcc", "-std=gnu11", *WARNINGS, *SANITIZE, "-I", C / "include", C / "tests/c/seals.c", *static, "-o", seals)
    run("gcc", "-std=gnu11", *WARNINGS, *SANITIZE, "-I", C / "include", ROOT / "examples/cpp/locate.c", *static, "-o", locate)
    # Without the sanitizers, whose heap is their own: the heap must not grow.
    plain = place.work / "seals-plain"
    run("gcc", "-std=gnu11", *WARNINGS, "-O1", "-I", C / "include", C / "tests/c/seals.c", *static, "-o", plain)
    return [place.seals(seals, repeat=repeat) + " without a leak", place.seals(plain, repeat=repeat) + " in a heap that does not grow",
            place.locate(locate)]


def cpp(place, _):
    seals = place.work / "seals_cpp"
    locate, build = place.work / "locate_cpp", place.work / "cmake"
    static = [place.libraries / "libveiloc_c.a", "-lpthread", "-ldl", "-lm"]
    run("g++", "-std=c++14", *WARNINGS, *SANITIZE, "-I", C / "include", ROOT / "examples/cpp/locate.cpp", *static, "-o", locate)
    run("g++", "-std=c++14", *WARNINGS, *SANITIZE, "-I", C / "include", C / "tests/c/seals.cpp", *static, "-o", seals)
    run("cmake", "-S", ROOT / "examples/cpp", "-B", build, f"-Dveiloc_DIR={C / 'cmake'}", f"-Dveiloc_LIBRARY_DIR={place.libraries}")
    run("cmake", "--build", build)
    guide(place)
    return [place.seals(seals), place.locate(locate), place.locate(build / "locate_cpp") + " (CMake)"]


def guide(place):
    """The two files of docs/guide/phone.md in an empty folder: the query of a frame is answered."""
    text = (ROOT / "docs/guide/phone.md").read_text()
    app = place.work / "app"
    shutil.rmtree(app, ignore_errors=True)
    app.mkdir()
    for name, kind in (("CMakeLists.txt", "cmake"), ("main.cpp", "cpp")):
        (app / name).write_text(re.search(rf"```{kind}\n((?:#|//) {re.escape(name)}.*?)```", text, re.S).group(1))
    run("cmake", "-S", app, "-B", app / "build", f"-Dveiloc_DIR={C / 'cmake'}", f"-Dveiloc_LIBRARY_DIR={place.libraries}")
    run("cmake", "--build", app / "build")
    width, height, focal = place.size_and_params.split(",")[:3]
    frame = place.frames[0].read_bytes()[-int(width) * int(height):]
    query = subprocess.run([app / "build/app", place.profile, width, height, focal], input=frame, capture_output=True, check=True).stdout
    request = urllib.request.Request(f"http://127.0.0.1:{place.port}/v1/maps/place/localize", query,
                                     {"Content-Type": "application/x-protobuf"})
    with urllib.request.urlopen(request) as reply:
        answer = json.load(reply)
    if math.dist(answer["center"], place.centres[0]) > 0.05:
        sys.exit(f"the program of the guide is at {answer['center']}, not at {place.centres[0]}")


def cs(place, repeat):
    """C# by mono, with the wrapper of the Unity package."""
    unity, program = ROOT / "bindings/unity", place.work / "unity.exe"
    run("mcs", "-langversion:7", "-warnaserror", "-define:VEILOC_SEEDED", f"-out:{program}", unity / "Runtime/Veiloc.cs",
        unity / "Tests~/Main.cs")
    # The sources that need Unity, against declarations of what they use of it.
    run("mcs", "-langversion:7", "-warnaserror", "-nowarn:649,169,414", "-unsafe", "-target:library", "-define:UNITY_2022_3_OR_NEWER",
        f"-out:{place.work / 'unity.dll'}", unity / "Tests~/UnityStubs.cs",
        *(file for folder in ("Runtime", "Tests", "Samples~") for file in sorted((unity / folder).rglob("*.cs"))))
    environment = dict(os.environ, MONO_PATH=str(place.libraries), LD_LIBRARY_PATH=str(place.libraries))
    mono = ["mono", program]
    return [place.seals(*mono, "seals", repeat=min(repeat, FEW), env=environment), place.locate(*mono, "locate", env=environment)]


def kotlin(place, repeat):
    """Kotlin on a JVM: the compiler of npm, Debian's JNA."""
    tools, sources, jar = place.work / "kotlin", place.work / "generated", place.work / "kotlin.jar"
    lib = tools / "node_modules/kotlin-compiler/lib"
    if not lib.exists():
        run("npm", "install", "--silent", "--no-audit", "--no-fund", "--prefix", tools, "kotlin-compiler@2.4.20")
    jna = next((path for path in map(pathlib.Path, ("/usr/share/java/jna.jar",)) if path.exists()), None)
    if jna is None:
        sys.exit("no JNA: apt-get install libjna-java")
    run(ROOT / "bindings/mobile/generate.sh", place.libraries / "libveiloc_mobile.so", sources)
    needed = [lib / name for name in ("kotlin-stdlib.jar", "kotlinx-coroutines-core-jvm.jar")]
    compiler = [lib / "kotlin-compiler.jar", *needed,
                *(lib / f"{name}.jar" for name in ("annotations-13.0", "kotlin-script-runtime", "kotlin-reflect", "kotlin-daemon-client"))]
    path = lambda jars: ":".join(map(str, jars))
    run("java", "-Xmx2g", "-cp", path(compiler), "org.jetbrains.kotlin.cli.jvm.K2JVMCompiler", "-kotlin-home", lib.parent,
        "-no-reflect", "-nowarn", "-cp", path([jna, *needed]), "-d", jar, sources / "org/veiloc/veiloc_mobile.kt",
        ROOT / "bindings/mobile/tests/kotlin/Main.kt",
        ROOT / "examples/android/app/src/main/java/org/veiloc/example/Localizer.kt")
    java = ["java", f"-Djna.library.path={place.libraries}", "-cp", path([jar, jna, *needed]), "MainKt"]
    return [place.seals(*java, "seals", repeat=min(repeat, FEW)), place.locate(*java, "locate")]


def aarch64(place, _):
    """C for aarch64 Linux, under emulation. The library: cargo rustc -p veiloc-c --lib --crate-type staticlib --features seeded
    --target aarch64-unknown-linux-gnu, in the same target folder or that of VEILOC_AARCH64."""
    folder = os.environ.get("VEILOC_AARCH64") or place.libraries.parent / "aarch64-unknown-linux-gnu" / place.libraries.name
    library, seals = pathlib.Path(folder) / "libveiloc_c.a", place.work / "seals-aarch64"
    run("aarch64-linux-gnu-gcc", "-std=gnu11", *WARNINGS, "-O1", "-static", "-I", C / "include", C / "tests/c/seals.c", library,
        "-lpthread", "-ldl", "-lm", "-o", seals)
    return [place.seals("qemu-aarch64", seals)]


LANGUAGES = {"c": c, "cpp": cpp, "cs": cs, "kotlin": kotlin}
# Only when it is named: it takes a cross compiler, qemu-user and a build of its own.
EXTRA = {"aarch64": aarch64}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("languages", nargs="*", default=list(LANGUAGES), metavar="LANGUAGE", help=", ".join([*LANGUAGES, *EXTRA]))
    parser.add_argument("--veiloc", type=pathlib.Path, required=True, help="the program")
    parser.add_argument("--libraries", type=pathlib.Path, required=True, help="folder of the libraries, and of examples/reference")
    parser.add_argument("--work", type=pathlib.Path, help="folder for what is made; default: phones in that folder")
    parser.add_argument("--frames", type=int, default=8, help="real frames to compare (default 8)")
    parser.add_argument("--repeat", type=int, default=200, help="seals of small frames under the leak checker (default 200)")
    given = parser.parse_args()
    work = (given.work or given.libraries / "phones").resolve()
    work.mkdir(parents=True, exist_ok=True)
    place = Place(given.veiloc.resolve(), work, given.libraries.resolve(), given.frames)
    try:
        for language in given.languages:
            print(language, flush=True)
            for line in {**LANGUAGES, **EXTRA}[language](place, given.repeat):
                print(f"  {line}", flush=True)
    finally:
        place.service.terminate()
        place.service.wait()


if __name__ == "__main__":
    main()
