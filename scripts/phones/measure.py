"""What sealing one frame costs: time, instructions, memory, allocations; and the sizes of the libraries.

    scripts/phones/measure.py --frame FRAME.pgm --profile PLACE.profile [--scalar] [--csv docs/results/features/seal-frame.csv]

FRAME.pgm is a gray frame of 1280 x 720 (binary PGM); PLACE.profile is that of any map (`veiloc map profile`). Builds with the profile
`phone` into target/measure, and prints tables in Markdown:

- time on this machine with one thread and two, with AVX2 and with the portable code (builds with VEILOC_BACKEND): all take
  turns in --rounds rounds, and the fastest median of --times seals counts, because other programs only delay;
- instructions of a seal on aarch64, counted exactly under qemu-user (scripts/phones/instructions.c), by function;
- the peak of the heap, resident memory, and allocations of the second seal;
- sizes of the shared libraries for aarch64 Linux, stripped. Those for Android are linked by the NDK and differ a little.

`--built DIR` measures only times, for instance on a quieter machine, with the programs that a run left in target/measure. `--scalar`
also counts a build without vector instructions in loops (`-C no-vectorize-loops -C no-vectorize-slp`), but for those that are written
with NEON intrinsics. Needs qemu-user, gcc-aarch64-linux-gnu and the target aarch64-unknown-linux-gnu of rustup. Standard library only.
"""

import argparse
import csv
import os
import pathlib
import re
import shutil
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent.parent
ARM = "aarch64-unknown-linux-gnu"
SYSROOT = "/usr/aarch64-linux-gnu"
# Values of VEILOC_BACKEND, with which the program is built for comparisons.
BACKENDS = {"portable": "portable (SSE2)", "avx2": "AVX2"}
# Functions of a seal by what they do; the first match counts. Small ones are inlined into the function that calls them.
PARTS = [("blur", r"blur_down|blur_along"), ("doubling the image", r"double_row"), ("differences of levels", r"differences"),
         ("peaks", r"peaks|is_peak"), ("descriptors", r"describe"), ("directions", r"directions"),
         ("octaves and refinement", r"strip|extrema|octave|Octave|Strip"), ("memory", r"memcpy|memset|memmove|malloc|free|calloc")]


def run(*command, environment=None, capture=True):
    done = subprocess.run([str(word) for word in command], cwd=ROOT, env={**os.environ, **(environment or {})},
                          stdout=subprocess.PIPE if capture else None, stderr=subprocess.PIPE if capture else None, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}: status {done.returncode}\n{done.stdout or ''}{done.stderr or ''}")
    return done


def cargo(target, *arguments, environment=None):
    linker = {"CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER": "aarch64-linux-gnu-gcc"}
    run("cargo", *arguments, "--locked", "--profile", "phone",
        environment={"CARGO_TARGET_DIR": str(target), "CARGO_INCREMENTAL": "0", **linker, **(environment or {})})


def example(target, triple=None, environment=None):
    """The program, built with its symbols."""
    cargo(target, "build", "--package", "veiloc-ar", "--example", "seal_frame", *(["--target", triple] if triple else []),
          environment={"CARGO_PROFILE_PHONE_STRIP": "false", **(environment or {})})
    return pathlib.Path(target, *([triple] if triple else []), "phone/examples/seal_frame")


def sealed(program, given, times, threads, *before, side=()):
    out = run(*before, program, given.frame.resolve(), given.profile.resolve(), times, *side,
              environment={"RAYON_NUM_THREADS": str(threads)})
    return dict(line.split(" ", 1) for line in out.stdout.splitlines()), out.stderr


def counted(program, given, plugin):
    """Instructions of one seal by function, and what the program printed: those of two seals without those of one."""
    counts, hashes = [], []
    for times in (1, 2):
        values, log = sealed(program, given, times, 1, "qemu-aarch64", "-L", SYSROOT, "-plugin", plugin)
        counts.append({name: int(count) for count, name in re.findall(r"^(\d+) (\S+)$", log, re.M)})
        hashes.append(values["hash"])
    return {name: count - counts[0].get(name, 0) for name, count in counts[1].items()}, hashes


def parts(counts):
    found = {}
    for name, count in counts.items():
        if name != "total" and count > 0:
            part = next((part for part, pattern in PARTS if re.search(pattern, name)), "everything else")
            found[part] = found.get(part, 0) + count
    return found


