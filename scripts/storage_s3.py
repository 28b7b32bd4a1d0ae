"""Regions to S3 and back, against a local S3 (moto): what docs/scale.md says of it.

    pip install "moto[server,s3]"
    cargo build --release --features clouds
    python3 scripts/storage_s3.py target/release/veiloc place.vmap

Publishes the map's regions, publishes again (nothing is sent), fetches them (equal, byte for byte), then lets the storage
go wrong: other bytes under an object's name, a shorter object, a missing one, a pointer to nowhere. Each must be told, and
nothing of it must reach the folder.
"""
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import boto3
from moto.server import ThreadedMotoServer

BUCKET = "maps"
URL = f"s3://{BUCKET}/of mine"


def main(program, place):
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    settings = {
        "AWS_ENDPOINT": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_ACCESS_KEY_ID": "key",
        "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1",
    }
    storage = boto3.client("s3", endpoint_url=endpoint, region_name="us-east-1", aws_access_key_id="key",
                           aws_secret_access_key="secret")
    storage.create_bucket(Bucket=BUCKET)

    def run(*words):
        started = time.monotonic()
        done = subprocess.run([program, *words], env=os.environ | settings, capture_output=True, text=True, check=False)
        return done, time.monotonic() - started

    def document(*words):
        done, seconds = run(*words, "--json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout), seconds

    def key(path):
        return f"of mine/{path}"

    with tempfile.TemporaryDirectory() as folder:
        regions, back = Path(folder, "regions"), Path(folder, "back")
        split, _ = document("map", "split", place, "--images", "20", "--name", "place", "--out", str(regions))
        objects = len(split["regions"]) + 2
        published, seconds = document("map", "publish", str(regions), URL)
        assert published["objects_sent"] == objects and published["bytes_sent"] == split["bytes"], published
        print(f"published {objects} objects, {split['bytes'] / 1e6:.1f} MB in {seconds:.1f} s")
        again, seconds = document("map", "publish", str(regions), URL)
        assert again["objects_sent"] == 0 and again["objects_there"] == objects, again
        print(f"published again: nothing sent, {seconds:.1f} s")
        fetched, seconds = document("map", "fetch", URL, "place", "--out", str(back))
        assert fetched["objects_fetched"] == objects and fetched["manifest"] == split["manifest"], fetched
        files = sorted(p.relative_to(regions) for p in regions.rglob("*") if p.is_file())
        assert files == sorted(p.relative_to(back) for p in back.rglob("*") if p.is_file()), files
        assert all((regions / f).read_bytes() == (back / f).read_bytes() for f in files)
        print(f"fetched {objects} objects in {seconds:.1f} s: equal, byte for byte")

        name = split["regions"][0]["sha256"]
        good = (regions / "objects" / name).read_bytes()

        def refused(why, expected):
            target = Path(folder, "refused")
            done, seconds = run("map", "fetch", URL, "place", "--out", str(target))
            assert done.returncode == 1 and expected in done.stderr, (why, done.returncode, done.stderr)
            assert not (target / "manifest.json").exists() and not (target / "objects" / name).exists(), why
            print(f"{why}: refused in {seconds:.1f} s")

        wrong = bytearray(good)
        wrong[len(wrong) // 2] ^= 1
        storage.put_object(Bucket=BUCKET, Key=key(f"objects/{name}"), Body=bytes(wrong))
        refused("another byte", name)
        storage.put_object(Bucket=BUCKET, Key=key(f"objects/{name}"), Body=good[:-1])
        refused("a byte less", name)
        again, _ = document("map", "publish", str(regions), URL)
        assert again["objects_sent"] == 1, again
        print("published again: the short one was sent anew")
        storage.delete_object(Bucket=BUCKET, Key=key(f"objects/{name}"))
        refused("an object that is gone", "veiloc map publish")
        storage.put_object(Bucket=BUCKET, Key=key("place.json"),
                           Body=json.dumps({"version": 1, "map": "place", "manifest": "../" * 20 + "0000"}).encode())
        refused("a pointer to elsewhere", "no pointer")
        settings["AWS_ENDPOINT"] = "http://127.0.0.1:9"
        done, seconds = run("map", "fetch", "s3://nowhere/x", "place", "--out", str(back))
        print(f"no storage there: exit code {done.returncode} in {seconds:.1f} s")
        assert done.returncode == 1
    server.stop()
    print("all as it should be")


if __name__ == "__main__":
    main(*sys.argv[1:])
