#!/usr/bin/env python3
"""pycolmap's triangulation under known poses, beside a map of ours.

The same photographs and poses: pycolmap extracts SIFT, matches every pair, triangulates with the poses held fixed. Prints
number of points, mean track length and mean reprojection error, and the same of our map when it is given as a COLMAP
model, as `cargo run --release -p veiloc-map --example export_colmap -- place.vmap DIR` writes it.

    .venv/bin/python scripts/oracle_mapping.py --posed $VEILOC_DATA/redkitchen/posed \
        --images $VEILOC_DATA/redkitchen/images --list $VEILOC_DATA/redkitchen/map.txt [--ours DIR]
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
import pycolmap


def describe(title, model, seconds=None):
    lengths = np.array([p.track.length() for p in model.points3D.values()])
    model.update_point_3d_errors()
    errors = np.array([p.error for p in model.points3D.values()])
    print(
        f"{title:>10}: {len(lengths)} points ({np.mean(lengths > 2):.0%} seen by 3 or more), "
        f"{lengths.sum()} observations, mean track length {lengths.mean():.2f}, "
        f"mean reprojection error {np.average(errors, weights=lengths):.3f} px"
        + (f", {seconds:.0f} s" if seconds else "")
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--posed", required=True)
    parser.add_argument("--images", required=True)
    parser.add_argument("--list", required=True)
    parser.add_argument("--keypoints", type=int, default=4096)
    parser.add_argument("--max-error", type=float, default=4.0, help="pixels, COLMAP's filter_max_reproj_error")
    parser.add_argument("--two-view", action="store_true", help="also triangulate tracks of two views")
    parser.add_argument("--ours", help="our map as a COLMAP text model")
    args = parser.parse_args()

    names = [line.strip() for line in Path(args.list).read_text().splitlines() if line.strip()]
    posed = pycolmap.Reconstruction(args.posed)
    by_name = {image.name: image for image in posed.images.values()}
    camera = next(iter(posed.cameras.values()))
    started = time.time()
    with tempfile.TemporaryDirectory() as folder:
        database_path = Path(folder) / "database.db"
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = camera.model.name
        reader.camera_params = ",".join(str(p) for p in camera.params)
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.sift.max_num_features = args.keypoints
        extraction.use_gpu = False
        pycolmap.extract_features(
            database_path, args.images, image_names=names, camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=reader, extraction_options=extraction, device=pycolmap.Device.cpu,
        )
        pycolmap.match_exhaustive(database_path, device=pycolmap.Device.cpu)
        database = pycolmap.Database.open(database_path)
        model = pycolmap.Reconstruction()
        images = database.read_all_images()
        for row in database.read_all_cameras():
            model.add_camera_with_trivial_rig(row)
        for row in images:
            points = [pycolmap.Point2D(k[:2]) for k in database.read_keypoints(row.image_id)]
            row.points2D = pycolmap.Point2DList(points)
            model.add_image_with_trivial_frame(row, by_name[row.name].cam_from_world())
        database.close()
        options = pycolmap.IncrementalPipelineOptions()
        options.triangulation.ignore_two_view_tracks = not args.two_view
        options.mapper.filter_max_reproj_error = args.max_error
        options.ba_refine_focal_length = options.ba_refine_extra_params = options.ba_refine_principal_point = False
        out = Path(folder) / "out"
        out.mkdir()
        model = pycolmap.triangulate_points(
            model, database_path, args.images, out, options=options, refine_intrinsics=False,
        )
        describe("pycolmap", model, time.time() - started)
    if args.ours:
        describe("veiloc", pycolmap.Reconstruction(args.ours))


if __name__ == "__main__":
    main()
