"""Fixtures: every test starts from an empty file with factory settings."""

import gc
import signal
import threading
from dataclasses import replace

import bpy
import pytest

import facemime
from facemime.blender import rendering
from facemime.blender.frames import to_blender
from facemime.blender.heads.new_heads import add_head
from facemime.blender.meshes import read_landmarks
from facemime.core.puppet.sources import PacedSource
from facemime.core.takes.file import save_take
from facemime.core.takes.neutral import calibrate
from facemime.sessions.session import Session
from facemime.sessions.start import start_session
from facemime.settings import storage
from facemime.settings.performers import write_calibration
from tests.helpers.clocks import AskedClock
from tests.helpers.face_rigs import make_face_rig
from tests.helpers.owners import UNDER_WINE
from tests.helpers.scans import scanned
from tests.helpers.takes import performance

_ENDING = 20
"""Seconds until a Blender that hangs on exit, as 4.5 as a module does if its thread that closes files has started, is
killed."""


def pytest_unconfigure(config):
    """Let the system kill the process after the tests, as no Python code runs if Blender hangs on exit."""
    if hasattr(signal, "alarm"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_ENDING)


@pytest.fixture(scope="session", autouse=True)
def _own_documents(tmp_path_factory):
    """Keep files out of the documents and the settings of whoever runs the tests."""
    folder = tmp_path_factory.mktemp("documents")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(storage, "documents", lambda: folder)
        yield


@pytest.fixture(scope="session", autouse=True)
def _registered(_own_documents):
    """Register the extension, and unregister it at the end: Blender crashes if it exits with classes registered."""
    facemime.register()
    gc.collect()
    gc.freeze()  # collecting garbage need not look at the modules each time
    yield
    facemime.unregister()


@pytest.fixture(autouse=True)
def _empty_file(_registered):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


@pytest.fixture(scope="session", autouse=True)
def _pictures_where_they_can_be_drawn():
    """Skip tests that render under wine, which has no graphics here and would crash."""
    with pytest.MonkeyPatch.context() as patch:
        if UNDER_WINE:
            patch.setattr(rendering, "_rendered", lambda *_: pytest.skip("wine draws no pictures"))
        yield


@pytest.fixture(autouse=True)
def _frames_come_when_asked(monkeypatch):
    monkeypatch.setattr(PacedSource, "pace", AskedClock())


@pytest.fixture
def at_the_takes_rate():
    """Set the frame rate to the take's, as caches hold whole frames."""
    bpy.context.scene.render.fps = 25


@pytest.fixture
def true():
    """The landmarks of the built-in head."""
    return read_landmarks(add_head(bpy.context))


@pytest.fixture
def rigged():
    """A head on a made rig, which is active."""
    bpy.context.scene.render.fps = 25
    head, armature = make_face_rig()
    bpy.context.view_layer.objects.active = head
    bpy.context.view_layer.update()
    return head, armature


@pytest.fixture
def nothing_left_over():
    """Check that no session, thread, recording or modal operator is left."""
    yield
    if Session.current is not None:
        Session.current.close()
    Session.current = None
    gc.collect()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("facemime")]


@pytest.fixture(scope="session")
def kept(tmp_path_factory):
    """Make objects that take long, once; later tests append them from a file."""
    folder = tmp_path_factory.mktemp("kept")

    def get(name, make):
        path = folder / f"{name}.blend"
        if not path.exists():
            made = make()
            bpy.data.libraries.write(str(path), set(made))
            return made
        with bpy.data.libraries.load(str(path)) as (stored, loaded):
            loaded.objects = stored.objects
        for obj in loaded.objects:
            bpy.context.scene.collection.objects.link(obj)
        return loaded.objects

    return get


@pytest.fixture
def scan(kept):
    """An active scan with landmarks."""
    return _active(kept("Scan", lambda: [_bound("Scan", *scanned())]))


@pytest.fixture
def coarse_scan(kept):
    """The same scan with a ninth of the vertices."""
    return _active(kept("Coarse Scan", lambda: [_bound("Coarse Scan", *scanned(0.06))]))


def _active(objects):
    (obj,) = objects
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    return obj


def _bound(name, places, faces):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(to_blender(places).tolist(), [], faces.tolist())
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    _active([obj])
    assert bpy.ops.facemime.bind_landmarks() == {"FINISHED"}
    return obj


@pytest.fixture
def take(tmp_path):
    """A take as the source, played once without waiting."""
    path = tmp_path / "take.facetake"
    save_take(performance(), path)
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take = "TAKE", str(path)
    settings.source.loop, settings.source.speed, settings.smoothing = False, 20.0, 0.0
    write_calibration(settings, replace(calibrate(performance()), asked=True))
    return performance()


@pytest.fixture
def looping(take):
    """A take as the source, looped."""
    bpy.context.scene.facemime.source.loop = True


@pytest.fixture
def in_a_project(_empty_file, nothing_left_over, tmp_path):
    """Save the .blend file."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "project.blend"))
    bpy.context.scene.render.fps = 25


@pytest.fixture
def takes(in_a_project):
    """The list of takes."""
    return bpy.context.scene.facemime_takes


@pytest.fixture
def imported(tmp_path, takes):
    """A take that was imported into the list, of a face elsewhere in the image than that of the session."""
    take = performance()
    save_take(replace(take, landmarks=take.landmarks + 8.0), tmp_path / "First.facetake")
    assert bpy.ops.facemime.import_take(filepath=str(tmp_path / "First.facetake")) == {"FINISHED"}
    return takes.items[0]


@pytest.fixture
def session(in_a_project, tmp_path):
    """A live session that loops a take, as endless as a camera."""
    save_take(performance(), tmp_path / "source.facetake")
    settings = bpy.context.scene.facemime
    settings.source.kind, settings.source.take = "TAKE", str(tmp_path / "source.facetake")
    settings.source.loop, settings.source.speed = True, 10.0
    write_calibration(settings, replace(calibrate(performance()), asked=True))
    return start_session(bpy.context.scene, [add_head(bpy.context)])