def megabytes(values, key):
    return f"{int(values[key]) / 1e6:.1f}"


def timed(programs, given):
    """Rows of all programs with one thread and two, in turns."""
    fastest = {}
    for _ in range(given.rounds):
        for name, program, side in programs:
            for threads in (1, 2):
                values, _ = sealed(program, given, given.times, threads, side=side)
                before = fastest.get((name, threads), values)
                values["milliseconds"] = min(before["milliseconds"], values["milliseconds"], key=float)
                fastest[name, threads] = values
    return [(name, threads, f"{float(values['milliseconds']):.1f}", megabytes(values, "peak_bytes"),
             megabytes(values, "resident_bytes"), values["allocations"]) for (name, threads), values in fastest.items()]


def table(head, rows):
    print("| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |")
    print(flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frame", type=pathlib.Path, required=True)
    parser.add_argument("--profile", type=pathlib.Path, required=True)
    parser.add_argument("--times", type=int, default=15, help="seals of a run (default 15)")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each build (default 5)")
    parser.add_argument("--built", type=pathlib.Path, help="folder with seal_frame_portable and seal_frame_avx2: only times are measured")
    parser.add_argument("--csv", type=pathlib.Path, help="also write the last table as CSV")
    parser.add_argument("--scalar", action="store_true", help="also count a build without vector instructions in loops")
    given = parser.parse_args()
    if given.built:
        programs = {name: (given.built / f"seal_frame_{name}").resolve() for name in BACKENDS}
        expected = None
    else:
        target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")).resolve() / "measure"
        expected = on_aarch64(target, given)
        programs = {}
        for name in BACKENDS:
            # The next build has the same name.
            programs[name] = target / f"seal_frame_{name}"
            shutil.copy(example(target, environment={"VEILOC_BACKEND": name}), programs[name])
    for name, program in programs.items():
        for threads in (1, 2):
            values, _ = sealed(program, given, 2, threads)
            expected = expected or values["hash"]
            if values["hash"] != expected:
                sys.exit(f"{name} with {threads} threads seals other bytes")
    runs = [(BACKENDS[name], program, ()) for name, program in programs.items()]
    runs.append((f"{BACKENDS['avx2']}, longest side 1024", programs["avx2"], (1024,)))
    head = ("code for x86-64", "threads", "time (ms)", "largest heap (MB)", "resident memory (MB)", "allocations")
    rows = timed(runs, given)
    print(f"Queries of {values['rows']} rows from {values['keypoints']} keypoints; equal bytes in all runs.\n")
    table(head, rows)
    if given.csv:
        with given.csv.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows([head, *rows])


def on_aarch64(target, given):
    """Prints sizes and instructions; the hash of two seals."""
    plugin = target / "instructions.so"
    target.mkdir(parents=True, exist_ok=True)
    run("gcc", "-shared", "-fPIC", "-O2", "-Wall", ROOT / "scripts/phones/instructions.c", "-o", plugin)
    libraries = []
    for crate in ("veiloc-c", "veiloc-mobile"):
        cargo(target, "rustc", "--package", crate, "--lib", "--crate-type", "cdylib", "--target", ARM)
        library = target / ARM / "phone" / f"lib{crate.replace('-', '_')}.so"
        libraries.append((f"`{library.name}`", f"{library.stat().st_size / 1e6:.2f} MB"))
    table(["library for aarch64 Linux, stripped", "size"], libraries)

    program = example(target, ARM)
    counts, hashes = counted(program, given, plugin)
    columns = [("NEON", parts(counts), counts["total"])]
    if given.scalar:
        flags = {"RUSTFLAGS": "-C no-vectorize-loops -C no-vectorize-slp"}
        scalar, again = counted(example(target / "scalar", ARM, flags), given, plugin)
        if again != hashes:
            sys.exit("the scalar build seals other bytes")
        columns.append(("scalar", parts(scalar), scalar["total"]))
    names = sorted({name for _, found, _ in columns for name in found}, key=lambda name: -columns[0][1].get(name, 0))
    millions = lambda count: f"{count / 1e6:.1f}"
    rows = [(name, *(millions(found.get(name, 0)) for _, found, _ in columns)) for name in names]
    table(["aarch64, millions of instructions", *(name for name, _, _ in columns)],
          [*rows, ("**all**", *(f"**{millions(total)}**" for _, _, total in columns))])
    return hashes[1]


if __name__ == "__main__":
    main()
