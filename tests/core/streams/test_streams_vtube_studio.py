"""VTube Studio on a computer: a real WebSocket server that follows the published interface."""

from __future__ import annotations

import json
from contextlib import closing

import numpy as np
import pytest

from facemime.core.face.names import COEFFICIENT_INDEX, N_COEFFICIENTS
from facemime.core.face.rotation import from_face_axes
from facemime.core.streams.protocols.frames import FaceValues
from facemime.core.streams.vtube_studio_api import VTubeStudioSender, injection, parameters, request
from facemime.core.takes.measured import coefficient_face
from facemime.core.tracking.result import TrackResult
from tests.helpers.clocks import wait_for
from tests.helpers.vtube_studio import TOKEN, Studio, running

NAMES = (
    *("FacePositionX", "FacePositionY", "FacePositionZ", "FaceAngleX", "FaceAngleY", "FaceAngleZ", "MouthSmile"),
    *("MouthOpen", "Brows", "TongueOut", "EyeOpenLeft", "EyeOpenRight", "EyeLeftX", "EyeLeftY", "EyeRightX"),
    *("EyeRightY", "CheekPuff", "BrowLeftY", "BrowRightY", "MouthX"),
)
"""The default parameters that Facemime sets."""


def face(**values: float) -> FaceValues:
    coefficients = np.zeros(N_COEFFICIENTS)
    for name, value in values.items():
        coefficients[COEFFICIENT_INDEX[name]] = value
    return FaceValues(coefficients, np.zeros(3))


def send(sender: VTubeStudioSender, **values: float) -> None:
    result = coefficient_face().result(face(**values).coefficients, np.zeros(3), None)
    sender.send(0.0, result, coefficient_face().neutral)


def value_of(data: dict, name: str) -> float:
    return next(each["value"] for each in data["parameterValues"] if each["id"] == name)


def test_a_request_follows_the_specification():
    assert json.loads(request("AuthenticationTokenRequest", {"pluginName": "Facemime"})) == {
        "apiName": "VTubeStudioPublicAPI",
        "apiVersion": "1.0",
        "requestID": "Facemime",
        "messageType": "AuthenticationTokenRequest",
        "data": {"pluginName": "Facemime"},
    }
    assert json.loads(injection({"FaceAngleX": 12.31}, found=True))["data"] == {
        "faceFound": True,
        "mode": "set",
        "parameterValues": [{"id": "FaceAngleX", "value": 12.31}],
    }


def test_a_face_at_rest_gives_a_model_at_rest():
    assert parameters(face()) == {
        **dict.fromkeys(NAMES, 0.0),
        **dict.fromkeys(("MouthSmile", "Brows", "BrowLeftY", "BrowRightY"), 0.5),
        **dict.fromkeys(("EyeOpenLeft", "EyeOpenRight"), 1.0),
    }


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"jawOpen": 0.7, "mouthClose": 0.2}, {"MouthOpen": 0.5}),
        ({"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0}, {"MouthSmile": 1.0}),
        ({"mouthFrownLeft": 1.0, "mouthFrownRight": 1.0}, {"MouthSmile": 0.0}),
        ({"eyeBlinkLeft": 0.8}, {"EyeOpenLeft": 0.2}),
        ({"eyeLookInLeft": 0.4, "eyeLookOutRight": 0.4}, {"EyeLeftX": 0.4, "EyeRightX": 0.4}),
        ({"eyeLookUpLeft": 0.3, "eyeLookDownRight": 0.3}, {"EyeLeftY": 0.3, "EyeRightY": -0.3}),
        ({"browInnerUp": 1.0, "browOuterUpLeft": 1.0}, {"BrowLeftY": 1.0, "BrowRightY": 0.75, "Brows": 0.875}),
        ({"browDownRight": 1.0}, {"BrowRightY": 0.0, "Brows": 0.25}),
        ({"mouthRight": 0.5}, {"MouthX": -0.5}),
        ({"cheekPuff": 0.6, "tongueOut": 0.9}, {"CheekPuff": 0.6, "TongueOut": 0.9}),
    ],
)
def test_coefficients_become_parameters(values, expected):
    found, rest = parameters(face(**values)), parameters(face())
    assert {name: value for name, value in found.items() if value != rest[name]} == pytest.approx(expected)


