#!/usr/bin/env python3
"""Exports published networks as ONNX files for the program.

    .venv/bin/pip install -e research/train scipy
    .venv/bin/python scripts/export_onnx.py alike alike-t.pth alike-t.onnx
    .venv/bin/python scripts/export_onnx.py aliked aliked-n16.pth aliked-n16.onnx
    .venv/bin/python scripts/export_onnx.py superpoint superpoint_v1.pth superpoint.onnx
    .venv/bin/python scripts/export_onnx.py netvlad VGG16-NetVLAD-Pitts30K.mat netvlad.onnx
    .venv/bin/python scripts/export_onnx.py st-lpips alex_shift_tolerant.pth st-lpips.onnx
    .venv/bin/python scripts/export_onnx.py lpips alex.pth lpips.onnx --backbone alexnet-owt-7be5be79.pth
    .venv/bin/python scripts/export_onnx.py efficientnet-lite0 efficientnet-lite0-57934424.pth efficientnet-lite0.onnx

Weights are `.pth` files, or `.npz` with the same tensors. The layers follow the papers, with the names of the tensors in the files.
Batch normalizations are folded into the ordinary convolutions before them. If ONNX Runtime is installed, each written file is compared with
PyTorch, and the largest difference is printed.

Inputs and outputs:

- alike: `image` [1, 3, H, W], 0 to 1, sides multiples of 32 -> `scores` [1, 1, H, W]; `level1` to `level4` [1, dim/4, ...], of the sizes
  1, 1/2, 1/8 and 1/32; `head` [dim, dim], which maps the concatenated levels at a keypoint (each upsampled with aligned corners) to a
  descriptor; with --dense `descriptors` [1, dim, H, W], those of all pixels.
- aliked: two files, OUT and its head beside it, `aliked-n16-head.onnx` for `aliked-n16.onnx`:
  `image` [1, 3, H, W], 0 to 1, sides multiples of 32 -> `scores` [1, 1, H, W], `features` [1, dim, H, W];
  `features` and `keypoints` [1, N, 2], column and row, integers are pixel centres -> `descriptors` [1, N, dim] of length 1.
- superpoint: `image` [1, 1, H, W], 0 to 1, sides multiples of 8 -> `scores` [1, 65, H/8, W/8] before the softmax; `descriptors`
  [1, 256, H/8, W/8] before normalization.
- netvlad: `image` [1, 3, H, W], 0 to 1 -> `vector` [1, numbers] of length 1; with --features only `features` [1, 512, H/16, W/16].
- st-lpips, lpips: `a` and `b` [1, 3, H, W], sRGB, 0 to 1 -> `distance` [1].
- efficientnet-lite0: `image` [1, 3, 224, 224], (x - 127) / 128 of 0 to 255 -> `logits` [1, 1000].
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional as F

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "research/train"))

from veiloc_train.export import onnx_graph  # noqa: E402
from veiloc_train.perceptual import StLpips, unit  # noqa: E402


def tensors_of(path: Path) -> dict[str, torch.Tensor]:
    """The tensors of a file, by name."""
    if path.suffix == ".npz":
        return {name: torch.from_numpy(value) for name, value in np.load(path).items()}
    loaded = torch.load(path, map_location="cpu", weights_only=True)
    return loaded.get("state_dict", loaded)


def fill(network: nn.Module, tensors: dict[str, torch.Tensor]) -> nn.Module:
    """Loads exactly these weights; batch counters are ignored."""
    wanted = {name for name in network.state_dict() if not name.endswith("num_batches_tracked")}
    given = {name: value for name, value in tensors.items() if not name.endswith("num_batches_tracked")}
    if wanted != set(given):
        lacking, unknown = sorted(wanted - set(given)), sorted(set(given) - wanted)
        sys.exit(f"weights of another network: lacks {lacking[:4]}, does not know {unknown[:4]}")
    network.load_state_dict(given, strict=False)
    return network.eval()


class AlikeBlock(nn.Module):
    """Two convolutions, with a skip connection if the block has one."""

    def __init__(self, inputs: int, outputs: int, residual: bool):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        if residual:
            self.downsample = nn.Conv2d(inputs, outputs, 1)
        self.residual = residual

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.bn2(self.conv2(F.relu(self.bn1(self.conv1(x)))))
        return F.relu(y + self.downsample(x)) if self.residual else F.relu(y)


class Alike(nn.Module):
    """Zhao et al., ALIKE, IEEE Transactions on Multimedia 2022, with one head.

    The last convolution is pointwise: for the scores it runs before the upsampling, and for descriptors it is left to the caller of the
    network for the descriptors.
    """

    SIZES = (1, 2, 8, 32)

    def __init__(self, tensors: dict[str, torch.Tensor], dense: bool = False):
        super().__init__()
        before = 3
        for number in range(1, 5):
            own = tensors[f"block{number}.conv2.weight"].shape[0]
            self.add_module(f"block{number}", AlikeBlock(before, own, number > 1))
            self.add_module(f"conv{number}", nn.Conv2d(own, tensors["conv1.weight"].shape[0], 1, bias=False))
            before = own
        self.quarter = tensors["conv1.weight"].shape[0]
        self.dim = 4 * self.quarter
        self.convhead2 = nn.Conv2d(self.dim, self.dim + 1, 1, bias=False)
        self.dense = dense
        fill(self, tensors)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        x, levels = image, []
        for number, pool in enumerate((1, 2, 4, 4), 1):
            x = getattr(self, f"block{number}")(F.max_pool2d(x, pool) if pool > 1 else x)
            levels.append(F.relu(getattr(self, f"conv{number}")(x)))
        kernel = self.convhead2.weight
        rows = kernel[self.dim :].split(self.quarter, dim=1)
        scores = sum(self.enlarged(F.conv2d(x, row), size) for x, row, size in zip(levels, rows, self.SIZES))
        found = (torch.sigmoid(scores), *levels)
        if self.dense:
            joined = torch.cat([self.enlarged(x, size) for x, size in zip(levels, self.SIZES)], dim=1)
            found += (F.conv2d(joined, kernel[: self.dim]),)
        return found

    def head(self) -> torch.Tensor:
        """Maps the concatenated levels to the descriptor. `[dim, dim]`"""
        return self.convhead2.weight[: self.dim, :, 0, 0].detach()

    @staticmethod
    def enlarged(x: torch.Tensor, size: int) -> torch.Tensor:
        return x if size == 1 else F.interpolate(x, scale_factor=float(size), mode="bilinear", align_corners=True)


class Selu(nn.Module):
    """Klambauer et al., Self-Normalizing Neural Networks, NeurIPS 2017; by ELU, as rten has no operator of its own for it."""

    ALPHA, SCALE = 1.6732632423543772, 1.0507009873554805

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.SCALE * F.elu(x, self.ALPHA)


def sampled(x: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
    """Values of `x` [1, C, H, W] at `positions` [1, 2, A, B], column and row; bilinear, zero outside. [1, C, A, B]"""
    sides = torch._shape_as_tensor(x)[[3, 2]].float().reshape(1, 2, 1, 1)
    grid = (2 * positions + 1) / sides - 1
    return F.grid_sample(x, grid.permute(0, 2, 3, 1), align_corners=False)


def bounded(offsets: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Offsets of at most a quarter of the longer side of `x`."""
    most = torch._shape_as_tensor(x)[2:].float().max() / 4
    return torch.minimum(torch.maximum(offsets, -most), most)


