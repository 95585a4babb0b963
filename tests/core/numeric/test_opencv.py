"""Versions of OpenCV that another extension may have installed."""

from types import SimpleNamespace

import cv2
import pytest

from facemime.core.errors import ModelError
from facemime.core.numeric import opencv
from facemime.core.numeric.opencv import Node, encode_network


def _encoded() -> bytes:
    """A network that multiplies two matrices."""
    return encode_network([Node("Gemm", ("left", "right"), "product")], dict.fromkeys(("left", "right"), (1, 1)))


@pytest.mark.parametrize("version", ["4.10.0", "5.0.0", "5.1.0-dev"])
def test_an_unsupported_version_is_named_with_what_to_do(monkeypatch, version) -> None:
    monkeypatch.setattr(cv2, "__version__", version)
    with pytest.raises(ModelError, match=rf"OpenCV {version} is installed.*Disable other extensions"):
        opencv.read_network(_encoded())


@pytest.mark.parametrize("version", ["4.11.0", "4.14.0"])
def test_later_versions_of_the_same_series_are_accepted(monkeypatch, version) -> None:
    monkeypatch.setattr(cv2, "__version__", version)
    assert isinstance(opencv.read_network(_encoded()), cv2.dnn.Net)


def test_a_network_that_opencv_cannot_read_is_an_error_of_the_model() -> None:
    node = Node("Gemm", ("missing", "too"), "product")
    with pytest.raises(ModelError, match="cannot read a network"):
        opencv.read_network(encode_network([node], {"left": (1, 1)})[:-20])


@pytest.mark.parametrize("place", ["cv2", "cv2.utils.logging"])
def test_messages_are_silenced_wherever_the_function_is(monkeypatch, place) -> None:
    levels: list[int] = []
    own = SimpleNamespace(setLogLevel=levels.append)
    if place == "cv2":
        monkeypatch.delattr(cv2.utils, "logging", raising=False)
        monkeypatch.setattr(cv2, "setLogLevel", levels.append, raising=False)
    else:
        monkeypatch.setattr(cv2.utils, "logging", own, raising=False)
    opencv.silence_opencv()
    assert levels == [0]