def test_angles_are_degrees_to_the_right_up_and_clockwise_of_the_screen():
    turned = FaceValues(np.zeros(N_COEFFICIENTS), from_face_axes(0.1, 0.2, 0.3), np.array([0.01, 0.02, 0.03]))
    found = parameters(turned)
    angles = [found[f"FaceAngle{axis}"] for axis in "XYZ"]
    np.testing.assert_allclose(angles, np.degrees([0.2, -0.1, -0.3]), atol=1e-4)
    assert [found[f"FacePosition{axis}"] for axis in "XYZ"] == [1.0, -2.0, 1.5]


def test_the_user_is_asked_only_the_first_time(tmp_path):
    token, studio = tmp_path / "settings" / "token", Studio(tokens=())
    with running(studio) as port:
        with closing(VTubeStudioSender("127.0.0.1", port, token)) as sender:
            send(sender, jawOpen=0.5)
            wait_for(studio.injected)
            assert sender.message == "" and sender.sent >= 1
        assert studio.kinds()[:2] == ["AuthenticationTokenRequest", "AuthenticationRequest"]
        assert studio.requests[0]["data"] == {"pluginName": "Facemime", "pluginDeveloper": "Facemime"}
        assert studio.requests[1]["data"]["authenticationToken"] == TOKEN == token.read_text().strip()
        studio.requests.clear()
        with closing(VTubeStudioSender("127.0.0.1", port, token)) as sender:
            send(sender, jawOpen=0.5)
            wait_for(studio.injected)
        assert "AuthenticationTokenRequest" not in studio.kinds()
    data = studio.injected()[0]
    assert data["faceFound"] is True and data["mode"] == "set"
    assert {each["id"] for each in data["parameterValues"]} == set(NAMES)
    assert value_of(data, "MouthOpen") == pytest.approx(0.5, abs=0.01)


def test_a_revoked_token_is_requested_again(tmp_path):
    (tmp_path / "token").write_text("of another year\n")
    studio = Studio()
    with running(studio) as port, closing(VTubeStudioSender("127.0.0.1", port, tmp_path / "token")) as sender:
        send(sender)
        wait_for(studio.injected)
    assert studio.kinds()[:3] == ["AuthenticationRequest", "AuthenticationTokenRequest", "AuthenticationRequest"]
    assert (tmp_path / "token").read_text().strip() == TOKEN


def test_values_are_sent_again_within_a_second(tmp_path):
    studio = Studio()
    with running(studio) as port, closing(VTubeStudioSender("127.0.0.1", port, tmp_path / "token")) as sender:
        send(sender, jawOpen=0.3)
        wait_for(lambda: len(studio.injected()) >= 4)
        assert sender.sent == 1 and studio.injected()[-1] == studio.injected()[0]
        sender.send(1.0, TrackResult.nothing(0), coefficient_face().neutral)
        wait_for(lambda: not studio.injected()[-1]["faceFound"])
        assert studio.injected()[-1]["parameterValues"] == studio.injected()[0]["parameterValues"]


def test_a_user_who_denies_is_not_asked_again(tmp_path):
    studio = Studio(allow=False, tokens=())
    with running(studio) as port, closing(VTubeStudioSender("127.0.0.1", port, tmp_path / "token")) as sender:
        wait_for(lambda: "denied" in sender.message)
        assert studio.kinds() == ["AuthenticationTokenRequest"] and not (tmp_path / "token").exists()


def test_a_missing_studio_is_reported_and_found_when_it_starts(tmp_path):
    with running(Studio()) as port:
        pass
    with closing(VTubeStudioSender("127.0.0.1", port, tmp_path / "token")) as sender:
        send(sender)
        wait_for(lambda: "does not answer" in sender.message)
        studio = Studio()
        with running(studio, port):
            wait_for(studio.injected)
            assert sender.message == ""


def test_invalid_answers_do_not_end_the_connection(tmp_path):
    class Nonsense(Studio):
        def answer(self, connection, asked, kind, data):
            connection.send("[1, 2")

    with running(Nonsense()) as port, closing(VTubeStudioSender("127.0.0.1", port, tmp_path / "token")) as sender:
        wait_for(lambda: "does not answer" in sender.message)
    assert not sender._thread.is_alive()
