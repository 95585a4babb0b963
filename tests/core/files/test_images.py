"""Images are read within bounds or refused with a message, and an invalid one does not affect others in its folder."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from facemime.cli.main import main
from facemime.core.errors import OutputError, SourceError
from facemime.core.files.capture import IMAGE_SUFFIXES, read_image, write_image
from facemime.core.files.media_headers import stated_size
from facemime.core.files.orientation import webp_orientation
from facemime.core.puppet.sources import PicturePlayer


def encoded(suffix: str, width: int = 53, height: int = 37, *options: int) -> bytes:
    shape = (height, width) if suffix == ".pgm" else (height, width, 3)
    return bytes(cv2.imencode(suffix, np.random.default_rng(3).integers(0, 255, shape, np.uint8), options)[1])


def claiming(width: int, height: int) -> bytes:
    """A PNG of 65 bytes that states a size."""

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize("suffix", sorted(IMAGE_SUFFIXES))
def test_the_size_of_an_image_is_known_before_it_is_decoded(suffix, tmp_path):
    data = encoded(suffix)
    assert stated_size(data) == (53, 37)
    (tmp_path / f"a{suffix}").write_bytes(data)
    assert read_image(tmp_path / f"a{suffix}").shape == (37, 53, 3)


@pytest.mark.parametrize(
    ("suffix", "options"),
    [
        (".webp", (cv2.IMWRITE_WEBP_QUALITY, 101)),
        (".jpg", (cv2.IMWRITE_JPEG_PROGRESSIVE, 1)),
        (".ppm", (cv2.IMWRITE_PXM_BINARY, 0)),
    ],
)
def test_the_size_of_other_formats_is_known_too(suffix, options):
    assert stated_size(encoded(suffix, 53, 37, *options)) == (53, 37)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize("compression", [(), (cv2.IMWRITE_TIFF_COMPRESSION, 1), (cv2.IMWRITE_TIFF_COMPRESSION, 8)])
def test_a_tiff_of_floating_point_numbers_has_white_at_1_and_black_at_0(tmp_path, kind, channels, compression, capfd):
    grey = np.linspace(0.0, 1.0, 60 * channels).reshape(1, 60, channels).repeat(40, axis=0).astype(kind)
    (tmp_path / "a.tif").write_bytes(bytes(cv2.imencode(".tif", grey, compression)[1]))
    image = read_image(tmp_path / "a.tif")
    wanted = grey[..., :3] if channels > 1 else grey.repeat(3, axis=2)
    # Without a compression, OpenCV writes three channels as logarithms.
    assert image.shape == (40, 60, 3) and np.abs(image - 255.0 * wanted).mean() < 2.5
    assert capfd.readouterr() == ("", "")


def test_numbers_of_a_tiff_beyond_white_are_white_and_others_that_are_none_black(tmp_path):
    odd = np.zeros((8, 8, 3), np.float32)
    odd[0], odd[1], odd[2], odd[3] = 7.0, -3.0, np.nan, np.inf
    (tmp_path / "a.tif").write_bytes(bytes(cv2.imencode(".tif", odd, (cv2.IMWRITE_TIFF_COMPRESSION, 1))[1]))
    assert read_image(tmp_path / "a.tif")[:4, 0, 0].tolist() == [255, 0, 0, 255]


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_tiff_of_16_bits_keeps_its_brightness(tmp_path, channels):
    grey = np.full((20, 30, channels), 0.5 * 65535, np.uint16)
    (tmp_path / "a.tif").write_bytes(bytes(cv2.imencode(".tif", grey)[1]))
    assert np.abs(read_image(tmp_path / "a.tif") - 127.5).max() < 2.0


@pytest.mark.parametrize("suffix", sorted(IMAGE_SUFFIXES))
def test_a_truncated_image_is_read_or_refused(suffix, tmp_path):
    data = encoded(suffix)
    for cut in [*range(60), len(data) // 2, len(data) - 1]:
        (tmp_path / "cut").write_bytes(data[:cut])
        try:
            assert read_image(tmp_path / "cut").size
        except SourceError as error:
            assert "cannot be read as an image" in str(error)


@pytest.mark.parametrize(("width", "height"), [(100_000, 100_000), (16_384, 16_384), (100_000, 10), (2**31 - 1, 1)])
def test_an_image_that_is_too_large_is_refused_with_its_size(tmp_path, width, height):
    (tmp_path / "large.png").write_bytes(claiming(width, height))
    with pytest.raises(SourceError, match=f"is {width} x {height} pixels; the limit is 100 megapixels"):
        read_image(tmp_path / "large.png")


def test_a_real_image_that_is_too_wide_is_refused(tmp_path):
    (tmp_path / "wide.png").write_bytes(encoded(".png", 100_000, 2))
    with pytest.raises(SourceError, match="30000 pixels per side"):
        read_image(tmp_path / "wide.png")


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"GIF89a", b"BM", b"RIFF....WEBPVP8 ", b"P6\n9 9 255\n", b"II*\0\xff\xff\xff\xff"]
)
def test_files_that_are_not_images_are_refused(tmp_path, content):
    (tmp_path / "odd.png").write_bytes(content)
    with pytest.raises(SourceError, match="cannot be read as an image"):
        read_image(tmp_path / "odd.png")


@pytest.fixture
def folder(tmp_path) -> Path:
    """Two valid images, and between them some that make OpenCV fail."""
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    for name in ("a.png", "z.png"):
        (pictures / name).write_bytes(encoded(".png", 80, 60))
    (pictures / "b.png").write_bytes(claiming(100_000, 100_000))
    (pictures / "c.png").write_bytes(encoded(".png", 100_000, 2))
    (pictures / "d.png").write_bytes(b"hello")
    return pictures


def test_unreadable_images_in_a_folder_are_reported_and_the_others_processed(folder, tmp_path, capsys):
    assert main(["landmarks", str(folder), "-o", str(tmp_path / "out.npz")]) == 1
    told = capsys.readouterr().err
    assert told.count("facemime: ") >= 3 and "100000 x 100000" in told and "d.png cannot be read as an image" in told
    with np.load(tmp_path / "out.npz") as out:
        assert out["names"].tolist() == ["a.png", "b.png", "c.png", "d.png", "z.png"]


def test_unreadable_images_are_skipped_when_a_folder_is_played(folder):
    assert len(list(PicturePlayer(folder).frames())) == 2


def test_an_image_that_is_too_large_for_its_format_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"cannot hold 70000 x 1 pixels\. Use the suffix \.png"):
        write_image(tmp_path / "wide.jpg", np.zeros((1, 70_000, 3), np.uint8))
    assert not list(tmp_path.iterdir())


def stated(orientation: int, order: str) -> bytes:
    """EXIF data that states an orientation, in an order of bytes of `struct`."""
    head = b"II*\0" if order == "<" else b"MM\0*"
    entries = struct.pack(order + "HHIHH", 0x0100, 3, 1, 64, 0) + struct.pack(
        order + "HHIHH", 0x0112, 3, 1, orientation, 0
    )
    return head + struct.pack(order + "IH", 8, 2) + entries + bytes(4)


def chunk(name: bytes, content: bytes) -> bytes:
    """A chunk of a WebP file."""
    return name + struct.pack("<I", len(content)) + content + bytes(len(content) % 2)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("prefix", [b"", b"Exif\0\0"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_webp_image_is_upright_as_a_jpeg_with_the_same_exif_data_is(tmp_path, orientation, prefix, order):
    image = np.zeros((48, 64, 3), np.uint8)
    image[:16], image[16:, :16] = 255, 128
    exif = stated(orientation, order)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    marker = b"\xff\xe1" + struct.pack(">H", 8 + len(exif)) + b"Exif\0\0" + exif
    (tmp_path / "a.jpg").write_bytes(jpeg[:2] + marker + jpeg[2:])
    pixels = cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()[12:]
    canvas = bytes([8, 0, 0, 0]) + (63).to_bytes(3, "little") + (47).to_bytes(3, "little")
    chunks = b"WEBP" + chunk(b"VP8X", canvas) + pixels + chunk(b"EXIF", prefix + exif)
    (tmp_path / "a.webp").write_bytes(b"RIFF" + struct.pack("<I", len(chunks)) + chunks)
    jpeg_image, webp_image = read_image(tmp_path / "a.jpg"), read_image(tmp_path / "a.webp")
    assert webp_image.shape == jpeg_image.shape == ((48, 64, 3) if orientation < 5 else (64, 48, 3))
    assert np.abs(webp_image.astype(int) - jpeg_image).mean() < 4.0


@pytest.mark.parametrize(
    "content",
    [b"", b"Exif\0\0", b"II*\0", stated(0, "<"), stated(9, "<"), stated(6, "<")[:20], b"II*\0" + b"\xff" * 40],
)
def test_damaged_exif_data_of_a_webp_image_turns_nothing(content):
    data = b"RIFF" + bytes(4) + b"WEBP" + chunk(b"VP8L", bytes(7)) + chunk(b"EXIF", content)
    assert webp_orientation(data) == 1 == webp_orientation(data[:40])
