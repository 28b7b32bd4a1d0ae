"""The networks. Their inputs and outputs are those of the program's runner (README.md)."""

import math

import torch
from torch import nn
from torch.nn import functional as F

from .sets import SetEncoder, centered

INPUTS = ("set", "row", "line")


class Positions(nn.Module):
    """Position of each keypoint on its line.

    A line is encoded by the mean of products of cosines over its bins. The output is a sum of the same products, evaluated at each bin:

        logits[n, b] = sum over i, j of A_n[i, j] cos(pi i x_b) cos(pi j y_b),   A_n from all rows

    The caller adds the log prior `guess` to the logits. The last layer is initialized with zeros.
    """

    #: Mean products of cosines are small compared with entries of descriptors.
    LINE_SCALE = 3.0

    def __init__(
        self, dimension: int, input: str = "set", waves: int = 12, width: int = 96, heads: int = 4, layers: int = 2,
        dropout: float = 0.1,
    ):  # fmt: skip
        super().__init__()
        if input not in INPUTS:
            raise ValueError(f"input: must be one of {INPUTS}, not {input!r}")
        self.input, self.waves = input, waves
        inputs = dimension + waves * waves
        self.encoder = SetEncoder(inputs, waves * waves, width, heads, layers, input == "set", dropout, zero=True)
        self.register_buffer("frequencies", math.pi * torch.arange(waves, dtype=torch.float32), persistent=False)

    def forward(
        self, descriptors: torch.Tensor, places: torch.Tensor, guess: torch.Tensor, present: torch.Tensor | None = None
    ) -> torch.Tensor:
        """`[1, N, D]`, `[1, N, B, 2]`, `[1, N, B]` to `[1, N, B]`."""
        images, rows = descriptors.shape[0], descriptors.shape[1]
        across = torch.cos(places[..., 0:1] * self.frequencies)  # [1, N, B, waves]
        down = torch.cos(places[..., 1:2] * self.frequencies)
        share = torch.softmax(guess, dim=-1).unsqueeze(-1)
        line = across.transpose(2, 3) @ (down * share)  # [1, N, waves, waves]
        line = self.LINE_SCALE * line.reshape(images, rows, self.waves * self.waves)
        if self.input == "set":
            descriptors = centered(descriptors, present)
        elif self.input == "line":
            descriptors = descriptors * 0.0
        answers = self.encoder(torch.cat([descriptors, line], dim=-1), present)
        answers = answers.reshape(images, rows, self.waves, self.waves)
        return ((across @ answers) * down).sum(dim=-1)


class Neighbours(nn.Module):
    """Embeds descriptors as unit vectors; dot products are large for keypoints near each other in the image."""

    def __init__(
        self, dimension: int, outputs: int = 96, width: int = 96, heads: int = 4, layers: int = 2, dropout: float = 0.1
    ):
        super().__init__()
        self.encoder = SetEncoder(dimension, outputs, width, heads, layers, True, dropout)
        #: Scale of the dot products, used only in training.
        self.log_scale = nn.Parameter(torch.tensor(math.log(8.0)))

    def forward(self, descriptors: torch.Tensor, present: torch.Tensor | None = None) -> torch.Tensor:
        """`[1, N, D]` to `[1, N, E]`."""
        embedded = self.encoder(centered(descriptors, present), present)
        return embedded / (embedded.square().sum(dim=-1, keepdim=True) + 1e-12).sqrt()


class Convolutions(nn.Sequential):
    """Two convolutions of 3 x 3 pixels with batch normalization."""

    def __init__(self, inputs: int, outputs: int):
        def one(channels: int) -> list[nn.Module]:
            convolution = nn.Conv2d(channels, outputs, 3, padding=1, bias=False)
            return [convolution, nn.BatchNorm2d(outputs), nn.LeakyReLU(0.1, inplace=True)]

        super().__init__(*one(inputs), *one(outputs))


class UNet(nn.Module):
    """Ronneberger et al., U-Net, MICCAI 2015: `levels` resolutions, `width` channels at the largest, doubled at each next level.

    With width 64 and five levels it is the network of the paper: 64, 128, 256, 512 and 1024 channels. The sides of the input must be
    multiples of `2 ** (levels - 1)`.
    """

    def __init__(self, inputs: int, outputs: int, width: int = 64, levels: int = 5):
        super().__init__()
        widths = [width << level for level in range(levels)]
        self.down = nn.ModuleList(Convolutions(a, b) for a, b in zip([inputs, *widths], widths))
        pairs = list(zip(widths[1:], widths[:-1]))[::-1]
        self.narrow = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in pairs)
        self.up = nn.ModuleList(Convolutions(2 * b, b) for _, b in pairs)
        self.last = nn.Conv2d(width, outputs, 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        skips = []
        for level, convolutions in enumerate(self.down):
            x = convolutions(F.max_pool2d(x, 2) if level else x)
            skips.append(x)
        skips.pop()
        for narrow, convolutions in zip(self.narrow, self.up):
            x = narrow(F.interpolate(x, scale_factor=2.0, mode="nearest"))
            x = convolutions(torch.cat([skips.pop(), x], dim=1))
        return self.last(x)


FORMS = ("unet", "invsfm")


class Inversion(nn.Module):
    """Image from descriptors and their positions. `[1, D + 1, H, W]` to `[1, 3, H, W]`, sRGB 0 to 1."""

    def __init__(self, dimension: int, width: int = 64, levels: int = 5):
        super().__init__()
        self.network = UNet(dimension + 1, 3, width, levels)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(self.network(features))


class InvSfm(nn.Module):
    """Three stages after Pittaluga et al., Revealing Scenes by Inverting Structure from Motion Reconstructions, CVPR 2019.

    The first stage predicts which cells hold descriptors at their true position, the second reconstructs an image from these, the
    third refines it. In the paper the first stage finds occluded points; here it finds misplaced descriptors.
    """

    def __init__(self, dimension: int, width: int = 64, levels: int = 5):
        super().__init__()
        self.visibility = UNet(dimension + 1, 1, max(width // 2, 2), levels)
        self.coarse = UNet(dimension + 1, 3, width, levels)
        self.refine = UNet(dimension + 4, 3, width, levels)

    def stages(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Logits of visibility, coarse and refined image."""
        logits = self.visibility(features)
        held = features * torch.sigmoid(logits)
        coarse = self.coarse(held)
        refined = coarse + self.refine(torch.cat([held, torch.sigmoid(coarse)], dim=1))
        return logits, torch.sigmoid(coarse), torch.sigmoid(refined)

    def forward(self, features: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        logits, _, refined = self.stages(features)
        return refined, torch.sigmoid(logits)


def inversion(form: str, dimension: int, width: int, levels: int) -> nn.Module:
    """The network of this form."""
    return {"unet": Inversion, "invsfm": InvSfm}[form](dimension, width, levels)


def parameters(network: nn.Module) -> int:
    """Number of trainable parameters."""
    return sum(p.numel() for p in network.parameters())
