"""ST-LPIPS, a shift-tolerant perceptual distance, and its layers for a perceptual loss.

Ghildyal and Liu, Shift-tolerant Perceptual Similarity Metric, ECCV 2022, with AlexNet. It differs from LPIPS: pooling is
anti-aliased, and the first convolution has no stride. Tensors have the names of the authors' file.
"""

from pathlib import Path

import torch
from torch import nn
from torch.nn import functional as F

#: Name of each convolution in the file, and its padding.
CONVOLUTIONS = [("slice1.0", 2), ("slice2.5", 2), ("slice3.9", 1), ("slice4.11", 1), ("slice5.13", 1)]
#: Blur kernels: after the first convolution, before the second and the third.
BLURS = ["slice1.1", "slice2.4", "slice3.8"]
MARGIN = 2


class StLpips(nn.Module):
    """Images are sRGB, 0 to 1, `[B, 3, H, W]`."""

    def __init__(self, tensors: dict[str, torch.Tensor]):
        super().__init__()
        for name in ("shift", "scale"):
            self.register_buffer(name, tensors[f"scaling_layer.{name}"].clone())
        self.convolutions, self.blurs = nn.ModuleList(), nn.ModuleList()
        for name, padding in CONVOLUTIONS:
            kernel, bias = tensors[f"net.{name}.weight"], tensors[f"net.{name}.bias"]
            layer = nn.Conv2d(kernel.shape[1], kernel.shape[0], kernel.shape[2], padding=padding)
            layer.load_state_dict({"weight": kernel, "bias": bias})
            self.convolutions.append(layer)
        for name in BLURS:
            kernel = tensors[f"net.{name}.filt"]
            layer = nn.Conv2d(len(kernel), len(kernel), 3, stride=2, groups=len(kernel), bias=False)
            layer.load_state_dict({"weight": kernel})
            self.blurs.append(layer)
        for number in range(len(CONVOLUTIONS)):
            self.register_buffer(f"weight{number}", tensors[f"lin{number}.model.1.weight"].clone())
        self.requires_grad_(False)

    @staticmethod
    def of_file(path: Path) -> "StLpips":
        return StLpips(torch.load(path, map_location="cpu", weights_only=True)).eval()

    def blurred(self, x: torch.Tensor, number: int) -> torch.Tensor:
        return self.blurs[number](F.pad(x, [MARGIN] * 4, mode="reflect"))

    def layers(self, image: torch.Tensor, count: int = 5) -> list[torch.Tensor]:
        """The first layers, after ReLU."""
        x = (2.0 * image - 1.0 - self.shift) / self.scale
        found = []
        for number, convolution in enumerate(self.convolutions[:count]):
            if number in (1, 2):
                x = self.blurred(F.max_pool2d(x, 3, stride=1), number)
            x = convolution(x)
            if number == 0:
                x = self.blurred(x, 0)
            x = F.relu(x)
            found.append(x)
        return found

    def forward(self, a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        """The distance of each pair. `[B]`"""
        total = 0.0
        for number, (x, y) in enumerate(zip(self.layers(a), self.layers(b))):
            difference = (unit(x) - unit(y)).square()
            total = total + (difference * getattr(self, f"weight{number}")).sum(dim=1).mean(dim=(1, 2))
        return total


def unit(x: torch.Tensor) -> torch.Tensor:
    """Normalizes over the channels."""
    return x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
