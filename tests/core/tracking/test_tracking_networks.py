"""Training of the networks; skipped without PyTorch, which only `make model` needs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed; `make model` does it")
pytest.importorskip("onnx", reason="ONNX is not installed; `make model` does it")

from facemime.core.tracking.network import OUTPUTS, Network, NetworkDetector  # noqa: E402
from lab.training.tracker.crops import ActionBatch, Batch  # noqa: E402
from lab.training.tracker.detection import Heads, Scenes  # noqa: E402
from lab.training.tracker.learn import Course, train_actions, train_detector, train_maps, train_pupils  # noqa: E402
from lab.training.tracker.networks import (  # noqa: E402
    ActionNetwork,
    DetectorNetwork,
    FaceNetwork,
    MapLoss,
    PartNetwork,
    PupilNetwork,
    load_onnx,
    to_onnx,
)
from lab.training.tracker.pupils import PupilBatch  # noqa: E402


def test_the_loss_has_the_gradient_of_its_definition() -> None:
    torch.manual_seed(0)
    scores = torch.randn(2, 3, 8, 6, requires_grad=True)
    cells, weights = torch.rand(2, 3, 2) * 5, torch.rand(2, 3)
    MapLoss.apply(scores, cells, weights, 0.7)[0].backward()
    steps = torch.arange(6).float(), torch.arange(8).float()
    wanted = [torch.softmax((steps[k] - cells[..., k, None]) ** 2 / -1.4, -1) for k in (0, 1)]
    free = scores.detach().clone().requires_grad_()
    log_likely = torch.log_softmax(free.flatten(2), -1).view(2, 3, 8, 6)
    likely = log_likely.exp()
    cross_entropy = -torch.einsum("bnyx,bnx,bny->bn", log_likely, *wanted)
    mean = torch.stack([(likely.sum(2 + k) * steps[k]).sum(-1) for k in (0, 1)], -1)
    away = torch.sqrt(((mean - cells) ** 2).sum(-1) + 0.01)
    (((cross_entropy + MapLoss.PULL * away) * weights).sum() / weights.sum()).backward()
    torch.testing.assert_close(scores.grad, free.grad, atol=1e-6, rtol=1e-4)


@pytest.mark.parametrize("size", [96, 80])
def test_opencv_runs_the_face_network_as_pytorch_does(size: int) -> None:
    torch.manual_seed(1)
    network = FaceNetwork().eval()
    picture = np.random.default_rng(0).normal(0, 1, (1, size, size)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(picture[:, None]))
    shown = Network(to_onnx(network, 96, 96), "maps", "face")(picture)
    for ours, theirs in zip(shown, expected, strict=True):
        np.testing.assert_allclose(ours, theirs.numpy(), atol=1e-4)


def test_a_network_learns_where_pupils_are_and_opencv_runs_it_as_pytorch_does(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    across, down = np.meshgrid(np.arange(32), np.arange(16))

    def draw() -> PupilBatch:
        pupils = rng.uniform(-0.2, 0.2, (32, 2, 2)) + [(-0.5, 0.0), (0.5, 0.0)]
        x, y = (16.0 * pupils[..., k, None, None] + (15.5, 7.5)[k] for k in (0, 1))
        eyes = np.exp(-0.25 * ((across - x) ** 2 + (down - y) ** 2)).sum(axis=1, keepdims=True)
        return PupilBatch(np.float32(-2.0 * eyes), np.float32(pupils), np.ones((32, 2), np.float32))

    torch.manual_seed(2)
    network = train_pupils(PupilNetwork(32, 16), draw, Course(150, tmp_path / "pupils.pt", "pupils")).eval()
    batch = draw()
    with torch.no_grad():
        expected = network(torch.from_numpy(batch.pictures)).numpy()
    away = np.linalg.norm(expected.reshape(-1, 2, 2) - batch.pupils, axis=2)
    assert away.mean() < 0.06  # 0.15 at the middle of each eye
    shown = Network(to_onnx(network, 32, 16), "pupils")
    np.testing.assert_allclose([shown(picture)[0][0] for picture in batch.pictures], expected, atol=1e-4)


@pytest.mark.parametrize("network", [FaceNetwork, lambda: PartNetwork(23)])
def test_a_network_that_was_exported_can_be_loaded_to_train_it_further(network: Callable[[], Any]) -> None:
    torch.manual_seed(6)
    trained, again = network(), network()
    with torch.no_grad():
        trained(torch.randn(8, 1, 48, 48) * 2.0)  # in training, so that the normalisations have seen something
    shown = torch.randn(2, 1, 48, 48)
    load_onnx(again, to_onnx(trained, 48, 48), 48, 48)
    with torch.no_grad():
        torch.testing.assert_close(again.eval()(shown), trained.eval()(shown), atol=1e-4, rtol=1e-4)
    again.train()(shown)
    assert all(torch.isfinite(value).all() for value in again.state_dict().values())


def test_the_detector_learns_where_a_spot_is_and_opencv_runs_it_at_any_size(tmp_path: Path) -> None:
    torch.manual_seed(2)
    spot = np.full((1, 136, 136), 40, np.uint8)
    spot[0, 56:80, 56:80] = 240
    pose = np.float32([[16.0, 0.0, 0.0, 0.0, 67.5, 67.5]])
    parts = [Heads(spot, spot > 100, pose, np.array([real])) for real in (False, True)]
    scenes = Scenes(Heads.join(parts), [np.full((160, 160), 40, np.uint8)], np.random.default_rng(3))
    course = Course(60, tmp_path / "detector.pt", "detector")
    network = train_detector(DetectorNetwork(len(OUTPUTS)), lambda: scenes.draw(8), course).eval()
    detector = NetworkDetector(Network(to_onnx(network, 160, 160), "faces"))
    image = np.full((100, 220), 40, np.uint8)
    image[48:72, 138:162] = 240
    found = detector.detect(image, (400,))[0].pose
    assert np.hypot(*(found[4:6] - (149.5, 59.5))) < 8.0
    picture = np.random.default_rng(0).normal(0, 1, (1, 96, 144)).astype(np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(picture[:, None])).numpy()
    np.testing.assert_allclose(detector.network(picture)[0], expected, atol=1e-4)


def test_training_resumes_from_its_checkpoint_and_learns_a_spot(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)

    def draw() -> Batch:
        cells = rng.uniform(3, 12, (16, 1, 2)).astype(np.float32)
        y, x = np.mgrid[0:32, 0:32].astype(np.float32)
        spots = [np.exp(((x - 2 * cx - 0.5) ** 2 + (y - 2 * cy - 0.5) ** 2) / -6.0) for cx, cy in cells[:, 0]]
        return Batch(np.stack(spots)[:, None] * 4, cells, np.ones((16, 1), np.float32), np.ones((16, 2), np.float32))

    checkpoint = tmp_path / "spot.pt"
    torch.manual_seed(3)
    course = Course(120, checkpoint, "spot")
    train_maps(PartNetwork(1), draw, 0.5, course)
    done = torch.load(checkpoint, weights_only=True)["done"]
    assert done == 120
    network = train_maps(PartNetwork(1), draw, 0.5, course).eval()
    batch = draw()
    with torch.no_grad():
        scores = network(torch.from_numpy(batch.pictures))
    away = MapLoss.apply(scores, torch.from_numpy(batch.cells), torch.from_numpy(batch.weights), 0.5)[1]
    assert float(away) < 1.0


def test_the_expert_of_actions_learns_which_side_is_bright_and_opencv_runs_it_alike(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)

    def draw() -> ActionBatch:
        sides = rng.random((32, 2)).astype(np.float32)
        pictures = np.repeat(sides[:, None, None, :], 16, axis=3).repeat(32, axis=2)
        return ActionBatch(pictures + rng.normal(0, 0.05, pictures.shape).astype(np.float32), sides)

    torch.manual_seed(5)
    network = train_actions(ActionNetwork(2, 32, 32), draw, Course(150, tmp_path / "sides.pt", "sides")).eval()
    batch = draw()
    with torch.no_grad():
        told = network(torch.from_numpy(batch.pictures)).numpy()
    assert np.abs(told - batch.actions).mean() < 0.12
    (shown,) = Network(to_onnx(network, 32, 32), "actions")(batch.pictures[:, 0])
    np.testing.assert_allclose(shown, told, atol=1e-4)
