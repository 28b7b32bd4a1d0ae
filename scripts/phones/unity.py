#!/usr/bin/env python3
"""The package for Unity: bindings/unity with native libraries, as an archive that Unity's Package Manager installs from disk or URL.

    scripts/phones/unity.py OUT.tgz [--skip-missing]     builds the libraries that can be built here, and says which are missing
    scripts/phones/unity.py --metas                      only writes the .meta files of the sources, which are committed

Linux is built for this machine; Windows and macOS need `pip install cargo-zigbuild ziglang` and the Rust targets, iOS its Rust target
(a static library, which Xcode links), Android the NDK (ANDROID_NDK_HOME). Without all of them the archive is only made with
--skip-missing. Only the library for Linux is run anywhere (scripts/phones/run.py cs).
"""
import argparse
import gzip
import hashlib
import io
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tarfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "bindings/unity"
# Rust target: file in the package, platform and settings in Unity, settings of the editor that loads it.
LIBRARIES = {
    "x86_64-unknown-linux-gnu": ("Linux/x86_64/libveiloc_c.so", "Standalone: Linux64", "x86_64", "Linux"),
    "x86_64-pc-windows-gnu": ("Windows/x86_64/veiloc_c.dll", "Standalone: Win64", "x86_64", "Windows"),
    "aarch64-apple-darwin": ("macOS/arm64/libveiloc_c.dylib", "Standalone: OSXUniversal", "ARM64", "OSX"),
    "x86_64-apple-darwin": ("macOS/x86_64/libveiloc_c.dylib", "Standalone: OSXUniversal", "x86_64", "OSX"),
    "aarch64-linux-android": ("Android/arm64-v8a/libveiloc_c.so", "Android: Android", "ARM64", None),
    "aarch64-apple-ios": ("iOS/libveiloc_c.a", "iPhone: iOS", None, None),
}


def meta(path, importer=""):
    """What Unity writes beside a file; the id, which scenes refer to, follows from the path."""
    guid = hashlib.md5(f"org.veiloc.device/{path}".encode()).hexdigest()
    return f"fileFormatVersion: 2\nguid: {guid}\n{importer}"


def plugin(platform, cpu, editor):
    """Import settings of a native library."""
    enabled = {platform: cpu, **({"Editor: Editor": cpu} if editor else {})}
    text = "PluginImporter:\n  serializedVersion: 2\n  isOverridable: 1\n  platformData:\n"
    text += "  - first:\n      Any: \n    second:\n      enabled: 0\n      settings: {}\n"
    for name in ["Editor: Editor", *sorted({entry[1] for entry in LIBRARIES.values()})]:
        text += f"  - first:\n      {name}\n    second:\n      enabled: {int(name in enabled)}\n"
        settings = {"CPU": enabled.get(name), "OS": editor if name.startswith("Editor") else None}
        lines = [f"        {key}: {value}\n" for key, value in settings.items() if value]
        text += "      settings:\n" + "".join(lines) if lines else "      settings: {}\n"
    return text


def sources():
    """Files of the package, and whether Unity imports them: not what is in a folder that ends with ~."""
    names = subprocess.run(["git", "ls-files", "--cached", "--others", "--exclude-standard", "."], cwd=PACKAGE, capture_output=True,
                           text=True, check=True).stdout.splitlines()
    files = [pathlib.PurePosixPath(name) for name in sorted(names) if not name.endswith(".meta") and (PACKAGE / name).exists()]
    return [(file, not any(part.endswith("~") for part in file.parts)) for file in files]


def metas(paths):
    """The .meta of files and of their folders."""
    every = {path for file in paths for path in (file, *file.parents) if path.name}
    return {f"{path}.meta": meta(path, "folderAsset: yes\n" if path not in paths else "") for path in sorted(every)}


