#!/usr/bin/env python3
"""GPS in EXIF to GeoPoses of hold-outs: `veiloc map align --gps`, `veiloc serve --geo-reference`, `POST /geopose`.

    python -m venv venv && venv/bin/pip install numpy pillow
    venv/bin/python research/study/gps_place.py VEILOC DATA WORK OUT.csv [PLACE…]

No place of DATA has GPS, so it is made here: the images of a place with poses in metres are copied without a change of their pixels, and
their EXIF gets the true position plus normal noise of NOISE metres along each axis, independent between images. (Real receivers err
by a few metres, and neighbours err alike, which no similarity can find.) The map gets poses in a random gauge, as structure from
motion would give them. Queries are sealed and sent to a service, and their GeoPoses are compared with the true positions and with
the GPS of their own files.
"""

import base64
import json
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

import numpy as np
from images_alone import arguments, place_of, run, write_rows
from map_merges import gauge, write_posed
from geometry import center
from PIL import Image

PLACES = ["herzjesu", "fountain"]
NOISE = [0.0, 1.0, 3.0]
SEED = 1
# Where the place is put: degrees, metres above the ellipsoid.
ORIGIN = (48.0, 11.0, 500.0)
A, E2 = 6378137.0, 0.00669437999014


def ecef(latitude, longitude, height):
    lat, lon = np.radians([latitude, longitude])
    n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
    return np.array(
        [(n + height) * np.cos(lat) * np.cos(lon), (n + height) * np.cos(lat) * np.sin(lon), (n * (1 - E2) + height) * np.sin(lat)]
    )