#: Row and column of the cells of a kernel of side 3, relative to its centre. `[2, 9]`
KERNEL = torch.stack(torch.meshgrid(torch.arange(3.0) - 1, torch.arange(3.0) - 1, indexing="ij")).reshape(2, 9)


class DeformableConv(nn.Module):
    """Dai et al., Deformable Convolutional Networks, ICCV 2017: a convolution of side 3 whose cells are moved by predicted offsets.

    The values at the nine positions of each pixel become the channels of a pointwise convolution.
    """

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        self.offset_conv = nn.Conv2d(inputs, 18, 3, padding=1)
        self.regular_conv = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        height, width = x.shape[2:]
        offsets = bounded(self.offset_conv(x), x).reshape(1, 9, 2, height, width)
        rows = offsets[:, :, 0] + KERNEL[0].reshape(9, 1, 1) + torch.arange(height).float()[:, None]
        columns = offsets[:, :, 1] + KERNEL[1].reshape(9, 1, 1) + torch.arange(width).float()
        values = sampled(x, torch.stack([columns, rows], 1).reshape(1, 2, -1, width))  # [1, C, 9 H, W]
        return F.conv2d(values.reshape(1, -1, height, width), self.regular_conv.weight.flatten(1)[:, :, None, None])


class AlikedBlock(nn.Module):
    """Two convolutions with SELU, with a skip connection if the block has one."""

    def __init__(self, inputs: int, outputs: int, residual: bool, deformable: bool):
        super().__init__()
        conv = DeformableConv if deformable else lambda a, b: nn.Conv2d(a, b, 3, padding=1, bias=False)
        self.conv1, self.bn1 = conv(inputs, outputs), nn.BatchNorm2d(outputs)
        self.conv2, self.bn2 = conv(outputs, outputs), nn.BatchNorm2d(outputs)
        if residual:
            self.downsample = nn.Conv2d(inputs, outputs, 1)
        self.residual, self.gate = residual, Selu()

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.bn2(self.conv2(self.gate(self.bn1(self.conv1(x)))))
        return self.gate(y + self.downsample(x)) if self.residual else self.gate(y)


