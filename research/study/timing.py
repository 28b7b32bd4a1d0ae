"""Shared code of the benchmarks against other programs: processor time of child processes, one thread."""

import os
import subprocess


def child_seconds(command, environment=()):
    """Runs a program with one thread and returns its processor seconds; it must succeed."""
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
    """ONNX Runtime options for one thread."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return options