def enu_from_ecef(latitude, longitude):
    lat, lon = np.radians([latitude, longitude])
    return np.array(
        [
            [-np.sin(lon), np.cos(lon), 0],
            [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
            [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
        ]
    )


def geodetic(enu):
    """Latitude, longitude, height of an offset from ORIGIN, by Bowring's iteration."""
    x, y, z = ecef(*ORIGIN) + enu_from_ecef(*ORIGIN[:2]).T @ enu
    lon, p = np.arctan2(y, x), np.hypot(x, y)
    lat = np.arctan2(z, p * (1 - E2))
    for _ in range(10):
        n = A / np.sqrt(1 - E2 * np.sin(lat) ** 2)
        height = p / np.cos(lat) - n
        lat = np.arctan2(z, p * (1 - E2 * n / (n + height)))
    return np.degrees(lat), np.degrees(lon), height


def offset(latitude, longitude, height):
    """East, north, up from ORIGIN, metres."""
    return enu_from_ecef(*ORIGIN[:2]) @ (ecef(latitude, longitude, height) - ecef(*ORIGIN))


def with_gps(jpeg, place):
    """The bytes of a JPEG file with GPS as its only EXIF data."""
    latitude, longitude, height = place

    def dms(angle):
        angle = abs(angle)
        degrees, rest = int(angle), (angle % 1) * 60
        return (degrees, int(rest), round((rest % 1) * 60, 6))

    exif = Image.Exif()
    exif[0x8825] = {
        1: "N" if latitude >= 0 else "S",
        2: dms(latitude),
        3: "E" if longitude >= 0 else "W",
        4: dms(longitude),
        5: b"\0",
        6: round(height, 3),
    }
    data = exif.tobytes()
    if not data.startswith(b"Exif"):
        data = b"Exif\0\0" + data
    return jpeg[:2] + b"\xff\xe1" + (len(data) + 2).to_bytes(2, "big") + data + jpeg[2:]


def geopose(address, sealed, camera):
    reading = {
        "timestamp": 0,
        "sensorId": "camera",
        "imageFormat": "VEILOC_SEALED_QUERY",
        "size": [int(n) for n in camera.split()[1:3]],
        "imageBytes": base64.b64encode(sealed).decode(),
        "privacy": {
            "dataRetention": [],
            "dataAcceptableUse": [],
            "dataSanitizationApplied": ["dcl"],
            "dataSanitizationRequested": [],
        },
    }
    body = {"id": "query", "timestamp": 0, "type": "geopose", "sensors": [{"id": "camera", "type": "camera"}]}
    body["sensorReadings"] = {"cameraReadings": [reading]}
    request = urllib.request.Request(f"{address}/geopose", json.dumps(body).encode(), {"Content-Type": "application/json"})
    try:
        return json.load(urllib.request.urlopen(request))["geopose"]["position"]
    except urllib.error.HTTPError as error:
        if json.load(error).get("type", "").endswith("not-localized"):
            return None
        raise


def rows_of(veiloc, folder, kept):
    _, truth, names, held_out = place_of(folder)
    centers = np.array([center(*truth[name][1:]) for name in names])
    # The cameras are upright on average; the direction of north is arbitrary.
    up = -np.mean([truth[name][1][1] for name in names], axis=0)
    up /= np.linalg.norm(up)
    east = np.cross([0.0, 1.0, 0.0] if abs(up[1]) < 0.9 else [1.0, 0.0, 0.0], up)
    east /= np.linalg.norm(east)
    enu_from_world = np.array([east, np.cross(up, east), up])
    of_world = lambda c: enu_from_world @ (c - centers.mean(0))
    write_posed(kept / "posed", truth, names, gauge(SEED))
    run([veiloc, "map", "build", "--images", folder / "images", "--posed", kept / "posed", "-o", kept / "given.vmap"])
    rows = []
    for noise in NOISE:
        random = np.random.default_rng(SEED)
        gps = {}
        images = kept / f"images-{noise}"
        images.mkdir(parents=True, exist_ok=True)
        for name in [*names, *held_out]:
            own = of_world(center(*truth[name][1:])) + noise * random.normal(size=3)
            gps[name] = geodetic(own)
            (images / name).write_bytes(with_gps((folder / "images" / name).read_bytes(), gps[name]))
        aligned = kept / "place.vmap"
        found = json.loads(run([veiloc, "map", "align", kept / "given.vmap", "--gps", images, "-o", aligned, "--json"])[0])["alignment"]
        run([veiloc, "map", "profile", aligned, "-o", kept / "place.profile"])
        origin = ",".join(repr(x) for x in found["origin"])
        service = subprocess.Popen(
            [veiloc, "serve", "--map", f"place={aligned}", "--geo-reference", f"place={origin}", "--listen", "127.0.0.1:0", "--rate", "1000",
             "--answer-quantum", "0"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            address = next(m[1] for m in (re.search(r"serving place on (http://[\d.:]+)", line) for line in service.stdout) if m)
            off_truth, off_gps = [], []
            for name in held_out:
                sealed = kept / "query.vquery"
                camera = truth[name][0]
                # The file with GPS: sealing reads no location.
                run([veiloc, "seal", images / name, "--camera", camera.replace(" ", ","), "--profile", kept / "place.profile", "-o", sealed])
                position = geopose(address, sealed.read_bytes(), camera)
                if position is not None:
                    there = offset(position["lat"], position["lon"], position["h"])
                    off_truth.append(np.linalg.norm(there - of_world(center(*truth[name][1:]))))
                    off_gps.append(np.linalg.norm(there - offset(*gps[name])))
        finally:
            service.kill()
            service.wait()
        s, _, _ = gauge(SEED)
        own = [np.linalg.norm(offset(*gps[name]) - of_world(center(*truth[name][1:]))) for name in held_out]
        rows.append(
            {
                "place": folder.name,
                "noise of GPS per axis (m)": noise,
                "images with GPS": len(names),
                "extent of the cameras (m)": f"{np.sqrt(((centers - centers.mean(0)) ** 2).sum(1).mean()):.1f}",
                "error of scale (%)": f"{100 * (found['scale'] * s - 1):.1f}",
                "queries": len(held_out),
                "with a GeoPose": len(off_truth),
                "GeoPose to the true position, median (m)": f"{np.median(off_truth):.2f}",
                "GeoPose to the query's own GPS, median (m)": f"{np.median(off_gps):.2f}",
                "own GPS to the true position, median (m)": f"{np.median(own):.2f}",
            }
        )
        print(rows[-1], file=sys.stderr)
    return rows


def main():
    veiloc, data, work, out, places = arguments(__doc__, "veiloc", "data", "work", "out", "places")
    rows = []
    for place in places or PLACES:
        rows += rows_of(veiloc, Path(data) / place, Path(work) / place)
        write_rows(out, rows)


if __name__ == "__main__":
    main()