class AlikedHead(nn.Module):
    """Its sparse deformable descriptor head: M samples around each keypoint, at offsets predicted from the 3 x 3 patch at its pixel.

    Samples are mapped and joined by convolutions over the keypoints. A subpixel keypoint is in the pixel of its integer part, as in
    the authors' program.
    """

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        self.samples, dim, _ = tensors["desc_head.agg_weights"].shape
        self.offset_conv = nn.Sequential(
            nn.Conv2d(dim, 2 * self.samples, 3), Selu(), nn.Conv2d(2 * self.samples, 2 * self.samples, 1)
        )
        self.sf_conv = nn.Conv2d(dim, dim, 1, bias=False)
        self.agg_weights = nn.Parameter(torch.zeros(self.samples, dim, dim))
        self.gate = Selu()

    def forward(self, features: torch.Tensor, keypoints: torch.Tensor) -> torch.Tensor:
        at = keypoints.transpose(1, 2)[:, :, None]  # [1, 2, 1, N], column and row
        cells = sampled(features, torch.floor(at) + KERNEL.flip(0)[None, :, :, None])  # [1, C, 9, N]
        first, gate, second = self.offset_conv
        patch = self.joined(cells, first.weight.flatten(1)) + first.bias[None, :, None, None]
        offsets = bounded(second(gate(patch)), features)  # [1, 2 M, 1, N], all columns before all rows
        values = sampled(features, at + offsets.reshape(1, 2, self.samples, -1))  # [1, C, M, N]
        values = self.gate(self.sf_conv(values))
        descriptors = self.joined(values, self.agg_weights.permute(2, 1, 0).flatten(1))
        return unit(descriptors)[:, :, 0].transpose(1, 2)

    @staticmethod
    def joined(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """One pointwise convolution of all A values of a column: `[1, C, A, N]` and `[D, C A]` to `[1, D, 1, N]`."""
        channels, cells = values.shape[1:3]
        return F.conv2d(values.reshape(1, channels * cells, 1, -1), weights[:, :, None, None])


class Aliked(nn.Module):
    """Zhao et al., ALIKED, IEEE Transactions on Instrumentation and Measurement 2023."""

    POOLS, SIZES = (1, 2, 4, 4), (1, 2, 8, 32)

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        before, quarter = 3, tensors["conv1.weight"].shape[0]
        for number in range(1, 5):
            own = tensors[f"block{number}.bn1.weight"].shape[0]
            self.add_module(f"block{number}", AlikedBlock(before, own, number > 1, number > 2))
            self.add_module(f"conv{number}", nn.Conv2d(own, quarter, 1, bias=False))
            before = own
        self.score_head = nn.Sequential(nn.Conv2d(4 * quarter, 8, 1, bias=False))
        for inputs, outputs in ((8, 4), (4, 4), (4, 1)):
            self.score_head.extend([Selu(), nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)])
        self.desc_head, self.gate = AlikedHead(tensors), Selu()
        fill(self, tensors)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x, levels = image, []
        for number, (pool, size) in enumerate(zip(self.POOLS, self.SIZES), 1):
            x = getattr(self, f"block{number}")(F.avg_pool2d(x, pool) if pool > 1 else x)
            levels.append(Alike.enlarged(self.gate(getattr(self, f"conv{number}")(x)), size))
        joined = torch.cat(levels, dim=1)
        return torch.sigmoid(self.score_head(joined)), unit(joined)


