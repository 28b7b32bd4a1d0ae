#!/usr/bin/env bash
# Makes the tables of README and docs/results with today's program, each with its commit, command and machine in
# docs/results/figures.csv. All of them take hours; an interrupted run goes on where it was. Needs Rust, Python and VEILOC_DATA, the
# folder of the real images. Installs the other programs (pycolmap, PoseLib, OpenCV, ONNX Runtime) from PyPI into target/figures.
# With VEILOC_MODELS, the folder of network files, it makes the tables of learned features too.
#
#     VEILOC_DATA=../shared/data research/figures.sh [PAGE | TABLE]…       # for example: poses trust/stress.csv
#     research/figures.sh --list
set -euo pipefail
cd "$(dirname "$0")/.."
venv=target/figures/venv
if [ ! -e "$venv/ready" ]; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet --disable-pip-version-check $(python3 research/study figures --packages)
    touch "$venv/ready"
fi
cargo build --release --locked --package veiloc-cli --features full
exec "$venv/bin/python" research/study figures "$@"
