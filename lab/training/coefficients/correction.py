"""Learning of the network that corrects the fit of coefficients (method.md, section 9.3)."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from facemime.core.bake.coefficients import HIDDEN, N_OBSERVED, CoefficientModel, CoefficientSolver, Layer
from facemime.core.face.names import COEFFICIENT_MIRROR, FITTED

from .learn import mirrored
from .simulate import Observed

_STYLES, _RESTYLED = 2, (-0.2, 1.2)
"""Number of times that each performance is used, in other styles, and how far these lie from ICT-FaceKit, at 0, to the
built-in head, at 1."""
_EPOCHS, _BATCH, _RATE, _DECAY = 8, 128, 2e-3, 1e-3
_NOISE, _DROPOUT = 0.3, 0.2
"""Noise of the inputs, in their deviations, and share of hidden units that are left out."""
_ABSOLUTE, _ACTED, _BELOW = 0.3, 2.0, 0.1
"""Weights of absolute errors beside squared ones, of coefficients that are acted, and of errors that are clipped."""
_SHOWN = 0.05


def learn_correction(
    model: CoefficientModel, rendered: list[Observed], restyling: np.ndarray, rng: np.random.Generator
) -> tuple[Layer, ...]:
    """Learn what the fit lacks from rendered performances, one per person.

    All performers have ICT-FaceKit's expressions. So that the network learns what an expression is rather than how one
    artist shaped it, their observations are moved towards those of another artist's, by `restyling`, (44, 198).
    """
    solver = CoefficientSolver(model)
    inputs, wanted = [], []
    for take in rendered:
        for _ in range(_STYLES):
            restyled = _restyled(take, restyling, rng)
            for side in (restyled, mirrored(restyled)):
                inputs += [solver.fitted_take(side.values), solver.fitted_frames(side.values)]
                wanted += [side.keys[:, FITTED]] * 2
    return _trained(np.concatenate(inputs), np.concatenate(wanted))


def _restyled(take: Observed, restyling: np.ndarray, rng: np.random.Generator) -> Observed:
    """Observations as though each coefficient, or all of them alike, were shaped by another artist to some extent."""
    shares = rng.uniform(*_RESTYLED, len(FITTED) if rng.random() < 0.5 else 1) * np.ones(len(FITTED))
    across = np.searchsorted(FITTED, COEFFICIENT_MIRROR[FITTED])
    shares = shares[np.minimum(np.arange(len(FITTED)), across)]
    values = take.values.copy()
    values[:, : restyling.shape[1]] += (take.keys[:, FITTED] * shares) @ restyling
    return Observed(values, take.keys)


def _trained(inputs: np.ndarray, wanted: np.ndarray) -> tuple[Layer, ...]:
    """Layers of a network that adds to the coefficients at the end of the inputs (N, 257) what `wanted` (N, 44) has."""
    torch.manual_seed(0)
    torch.set_num_threads(1)
    middle, deviation = inputs.mean(axis=0), inputs.std(axis=0) + 1e-6
    x = torch.tensor((inputs - middle) / deviation, dtype=torch.float32)
    lacking = torch.tensor(wanted - inputs[:, N_OBSERVED:], dtype=torch.float32)
    shown = torch.tensor(wanted > _SHOWN)
    absent = torch.tensor(wanted <= 0.0)
    network = _network(x.shape[1], lacking.shape[1])
    optimiser = torch.optim.AdamW(network.parameters(), _RATE, weight_decay=_DECAY)
    steps = _EPOCHS * -(-len(x) // _BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, _RATE, total_steps=steps)
    for _ in range(_EPOCHS):
        for batch in torch.randperm(len(x)).split(_BATCH):
            seen = x[batch] + _NOISE * torch.randn(len(batch), x.shape[1])
            error = network(seen) - lacking[batch]
            error = torch.where(absent[batch] & (error < 0.0), _BELOW * error, error)
            weight = torch.where(shown[batch], _ACTED, 1.0)
            loss = (weight * (error.square() + _ABSOLUTE * error.abs())).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            schedule.step()
    layers = [
        Layer(each.weight.detach().double().numpy().T, each.bias.detach().double().numpy())
        for each in network
        if isinstance(each, nn.Linear)
    ]
    scaled = layers[0].weights / deviation[:, None]
    return (Layer(scaled, layers[0].offsets - middle @ scaled), *layers[1:])


def _network(inputs: int, outputs: int) -> nn.Sequential:
    """A network whose output is 0 before it is trained."""
    parts: list[nn.Module] = []
    for width in HIDDEN:
        parts += [nn.Linear(inputs, width), nn.ReLU(), nn.Dropout(_DROPOUT)]
        inputs = width
    last = nn.Linear(inputs, outputs)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*parts, last)