class SuperPoint(nn.Module):
    """DeTone et al., SuperPoint, CVPR workshops 2018."""

    WIDTHS = {"1": (1, 64), "2": (64, 64), "3": (64, 128), "4": (128, 128)}

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        for stage, (before, own) in self.WIDTHS.items():
            self.add_module(f"conv{stage}a", nn.Conv2d(before, own, 3, padding=1))
            self.add_module(f"conv{stage}b", nn.Conv2d(own, own, 3, padding=1))
        for head, outputs in (("P", 65), ("D", 256)):
            self.add_module(f"conv{head}a", nn.Conv2d(128, 256, 3, padding=1))
            self.add_module(f"conv{head}b", nn.Conv2d(256, outputs, 1))
        fill(self, tensors)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        x = image
        for stage in self.WIDTHS:
            x = F.max_pool2d(x, 2) if stage != "1" else x
            for half in "ab":
                x = F.relu(getattr(self, f"conv{stage}{half}")(x))
        return tuple(getattr(self, f"conv{h}b")(F.relu(getattr(self, f"conv{h}a")(x))) for h in "PD")


class NetVlad(nn.Module):
    """Arandjelović et al., NetVLAD, CVPR 2016: VGG16 to its last convolution, residuals to soft words, whitened.

    Of the authors' MATLAB file. Centers have the other sign there.
    """

    CONVOLUTIONS = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
    HALVED = (2, 7, 14, 21)
    WORDS, WHITENING = 30, 33

    def __init__(self, path: Path, features_alone: bool = False):
        import scipy.io

        super().__init__()
        net = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)["net"]
        layers = (*self.CONVOLUTIONS, self.WORDS, self.WHITENING)
        weights = {n: [np.asarray(w, np.float32) for w in net.layers[n].weights] for n in layers}
        mean = np.asarray(net.meta.normalization.averageImage, np.float32).reshape(-1, 3)[0]
        self.register_buffer("mean", torch.from_numpy(mean.copy()).reshape(1, 3, 1, 1))
        self.convolutions = nn.ModuleList()
        for number in self.CONVOLUTIONS:
            kernel, bias = weights[number][0].transpose(3, 2, 0, 1), weights[number][1].ravel()
            kernel, bias = (torch.from_numpy(np.ascontiguousarray(w)) for w in (kernel, bias))
            layer = nn.Conv2d(kernel.shape[1], kernel.shape[0], 3, padding=1)
            layer.load_state_dict({"weight": kernel, "bias": bias})
            self.convolutions.append(layer)
        self.features_alone = features_alone
        assignment, centers = (torch.from_numpy(np.ascontiguousarray(w)) for w in weights[self.WORDS])
        self.register_buffer("assignment", assignment.T.contiguous())  # [K, D]
        self.register_buffer("centers", -centers)  # [D, K]
        whitening, bias = weights[self.WHITENING]
        self.register_buffer("whitening", torch.from_numpy(np.ascontiguousarray(whitening.reshape(-1, whitening.shape[-1]))))
        self.register_buffer("bias", torch.from_numpy(bias.ravel().copy()))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        x = 255.0 * image - self.mean
        for number, convolution in zip(self.CONVOLUTIONS, self.convolutions):
            x = convolution(x)
            if number == self.CONVOLUTIONS[-1]:
                break
            x = F.relu(x)
            x = F.max_pool2d(x, 2) if number in self.HALVED else x
        if self.features_alone:
            return x
        x = self.of_length_one(x, 1).flatten(2)  # [1, D, N]
        shares = torch.softmax(self.assignment @ x, dim=1)  # [1, K, N]
        # Sum over n of s_kn (x_n - c_k): [1, D, K].
        residuals = x @ shares.transpose(1, 2) - self.centers * shares.sum(dim=2, keepdim=True).transpose(1, 2)
        # Number d of word k stands at d K + k, as the whitening has it.
        vector = self.of_length_one(self.of_length_one(residuals, 1).flatten(1), 1)
        return self.of_length_one(vector @ self.whitening + self.bias, 1)

    @staticmethod
    def of_length_one(x: torch.Tensor, axis: int) -> torch.Tensor:
        return x / x.square().sum(dim=axis, keepdim=True).sqrt().clamp(min=1e-12)


