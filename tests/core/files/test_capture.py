"""Frames of video files."""

import contextlib
import os
import socket
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.core.errors import OutputError, SourceError
from facemime.core.files import capture, changing_format
from facemime.core.files.capture import (
    PictureSource,
    VideoSource,
    is_address,
    open_video,
    read_image,
    write_image,
)
from facemime.core.files.frames import Frame, at_constant_rate
from tests.helpers.matroska import browser_video
from tests.helpers.phone_video import phone_video
from tests.helpers.turned import turned_clip


def write_clip(path: Path, count: int, fps: float = 20.0, codec: str = "mp4v") -> Path:
    """A clip whose frames become brighter."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, (64, 48))
    for i in range(count):
        writer.write(np.full((48, 64, 3), 5 * i, np.uint8))
    writer.release()
    return path


def test_frames_come_in_order_with_presentation_times(tmp_path):
    with VideoSource(write_clip(tmp_path / "clip.mp4", 12)) as source:
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(12))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(12) / 20.0, atol=1e-3)
    means = [frame.image.mean() for frame in frames]
    assert frames[0].image.shape == (48, 64, 3) and np.all(np.diff(means) > 0)


@pytest.mark.parametrize(("turn", "bright"), [(0, "top"), (90, "right"), (180, "bottom"), (270, "left")])
def test_phone_videos_are_upright_in_any_orientation(tmp_path, turn, bright):
    with VideoSource(turned_clip(tmp_path / "clip.mp4", turn)) as source:
        image = next(iter(source)).image
    assert source.turn == turn and image.shape == ((48, 64, 3) if turn % 180 == 0 else (64, 48, 3))
    parts = {"top": image[:12], "bottom": image[-12:], "left": image[:, :12], "right": image[:, -12:]}
    assert max(parts, key=lambda side: parts[side].mean()) == bright


@pytest.mark.parametrize(
    ("turn", "bright", "grey"),
    [(0, "bottom", "left"), (90, "left", "top"), (180, "top", "right"), (270, "right", "bottom")],
)
def test_videos_that_are_stored_mirrored_are_shown_as_players_show_them(tmp_path, turn, bright, grey):
    with VideoSource(turned_clip(tmp_path / "clip.mp4", turn, mirrored=True)) as source:
        image = next(iter(source)).image
    assert source.turn == turn and source.mirrored
    parts = {"top": image[:12], "bottom": image[-12:], "left": image[:, :12], "right": image[:, -12:]}
    by_brightness = sorted(parts, key=lambda side: parts[side].mean(), reverse=True)
    assert by_brightness[:2] == [bright, grey]


@pytest.mark.parametrize("stamps", [[None] * 5, [None, None, 1.52, 1.56, 1.6], [7.0, 7.04, None, 7.12, None]])
def test_frames_without_a_time_follow_each_other_at_the_stated_rate(tmp_path, monkeypatch, stamps):
    path, shown = write_clip(tmp_path / "clip.mp4", 5, 25.0), iter(stamps)
    with VideoSource(path) as source:
        monkeypatch.setattr(changing_format, "stamp_of", lambda _: next(shown, None))
        np.testing.assert_allclose(list(source.times()), np.arange(5) / 25.0, atol=1e-9)


def test_a_video_whose_recording_was_interrupted_is_called_incomplete(tmp_path):
    whole = write_clip(tmp_path / "clip.mp4", 5).read_bytes()
    index = whole.index(b"moov") - 4
    for content in (whole[:index], whole[: index - 20], whole[: index + 20], whole[: whole.index(b"ftyp") + 40]):
        (tmp_path / "cut.mp4").write_bytes(content)
        with pytest.raises(SourceError, match="is incomplete: its index"):
            VideoSource(tmp_path / "cut.mp4")
    picture = whole[: int.from_bytes(whole[:4], "big")] + (8).to_bytes(4, "big") + b"meta"
    for content in (b"", whole[:6], b"text" * 40, picture):
        (tmp_path / "other.mp4").write_bytes(content)
        with pytest.raises(SourceError, match="cannot be read as a video"):
            VideoSource(tmp_path / "other.mp4")


@pytest.mark.parametrize(
    "steps",
    [
        [1 / 30] * 20 + [0.0] + [1 / 60] * 100 + [1 / 30] * 20,
        ([1 / 30] * 10 + [0.0]) * 8,
        [1 / 30] * 20 + [-0.01] + [1 / 60] * 100,
    ],
)
def test_a_frame_with_the_time_of_the_one_before_does_not_delay_the_following_ones(tmp_path, steps):
    stamps = np.round(1000.0 * np.cumsum([0.0, *steps])).astype(int)
    images = [np.full((48, 64, 3), number % 200, np.uint8) for number in range(len(stamps))]
    with VideoSource(browser_video(tmp_path / "clip.mkv", images, stamps.tolist())) as source:
        times = np.array(list(source.times()))
    assert np.all(np.diff(times) > 0.0) and len(times) == len(stamps)
    assert np.abs(times - stamps / 1000.0).max() < 0.035


def test_the_times_of_a_file_whose_clock_starts_again_go_on(tmp_path):
    stamps = [0, 40, 80, 120, 5000, 5100, 5200, 0, 100, 200]
    images = [np.full((48, 64, 3), 20 * number, np.uint8) for number in range(len(stamps))]
    with VideoSource(browser_video(tmp_path / "clip.mkv", images, stamps)) as source:
        steps = np.diff(list(source.times()))
    np.testing.assert_allclose(steps, [0.04, 0.04, 0.04, 4.88, 0.1, 0.1, 1.0 / source.fps, 0.1, 0.1], atol=1e-6)


def test_a_stream_without_a_container_has_the_times_of_its_rate(tmp_path):
    picture = cv2.imencode(".jpg", np.full((48, 64, 3), 100, np.uint8))[1].tobytes()
    (tmp_path / "camera.mjpeg").write_bytes(picture * 10)
    with VideoSource(tmp_path / "camera.mjpeg") as source:
        np.testing.assert_allclose(list(source.times()), np.arange(10) / source.fps, atol=1e-9)


@pytest.mark.parametrize("shown", [(96, 48), (64, 96), (64, 48)])
def test_pixels_that_are_not_square_are_stretched_to_what_players_show(tmp_path, shown):
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :32] = 255
    with VideoSource(browser_video(tmp_path / "clip.mkv", [image] * 3, [0, 40, 80], shown)) as source:
        frame = next(iter(source)).image
    assert frame.shape == (shown[1], shown[0], 3)
    assert frame[:, : shown[0] // 2 - 4].min() > 200 and frame[:, shown[0] // 2 + 4 :].max() < 50
    assert source.pixel_aspect == pytest.approx((shown[0] / shown[1]) / (64 / 48), rel=1e-3)


@pytest.mark.parametrize("rate", [24.0, 25.0, 29.97, 60.0])
def test_the_rate_of_a_browsers_recording_is_that_of_its_images(tmp_path, rate):
    jitter = np.random.default_rng(0).integers(-5, 6, 40)
    times = np.round(1000.0 * np.arange(40) / rate).astype(int)
    times[1:] += jitter[1:] if rate < 60.0 else 0
    path = browser_video(
        tmp_path / "clip.mkv", [np.full((48, 64, 3), 5 * i, np.uint8) for i in range(40)], times.tolist()
    )
    with VideoSource(path) as source:
        frames = list(source)
    assert source.fps == pytest.approx(rate, rel=0.07)
    np.testing.assert_allclose([frame.time for frame in frames], times / 1000.0, atol=1e-3)


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 50.0, 60.0])
@pytest.mark.parametrize("skipped", [0.04, 0.1])
def test_the_rate_of_a_phone_that_skips_frames_is_the_one_at_which_most_of_them_come(tmp_path, rate, skipped):
    steps = (1 + (np.random.default_rng(0).random(200) < skipped)) / rate
    with VideoSource(phone_video(tmp_path / "clip.mp4", steps.tolist())) as source:
        times = [frame.time for frame in source]
    assert source.fps == pytest.approx(rate, rel=0.002) and source.frame_count == 201
    np.testing.assert_allclose(np.diff(times), steps, atol=1e-3)


@pytest.mark.parametrize("rate", [10.0, 12.5, 15.0, 20.0, 28.125, 29.0, 31.0, 48.0, 100.0])
def test_an_unusual_rate_that_all_frames_keep_is_believed(tmp_path, rate):
    with VideoSource(phone_video(tmp_path / "clip.mp4", [1.0 / rate] * 80)) as source:
        assert source.fps == pytest.approx(rate, rel=1e-3)


def test_the_mean_is_the_rate_if_frames_come_at_no_rate(tmp_path):
    steps = np.random.default_rng(3).uniform(0.02, 0.1, 120)
    with VideoSource(phone_video(tmp_path / "clip.mp4", steps.tolist())) as source:
        assert source.fps == pytest.approx(1.0 / steps.mean(), rel=0.02)


def test_a_truncated_video_yields_its_complete_frames(tmp_path):
    path = write_clip(tmp_path / "clip.avi", 40, codec="MJPG")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with VideoSource(path) as source:
        assert 5 < len(list(source)) < 40


@pytest.mark.parametrize("content", [b"", b"not a video at all", b"\x00" * 4096])
def test_files_that_are_not_videos_are_clear_errors(tmp_path, content, capfd):
    path = tmp_path / "clip.mp4"
    path.write_bytes(content)
    with pytest.raises(SourceError, match="cannot be read as a video"):
        VideoSource(path)
    assert capfd.readouterr() == ("", "")


def test_a_container_without_frames_is_a_clear_error(tmp_path):
    path = write_clip(tmp_path / "clip.avi", 0, codec="MJPG")
    with pytest.raises(SourceError, match=r"cannot be read as a video|No frame"), VideoSource(path) as source:
        list(source)


def test_missing_files_folders_and_unreadable_files_have_different_errors(tmp_path):
    with pytest.raises(SourceError, match="There is no file"):
        VideoSource(tmp_path / "none.mp4")
    with pytest.raises(SourceError, match="not a file"):
        VideoSource(tmp_path)
    if os.name != "posix" or os.getuid() == 0:
        pytest.skip("files can be made unreadable on POSIX only, and not for root")
    path = write_clip(tmp_path / "clip.mp4", 3)
    path.chmod(0)
    with pytest.raises(SourceError, match="no permission"):
        VideoSource(path)


def test_a_variable_rate_becomes_constant_without_drift():
    image = np.zeros((1, 1, 3), np.uint8)
    times = np.cumsum([0.0, *np.random.default_rng(0).uniform(0.01, 0.08, 300)])
    frames = [Frame(image, float(t), i) for i, t in enumerate(times)]
    steady = list(at_constant_rate(frames, 30.0))
    for n, frame in enumerate(steady):
        assert frame.time == pytest.approx(n / 30.0)
        assert times[frame.index] <= frame.time + 0.5 / 30.0 + 1e-9
        if frame.index + 1 < len(times):
            assert times[frame.index + 1] > frame.time - 0.5 / 30.0 - 1e-9
    assert abs(steady[-1].time - times[-1]) < 1.5 / 30.0


def test_a_constant_rate_keeps_every_frame_once():
    image = np.zeros((1, 1, 3), np.uint8)
    frames = [Frame(image, i / 25.0, i) for i in range(50)]
    assert [frame.index for frame in at_constant_rate(frames, 25.0)] == list(range(50))


def test_images_survive_and_invalid_ones_are_refused(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)
    (tmp_path / "b.png").write_bytes(b"")
    for path in (tmp_path / "b.png", tmp_path / "none.png"):
        with pytest.raises(SourceError):
            read_image(path)
    with pytest.raises(OutputError, match="suffix"):
        write_image(tmp_path / "a.xyz", image)


def test_oversized_frames_are_refused_before_decoding(tmp_path, monkeypatch):
    path = write_clip(tmp_path / "clip.avi", 2, codec="MJPG")
    monkeypatch.setattr(capture, "MAX_PIXELS", 64 * 48)
    with VideoSource(path) as source:
        assert len(list(source)) == 2
    monkeypatch.setattr(capture, "MAX_PIXELS", 64 * 48 - 1)
    with pytest.raises(SourceError, match="too large: 64 x 48 pixels"):
        VideoSource(path)


@pytest.mark.skipif(os.name != "posix", reason="pipes and devices as POSIX has them")
def test_pipes_and_devices_are_not_files(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    (tmp_path / "zero.mp4").symlink_to("/dev/zero")
    for name in ("pipe.mp4", "zero.mp4"):
        with pytest.raises(SourceError, match="but a pipe or a device"):
            VideoSource(tmp_path / name)
        with pytest.raises(SourceError, match="but a pipe or a device"):
            read_image(tmp_path / name)
    for name in ("a\0b", "x" * 300):
        with pytest.raises(SourceError, match="Check the path"):
            VideoSource(tmp_path / name)


@pytest.mark.parametrize(
    "text",
    ["http://phone:8080/video", "http:phone/video", "HTTP:x", "rtsp:x", "udp://@:1234", "tcp:x", "concat:a|b", "file:a",
     "async:http:x", "subfile,,start,0,end,0,,:http:x"],
)  # fmt: skip
def test_everything_that_ffmpeg_takes_for_an_address_is_recognised(text):
    assert is_address(text)


@pytest.mark.parametrize(
    "text", ["0", "12:30.mp4", "/dev/video0", "C:\\clips\\a.mp4", "c:/clips/a.mp4", "./http:x", "/a/http://x", "a.mp4"]
)
def test_files_and_numbers_are_not_addresses(text):
    assert not is_address(text)


def test_playlists_on_the_network_are_not_opened(tmp_path):
    """No file name makes FFmpeg access the network."""
    asked = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.0)
        address = f"http://127.0.0.1:{server.getsockname()[1]}/a.ts"
        hls = f"#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\n{address}\n#EXT-X-ENDLIST\n"
        for name, text in (("a.m3u8", hls), ("a.mp4", hls), ("a.ffconcat", f"ffconcat version 1.0\nfile {address}\n")):
            (tmp_path / name).write_text(text)
            with pytest.raises(SourceError):
                list(VideoSource(tmp_path / name))
            with contextlib.suppress(BlockingIOError):
                asked.append(server.accept())
    assert not asked


def pictures(folder: Path, names: list[str]) -> Path:
    """Write a grey picture of each name, brighter than the one before."""
    folder.mkdir()
    for number, name in enumerate(names):
        write_image(folder / name, np.full((24, 32, 3), 20 + 30 * number, np.uint8))
    return folder


def test_pictures_are_frames_in_the_order_of_their_numbers(tmp_path):
    folder = pictures(tmp_path / "clip", ["face1.png", "face2.png", "face10.png"])
    (folder / "face3.png").write_bytes(b"no picture")
    (folder / "notes.txt").write_text("no picture either")
    with open_video(folder, 10.0) as source:
        frames = list(source)
    assert [int(frame.image.mean()) for frame in frames] == [20, 50, 80]
    assert [frame.time for frame in frames] == [0.0, 0.1, 0.2] and source.fps == 10.0


@pytest.mark.parametrize("step", [1, 5])
def test_later_pictures_of_a_sequence_keep_their_times_where_some_are_missing_or_damaged(tmp_path, step):
    numbers = [n for n in range(12) if n not in (4, 5)]
    folder = pictures(tmp_path / "clip", [f"frame_{100 + step * n:04d}.png" for n in numbers])
    (folder / f"frame_{100 + 2 * step:04d}.png").write_bytes(b"damaged")
    with open_video(folder, 10.0) as source:
        frames = list(source)
    assert [round(10.0 * frame.time) for frame in frames] == [0, 1, 3, 6, 7, 8, 9, 10, 11]
    assert source.skipped == 3 and [frame.index for frame in frames] == list(range(9))


@pytest.mark.parametrize("before", ["", "take", "take_", "a1b", "2024-12-01 "])
@pytest.mark.parametrize("numbers", [range(-3, 3), range(-12, 13, 4), range(-5, 2)])
def test_pictures_of_negative_frames_come_first(tmp_path, before, numbers):
    folder = pictures(tmp_path / "clip", [f"{before}{'-' * (n < 0)}{abs(n):04d}.png" for n in numbers])
    with open_video(folder, 10.0) as source:
        frames = list(source)
    assert [int(frame.image.mean()) for frame in frames] == [20 + 30 * n for n in range(len(frames))]
    assert [round(10.0 * frame.time) for frame in frames] == list(range(len(frames))) and source.skipped == 0


def test_pictures_that_all_begin_with_a_minus_are_negative_frames(tmp_path):
    folder = pictures(tmp_path / "clip", [f"-{n:04d}.png" for n in (12, 11, 10, 8)])
    with open_video(folder, 10.0) as source:
        assert [(int(frame.image.mean()), frame.time) for frame in source] == [
            (20, 0),
            (50, 0.1),
            (80, 0.2),
            (110, 0.4),
        ]


@pytest.mark.parametrize("before", ["take-", "take3-", "2024-12-", "take_-", "IMG-20241201-WA"])
def test_a_hyphen_between_text_and_number_is_no_sign(tmp_path, before):
    folder = pictures(tmp_path / "clip", [f"{before}{n}.png" for n in (2, 3, 5, 10)])
    with open_video(folder, 10.0) as source:
        assert [int(frame.image.mean()) for frame in source] == [20, 50, 80, 110]


def test_pictures_that_were_picked_follow_each_other(tmp_path):
    folder = pictures(tmp_path / "clip", ["IMG_1200.png", "IMG_1207.png", "IMG_1251.png"])
    with open_video(folder, 10.0) as source:
        assert [frame.time for frame in source] == [0.0, 0.1, 0.2] and source.skipped == 0


def test_a_folder_without_pictures_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no images"):
        open_video(tmp_path)
    with pytest.raises(SourceError, match="no folder"):
        PictureSource(tmp_path / "missing")
    with pytest.raises(SourceError, match="rate"):
        PictureSource(pictures(tmp_path / "clip", ["1.png"]), 0.0)
    (pictures(tmp_path / "bad", []) / "1.png").write_bytes(b"no picture")
    with open_video(tmp_path / "bad") as source, pytest.raises(SourceError, match="cannot be read as an image"):
        list(source)
