"""Tables of docs/results/robots.md: walks of real places as bags, with odometry that drifts (`pip install './bindings/python[ros]'`)."""

from pathlib import Path

from study.common import ROOT, command, names_of

RATES = {"hololens-office": 5.0, "tum-fr1-rpy": 10.0, "redkitchen": 6.0}
"""Images of a walk per second, as recorded."""
PLACES = list(RATES)
DOWN_OF_BAGS = [0, 0, -1]
NEAR = (0.1, 2.0)


def bags(run, place: str) -> tuple[Path, Path]:
    """A map of the map images of a place, and a bag of a robot that walks past all images and sees the query images."""
    import veiloc
    from veiloc import ros
    from veiloc.ros.walk import write_walk

    scene = run.place(place)
    folder = run.kept() / "robots" / place
    if not (folder / "place.vmap").exists():
        folder.mkdir(parents=True, exist_ok=True)
        made = {"mapped": dict(names=names_of(scene / "map.txt"), drift=0.0, drift_deg=0.0), "walk": dict(names=names_of(scene / "query.txt"))}
        for name, options in made.items():
            print(place, name, write_walk(scene / "posed", scene / "images", folder / name, rate=RATES[place], **options))
        with ros.Bag(folder / "mapped", odometry="/ground_truth") as bag:
            ros.write_frames(bag, folder / "frames", min_translation=0.0, min_rotation_deg=0.0)
        built = veiloc.Map.build(folder / "frames/posed", folder / "frames/images", down=DOWN_OF_BAGS, metres=True)
        built.save(folder / "place.vmap")
    return folder / "place.vmap", folder / "walk"


class Wrong:
    """A server every fifth answer of which is an earlier trusted one: the nearest that is off by half a metre or 20° at least."""

    def __init__(self, server):
        self.server, self.trusted, self.is_wrong = server, [], []

    def localize(self, query, near):
        answer = self.server.localize(query, near)
        self.is_wrong.append(False)
        far = [(other.pose.error(answer.pose), other) for other in self.trusted if answer.pose]
        far = [(metres, other) for (degrees, metres), other in far if metres >= 0.5 or degrees >= 20]
        if answer.trusted:
            self.trusted.append(answer)
        if far and len(self.is_wrong) % 5 == 0:
            self.is_wrong[-1] = True
            return min(far, key=lambda entry: entry[0])[1]
        return answer


def replayed(run, place: str, wrong: bool = False, **options):
    """The replay of a walk, and which of the answers were made wrong."""
    import veiloc
    from veiloc import ros
    from veiloc.ros.replay import replay_bag, server_of

    file, walk = bags(run, place)
    server, profile = server_of(file)
    asked = Wrong(server) if wrong else server
    with ros.Bag(walk) as bag:
        found = replay_bag(bag, asked, veiloc.Sealer(profile), truth="/ground_truth", **options)
    return found, asked.is_wrong if wrong else []


def off(found):
    """Seconds since the start, and the errors of the robot's pose (metres, degrees) with corrections and by odometry alone from the first
    correction on; None before it."""
    from veiloc.ros.geometry import inverse
    from veiloc.ros.replay import errors

    odometry, first, rows = dict(found.odometry), None, []
    start = found.corrected[0][0]
    for stamp, corrected in found.corrected:
        true = found.truth.at(stamp)
        if corrected is not None and first is None:
            first = corrected @ inverse(odometry[stamp])
        alone = None if first is None else errors(first @ odometry[stamp], true)
        rows.append((1e-9 * (stamp - start), None if corrected is None else errors(corrected, true), alone))
    return rows


def within(pairs) -> str:
    """Share of the time within 10 cm and 2°, %."""
    return f"{100 * sum(p is not None and p[0] <= NEAR[0] and p[1] <= NEAR[1] for p in pairs) / len(pairs):.1f}"


def median(values) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


@command("robots/walks.csv", "robots/over-time.csv", places=PLACES)
def walks(run):
    """Walks with odometry that drifts 1 % and 0.1° a metre: the robot in the map over time, with late answers and wrong ones."""
    table = run.table("robots/walks.csv", "place", "answer after (s)", "wrong answers given", "questions", "trusted", "wrong answers taken",
                      "corrections beyond 25 cm or 2°", "median error (cm)", "largest error (cm)", "median error (°)",
                      "within 10 cm and 2° (% of the time)", "odometry alone within (% of the time)")  # fmt: skip
    over_time = run.table("robots/over-time.csv", "place", "time (s)", "error (cm)", "error (°)", "odometry alone (cm)", "odometry alone (°)")
    for place in run.places:
        for latency, wrong in ((0.2, False), (1.2, False), (3.0, False), (0.2, True)):
            # More questions than a robot asks, so that more wrong answers come.
            often = {"rate": 1000.0, "min_translation": 0.0, "min_rotation_deg": 0.0} if wrong else {}
            found, given = replayed(run, place, wrong, latency=latency, **often)
            rows = off(found)
            known = [pose for _, pose, _ in rows if pose is not None]
            taken = [o for o, is_wrong in zip([o for o in found.outcomes if o.answer], given) if is_wrong and o.update == "used"]
            table.add([place, latency, sum(given), len(found.outcomes), sum(o.state == "trusted" for o in found.outcomes), len(taken),
                       sum(e[0] > 0.25 or e[1] > 2 for e in known), f"{100 * median(e[0] for e in known):.1f}",
                       f"{100 * max(e[0] for e in known):.1f}", f"{median(e[1] for e in known):.2f}", within([pose for _, pose, _ in rows]),
                       within([alone for *_, alone in rows])])  # fmt: skip
            if latency == 0.2 and not wrong:
                cells = lambda e: ["", ""] if e is None else [f"{100 * e[0]:.1f}", f"{e[1]:.2f}"]  # noqa: E731
                for second, pose, alone in rows:
                    over_time.add([place, f"{second:.1f}", *cells(pose), *cells(alone)])


