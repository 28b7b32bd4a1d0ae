"""The training loop: optimizer, schedule, curve, checkpoints."""

import argparse
import csv
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.utils.data import DataLoader, Dataset


@dataclass(frozen=True)
class Task:
    """A network with its data, loss and validation."""

    network: nn.Module
    #: Samples the batch of a step with the generator; runs in other processes, so it must not use a GPU.
    draw: Callable[[np.random.Generator], Any]
    #: The loss of a batch.
    loss: Callable[[Any], torch.Tensor]
    #: Validation figures by name; the first one selects the best checkpoint (smaller is better).
    validate: Callable[[], dict[str, float]]


def add_arguments(parser: argparse.ArgumentParser, steps: int, batch: int, rate: float, of_keypoints: bool = True) -> None:
    """Adds the options of all trainings."""
    if of_keypoints:
        parser.add_argument("keypoints", type=Path, nargs="+", help="files of `veiloc eval keypoints`")
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="STEM",
                        help="STEM.onnx and STEM.toml are the network, STEM.csv its curve, STEM.pt the checkpoint")  # fmt: skip
    parser.add_argument("--steps", type=int, default=steps, help="steps of the optimizer (%(default)s)")
    parser.add_argument("--batch", type=int, default=batch, help="images per step (%(default)s)")
    parser.add_argument("--rate", type=float, default=rate, help="highest learning rate (%(default)s)")
    parser.add_argument("--decay", type=float, default=0.01, help="weight decay (%(default)s)")
    parser.add_argument("--validation", type=int, default=64, help="number of validation images (%(default)s)")
    parser.add_argument("--every", type=int, default=250, help="steps between checkpoints (%(default)s)")
    parser.add_argument("--minutes", type=float, help="time limit; the learning rate schedule ends with it")
    parser.add_argument("--images", type=int, help="most images to read")
    parser.add_argument("--resume", action="store_true", help="continue from STEM.pt, if it exists")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="(%(default)s)")
    parser.add_argument("--threads", type=int, help="CPU threads of PyTorch")
    parser.add_argument("--workers", type=int, default=2, help="processes that prepare batches in advance; 0: none (%(default)s)")
    parser.add_argument("--seed", type=int, default=0)


def setup(args: argparse.Namespace) -> None:
    """Sets seed, precision and threads; call it before creating the network."""
    torch.manual_seed(args.seed)
    torch.set_float32_matmul_precision("high")  # TF32, where the device has it
    if args.threads:
        torch.set_num_threads(args.threads)
    args.out.parent.mkdir(parents=True, exist_ok=True)


def rate_at(done: float) -> float:
    """Learning rate, relative to the highest, after this share of the training: warm-up over 3 %, then cosine decay."""
    return min(done / 0.03 + 1e-3, 1.0) * (0.02 + 0.98 * 0.5 * (1.0 + math.cos(math.pi * min(done, 1.0))))


def decaying(network: nn.Module, decay: float) -> list[dict]:
    """Parameter groups: weight decay only for matrices, not for biases and normalizations."""
    matrices = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": matrices, "weight_decay": decay}, {"params": others, "weight_decay": 0.0}]


def identity(args: argparse.Namespace) -> str:
    """The options that must be equal to resume a training."""
    loose = {"out", "resume", "device", "threads", "workers", "minutes", "keypoints", "run", "image_folder"}
    return repr(sorted((k, str(v)) for k, v in vars(args).items() if k not in loose))


class Steps(Dataset):
    """The batch of each step.

    Each step has a generator seeded by its number, so a resumed training gets the same batches, with any number of workers.
    """

    def __init__(self, draw: Callable[[np.random.Generator], Any], seed: int):
        self.draw, self.seed = draw, seed

    def __getitem__(self, step: int) -> Any:
        return self.draw(np.random.default_rng([self.seed, step]))


def draws(task: Task, args: argparse.Namespace, step: int) -> Iterator[Any]:
    """The batches from this step on."""
    context = "fork" if args.workers else None  # the functions that draw cannot be pickled
    steps = Steps(task.draw, args.seed)
    own = torch.Generator()  # the default one is that of the network's dropout
    order = range(step, args.steps)
    return iter(DataLoader(steps, None, sampler=order, num_workers=args.workers, multiprocessing_context=context, generator=own))


def train(task: Task, args: argparse.Namespace) -> nn.Module:
    """Trains, and returns the network of the best checkpoint."""
    network = task.network.to(args.device)
    optimizer = torch.optim.AdamW(decaying(network, args.decay), lr=args.rate)
    state = {"step": 0, "seconds": 0.0, "best": math.inf, "weights": None, "curve": []}
    checkpoint, own = args.out.with_suffix(".pt"), identity(args)
    if args.resume and checkpoint.exists():
        saved = torch.load(checkpoint, map_location=args.device, weights_only=False)
        if saved["identity"] != own:
            sys.exit(f"{checkpoint} is from a training with other options; use the same options, or another output")
        network.load_state_dict(saved["network"])
        optimizer.load_state_dict(saved["optimizer"])
        torch.set_rng_state(saved["random"].cpu())
        state = saved["state"]
        print(f"resumes at step {state['step']}", file=sys.stderr)

    def done() -> float:
        by_time = state["seconds"] / (60.0 * args.minutes) if args.minutes else 0.0
        return max(state["step"] / args.steps, by_time)

    losses: list[float] = []
    drawn = draws(task, args, state["step"])
    while True:
        is_due = state["step"] % args.every == 0 or done() >= 1.0
        if is_due and (losses or state["step"] == 0):
            validate_and_log(task, network, state, losses, args)
            losses = []
            saved = {"identity": own, "network": network.state_dict(), "optimizer": optimizer.state_dict()}
            save_atomically(checkpoint, saved | {"random": torch.get_rng_state(), "state": state})
        if done() >= 1.0:
            break
        started = time.monotonic()
        network.train()
        for group in optimizer.param_groups:
            group["lr"] = args.rate * rate_at(done())
        loss = task.loss(next(drawn))
        if not torch.isfinite(loss):
            sys.exit(f"the loss is not finite at step {state['step']}")
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        losses.append(loss.item())
        state["step"] += 1
        state["seconds"] += time.monotonic() - started
    del drawn  # ends the workers
    network.load_state_dict(state["weights"])
    return network.eval()


def validate_and_log(task: Task, network: nn.Module, state: dict, losses: list[float], args: argparse.Namespace) -> None:
    """Validates the network, stores its weights if it is the best, and writes the curve."""
    network.eval()
    with torch.no_grad():
        figures = task.validate()
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


def save_atomically(path: Path, saved: dict) -> None:
    """Writes a checkpoint; a failure leaves the old file unchanged."""
    temporary = path.with_suffix(".pt.new")
    torch.save(saved, temporary)
    temporary.replace(path)
