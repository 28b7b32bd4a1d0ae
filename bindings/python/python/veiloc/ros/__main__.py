"""`python -m veiloc.ros`: bags. `frames` writes the images of a bag with poses, `replay` localizes a bag, `walk` makes a bag for trials."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import veiloc
from veiloc.ros.bag import Bag
from veiloc.ros.frames import write_frames
from veiloc.ros.geometry import Matrix, matrix


def bar() -> Any:
    """A progress bar, if this is a terminal that can show one."""
    if not sys.stderr.isatty():
        return None
    try:
        return veiloc.ProgressBar()
    except ImportError:
        return None


def transform(text: str) -> Matrix:
    """`x,y,z,qx,qy,qz,qw`."""
    numbers = [float(word) for word in text.replace(",", " ").split()]
    if len(numbers) != 7:
        raise argparse.ArgumentTypeError(f"{text!r} is not x,y,z,qx,qy,qz,qw")
    return matrix(numbers[:3], numbers[3:])


def bag_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("bag", type=Path, help="folder of a bag of ROS 2, or its .mcap or .db3 file, or a .bag file of ROS 1")
    parser.add_argument("--topic", action="append", default=[], metavar="T", help="topic of images; repeat it for several cameras. Default: the only one")
    parser.add_argument("--odometry", metavar="T", help="topic of odometry or poses, or a frame of tf (map, odom). Default: the only topic of "
                        "odometry, or else tf from map or odom")  # fmt: skip
    parser.add_argument("--base", default="base_link", metavar="FRAME", help="frame of the robot in tf (default: base_link)")
    parser.add_argument("--base-from-camera", type=transform, metavar="x,y,z,qx,qy,qz,qw", help="where the camera is on the robot. Default: as tf says")
    parser.add_argument("--rectified", action=argparse.BooleanOptionalAction, default=None,
                        help="the images are rectified. Default: if the topic is called image_rect")  # fmt: skip


def opened(args: argparse.Namespace) -> Bag:
    return Bag(args.bag, topics=args.topic, odometry=args.odometry, base_from_cam=args.base_from_camera, base=args.base, rectified=args.rectified)


def frames(args: argparse.Namespace) -> None:
    state: dict[str, Any] = {"stage": None}

    def lines(stage: str, done: int, total: int) -> None:
        if stage != state["stage"]:
            state["stage"] = stage
            print(json.dumps({"stage": stage, "total": total}), flush=True)
        print(json.dumps({"done": done}), flush=True)

    with opened(args) as bag:
        found = write_frames(bag, args.out, min_translation=args.min_translation, min_rotation_deg=args.min_rotation,
                             progress=lines if args.json else bar())  # fmt: skip
    if args.json:
        print(json.dumps(found), flush=True)
        return
    for remark in found["remarks"]:
        print(f"warning: {args.bag}: {remark}", file=sys.stderr)
    print(f"{args.out}: {found['images']} of {found['of']} images with poses")
    print(f"veiloc map build --posed {args.out}/posed --images {args.out}/images --down 0,0,-1 --metres --out place.vmap")


def replay(args: argparse.Namespace) -> None:
    from veiloc.ros.replay import replay_bag, server_of, summary

    if (args.map is None) == (args.server is None):
        raise veiloc.InputError("give --map FILE, or --server URL with --map-name NAME")
    with opened(args) as bag:
        server, profile = server_of(args.map, args.server, args.map_name, args.token)
        found = replay_bag(
            bag, server, veiloc.Sealer(profile), truth=args.truth, rate=args.rate, min_translation=args.min_translation,
            min_rotation_deg=args.min_rotation, gravity_sd_deg=args.gravity_sd or None, metres_per_unit=args.metres_per_unit,
            progress=bar(),
        )  # fmt: skip
    for remark in found.remarks:
        print(f"warning: {args.bag}: {remark}", file=sys.stderr)
    if args.out is not None:
        found.write_tum(args.out)
    if args.mcap is not None:
        found.write_mcap(args.mcap)
    document = summary(found)
    if args.json:
        print(json.dumps(document, indent=1))
        return
    for name, value in document.items():
        print(f"{name}: {value}")


def walk(args: argparse.Namespace) -> None:
    from veiloc.ros.walk import write_walk

    names = None if args.list is None else args.list.read_text().split("\n")
    names = names and [name.strip() for name in names if name.strip()]
    down = None if args.down is None else np.array([float(word) for word in args.down.split(",")])
    made = write_walk(args.posed, args.images, args.out, names=names, rate=args.rate, drift=args.drift, drift_deg=args.drift_deg,
                      storage=args.storage, down=down)  # fmt: skip
    print(f"{args.out}: {made['images']} images, {made['metres']:.1f} m in {made['seconds']:.0f} s; down {made['down']}")


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m veiloc.ros", description=__doc__)
    commands = parser.add_subparsers(required=True)
    made = commands.add_parser("frames", help="write the images of a bag with their cameras and poses, for `veiloc map build`")
    bag_options(made)
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder that gets images/ and posed/")
    made.add_argument("--min-translation", type=float, default=0.1, metavar="M", help="keep an image when its camera moved by this (0.1)")
    made.add_argument("--min-rotation", type=float, default=5.0, metavar="DEG", help="or turned by this (5)")
    made.add_argument("--json", action="store_true", help="progress and result as JSON lines")
    made.set_defaults(run=frames)

    made = commands.add_parser("replay", help="localize the images of a bag as the node does, and compare with its poses")
    bag_options(made)
    made.add_argument("--map", type=Path, metavar="FILE", help="map file: nothing leaves this machine")
    made.add_argument("--server", metavar="URL", help="or a service")
    made.add_argument("--map-name", metavar="NAME", help="name of the map at the service")
    made.add_argument("--token", help="token of the service")
    made.add_argument("--truth", metavar="T", help="topic of true poses of the robot in the map, to compare with. Default: the poses of --odometry, "
                      "moved onto the found ones")  # fmt: skip
    made.add_argument("--rate", type=float, default=1.0, metavar="HZ", help="most questions a second (1)")
    made.add_argument("--min-translation", type=float, default=0.3, metavar="M", help="once found, ask again after this way (0.3)")
    made.add_argument("--min-rotation", type=float, default=15.0, metavar="DEG", help="or this turn (15)")
    made.add_argument("--gravity-sd", type=float, default=2.0, metavar="DEG", help="standard deviation of the odometry's vertical; 0 does not use it (2)")
    made.add_argument("--metres-per-unit", type=float, metavar="M", help="metres of a unit of the map, if the map has no metric scale")
    made.add_argument("--out", type=Path, metavar="FILE", help="write the poses of the robot in the map, in TUM's format")
    made.add_argument("--mcap", type=Path, metavar="DIR", help="write them as a bag: /veiloc/pose and tf map → odom")
    made.add_argument("--json", action="store_true", help="the summary as JSON")
    made.set_defaults(run=replay)

    made = commands.add_parser("walk", help="make a bag of a robot that walks along posed images, with odometry that drifts")
    made.add_argument("--posed", type=Path, required=True, help="images with poses in metres")
    made.add_argument("--images", type=Path, required=True, help="folder of the images")
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the bag")
    made.add_argument("--list", type=Path, metavar="FILE", help="names of the images that the bag has. Default: all; the robot walks past all")
    made.add_argument("--rate", type=float, default=5.0, help="images of the walk per second (5)")
    made.add_argument("--drift", type=float, default=0.01, help="by which share distances of the odometry are too long (0.01)")
    made.add_argument("--drift-deg", type=float, default=0.1, help="degrees by which its heading turns in a metre (0.1)")
    made.add_argument("--storage", choices=["mcap", "sqlite3"], default="mcap")
    made.add_argument("--down", metavar="x,y,z", help="direction of gravity in the frame of the poses. Default: what is down in the images")
    made.set_defaults(run=walk)
    return parser


def main() -> int:
    """Runs a command; errors are one line."""
    args = arguments().parse_args()
    try:
        args.run(args)
    except (veiloc.Error, OSError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