@command(needs="matplotlib", places=PLACES, image=ROOT / "docs/images/robots-walk.svg")
def picture(run):
    """The picture of robots/over-time.csv."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from study.common import RESULTS, read_csv

    rows = read_csv(RESULTS / "robots/over-time.csv")
    pyplot.rcParams["svg.hashsalt"] = "veiloc"
    figure, axes = pyplot.subplots(1, len(run.places), figsize=(9, 2.6), layout="constrained")
    for place, axis in zip(run.places, axes):
        for column, label in (("odometry alone (cm)", "odometry alone"), ("error (cm)", "with answers")):
            points = [(float(r["time (s)"]), float(r[column])) for r in rows if r["place"] == place and r[column]]
            axis.plot(*zip(*points), label=label)
        axis.set(title=place, xlabel="time (s)", ylim=(0, None))
    axes[0].set_ylabel("robot in the map: error (cm)")
    axes[0].legend(fontsize="small")
    figure.savefig(run.image, metadata={"Date": None})


@command("robots/covariance.csv", places=PLACES)
def covariance(run):
    """Regions of the trusted answers in the order of ROS, against their errors."""
    from veiloc.ros.replay import REGIONS, squared_distance

    table = run.table("robots/covariance.csv", "place", "trusted answers", *(f"in the {region} % region (%)" for region in REGIONS))
    for place in run.places:
        found, _ = replayed(run, place, rate=1000.0, min_translation=0.0, min_rotation_deg=0.0)
        of = [(o, found.truth.at(o.stamp)) for o in found.outcomes if o.state == "trusted" and o.covariance is not None]
        squared = [squared_distance(outcome, true) for outcome, true in of if true is not None]
        table.add([place, len(squared), *(f"{100 * sum(s <= limit for s in squared) / len(squared):.0f}" for limit in REGIONS.values())])


@command("robots/rigs.csv", places=PLACES)
def rigs(run):
    """Three images of a walk with their true relative poses, as three cameras of a rig see a place, against one."""
    import veiloc
    from veiloc import ros
    from veiloc.ros.replay import errors, server_of

    table = run.table("robots/rigs.csv", "place", "cameras", "questions", "trusted (%)", "found (%)", "median error (cm)", "largest trusted error (cm)",
                      "median error (°)", "bytes of a query")  # fmt: skip
    for place in run.places:
        file, walk = bags(run, place)
        server, profile = server_of(file)
        with ros.Bag(walk, odometry="/ground_truth") as bag:
            pictures = list(bag.pictures())
            groups = [pictures[k : k + 3] for k in range(0, len(pictures) - 2, 3)]
            for cameras in (1, 3):
                found = []
                for group in groups:
                    localizer = ros.Localizer(server, veiloc.Sealer(profile))
                    frames = [ros.Frame(p.stamp, ros.image_of(p.message), bag.cameras[p.topic], bag.extrinsics(p)) for p in group[-cameras:]]
                    # True relative poses: a rig is rigid.
                    localizer.drift = (0.0, 0.0)
                    outcome = localizer.ask(frames, bag.trajectory([p.stamp for p in group]))
                    found.append((outcome, bag.odom_from_base(outcome.stamp)))
                posed = [(o, errors(o.map_from_base, true)) for o, true in found if o.map_from_base is not None]
                trusted = [e for o, e in posed if o.state == "trusted"]
                table.add([place, cameras, len(groups), f"{100 * len(trusted) / len(groups):.0f}", f"{100 * len(posed) / len(groups):.0f}",
                           f"{100 * median(e[0] for _, e in posed):.1f}", f"{100 * max(e[0] for e in trusted):.1f}",
                           f"{median(e[1] for _, e in posed):.2f}", int(median(o.sealed_bytes for o, _ in found))])  # fmt: skip


@command("robots/costs.csv", places=PLACES)
def costs(run):
    """What a question costs a robot: processor time to seal, bytes that leave, the wait for a map in the same process."""
    table = run.table("robots/costs.csv", "place", "processor time to seal (ms)", "the same at the end of the walk (ms)", "bytes of a query",
                      "wait for an answer (ms)")  # fmt: skip
    for place in run.places:
        found, _ = replayed(run, place, rate=1000.0, min_translation=0.0, min_rotation_deg=0.0)
        asked = [o for o in found.outcomes if o.sealed_bytes]
        table.add([place, f"{median(o.seal_ms for o in asked[1:6]):.0f}", f"{median(o.seal_ms for o in asked[-10:]):.0f}",
                   int(median(o.sealed_bytes for o in asked)), f"{median(o.wait_ms for o in asked):.0f}"])  # fmt: skip
