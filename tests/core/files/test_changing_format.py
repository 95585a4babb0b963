"""Videos whose images change their size, or how their colours are stored, midway."""

from __future__ import annotations

import contextlib
import struct
import tempfile

import cv2
import numpy as np
import pytest

from facemime.core.errors import SourceError
from facemime.core.files import changing_format
from facemime.core.files.capture import VideoSource
from facemime.core.files.changing_format import fitted
from facemime.core.files.frame_finder import FrameFinder
from tests.helpers.matroska import browser_video
from tests.helpers.turned import turned_clip

WIDE, SMALL, TALL = (160, 120), (96, 72), (72, 128)
JPEG_422, JPEG_420 = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420


def picture(size, number):
    """(H, W, 3) ramps of a size, whose blue says the number of the frame."""
    width, height = size
    x, y = np.meshgrid(np.linspace(0, 200, width), np.linspace(0, 200, height))
    return np.dstack([np.full_like(x, 10.0 * number), y, x]).astype(np.uint8)


def error(image, size, number):
    """Mean difference between an image and the picture, within the first size."""
    return np.abs(fitted(picture(size, number), image.shape[1::-1]).astype(float) - image).mean()


def jpeg_stream(path, sizes, samplings=None):
    """Write a stream of JPEG images without a container."""
    samplings = samplings or [JPEG_420] * len(sizes)
    images = [
        cv2.imencode(".jpg", picture(size, number), [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling])[1].tobytes()
        for number, (size, sampling) in enumerate(zip(sizes, samplings, strict=True))
    ]
    path.write_bytes(b"".join(images))
    return path


def packets(path):
    """The encoded images of a video."""
    raw = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    found = []
    while (read := raw.read())[0]:
        found.append(read[1].tobytes())
    return found


def joined_webm(folder, codec, sizes):
    """Write runs of five frames of each size in a codec of WebM, as calls are recorded."""
    frames = b""
    for number, size in enumerate(sizes):
        path = folder / f"{number}.webm"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 25.0, size)
        for frame in range(5):
            writer.write(picture(size, 5 * number + frame))
        writer.release()
        for frame, data in enumerate(packets(path)):
            frames += struct.pack("<IQ", len(data), 5 * number + frame) + data
    head = struct.pack("<4sHH4sHHIIII", b"DKIF", 0, 32, codec.encode(), *sizes[0], 25, 1, 0, 0)
    (folder / "call.ivf").write_bytes(head + frames)
    return folder / "call.ivf"


@pytest.mark.parametrize(
    "sizes",
    [
        [WIDE] * 3 + [SMALL] * 3,
        [SMALL] * 3 + [WIDE] * 3,
        [WIDE] * 2 + [TALL] * 2 + [WIDE] * 2,
        [WIDE, SMALL, TALL, SMALL],
        [TALL] * 90 + [SMALL] * 90,
    ],
)
def test_images_of_another_size_are_shown_within_the_first_size(tmp_path, sizes):
    with VideoSource(jpeg_stream(tmp_path / "call.mjpeg", sizes)) as source:
        frames = list(source)
    assert len(frames) == len(sizes)
    assert {frame.image.shape for frame in frames} == {(*sizes[0][::-1], 3)}
    np.testing.assert_allclose(np.diff([frame.time for frame in frames]), 1.0 / source.fps, atol=1e-6)
    blue = [number % 25 for number in range(len(sizes))]
    assert max(error(frame.image, *shown) for frame, *shown in zip(frames[:25], sizes, blue, strict=False)) < 4.0


