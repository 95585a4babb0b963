"""Training of the output for the tongue of the network of the mouth's actions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from facemime.core.face.names import ACTIONS
from facemime.core.tracking.network import Network
from facemime.core.tracking.patch_experts import ActionExperts
from facemime.core.tracking.tracker import FaceTracker

pytest.importorskip("onnx", reason="onnx is not installed; `make model` does it")

from lab.training.tracker.tongue import Classifier, _Seen, calibrated, train, varied, with_output

TONGUE = ACTIONS.index("tongueOut")


@pytest.fixture(scope="module")
def experts() -> ActionExperts:
    return next(each for each in FaceTracker.load()._model.actions if TONGUE in each.actions)


@pytest.fixture(scope="module")
def crops(experts: ActionExperts) -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, 1.0, (5, *experts.size[::-1])).astype(np.float32)


def test_only_the_output_for_the_tongue_is_replaced(experts: ActionExperts, crops: np.ndarray) -> None:
    output, seen = int(np.flatnonzero(experts.actions == TONGUE)[0]), _Seen(experts)(crops)
    rng = np.random.default_rng(2)
    classifier = Classifier(rng.normal(0.0, 0.05, (8, seen.shape[1])), rng.normal(size=8), rng.normal(size=8), -0.3)
    (before,) = experts.network(crops)
    replaced = with_output(experts.network.onnx, output, classifier)
    (after,) = Network(replaced, "actions")(crops)
    others = np.delete(np.arange(after.shape[1]), output)
    np.testing.assert_allclose(after[:, others], before[:, others], atol=1e-5)
    odds = np.maximum(seen @ classifier.hidden.T + classifier.hidden_bias, 0.0) @ classifier.weights + classifier.bias
    np.testing.assert_allclose(after[:, output], 1.0 / (1.0 + np.exp(-odds)), atol=1e-4)
    # Replaced once more, the network does not grow.
    assert (
        abs(len(with_output(replaced, output, replace(classifier, weights=-classifier.weights))) - len(replaced)) < 100
    )


def test_training_separates_tongues_from_real_mouths() -> None:
    rng = np.random.default_rng(3)
    renders, shown = rng.normal(size=(400, 20)), np.repeat([0.0, 1.0], 200)
    renders[200:, 0] += 4.0
    real = rng.normal(size=(300, 20))
    real[:, 1] += 4.0
    classifier = train((renders, real[:150], real[150:]), shown, rng)

    def odds(seen: np.ndarray, by: Classifier) -> np.ndarray:
        return np.asarray(np.maximum(seen @ by.hidden.T + by.hidden_bias, 0.0) @ by.weights + by.bias)

    assert (odds(renders[200:], classifier) > 0.0).mean() > 0.9
    assert (odds(np.concatenate([renders[:200], real]), classifier) > 0.0).mean() < 0.05
    # The order stays as it is.
    rank = np.argsort(np.argsort(odds(renders, classifier)))
    np.testing.assert_array_equal(np.argsort(np.argsort(odds(renders, calibrated(classifier)))), rank)


def test_varied_crops_are_finite_and_differ(crops: np.ndarray) -> None:
    other = varied(crops, np.random.default_rng(4))
    assert other.shape == crops.shape and np.isfinite(other).all()
    assert (np.abs(other - crops).reshape(len(crops), -1).max(axis=1) > 0.1).all()
