"""A transformer over a set of keypoints, without positional encoding (Lee et al., Set Transformer, ICML 2019).

Attention is implemented explicitly, so that the exported graph has only MatMul and Softmax, for any number of keypoints.
"""

import torch
from torch import nn


class Attention(nn.Module):
    """Multi-head self-attention. `[1, N, width]` to the same shape."""

    def __init__(self, width: int, heads: int):
        super().__init__()
        if width % heads:
            raise ValueError(f"{heads} heads do not divide a width of {width}")
        self.heads = heads
        self.query, self.key, self.value, self.out = (nn.Linear(width, width) for _ in range(4))

    def forward(self, x: torch.Tensor, present: torch.Tensor | None = None) -> torch.Tensor:
        """`present` `[images, N]`, for batches of sets of unequal size: False for padding."""
        images, _, width = x.shape

        def split(y: torch.Tensor) -> torch.Tensor:
            return y.reshape(images, -1, self.heads, width // self.heads).transpose(1, 2)

        query, key, value = split(self.query(x)), split(self.key(x)), split(self.value(x))
        scores = query @ key.transpose(2, 3) * (width // self.heads) ** -0.5
        if present is not None:
            scores = scores.masked_fill(~present[:, None, None, :], -1e9)
        mixed = torch.softmax(scores, dim=-1) @ value
        return self.out(mixed.transpose(1, 2).reshape(images, -1, width))


class Block(nn.Module):
    """Attention and a perceptron, each with pre-normalization and a residual connection."""

    def __init__(self, width: int, heads: int, attends: bool, dropout: float):
        super().__init__()
        if attends:
            self.attention_norm = nn.LayerNorm(width)
            self.attention = Attention(width, heads)
        self.attends = attends
        self.norm = nn.LayerNorm(width)
        self.perceptron = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: torch.Tensor, present: torch.Tensor | None = None) -> torch.Tensor:
        if self.attends:
            x = x + self.dropout(self.attention(self.attention_norm(x), present))
        return x + self.dropout(self.perceptron(self.norm(x)))


class SetEncoder(nn.Module):
    """`[1, N, inputs]` to `[1, N, outputs]`; without attention it processes each row separately."""

    def __init__(
        self,
        inputs: int,
        outputs: int,
        width: int = 96,
        heads: int = 4,
        layers: int = 2,
        attends: bool = True,
        dropout: float = 0.1,
        zero: bool = False,
    ):
        super().__init__()
        self.first = nn.Linear(inputs, width)
        self.blocks = nn.ModuleList(Block(width, heads, attends, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.last = nn.Linear(width, outputs)
        if zero:
            nn.init.zeros_(self.last.weight)
            nn.init.zeros_(self.last.bias)

    def forward(self, x: torch.Tensor, present: torch.Tensor | None = None) -> torch.Tensor:
        x = self.first(x)
        for block in self.blocks:
            x = block(x, present)
        return self.last(self.norm(x))


def centered(descriptors: torch.Tensor, present: torch.Tensor | None = None) -> torch.Tensor:
    """Rows minus the mean of their set, to emphasize the differences of keypoints in one image."""
    if present is None:
        return descriptors - descriptors.mean(dim=1, keepdim=True)
    weight = present.to(descriptors.dtype).unsqueeze(-1)
    mean = (descriptors * weight).sum(dim=1, keepdim=True) / weight.sum(dim=1, keepdim=True).clamp(min=1)
    return (descriptors - mean) * weight
