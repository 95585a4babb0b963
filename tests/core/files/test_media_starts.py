"""When images and sound of a file start, and whether images are mirrored, from its headers."""

import struct
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from facemime.core.files.media_headers import SOUND, VIDEO, is_mirrored, last_image, read_starts, sound_lead
from tests.helpers.matroska import element


def box(name: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", 8 + len(data), name) + data


def track(handler: bytes, edits: list[tuple[int, int]], late: int = 0, *, mov: bool = False) -> bytes:
    """A track of 48,000 ticks per second; edits are durations in milliseconds and times in the media."""
    rows = b"".join(struct.pack(">Iihh", duration, media, 1, 0) for duration, media in edits)
    edit_list = box(b"edts", box(b"elst", struct.pack(">II", 0, len(edits)), rows)) if edits else b""
    header = box(b"mdhd", struct.pack(">IIIII", 0, 0, 0, 48_000, 0))
    offsets = box(b"ctts", struct.pack(">IIIi", 0, 1, 10, late))
    data_handler = box(b"hdlr", bytes(4) + b"dhlrurl ") if mov else b""
    media = box(b"minf", data_handler, box(b"stbl", offsets))
    kind = box(b"hdlr", bytes(4) + (b"mhlr" if mov else bytes(4)) + handler, bytes(12))
    return box(b"trak", edit_list, box(b"mdia", header, kind, media))


def movie(*tracks: bytes) -> bytes:
    header = box(b"mvhd", struct.pack(">IIIII", 0, 0, 0, 1000, 0))
    return box(b"ftyp", b"isom") + box(b"mdat", bytes(40)) + box(b"moov", header, *tracks)


def matroska(blocks: list[tuple[int, int, int]], *, unknown: bool = False) -> bytes:
    """A file with track 1 for images and 2 for sound; blocks are cluster, track and relative time, milliseconds."""
    entries = [element(0xAE, element(0xD7, bytes([n])) + element(0x83, bytes([n]))) for n in (1, 2)]
    info = element(0x1549A966, element(0x2AD7B1, (1_000_000).to_bytes(3, "big")))
    clusters = [
        element(
            0x1F43B675,
            element(0xE7, cluster.to_bytes(2, "big"))
            + element(0xA3, bytes([0x80 | number]) + struct.pack(">h", time) + bytes(9)),
            unknown=unknown,
        )
        for cluster, number, time in blocks
    ]
    content = info + element(0x1654AE6B, b"".join(entries)) + b"".join(clusters)
    return element(0x1A45DFA3, bytes(4)) + element(0x18538067, content, unknown=unknown)


FILES = {
    "late image": (movie(track(b"vide", [(480, -1), (2000, 0)]), track(b"soun", [(3000, 1024)])), 0.48, 0.0),
    "late sound": (movie(track(b"vide", [(2000, 0)]), track(b"soun", [(700, -1), (3000, 1024)])), 0.0, 0.7),
    "MOV": (movie(track(b"vide", [(480, -1), (2000, 0)], mov=True), track(b"soun", [], mov=True)), 0.48, 0.0),
    "reordered images": (movie(track(b"vide", [], late=4800), track(b"soun", [])), 0.1, 0.0),
    "Matroska": (matroska([(0, 2, 0), (400, 1, 80)]), 0.48, 0.0),
    "live WebM": (matroska([(0, 2, 10), (400, 1, 80)], unknown=True), 0.48, 0.01),
}


@pytest.mark.parametrize("kind", FILES)
def test_the_starts_of_images_and_sound_are_read(kind, tmp_path):
    content, image, sound = FILES[kind]
    path = tmp_path / "a.file"
    path.write_bytes(content)
    assert read_starts(path) == {VIDEO: pytest.approx(image), SOUND: pytest.approx(sound)}
    assert sound_lead(path) == pytest.approx(image - sound)


@pytest.mark.parametrize(
    "content", [b"", b"RIFF", b"\x1a\x45\xdf\xa3", box(b"ftyp", b"isom"), movie(track(b"vide", []))]
)
def test_a_file_that_states_none_has_no_lead(content, tmp_path):
    path = tmp_path / "a.file"
    path.write_bytes(content)
    assert sound_lead(path) == 0.0
    assert sound_lead(Path("no such file")) == 0.0


@pytest.mark.parametrize("unknown", [False, True])
def test_the_last_image_is_found_under_longer_sound_unless_the_file_was_cut(unknown, tmp_path):
    blocks = [(0, 2, 0), (400, 1, 80), (2000, 1, 40), (2000, 1, 0), (2000, 2, 0), (9000, 2, 0)]
    path, content = tmp_path / "a.mkv", matroska(blocks, unknown=unknown)
    path.write_bytes(content)
    assert last_image(path) == pytest.approx(1.56)
    path.write_bytes(content[:-6])
    assert last_image(path) is None
    path.write_bytes(movie(track(b"vide", [])))
    assert last_image(path) is None


@given(st.sampled_from([content for content, *_ in FILES.values()]), st.data())
def test_damaged_files_raise_nothing(content, data):
    damaged = bytearray(content[: data.draw(st.integers(0, len(content)))])
    for place in data.draw(st.lists(st.integers(0, max(len(damaged) - 1, 0)), max_size=8)):
        if damaged:
            damaged[place] = data.draw(st.integers(0, 255))
    with tempfile.NamedTemporaryFile() as file:
        file.write(bytes(damaged))
        file.flush()
        sound_lead(Path(file.name))
        last_image(Path(file.name))


def shown_by(name: bytes, version: int, a: int, d: int) -> bytes:
    """A header of a movie or a track with a matrix that has `a` and `d` on its diagonal."""
    before = {(b"mvhd", 0): 32, (b"tkhd", 0): 36, (b"mvhd", 1): 44, (b"tkhd", 1): 48}[name, version]
    matrix = struct.pack(">9i", a << 16, 0, 0, 0, d << 16, 0, 0, 0, 1 << 30)
    return box(name, bytes([version]), bytes(3 + before), matrix, bytes(24))


@pytest.mark.parametrize("version", [0, 1])
@pytest.mark.parametrize(
    ("whole", "track", "mirrored"),
    [
        ((1, 1), (1, 1), False),
        ((1, 1), (-1, -1), False),
        ((1, 1), (-1, 1), True),
        ((1, -1), (1, 1), True),
        ((-1, 1), (1, -1), False),
    ],
)
def test_the_matrices_of_the_movie_and_of_its_first_images_say_whether_they_are_mirrored(
    tmp_path, version, whole, track, mirrored
):
    path = tmp_path / "a.mov"

    def of_kind(handler: bytes, sides: tuple[int, int]) -> bytes:
        media = box(b"mdia", box(b"hdlr", bytes(8) + handler, bytes(12)))
        return box(b"trak", shown_by(b"tkhd", version, *sides), media)

    header = shown_by(b"mvhd", version, *whole)
    tracks = of_kind(b"soun", (1, -1)), of_kind(b"vide", track), of_kind(b"vide", (-track[0], track[1]))
    path.write_bytes(box(b"ftyp", b"qt  ") + box(b"moov", header, *tracks))
    assert is_mirrored(path) == mirrored
    path.write_bytes(box(b"ftyp", b"qt  ") + box(b"moov", header, of_kind(b"soun", (-1, 1))))
    assert not is_mirrored(path)


@pytest.mark.parametrize("form", [">f", ">d"])
@pytest.mark.parametrize(("yaw", "mirrored"), [(0.0, False), (180.0, True), (-180.0, True), (90.0, False)])
def test_a_flat_picture_of_matroska_that_is_seen_from_behind_is_mirrored(tmp_path, form, yaw, mirrored):
    path = tmp_path / "a.mkv"
    pose = element(0x7670, element(0x7671, b"\0") + element(0x7673, struct.pack(form, yaw)))
    track = element(0xAE, element(0xD7, b"\1") + element(0x83, b"\1") + element(0xE0, pose))
    path.write_bytes(element(0x1A45DFA3, bytes(4)) + element(0x18538067, element(0x1654AE6B, track)))
    assert is_mirrored(path) == mirrored
    path.write_bytes(path.read_bytes()[:-3])
    assert not is_mirrored(path)


@given(st.binary(max_size=200))
def test_damaged_headers_mirror_nothing(data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.mov"
        for start in (box(b"ftyp", b"qt  "), b"\x1a\x45\xdf\xa3"):
            path.write_bytes(start + data)
            assert is_mirrored(path) in (True, False)
