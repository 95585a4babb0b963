"""Training of the networks by AdamW with one cycle of the rate, averaged weights, and frequent checkpoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from .crops import ActionBatch, Batch
from .detection import SceneBatch
from .networks import ActionNetwork, DetectorNetwork, FaceNetwork, MapLoss, PartNetwork, PupilNetwork
from .pupils import PupilBatch

RATE = 3e-3
_AVERAGE = 0.005
"""Share of the newest weights in the average that is finally kept."""
_RARE = 2.0
"""Weight of an action that is shown, relative to one that is not."""
_REPORT, _CHECKPOINT = 100, 250
_HALF_PRECISION = any(torch.cpu.get_capabilities().get(unit, False) for unit in ("avx512_bf16", "amx_bf16"))
"""Whether the processor computes with 16 bits. Where it does not, this takes twelve times as long as with 32."""


@dataclass(frozen=True)
class Course:
    """How a network is trained: the steps, the checkpoint to resume from, its name in reports, and the highest rate."""

    steps: int
    checkpoint: Path
    name: str
    rate: float = RATE


def train_maps(
    network: FaceNetwork | PartNetwork, draw: Callable[[], Batch], variance: float, course: Course
) -> nn.Module:
    """Train a network of maps, whose Gaussians have that variance in cells. About a sixth of the face network's loss is
    whether there is a face.
    """
    return _train(network, lambda: _map_loss(network, draw(), variance), course, "cells")


def train_actions(network: ActionNetwork, draw: Callable[[], ActionBatch], course: Course) -> nn.Module:
    """Train the network of the expert of actions."""
    return _train(network, lambda: _action_loss(network, draw()), course, "off")


def train_pupils(network: PupilNetwork, draw: Callable[[], PupilBatch], course: Course) -> nn.Module:
    """Train the network of the experts of the pupils."""
    return _train(network, lambda: _pupil_loss(network, draw()), course, "heights")


def train_detector(network: DetectorNetwork, draw: Callable[[], SceneBatch], course: Course) -> nn.Module:
    """Train the network of the face detector."""
    return _train(network, lambda: _detector_loss(network, draw()), course, "off")


def _train(
    network: nn.Module, loss_of_batch: Callable[[], tuple[Tensor, float]], course: Course, unit: str
) -> nn.Module:
    """Train the network through all steps, each with the loss of another batch, which also gives a figure to report."""
    steps, checkpoint, name = course.steps, course.checkpoint, course.name
    torch.set_num_threads(1)  # one process a core; more threads would wait for each other
    network.to(memory_format=torch.channels_last)
    decayed = [p for p in network.parameters() if p.ndim > 1]
    free = [p for p in network.parameters() if p.ndim <= 1]
    optimiser = torch.optim.AdamW([{"params": decayed, "weight_decay": 1e-2}, {"params": free, "weight_decay": 0.0}])
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, course.rate, total_steps=steps, pct_start=0.08)
    average = {k: v.clone() for k, v in network.state_dict().items()}
    done = 0
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.load_state_dict(state["schedule"])
        average, done = state["average"], state["done"]
    began, away = perf_counter(), 0.0
    while done < steps:
        loss, error = loss_of_batch()
        away += error
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        schedule.step()
        share = max(_AVERAGE, 2.0 / (done + 2.0))  # what there was before the first steps soon counts nothing
        with torch.no_grad():
            for key, value in network.state_dict().items():
                average[key].lerp_(value, share) if value.dtype.is_floating_point else average[key].copy_(value)
        done += 1
        if done % _REPORT == 0:
            print(f"{name}: {done} of {steps}, {away / _REPORT:.3f} {unit}, {perf_counter() - began:.0f} s", flush=True)
            away = 0.0
        if done % _CHECKPOINT == 0 or done == steps:
            state = {"network": network.state_dict(), "optimiser": optimiser.state_dict(), "average": average}
            unfinished = checkpoint.with_suffix(".part")
            torch.save({**state, "schedule": schedule.state_dict(), "done": done}, unfinished)
            unfinished.replace(checkpoint)
    network.load_state_dict(average)
    return network


def _map_loss(network: FaceNetwork | PartNetwork, batch: Batch, variance: float) -> tuple[Tensor, float]:
    """Loss, and mean distance in cells."""
    pictures = torch.from_numpy(batch.pictures).to(memory_format=torch.channels_last)
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=_HALF_PRECISION):
        out = network(pictures)
    maps, face = out if isinstance(out, tuple) else (out, None)
    loss, away = MapLoss.apply(maps, torch.from_numpy(batch.cells), torch.from_numpy(batch.weights), variance)
    if face is not None:
        loss = loss + 0.5 * _face_loss(face, torch.from_numpy(batch.face))
    return loss, float(away.detach())


def _action_loss(network: ActionNetwork, batch: ActionBatch) -> tuple[Tensor, float]:
    """Loss, and mean absolute error of the activations."""
    pictures = torch.from_numpy(batch.pictures).to(memory_format=torch.channels_last)
    out = network(pictures)
    wanted = torch.from_numpy(batch.actions).clamp(0.0, 1.0)
    # Cross-entropy, because a loss that asks for the median would ignore what is rare and hard to see.
    loss = F.binary_cross_entropy_with_logits(out, wanted, pos_weight=torch.tensor(_RARE))
    return 2.0 * loss, float((torch.sigmoid(out.detach()) - wanted).abs().mean())


def _pupil_loss(network: PupilNetwork, batch: PupilBatch) -> tuple[Tensor, float]:
    """Loss, and mean distance in heights of the band."""
    out = network(torch.from_numpy(batch.pictures).to(memory_format=torch.channels_last))
    away = (out.view(-1, 2, 2) - torch.from_numpy(batch.pupils)).square().sum(-1)
    known = torch.from_numpy(batch.known)
    distance = (torch.sqrt(away + 1e-6) * known).sum() / known.sum().clamp_min(1.0)
    return 10.0 * distance, float(distance.detach())


def _detector_loss(network: DetectorNetwork, batch: SceneBatch) -> tuple[Tensor, float]:
    """Loss, and mean absolute error of the values found for faces."""
    out = network(torch.from_numpy(batch.pictures).to(memory_format=torch.channels_last)).float()
    face, weights = torch.from_numpy(batch.face), torch.from_numpy(batch.weights)
    odds = out[:, :1]
    every = F.binary_cross_entropy_with_logits(odds, face, reduction="none")
    missed = (torch.sigmoid(odds) - face).abs()  # focal loss: clear cases count little (Lin et al. 2017)
    shown = face.sum().clamp_min(1.0)
    about_faces = (every * missed**2 * weights).sum() / shown
    away = (out[:, 1:] - torch.from_numpy(batch.found)) * face
    return about_faces + F.smooth_l1_loss(away, torch.zeros_like(away), beta=0.1, reduction="sum") / shown, float(
        away.detach().abs().sum() / shown / away.shape[1]
    )


def _face_loss(log_odds: Tensor, face: Tensor) -> Tensor:
    every = F.binary_cross_entropy_with_logits(log_odds.float().mean((1, 2, 3)), face[:, 0], reduction="none")
    return (every * face[:, 1]).mean()
