"""The loop of any training: optimizer, schedule, curve, checkpoints."""

import argparse
import csv
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn


@dataclass(frozen=True)
class Task:
    """What is learned."""

    network: nn.Module
    #: What a step learns from; the generator says which. Runs beside the training.
    draw: Callable[[np.random.Generator], Any]
    #: The loss of a draw.
    loss: Callable[[Any], torch.Tensor]
    #: What the network is worth now: names and values, the first of which is made small.
    judge: Callable[[], dict[str, float]]


def add_arguments(parser: argparse.ArgumentParser, steps: int, batch: int, rate: float) -> None:
    """Those that every training has."""
    parser.add_argument("keypoints", type=Path, nargs="+", help="files of `veiloc eval keypoints`")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="STEM",
                        help="STEM.onnx and STEM.toml are the network, STEM.csv its curve, STEM.pt the checkpoint")  # fmt: skip
    parser.add_argument("--features", default="sift", help="kind of the descriptors, as the program's --features spells it")
    parser.add_argument("--steps", type=int, default=steps, help="of the optimizer (%(default)s)")
    parser.add_argument("--batch", type=int, default=batch, help="images of a step (%(default)s)")
    parser.add_argument("--rate", type=float, default=rate, help="highest learning rate (%(default)s)")
    parser.add_argument("--decay", type=float, default=0.01, help="weight decay (%(default)s)")
    parser.add_argument("--validation", type=int, default=64, help="images to judge by and not to learn from (%(default)s)")
    parser.add_argument("--every", type=int, default=250, help="steps between checkpoints (%(default)s)")
    parser.add_argument("--minutes", type=float, help="stop here, and end the schedule of the learning rate here")
    parser.add_argument("--images", type=int, help="read so many images and no more")
    parser.add_argument("--resume", action="store_true", help="go on from STEM.pt, if there is one")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="(%(default)s)")
    parser.add_argument("--threads", type=int, help="of PyTorch on a processor")
    parser.add_argument("--workers", type=int, default=2, help="threads that draw in advance; 0: none (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)


def begin(args: argparse.Namespace) -> None:
    """Before a network is made."""
    torch.manual_seed(args.seed)
    if args.threads:
        torch.set_num_threads(args.threads)
    args.out.parent.mkdir(parents=True, exist_ok=True)


def rate_at(done: float) -> float:
    """Share of the highest learning rate when this share of the training is done: up over 3 %, then down a half cosine."""
    return min(done / 0.03 + 1e-3, 1.0) * (0.02 + 0.98 * 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0))))


def decaying(network: nn.Module, decay: float) -> list[dict]:
    """Matrices decay; biases, normalizations and single numbers do not."""
    matrices = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": matrices, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]


def identity(args: argparse.Namespace) -> str:
    """What must be the same for a training to go on."""
    loose = {"out", "resume", "device", "threads", "workers", "minutes", "keypoints", "run", "image_folder"}
    return repr(sorted((k, str(v)) for k, v in vars(args).items() if k not in loose))


def draws(task: Task, args: argparse.Namespace, step: int) -> Iterator[Any]:
    """What the steps from this one on learn from.

    Each draws by its own number, so that a training that goes on draws what it would have drawn, however many workers there are.
    """

    def draw(number: int) -> Any:
        return task.draw(np.random.default_rng([args.seed, number]))

    if args.workers == 0:
        while True:
            yield draw(step)
            step += 1
    with ThreadPoolExecutor(args.workers) as pool:
        waiting = deque(pool.submit(draw, step + i) for i in range(2 * args.workers))
        step += 2 * args.workers
        try:
            while True:
                yield waiting.popleft().result()
                waiting.append(pool.submit(draw, step))
                step += 1
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def train(task: Task, args: argparse.Namespace) -> nn.Module:
    """Trains, and gives the network of the best checkpoint."""
    network = task.network.to(args.device)
    optimizer = torch.optim.AdamW(decaying(network, args.decay), lr=args.rate)
    state = {"step": 0, "seconds": 0.0, "best": math.inf, "weights": None, "curve": []}
    checkpoint, own = args.out.with_suffix(".pt"), identity(args)
    if args.resume and checkpoint.exists():
        kept = torch.load(checkpoint, map_location=args.device, weights_only=False)
        if kept["identity"] != own:
            sys.exit(f"{checkpoint} is of a training with other options")
        network.load_state_dict(kept["network"])
        optimizer.load_state_dict(kept["optimizer"])
        torch.set_rng_state(kept["random"].cpu())
        state = kept["state"]
        print(f"goes on at step {state['step']}", file=sys.stderr)

    def done() -> float:
        by_time = state["seconds"] / (60.0 * args.minutes) if args.minutes else 0.0
        return max(state["step"] / args.steps, by_time)

    losses: list[float] = []
    drawn = draws(task, args, state["step"])
    while True:
        whole = state["step"] % args.every == 0 or done() >= 1.0
        if whole and (losses or state["step"] == 0):
            note(task, network, state, losses, args)
            losses = []
            kept = {"identity": own, "network": network.state_dict(), "optimizer": optimizer.state_dict()}
            replace(checkpoint, kept | {"random": torch.get_rng_state(), "state": state})
        if done() >= 1.0:
            break
        started = time.monotonic()
        network.train()
        for group in optimizer.param_groups:
            group["lr"] = args.rate * rate_at(done())
        loss = task.loss(next(drawn))
        if not torch.isfinite(loss):
            sys.exit(f"the loss is no number at step {state['step']}")
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        losses.append(loss.item())
        state["step"] += 1
        state["seconds"] += time.monotonic() - started
    drawn.close()
    network.load_state_dict(state["weights"])
    return network.eval()


def note(task: Task, network: nn.Module, state: dict, losses: list[float], args: argparse.Namespace) -> None:
    """Judges the network, keeps it if it is the best, and writes the curve."""
    network.eval()
    with torch.no_grad():
        figures = task.judge()
    own = next(iter(figures.values()))
    if own < state["best"] or state["weights"] is None:
        state["best"] = own
        state["weights"] = {k: v.detach().to("cpu", copy=True) for k, v in network.state_dict().items()}
    loss = sum(losses) / len(losses) if losses else math.nan
    row = {"step": state["step"], "minutes": round(state["seconds"] / 60.0, 2), "loss": loss} | figures
    state["curve"].append(row)
    with args.out.with_suffix(".csv").open("w", newline="") as out:
        writer = csv.DictWriter(out, fieldnames=list(row))
        writer.writeheader()
        writer.writerows(state["curve"])
    print("  ".join(f"{k} {v:.5g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items()), file=sys.stderr, flush=True)


def replace(path: Path, kept: dict) -> None:
    """Whole or not at all."""
    beside = path.with_suffix(".pt.new")
    torch.save(kept, beside)
    beside.replace(path)
