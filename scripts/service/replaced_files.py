#!/usr/bin/env python3
"""Unsafe replacement of files under a running service: maps copied over, truncated, overwritten; token files deleted or emptied;
a token revoked while no file can be opened.

    VEILOC_DATA=../shared/data scripts/service/replaced_files.py [--veiloc PROGRAM]
"""

import resource
import shutil
import socket
import time

from common import LOCALIZE, RedKitchen, Server, arguments, ask, header, pose, row


def state(server, scene, poses):
    """The result of a query: the map of its pose, or the error."""
    if not server.alive():
        return f"process died (exit {server.process.returncode})"
    status, body, _ = ask(server.port, LOCALIZE, scene.query)
    if status != 200:
        return f"{status or 'no answer'}" + ("" if server.alive() else f", process died ({server.process.returncode})")
    return f"200, {poses.get(pose(body), 'a pose of no map')}"


def overwrite(path, data):
    with open(path, "r+b") as file:
        file.write(data)
        file.truncate(len(data))


def maps(scene, memory):
    live = scene.work / "live.vmap"
    poses = {}
    for path, name in ((scene.map, "old map"), (scene.smaller, "new map")):
        server = Server(scene, maps=["--map", f"place={path}"])
        poses[pose(ask(server.port, LOCALIZE, scene.query)[1])] = name
        server.stop()
    old, new = scene.map.read_bytes(), scene.smaller.read_bytes()
    for what, change in [
        ("`cp new.vmap live.vmap`", lambda: shutil.copyfile(scene.smaller, live)),
        ("truncated to a third", lambda: overwrite(live, old[:len(old) // 3])),
        ("overwritten with the same number of bytes", lambda: overwrite(live, bytes(len(old)))),
        ("replaced by rename (the correct way)", lambda: (shutil.copyfile(scene.smaller, scene.work / "n"),
                                                    (scene.work / "n").rename(live))),
    ]:
        shutil.copyfile(scene.map, live)
        server = Server(scene, *memory, maps=["--map", f"place={live}"])
        before = state(server, scene, poses)
        change()
        at_once = state(server, scene, poses)
        time.sleep(4)
        later = state(server, scene, poses)
        row(what, before, at_once, later)
        server.stop(timeout=10)
    del new


def tokens(scene):
    for what, change in [
        ("deleted", lambda path: path.unlink()),
        ("emptied", lambda path: path.write_text("")),
        ("one token removed", lambda path: scene.tokens(["ops!"], path)),
    ]:
        path = scene.tokens(["phone", "ops!"], scene.work / "changing")
        more = ["--tokens-max-stale", "8"] if "--tokens-max-stale" in scene.options() else []
        server = Server(scene, "--tokens", path, *more)
        change(path)
        time.sleep(4)
        soon = [ask(server.port, "/v1/maps", user=user)[0] for user in ("phone", "ops")]
        time.sleep(8)
        late = [ask(server.port, "/v1/maps", user=user)[0] for user in ("phone", "ops")]
        log_lines = sum("token" in line for line in server.log().splitlines())
        row(what, *soon, *late, log_lines)
        server.stop(timeout=10)


def revoked_without_files(scene):
    """Removes a token from the file while connections use up all open files; then closes the connections."""
    path = scene.tokens(["phone", "ops!"], scene.work / "revoked")
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    connections = "1024" if "--admin-listen" not in scene.options() else "100"
    server = Server(scene, "--tokens", path, "--connections", connections, nofile=300)
    connections_held = []
    for _ in range(400):
        try:
            connections_held.append(socket.create_connection(("127.0.0.1", server.port), timeout=1))
        except OSError:
            break
    scene.tokens(["ops!"], path)
    time.sleep(4)
    for stream in connections_held:
        stream.close()
    time.sleep(6)
    row("revoked while no file could be opened", ask(server.port, "/v1/maps", user="phone")[0])
    server.stop(timeout=40)


def main():
    scene = RedKitchen(arguments(__doc__).parse_args().veiloc)
    header("the map file is", "before", "at once", "after 4 s")
    maps(scene, [])
    if "--map-memory" in scene.options():
        print("\nThe same with `--map-memory mapped`, where the operator must prevent all of this:\n")
        header("the map file is", "before", "at once", "after 4 s")
        maps(scene, ["--map-memory", "mapped"])
    print()
    header("the token file is", "phone after 4 s", "ops", "phone after 12 s", "ops", "log lines about it")
    tokens(scene)
    print()
    header("a token", "after 10 s")
    revoked_without_files(scene)


if __name__ == "__main__":
    main()
