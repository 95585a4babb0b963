"""The networks of the convolutional experts in PyTorch, and their export to ONNX.

Separable convolutions with skip connections (Sandler et al. 2018) down to a coarse grid and up again (Ronneberger,
Fischer & Brox 2015), so that a landmark's map uses the whole image.
"""

from __future__ import annotations

import io

import onnx
import torch
from onnx import numpy_helper
from torch import Tensor, nn
from torch.nn import functional as F

FACE_CHANNELS, PART_CHANNELS = (16, 32, 64, 96), (32, 32, 48, 72)
DETECTOR_CHANNELS = (12, 24, 48, 64)
PUPIL_CHANNELS = (12, 20, 32)
ACTION_CHANNELS = (16, 32, 48, 72, 16)


def _convolution(inputs: int, outputs: int, kernel: int, stride: int) -> nn.Sequential:
    layer = nn.Conv2d(inputs, outputs, kernel, stride, kernel // 2, bias=False)
    return nn.Sequential(layer, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


class _Separable(nn.Module):
    """A 3 x 3 convolution of each channel, then one that mixes them."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        each = nn.Conv2d(inputs, inputs, 3, stride, 1, groups=inputs, bias=False)
        self.each = nn.Sequential(each, nn.BatchNorm2d(inputs))
        self.mixed = nn.Sequential(nn.Conv2d(inputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs))
        self.skipped = inputs == outputs and stride == 1

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) to (B, outputs, H / stride, W / stride)."""
        y = self.mixed(self.each(x))
        return F.relu(y + x if self.skipped else y)


class _Up(nn.Module):
    """Joins a coarse grid to one of twice its resolution."""

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(coarse, fine, 1)
        self.blend = _Separable(fine, fine)

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """(B, coarse, H, W) and (B, fine, 2 H, 2 W) to the latter's shape."""
        return self.blend(F.relu(fine + F.interpolate(self.narrow(coarse), scale_factor=2, mode="nearest")))


class FaceNetwork(nn.Module):
    """(B, 1, S, S) to the scores of 66 maps (B, 66, S / 4, S / 4) and the log odds of a face (B, 1, S / 16, S / 16)."""

    outputs = ("maps", "face")

    def __init__(self) -> None:
        super().__init__()
        a, b, c, d = FACE_CHANNELS
        self.at_quarter = nn.Sequential(_convolution(1, a, 5, 2), _convolution(a, b, 3, 2), _Separable(b, c))
        self.at_eighth = nn.Sequential(_Separable(c, d, 2), _Separable(d, d), _Separable(d, d))
        self.at_sixteenth = nn.Sequential(_Separable(d, d, 2), _Separable(d, d))
        self.to_eighth, self.to_quarter = _Up(d, d), _Up(d, c)
        self.maps, self.face = nn.Conv2d(c, 66, 1), nn.Conv2d(d, 1, 1)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Scores before the softmax, and log odds whose mean counts."""
        quarter = self.at_quarter(x)
        eighth = self.at_eighth(quarter)
        sixteenth = self.at_sixteenth(eighth)
        up = self.to_quarter(self.to_eighth(sixteenth, eighth), quarter)
        return self.maps(up), self.face(sixteenth)


class PartNetwork(nn.Module):
    """(B, 1, H, W) to the scores of a part's maps (B, n, H / 2, W / 2)."""

    outputs = ("maps",)

    def __init__(self, landmarks: int) -> None:
        super().__init__()
        a, b, c, d = PART_CHANNELS
        self.at_half = nn.Sequential(_convolution(1, a, 5, 2), _Separable(a, b))
        self.at_quarter = nn.Sequential(_Separable(b, c, 2), _Separable(c, c))
        self.at_eighth = nn.Sequential(_Separable(c, d, 2), _Separable(d, d))
        self.to_quarter, self.to_half = _Up(d, c), _Up(c, b)
        self.maps = nn.Conv2d(b, landmarks, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Scores before the softmax."""
        half = self.at_half(x)
        quarter = self.at_quarter(half)
        return self.maps(self.to_half(self.to_quarter(self.at_eighth(quarter), quarter), half))


class ActionNetwork(nn.Module):
    """(B, 1, H, W) to activations (B, n)."""

    outputs = ("actions",)

    def __init__(self, actions: int, width: int, height: int) -> None:
        super().__init__()
        a, b, c, d, e = ACTION_CHANNELS
        self.seen = nn.Sequential(
            *(_convolution(1, a, 5, 2), _Separable(a, b), _Separable(b, c, 2), _Separable(c, c)),
            *(_Separable(c, d, 2), _Separable(d, d), _Separable(d, d), nn.Conv2d(d, e, 1), nn.ReLU(inplace=True)),
        )
        # Each place has its own weights, as what lies above the lip cannot be a tongue.
        self.told = nn.Sequential(
            *(nn.Flatten(), nn.Dropout(0.1), nn.Linear(e * (width // 8) * (height // 8), 96)),
            *(nn.ReLU(inplace=True), nn.Linear(96, actions)),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Activations from 0 to 1, and in training their log odds."""
        told: Tensor = self.told(self.seen(x))
        return told if self.training else torch.sigmoid(told)


class PupilNetwork(nn.Module):
    """(B, 1, H, W) to the places of both pupils (B, 4), `(x, y, x, y)` from the middle of the band, in its heights.

    Few layers, as each takes as long as its multiplications on so small an image.
    """

    outputs = ("pupils",)

    def __init__(self, width: int, height: int) -> None:
        super().__init__()
        a, b, c = PUPIL_CHANNELS
        self.seen = nn.Sequential(
            *(_convolution(1, a, 5, 2), _convolution(a, b, 3, 2), _convolution(b, c, 3, 1), _convolution(c, c, 3, 2)),
        )
        self.told = nn.Sequential(
            *(nn.Flatten(), nn.Linear(c * (width // 8) * (height // 8), 64)),
            *(nn.ReLU(inplace=True), nn.Linear(64, 4)),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Places."""
        told: Tensor = self.told(self.seen(x))
        return told


class DetectorNetwork(nn.Module):
    """From (B, 1, H, W) to the log odds that a cell shows a face, and to its pose (B, 8, H / 8, W / 8)."""

    outputs = ("faces",)

    def __init__(self, found: int) -> None:
        super().__init__()
        a, b, c, d = DETECTOR_CHANNELS
        self.at_eighth = nn.Sequential(
            *(_convolution(1, a, 3, 2), _Separable(a, b, 2), _Separable(b, b), _Separable(b, c, 2)),
            *(_Separable(c, c), _Separable(c, c), _Separable(c, c)),
        )
        self.at_sixteenth = nn.Sequential(_Separable(c, d, 2), _Separable(d, d), _Separable(d, d))
        self.to_eighth = _Up(d, c)
        self.faces = nn.Conv2d(c, 1 + found, 1)
        nn.init.constant_(self.faces.bias[:1], -3.0)

    def forward(self, x: Tensor) -> Tensor:
        """Log odds, then the values found for each face."""
        eighth = self.at_eighth(x)
        out: Tensor = self.faces(self.to_eighth(self.at_sixteenth(eighth), eighth))
        return out


class MapLoss(torch.autograd.Function):
    """Distance of maps from their landmarks: cross-entropy to a Gaussian around each, plus `PULL` times the distance of
    the map's mean (integral regression: Sun et al. 2018), in one pass over the maps forwards and one backwards.

    Inputs: scores (B, n, H, W), cells (B, n, 2) of the landmarks `(x, y)`, weights (B, n), the Gaussian's variance in
    cells. Outputs: the loss, and the weighted mean distance in cells, which has no gradient.
    """

    PULL = 2.0

    @staticmethod
    def forward(
        ctx: torch.autograd.function.FunctionCtx, scores: Tensor, cells: Tensor, weights: Tensor, variance: float
    ) -> tuple[Tensor, Tensor]:
        """Loss and mean distance."""
        across, down = (torch.arange(scores.shape[k], dtype=torch.float32) for k in (3, 2))
        wanted_x = torch.exp((across - cells[..., 0, None]) ** 2 / (-2.0 * variance))
        wanted_y = torch.exp((down - cells[..., 1, None]) ** 2 / (-2.0 * variance))
        wanted_x = wanted_x / wanted_x.sum(-1, keepdim=True).clamp_min(1e-6)
        wanted_y = wanted_y / wanted_y.sum(-1, keepdim=True).clamp_min(1e-6)
        full = scores.float()
        at_target = torch.matmul(torch.matmul(wanted_y[..., None, :], full), wanted_x[..., None])[..., 0, 0]
        highest = full.amax((2, 3), keepdim=True)
        likely = (full - highest).exp_()
        total = likely.sum((2, 3), keepdim=True)
        likely.div_(total)
        cross_entropy = (highest + total.log())[..., 0, 0] - at_target
        mean_x, mean_y = (likely.sum(2) * across).sum(-1), (likely.sum(3) * down).sum(-1)
        dx, dy = mean_x - cells[..., 0], mean_y - cells[..., 1]
        away = torch.sqrt(dx * dx + dy * dy + 0.01)
        share = weights / weights.sum().clamp_min(1e-6)
        pull_x, pull_y = MapLoss.PULL * dx / away, MapLoss.PULL * dy / away
        ctx.save_for_backward(likely, wanted_x, wanted_y, share, pull_x, pull_y, mean_x, mean_y)
        ctx.kind = scores.dtype
        return ((cross_entropy + MapLoss.PULL * away) * share).sum(), (away * share).sum()

    @staticmethod
    def backward(ctx: torch.autograd.function.FunctionCtx, grad: Tensor, _: Tensor) -> tuple[Tensor | None, ...]:
        """Gradient of the loss with respect to the scores."""
        likely, wanted_x, wanted_y, share, pull_x, pull_y, mean_x, mean_y = ctx.saved_tensors
        across, down = (torch.arange(likely.shape[k], dtype=torch.float32) for k in (3, 2))
        by_x = (across - mean_x[..., None]) * pull_x[..., None]
        by_y = (down - mean_y[..., None]) * pull_y[..., None]
        out = likely * (1.0 + by_x[..., None, :] + by_y[..., None])
        out.addcmul_(wanted_y[..., None], wanted_x[..., None, :], value=-1)
        out.mul_((share * grad)[..., None, None])
        return out.to(ctx.kind), None, None, None


def to_onnx(
    network: FaceNetwork | PartNetwork | ActionNetwork | PupilNetwork | DetectorNetwork, width: int, height: int
) -> bytes:
    """Return the network for images of that size in the form that OpenCV reads."""
    buffer = io.BytesIO()
    torch.onnx.export(
        network.eval(),
        (torch.zeros(1, 1, height, width),),
        buffer,
        dynamo=False,
        opset_version=13,
        output_names=list(network.outputs),
    )
    return buffer.getvalue()


def load_onnx(network: FaceNetwork | PartNetwork, exported: bytes, width: int, height: int) -> None:
    """Give a network the weights of its own kind that `to_onnx` exported.

    The export multiplies each normalisation into the convolution before it, so that here it leaves what it is given as
    it is, until it is trained.
    """
    graph = onnx.load_from_string(exported).graph
    weights = {saved.name: torch.from_numpy(numpy_helper.to_array(saved).copy()) for saved in graph.initializer}
    layers: list[nn.Module] = []
    hooks = [
        layer.register_forward_hook(lambda layer, *_: layers.append(layer))
        for layer in network.modules()
        if isinstance(layer, nn.Conv2d | nn.BatchNorm2d)
    ]
    network.eval()(torch.zeros(1, 1, height, width))  # tells the order of the layers, which is that of the graph
    for hook in hooks:
        hook.remove()
    convolutions = iter([node for node in graph.node if node.op_type == "Conv"])
    for layer, following in zip(layers, [*layers[1:], None], strict=True):
        if not isinstance(layer, nn.Conv2d):
            continue
        kernel, bias = (weights[name] for name in next(convolutions).input[1:3])
        layer.weight.data = kernel
        if isinstance(following, nn.BatchNorm2d):
            following.weight.data.fill_(1.0)
            following.bias.data = bias
            following.running_mean.zero_()
            following.running_var.fill_(1.0 - following.eps)
        else:
            layer.bias.data = bias