@pytest.mark.parametrize("codec", ["VP80", "VP90"])
def test_recorded_calls_that_adapt_to_the_network_are_read(tmp_path, codec):
    sizes = [SMALL, WIDE, TALL]
    with VideoSource(joined_webm(tmp_path, codec, sizes)) as source:
        frames = list(source)
    assert len(frames) == 15
    assert max(error(frame.image, sizes[number // 5], number) for number, frame in enumerate(frames)) < 12.0
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(15) / 25.0, atol=2e-3)


def test_images_whose_colours_are_sampled_in_another_way_are_read(tmp_path):
    samplings = [JPEG_422] + [JPEG_420] * 4 + [JPEG_422] * 2
    with VideoSource(jpeg_stream(tmp_path / "clip.mjpeg", [WIDE] * 7, samplings)) as source:
        assert max(error(frame.image, WIDE, number) for number, frame in enumerate(source)) < 4.0


def test_times_of_a_container_go_on_after_a_change_of_the_size(tmp_path):
    sizes, stamps = [WIDE] * 3 + [TALL] * 3, [0, 40, 90, 130, 180, 1000]
    images = [picture(size, number) for number, size in enumerate(sizes)]
    with VideoSource(browser_video(tmp_path / "clip.mkv", images, stamps)) as source:
        frames = list(source)
    np.testing.assert_allclose([frame.time for frame in frames], np.array(stamps) / 1000.0, atol=1e-6)
    assert max(error(frame.image, sizes[number], number) for number, frame in enumerate(frames)) < 4.0


def test_a_frame_after_a_change_of_the_size_is_found(tmp_path):
    sizes = [WIDE] * 4 + [SMALL] * 4
    images = [picture(size, number) for number, size in enumerate(sizes)]
    with FrameFinder(browser_video(tmp_path / "clip.mkv", images, [40 * n for n in range(8)])) as finder:
        for number in (6, 1, 5):
            image = finder.at(0.04 * number)
            assert image is not None and error(image, sizes[number], number) < 4.0


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_images_after_a_change_are_upright_in_any_orientation(tmp_path, monkeypatch, turn, mirrored):
    path = turned_clip(tmp_path / "clip.mov", turn, mirrored=mirrored, codec="MJPG")
    (whole := VideoSource(path)).close()
    formats = iter([b"one", *[b"another"] * 9])
    codec = changing_format._CODECS["mjpg"]._replace(format=lambda data: next(formats))
    monkeypatch.setattr(changing_format, "_CODECS", dict.fromkeys(changing_format._CODECS, codec))
    with VideoSource(path) as source:
        first, *others = [frame.image for frame in source]
        assert source._stream._part is not None and whole.turn == turn
    assert len(others) == 2
    for image in others:
        np.testing.assert_array_equal(image, first)


def test_a_damaged_change_of_the_size_raises_nothing_else_than_errors_of_videos(tmp_path):
    whole, random = joined_webm(tmp_path, "VP80", [SMALL, WIDE]).read_bytes(), np.random.default_rng(0)
    for number in range(40):
        data = bytearray(whole)
        for place in random.integers(32, len(data), 1 + number % 8):
            data[place] = random.integers(256)
        (tmp_path / "damaged.ivf").write_bytes(data)
        with contextlib.suppress(SourceError), VideoSource(tmp_path / "damaged.ivf") as source:
            assert all(frame.image.shape == (72, 96, 3) for frame in source)


def test_an_image_that_opencv_refuses_ends_the_video(tmp_path):
    class Refusing:
        def retrieve(self):
            raise cv2.error("damaged")

    with VideoSource(jpeg_stream(tmp_path / "clip.mjpeg", [WIDE] * 3)) as source:
        next(source.times())
        source._stream._capture = Refusing()
        assert source.image() is None
        source._stream._capture = source._capture


def test_a_video_whose_first_image_cannot_be_decoded_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(changing_format.Stream, "image", lambda stream, turn: None)
    path = jpeg_stream(tmp_path / "clip.mjpeg", [WIDE] * 3)
    with VideoSource(path) as source, pytest.raises(SourceError, match=r"No frame of .* can be decoded"):
        list(source)


def test_nothing_is_left_in_the_folder_for_temporary_files(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    path = jpeg_stream(tmp_path / "call.mjpeg", [WIDE] * 2 + [SMALL] * 2)
    with VideoSource(path) as source:
        frames = iter(source)
        for _ in range(3):
            next(frames)
        assert list((tmp_path / "temporary").iterdir())
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.parametrize(
    ("name", "code"), [("h264", b"\x67"), ("hevc", b"\x42\x01"), ("fmp4", b"\x20"), ("mpg2", b"\xb3")]
)
def test_headers_of_streams_of_mpeg_tell_formats_apart(name, code):
    form = changing_format._CODECS[name].format
    first, other = (
        form(b"\0\0\1" + code + content + b"\0\0\1\x65\x88") for content in (b"\x28\x01\xe0", b"\x14\0\xf0")
    )
    assert first and other and first != other
    assert first == form(b"\0\0\0\1" + code + b"\x28\x01\xe0" + b"\0\0\0\1\x65\x99")
    assert form(b"\0\0\1\x41\x9a\x24") == form(b"") == form(b"\0\0\1") == b""


@pytest.mark.parametrize("name", changing_format._CODECS)
def test_damaged_headers_are_ignored(name):
    form, noise = changing_format._CODECS[name].format, np.random.default_rng(0)
    for length in (0, 1, 3, 9, 12, 40, 200):
        assert isinstance(form(b"\xff\xd8\xff\xc0" + noise.bytes(length)), bytes)
        assert isinstance(form(b"\0\0\1" + noise.bytes(length)), bytes)
        assert isinstance(form(b"\x82\x49\x83\x42"[: length + 1]), bytes)
