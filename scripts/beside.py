"""What the scripts that set ours beside other programs share: times of child processes, one thread, files of networks."""

import os
import subprocess
from pathlib import Path

import numpy as np


def child_seconds(command, environment=()):
    """Processor seconds of a program that uses one thread; it must succeed."""
    command = [str(word) for word in command]
    environment = {**os.environ, "RAYON_NUM_THREADS": "1", **dict(environment)}
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    child = subprocess.Popen(command, env=environment, **silent)
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = status
    if status != 0:
        raise SystemExit(f"{' '.join(command)} failed")
    return usage.ru_utime + usage.ru_stime


def one_thread():
    """ONNX Runtime's options."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return options


def made_up(count: int) -> np.ndarray:
    """Numbers from -0.05 to 0.05 by a formula."""
    i = np.arange(count, dtype=np.uint64)
    return ((((i * 2654435761) % 2**32) / 2**32 - 0.5) * 0.1).astype(np.float32)


def superpoint_weights(folder: Path) -> dict:
    """SuperPoint's encoder and descriptors; its detector head is made up: what is found with it is not SuperPoint."""
    weights = dict(np.load(folder / "superpoint/superpoint_v1_encoder_desc.npz"))
    for name, shape in [("convPa", (256, 128, 3, 3)), ("convPb", (65, 256, 1, 1))]:
        weights[name + ".weight"] = made_up(int(np.prod(shape))).reshape(shape)
        weights[name + ".bias"] = made_up(shape[0])
    return weights