class Lpips(nn.Module):
    """Zhang et al., The Unreasonable Effectiveness of Deep Features as a Perceptual Metric, CVPR 2018: of AlexNet, version 0.1.

    Linear layers from the authors' file, the backbone from torchvision's `features`.
    """

    #: Number among torchvision's layers, channels in and out, side, padding, stride, whether a pool (3, stride 2) is before it.
    LAYERS = (
        (0, 3, 64, 11, 2, 4, False),
        (3, 64, 192, 5, 2, 1, True),
        (6, 192, 384, 3, 1, 1, True),
        (8, 384, 256, 3, 1, 1, False),
        (10, 256, 256, 3, 1, 1, False),
    )
    SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)

    def __init__(self, linear: dict[str, torch.Tensor], backbone: dict[str, torch.Tensor]):
        super().__init__()
        self.register_buffer("shift", torch.tensor(self.SHIFT).reshape(1, 3, 1, 1))
        self.register_buffer("scale", torch.tensor(self.SCALE).reshape(1, 3, 1, 1))
        self.convolutions = nn.ModuleList()
        for number, before, own, side, padding, stride, _ in self.LAYERS:
            layer = nn.Conv2d(before, own, side, padding=padding, stride=stride)
            layer.load_state_dict({end: backbone[f"features.{number}.{end}"] for end in ("weight", "bias")})
            self.convolutions.append(layer)
        for number in range(5):
            name = next(n for n in linear if n.startswith(f"lin{number}.") or n == f"lin{number}")
            self.register_buffer(f"weight{number}", linear[name].reshape(1, -1, 1, 1).float())
        self.eval()

    def layers(self, image: torch.Tensor) -> list[torch.Tensor]:
        x, found = (2.0 * image - 1.0 - self.shift) / self.scale, []
        for layer, own in zip(self.convolutions, self.LAYERS):
            x = F.relu(layer(F.max_pool2d(x, 3, stride=2) if own[-1] else x))
            found.append(x)
        return found

    def forward(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        total = 0.0
        for number, (x, y) in enumerate(zip(self.layers(a), self.layers(b))):
            difference = (unit(x) - unit(y)).square() * getattr(self, f"weight{number}")
            total = total + difference.sum(dim=1).mean(dim=(1, 2))
        return total


def same(x: torch.Tensor, side: int, stride: int) -> torch.Tensor:
    """Zero padding like TensorFlow's "same": an odd pixel goes to the end."""
    pads = []
    for length in (x.shape[-1], x.shape[-2]):
        whole = max((-(-int(length) // stride) - 1) * stride + side - int(length), 0)
        pads += [whole // 2, whole - whole // 2]
    return F.pad(x, pads)


class MobileBlock(nn.Module):
    """Inverted residual: expansion, depthwise convolution, projection; with a skip connection where the shapes agree."""

    def __init__(self, inputs: int, outputs: int, expand: int, side: int, stride: int):
        super().__init__()
        wide = inputs * expand
        if expand > 1:
            self._expand_conv = nn.Conv2d(inputs, wide, 1, bias=False)
            self._bn0 = nn.BatchNorm2d(wide, eps=1e-3)
        self._depthwise_conv = nn.Conv2d(wide, wide, side, stride=stride, groups=wide, bias=False)
        self._bn1 = nn.BatchNorm2d(wide, eps=1e-3)
        self._project_conv = nn.Conv2d(wide, outputs, 1, bias=False)
        self._bn2 = nn.BatchNorm2d(outputs, eps=1e-3)
        self.expand, self.side, self.stride = expand > 1, side, stride
        self.adds = inputs == outputs and stride == 1

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = F.relu6(self._bn0(self._expand_conv(x))) if self.expand else x
        y = F.relu6(self._bn1(self._depthwise_conv(same(y, self.side, self.stride))))
        y = self._bn2(self._project_conv(y))
        return x + y if self.adds else y


class EfficientNetLite0(nn.Module):
    """Tan and Le, EfficientNet, ICML 2019, without squeeze and excitation and with ReLU6."""

    #: Expansion, channels, times, side, stride of the first.
    BLOCKS = (
        (1, 16, 1, 3, 1),
        (6, 24, 2, 3, 2),
        (6, 40, 2, 5, 2),
        (6, 80, 3, 3, 2),
        (6, 112, 3, 5, 1),
        (6, 192, 4, 5, 2),
        (6, 320, 1, 3, 1),
    )

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        self._conv_stem = nn.Conv2d(3, 32, 3, stride=2, bias=False)
        self._bn0 = nn.BatchNorm2d(32, eps=1e-3)
        blocks, before = [], 32
        for expand, own, times, side, stride in self.BLOCKS:
            for time in range(times):
                blocks.append(MobileBlock(before, own, expand, side, stride if time == 0 else 1))
                before = own
        self._blocks = nn.ModuleList(blocks)
        self._conv_head = nn.Conv2d(before, 1280, 1, bias=False)
        self._bn1 = nn.BatchNorm2d(1280, eps=1e-3)
        self._fc = nn.Linear(1280, 1000)
        fill(self, tensors)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        x = F.relu6(self._bn0(self._conv_stem(same(image, 3, 2))))
        for block in self._blocks:
            x = block(x)
        return self._fc(F.relu6(self._bn1(self._conv_head(x))).mean(dim=(2, 3)))


def add_constant(path: Path, name: str, value: torch.Tensor) -> None:
    """An additional output that is the same for every image."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    model = onnx.load(path)
    model.graph.initializer.append(numpy_helper.from_array(np.ascontiguousarray(value.numpy()), f"{name}.weight"))
    model.graph.node.append(helper.make_node("Identity", [f"{name}.weight"], [name]))
    model.graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, list(value.shape)))
    onnx.checker.check_model(model)
    onnx.save(model, path)


def write(network: nn.Module, given: dict[str, torch.Tensor], results: list[str], path: Path, fixed: bool = False) -> None:
    """Writes the file, and compares it with PyTorch on an input of another size."""
    network = network.eval()
    axes = {} if fixed else {4: {2: "height", 3: "width"}, 3: {1: "keypoints"}}
    with torch.no_grad():
        outputs = of_all(network(*given.values()))
        named = [{name: axes.get(v.ndim, {}) for name, v in zip(*of)} for of in ((given, given.values()), (results, outputs))]
        onnx_graph(network, given.values(), path, *named)
        print(f"{path}: {path.stat().st_size} bytes, outputs {', '.join(results)}")
        try:
            import onnxruntime
        except ImportError:
            print("not compared: onnxruntime is not installed", file=sys.stderr)
            return
        session = onnxruntime.InferenceSession(str(path))
        larger = lambda value: torch.rand(*value.shape[:2], value.shape[2] + 32, value.shape[3]) if value.ndim == 4 else 1.5 * value
        other = given if fixed else {name: larger(value) for name, value in given.items()}
        answers = of_all(network(*other.values()))
        found = session.run(results, {name: value.numpy() for name, value in other.items()})
        for name, a, b in zip(results, answers, found):
            print(f"  {name} {list(b.shape)}: largest {a.abs().max():.4g}, largest difference {np.abs(a.numpy() - b).max():.2g}")


def of_all(answers) -> tuple[torch.Tensor, ...]:
    return answers if isinstance(answers, tuple) else (answers,)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="network", required=True)
    for name in ("alike", "aliked", "superpoint", "netvlad", "st-lpips", "lpips", "efficientnet-lite0"):
        command = commands.add_parser(name)
        command.add_argument("weights", type=Path)
        command.add_argument("out", type=Path)
        if name == "alike":
            command.add_argument("--dense", action="store_true", help="also output the descriptors of all pixels")
        if name == "netvlad":
            command.add_argument("--features", action="store_true", help="only the convolutions")
        if name == "lpips":
            command.add_argument("--backbone", type=Path, required=True, help="torchvision's file of AlexNet")
    args = parser.parse_args()
    torch.manual_seed(0)
    pair = {"a": torch.rand(1, 3, 96, 128), "b": torch.rand(1, 3, 96, 128)}
    image = {"image": torch.rand(1, 3, 96, 128)}
    if args.network == "alike":
        results = ["scores", *(f"level{i}" for i in range(1, 5))] + ["descriptors"] * args.dense
        network = Alike(tensors_of(args.weights), args.dense)
        write(network, image, results, args.out)
        add_constant(args.out, "head", network.head())
    elif args.network == "aliked":
        network = Aliked(tensors_of(args.weights))
        write(network, image, ["scores", "features"], args.out)
        features = unit(torch.randn(1, network.desc_head.sf_conv.in_channels, 96, 128))
        inputs = {"features": features, "keypoints": 20 + 40 * torch.rand(1, 7, 2)}
        write(network.desc_head, inputs, ["descriptors"], args.out.with_stem(f"{args.out.stem}-head"))
    elif args.network == "superpoint":
        write(SuperPoint(tensors_of(args.weights)), {"image": image["image"][:, :1]}, ["scores", "descriptors"], args.out)
    elif args.network == "netvlad":
        write(NetVlad(args.weights, args.features), image, ["features" if args.features else "vector"], args.out)
    elif args.network == "st-lpips":
        write(StLpips(tensors_of(args.weights)), pair, ["distance"], args.out)
    elif args.network == "lpips":
        write(Lpips(tensors_of(args.weights), tensors_of(args.backbone)), pair, ["distance"], args.out)
    else:
        square = {"image": torch.rand(1, 3, 224, 224) * 2 - 1}
        write(EfficientNetLite0(tensors_of(args.weights)), square, ["logits"], args.out, fixed=True)


if __name__ == "__main__":
    main()