def built(target, profile="phone"):
    """The library for a target; None, and why, where it cannot be built here."""
    run = lambda *words, **more: subprocess.run(list(map(str, words)), cwd=ROOT, **more)
    host = next(line.split()[1] for line in run("rustc", "-vV", capture_output=True, text=True).stdout.splitlines() if line.startswith("host"))
    folder = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    command, more = ["cargo", "rustc"], []
    environment = dict(os.environ)
    if target != host:
        libdir = run("rustc", "--print", "target-libdir", "--target", target, capture_output=True, text=True).stdout.strip()
        if not pathlib.Path(libdir).is_dir():
            return None, f"rustup target add {target}"
        more, folder = ["--target", target], folder / target
        if target.endswith("android"):
            ndk = environment.get("ANDROID_NDK_HOME")
            if not ndk:
                return None, "the NDK (ANDROID_NDK_HOME)"
            environment["CARGO_TARGET_AARCH64_LINUX_ANDROID_LINKER"] = f"{ndk}/toolchains/llvm/prebuilt/linux-x86_64/bin/aarch64-linux-android26-clang"
            environment["CARGO_TARGET_AARCH64_LINUX_ANDROID_RUSTFLAGS"] = "-Clink-arg=-Wl,-z,max-page-size=16384"
        elif not target.endswith("ios"):
            if not shutil.which("cargo-zigbuild"):
                return None, "pip install cargo-zigbuild ziglang"
            command = ["cargo-zigbuild", "rustc"]
    kind = "staticlib" if target.endswith("ios") else "cdylib"
    # No output between the lines of a release: cargo's is on stderr.
    run(*command, "--locked", "--profile", profile, "--package", "veiloc-c", "--lib", "--crate-type", kind, *more, env=environment, check=True)
    return folder / profile / pathlib.PurePosixPath(LIBRARIES[target][0]).name, None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", nargs="?", type=pathlib.Path, help="the archive")
    parser.add_argument("--skip-missing", action="store_true", help="leave out what cannot be built here")
    parser.add_argument("--metas", action="store_true", help="only write the .meta files of the sources")
    given = parser.parse_args()
    if given.metas == bool(given.out):
        parser.error("give either the archive or --metas")
    files = sources()
    written = metas([file for file, imported in files if imported])
    if given.metas:
        for name, text in written.items():
            (PACKAGE / name).write_text(text)
        return
    stale = [name for name, text in written.items() if not (PACKAGE / name).exists() or (PACKAGE / name).read_text() != text]
    if stale:
        sys.exit(f"not as `scripts/phones/unity.py --metas` writes them: {', '.join(stale)}")

    content = {str(file): (PACKAGE / file).read_bytes() for file, _ in files}
    added, missing = {}, []
    for target, (name, platform, cpu, editor) in LIBRARIES.items():
        library, remedy = built(target)
        if library is None:
            missing.append(f"{name} ({remedy})")
            continue
        path = pathlib.PurePosixPath("Runtime/Plugins", name)
        content[str(path)] = library.read_bytes()
        added[path] = meta(path, plugin(platform, cpu, editor))
        print(f"{len(content[str(path)]):10d}  {path}")
    if missing and not given.skip_missing:
        sys.exit(f"missing: {'; '.join(missing)}; --skip-missing leaves them out")
    for line in missing:
        print(f"   missing  {line}")
    written.update(metas(list(added)))
    written.update({f"{path}.meta": text for path, text in added.items()})
    content.update({name: text.encode() for name, text in written.items()})
    for name in ("LICENSE-APACHE", "LICENSE-MIT"):
        content[f"{name}.md"] = (ROOT / name).read_bytes()
        content[f"{name}.md.meta"] = meta(f"{name}.md").encode()
    partial = given.out.with_name(f"{given.out.name}.part")
    with partial.open("wb") as file, gzip.GzipFile(fileobj=file, mode="wb", filename="", mtime=0) as packed, tarfile.open(fileobj=packed, mode="w") as archive:
        for name, data in sorted(content.items()):
            entry = tarfile.TarInfo(f"package/{name}")
            entry.size, entry.mode = len(data), 0o644
            archive.addfile(entry, io.BytesIO(data))
    partial.replace(given.out)
    version = json.loads(content["package.json"])["version"]
    print(f"{given.out}: version {version}, {len(content)} files, {given.out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
