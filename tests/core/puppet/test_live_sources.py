"""Live sources keep to the clock, drop late frames, and report errors."""

from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
import pytest

import facemime
from facemime.core.errors import SourceError
from facemime.core.files.capture import VideoSource
from facemime.core.puppet.sources import LiveFrame, LiveSource, PacedSource, PicturePlayer, TakePlayer, VideoPlayer
from tests.helpers.clocks import EagerClock
from tests.helpers.takes import performance

SAMPLE = Path(facemime.__file__).parent / "assets" / "sample" / "sample.mp4"


def played(source: LiveSource, count: int | None = None) -> list[LiveFrame]:
    """Return the frames of `source` until its end, or the first `count`."""
    frames: list[LiveFrame] = []
    source.pace = EagerClock()
    while not source.ended and (count is None or len(frames) < count):
        frame = source.read(1.0)
        if frame is not None:
            frames.append(frame)
    source.close()
    return frames


class Numbers(PacedSource):
    """Ten frames, a hundredth of a second apart."""

    def __init__(self, **options):
        super().__init__("numbers", **options)
        self.opened = 0

    def frames(self):
        self.opened += 1
        for index in range(10):
            yield LiveFrame(index / 100.0, np.full((2, 2, 3), index, np.uint8))


def test_a_video_is_played_with_its_own_times_and_images():
    with VideoSource(SAMPLE) as source:
        wanted = [frame for frame, _ in zip(source, range(6), strict=False)]
    frames = played(VideoPlayer(SAMPLE, speed=0.25), 6)
    assert [frame.dropped for frame in frames] == [0] * 6
    for frame, other in zip(frames, wanted, strict=True):
        assert frame.time == pytest.approx(other.time)
        np.testing.assert_array_equal(frame.image, other.image)


def test_frames_come_on_time_and_all_are_delivered_or_counted_as_dropped():
    source = Numbers(speed=0.5)
    clock = source.pace = EagerClock()
    began, frames = clock.now(), []
    while not source.ended:
        frames.append(source.read(1.0))
        assert clock.now() - began == pytest.approx(2.0 * frames[-1].time)
        clock.time += 0.001
    assert [frame.dropped for frame in frames] == [0] * 10


def test_a_reader_waits_until_a_frame_is_due_or_the_timeout():
    """Runs in real time, as waiting for the shared clock cannot be observed on another one."""
    source = Numbers(speed=0.1)
    source.read(1.0)
    began = perf_counter()
    assert source.read(0.01) is None
    while (frame := source.read(1.0)) is None:
        pass
    assert perf_counter() - began >= 0.09 and frame.time >= 0.01
    source.close()


def test_late_frames_are_dropped_and_counted():
    source = Numbers()
    source.pace = EagerClock()
    source.read(1.0)
    source.pace.time += 0.055
    late = source.read(1.0)
    assert late.dropped == 4 and late.image[0, 0, 0] == 5


def test_a_slow_source_is_played_slowly_without_growing_delay():
    class Slow(Numbers):
        pace = EagerClock()

        def frames(self):
            for frame in super().frames():
                self.pace.time += 0.15
                yield frame

    source = Slow(loop=True)
    dropped = []
    for _ in range(12):
        source.pace.time += 0.05  # what is done with a frame
        dropped.append(source.read(0.0).dropped)
    assert max(dropped) <= 1


def test_a_loop_has_increasing_times():
    source = Numbers(loop=True, speed=5.0)
    frames = played(source, 25)
    assert source.opened >= 3 and not source.ended
    times = np.array([frame.time for frame in frames])
    assert np.all(np.diff(times) > 0)
    shown = [int(frame.image[0, 0, 0]) for frame in frames]
    np.testing.assert_allclose(times, [round(time * 100) / 100 for time in times], atol=1e-9)
    assert [round(time * 100) % 10 for time in times] == shown


def test_closing_wakes_a_reader_and_ends_the_source():
    source = VideoPlayer(SAMPLE, speed=0.05)
    source.read(1.0)
    source.close()
    assert source.read(1e6) is None
    source.close()


def test_images_in_a_folder_are_played_by_name(tmp_path):
    for index in (2, 0, 1):
        cv2.imwrite(str(tmp_path / f"face{index}.png"), np.full((4, 4, 3), 50 * index, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    frames = played(PicturePlayer(tmp_path, rate=20.0))
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [0, 50, 100]
    assert [frame.time for frame in frames] == pytest.approx([0.0, 0.05, 0.1])


def test_unreadable_images_are_skipped_unless_all_are(tmp_path):
    (tmp_path / "face1.png").write_text("no picture")
    with pytest.raises(SourceError, match="cannot be read as an image"):
        PicturePlayer(tmp_path).read(1.0)
    for index in (0, 2):
        cv2.imwrite(str(tmp_path / f"face{index}.png"), np.full((4, 4, 3), 50 * index, np.uint8))
    frames = played(PicturePlayer(tmp_path, rate=20.0))
    assert [int(frame.image[0, 0, 0]) for frame in frames] == [0, 100]
    assert [frame.time for frame in frames] == pytest.approx([0.0, 0.1])


def test_a_take_is_played_without_images():
    take = performance()
    frames = played(TakePlayer(take, "take", speed=20.0))
    assert all(frame.image_size == tuple(take.info["image_size"]) for frame in frames)
    assert all(frame.image is None for frame in frames)
    last = frames[-1]
    index = int(np.argmin(np.abs(take.times - take.times[0] - last.time)))
    np.testing.assert_array_equal(last.result.landmarks, take.landmarks[index])


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (lambda folder: VideoPlayer(folder / "none.mp4"), "There is no file"),
        (lambda folder: VideoPlayer(folder / "broken.mp4"), "cannot be read as a video"),
        (lambda folder: PicturePlayer(folder / "none"), "There is no folder"),
        (PicturePlayer, "There are no images"),
    ],
)
def test_a_source_that_cannot_be_played_raises_an_error_and_is_retried(tmp_path, source, said):
    (tmp_path / "broken.mp4").write_bytes(b"nothing")
    opened = source(tmp_path)
    for _ in range(2):
        with pytest.raises(SourceError, match=said):
            opened.read(0.1)
    opened.close()


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), 1e9])
def test_an_impossible_speed_is_refused(speed):
    with pytest.raises(SourceError, match="speed"):
        VideoPlayer(SAMPLE, speed=speed)
