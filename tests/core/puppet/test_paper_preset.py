"""The method of Yao et al. 2019: every ingredient is a setting, and together they are a preset."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facemime.cli.main import main
from facemime.cli.options import Parser, add_preset_option, add_puppet_options, as_options, parse, puppet_job
from facemime.core.control_points.select import select_control_points
from facemime.core.control_points.selection import from_json
from facemime.core.deform.head_deformer import head_deformer
from facemime.core.deform.rbf import IncrementalDeformer, RBFDeformer
from facemime.core.drive.drive_settings import DriveSettings
from facemime.core.drive.driver import HeadDriver, drive_take
from facemime.core.errors import HeadError, SourceError
from facemime.core.face.landmarks import LOWER_LIDS, UPPER_LIDS, from_ibug
from facemime.core.heads.regions import LOWER, MIDDLE, membership, sharp_regions
from facemime.core.heads.rig import FaceParts, HeadRig, Part, built_in_head
from facemime.core.puppet.job import PuppetJob
from facemime.core.takes.file import save_take
from facemime.core.takes.neutral import calibrate
from facemime.core.takes.take import Take
from facemime.core.tracking.tracker import CASCADES, TrackingSettings
from tests.helpers.takes import make_take, performance

PAPER = DriveSettings(
    mode="planar",
    kernel="gaussian",
    only_landmarks=True,
    borders="sharp",
    exact=True,
    incremental=True,
    contact=False,
)
RIG = built_in_head()
POINTS = np.asarray(RIG.vertices, dtype=np.float64)[RIG.landmarks]


def job_of(*line: str) -> PuppetJob:
    parser = Parser()
    add_preset_option(parser)
    add_puppet_options(parser)
    return puppet_job(parse(parser, line), source=Path("a.mp4"), output=Path("b.blend"))


def blinking() -> Take:
    """A second at rest, followed by closing lids."""
    shapes = np.tile(POINTS / RIG.eye_distance, (40, 1, 1))
    for frame in range(30, 40):
        share = min((frame - 29) / 5.0, 1.0)
        shapes[frame, UPPER_LIDS] += share * (shapes[0, LOWER_LIDS] - shapes[0, UPPER_LIDS])
    return make_take(shapes)


def test_the_preset_sets_the_papers_method_and_options_override_it():
    assert job_of("--preset", "paper").settings.drive == PAPER
    for line in (
        ("--preset", "paper", "--mode", "3d", "--contact"),
        ("--mode", "3d", "--contact", "--preset", "paper"),
    ):
        assert job_of(*line).settings.drive == replace(PAPER, mode="3d", contact=True)
    assert job_of("--preset", "calm-speech").settings.smoothing == 1.5
    assert job_of().settings.drive == DriveSettings()


def test_a_given_model_completes_the_preset_and_reaches_the_processes_of_a_batch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    job = job_of("--preset", "paper", "--tracker-model", "face2.tracker")
    assert job.settings.tracking == TrackingSettings(CASCADES, str(tmp_path / "face2.tracker"))
    assert job_of(*as_options(job)).settings.tracking == job.settings.tracking
    assert job_of("--preset", "paper").settings.tracking == TrackingSettings(CASCADES)
    assert job_of("--tracker-model", "").settings.tracking == TrackingSettings()


@pytest.mark.parametrize(("text", "message"), [(None, "There is no preset"), ("{}", "not a Facemime preset")])
def test_a_preset_that_cannot_be_read_is_a_clear_error(tmp_path, text, message):
    path = tmp_path / "mine.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(SourceError, match=message):
        job_of("--preset", str(path))


def test_the_preset_drives_the_built_in_head_from_frame_to_frame():
    take = performance()
    driver = HeadDriver(RIG, calibrate(take), PAPER)
    assert isinstance(driver.deformer, IncrementalDeformer)
    moved = drive_take(driver, take).vertices
    wanted = np.stack([driver.retargeter.displacements(shape) for shape in take.shape[take.found]])
    np.testing.assert_allclose(moved[:, RIG.landmarks], wanted, atol=1e-6)
    assert np.abs(moved).max() > 1e-3


@pytest.mark.parametrize("contact", [True, False])
@pytest.mark.parametrize("kernel", ["informed", "gaussian"])
def test_planar_motion_keeps_the_depth_of_every_vertex_even_in_a_blink(kernel, contact):
    take = blinking()
    options = DriveSettings(mode="planar", kernel=kernel, contact=contact)
    frame = HeadDriver(RIG, calibrate(take, start=0.0), options).frame(take.result(39))
    np.testing.assert_array_equal(frame.vertices[:, 2], RIG.vertices[:, 2])
    assert np.abs(frame.vertices - RIG.vertices).max() > 1e-3


def test_lashes_keep_their_depth_in_planar_motion(character_with_lashes):
    rig, riding = character_with_lashes
    take = blinking()
    frame = HeadDriver(rig, calibrate(take, start=0.0), DriveSettings(mode="planar")).frame(take.result(39))
    np.testing.assert_array_equal(frame.vertices[riding, 2], rig.all_vertices[riding, 2])
    assert np.abs(frame.vertices[riding] - rig.all_vertices[riding]).max() > 1e-3


@pytest.fixture
def character_with_lashes() -> tuple[HeadRig, np.ndarray]:
    """The built-in head with a strip in front of its upper lid."""
    strip = POINTS[UPPER_LIDS] + (0.0, 0.0, -0.004)
    tips = strip + (0.0, -0.002, -0.006)
    first = len(RIG.vertices)
    quads = np.array([[0, 1, 5, 4], [2, 3, 7, 6]]) + first
    parts = np.full(first + 8, Part.SKIN, dtype=np.int8)
    parts[first:] = Part.ON_SKIN
    others = np.concatenate([strip, tips]).astype(np.float32)
    return replace(RIG, parts=FaceParts(parts, others, quads)), np.arange(first, first + 8)


def test_without_contact_lids_shut_along_a_line_and_with_it_over_the_eyeball():
    take = blinking()
    neutral = calibrate(take, start=0.0)
    slid, straight = (
        HeadDriver(RIG, neutral, DriveSettings(contact=contact)).frame(take.result(39)).vertices
        for contact in (True, False)
    )
    centre, radius = RIG.eyeballs[0, :3], RIG.eyeballs[0, 3]
    rest = np.linalg.norm(RIG.vertices - centre, axis=1)
    outside = (rest >= radius) & (RIG.region_weights.sum(axis=0) > 0)
    depth = [float((radius - np.linalg.norm(v - centre, axis=1)[outside]).max()) for v in (slid, straight)]
    assert depth[0] < 1e-5 < 1e-4 < depth[1]


def test_sharp_regions_are_sets_whose_borders_belong_to_both_sides():
    sharp = sharp_regions(RIG.region_weights, RIG.landmarks, RIG.faces)
    assert set(np.unique(sharp)) == {0.0, 1.0}
    np.testing.assert_array_equal(sharp.any(axis=0), np.asarray(RIG.region_weights).any(axis=0))
    np.testing.assert_array_equal(sharp[:, RIG.landmarks] > 0, membership())
    own = np.asarray(RIG.region_weights).argmax(axis=0)
    both = sharp.sum(axis=0) > 1
    assert 20 < both.sum() < 200
    edges = np.concatenate([RIG.faces[:, [i, (i + 1) % 4]] for i in range(4)])
    edges = edges[(edges >= 0).all(axis=1) & sharp.any(axis=0)[edges].all(axis=1)]
    crossing = edges[own[edges[:, 0]] != own[edges[:, 1]]]
    bound = np.isin(crossing, RIG.landmarks).any(axis=1)
    assert both[crossing[~bound]].any(axis=1).all()


def test_the_lips_and_the_lids_share_no_border():
    sharp = sharp_regions(RIG.region_weights, RIG.landmarks, RIG.faces)
    upper, lower = RIG.landmarks[from_ibug((61, 62, 63))], RIG.landmarks[from_ibug((65, 66, 67))]
    assert not sharp[LOWER, upper].any() and not sharp[MIDDLE, lower].any()


def test_without_faces_sharp_regions_are_the_largest_weights():
    sharp = sharp_regions(RIG.region_weights, RIG.landmarks, None)
    inner = np.setdiff1d(np.arange(len(RIG.vertices)), RIG.landmarks)
    assert sharp[:, inner].sum(axis=0).max() == 1.0


@pytest.mark.parametrize("borders", ["soft", "sharp"])
def test_an_exact_fit_meets_the_landmarks_where_the_paint_is_full(borders):
    rig = RIG
    if borders == "sharp":
        rig = replace(RIG, region_weights=sharp_regions(RIG.region_weights, RIG.landmarks, RIG.faces))
    within = np.flatnonzero(rig.region_weights[:, RIG.landmarks].max(axis=0) >= 1.0)
    moved = np.random.default_rng(0).normal(0.0, 0.002, (66, 3))
    errors = []
    for exact in (True, False):
        deformer = head_deformer(rig, "gaussian", exact=exact)
        found = (deformer.deform(moved) - deformer.rest)[RIG.landmarks]
        errors.append(np.abs(found - moved)[within].max())
    assert errors[0] < 1e-6 < 1e-5 < errors[1]


def test_an_ill_conditioned_fit_without_a_ridge_is_refused_with_advice():
    rng = np.random.default_rng(0)
    vertices = rng.uniform(size=(40, 3))
    with pytest.raises(HeadError, match="Turn off Exact Fit"):
        RBFDeformer(vertices, vertices[:20], np.ones((1, 40)), np.ones((1, 20), bool), sigma=9.0, regularisation=0.0)


def test_refitting_survives_control_points_that_meet():
    deformer = head_deformer(RIG, "gaussian", incremental=True, exact=True)
    shut = np.zeros((66, 3))
    shut[UPPER_LIDS] = POINTS[LOWER_LIDS] - POINTS[UPPER_LIDS]
    lips = from_ibug((50, 51, 52)), from_ibug((61, 62, 63))
    shut[lips[0]] = POINTS[lips[1]] - POINTS[lips[0]]
    for share in (0.5, 1.0, 1.0, 0.2):
        assert np.isfinite(deformer.deform(share * shut)).all()
    assert np.abs(deformer.deform(np.zeros((66, 3))) - deformer.rest).max() < 0.1


def test_the_papers_search_only_adds_points_and_needs_more_of_them():
    take = performance()
    ours, papers = (select_control_points(RIG, take, tolerance=0.004, search=search) for search in ("take", "paper"))
    assert papers.reached and papers.covariance is None
    assert {step.action for step in papers.steps} <= {"start", "add"}
    assert len(ours.landmarks) < len(papers.landmarks)
    assert papers.membership[0].sum() >= 12


def test_the_points_of_a_search_drive_the_head_by_the_papers_method():
    take = performance()
    chosen = select_control_points(RIG, take, tolerance=0.01, search="paper")
    rig = replace(RIG, control_points=chosen.membership, covariance=chosen.covariance)
    moved = drive_take(HeadDriver(rig, calibrate(take), PAPER), take).vertices
    all_points = drive_take(HeadDriver(RIG, calibrate(take), PAPER), take).vertices
    width = np.linalg.norm(np.subtract(*POINTS[from_ibug((0, 16))]))
    away = np.linalg.norm(moved - all_points, axis=2)[:, RIG.landmarks]
    assert 0.0 < away.max() < 0.05 * width


def test_the_command_selects_by_the_papers_search(tmp_path, capsys):
    save_take(performance(), tmp_path / "a.facetake")
    line = ["select", str(tmp_path / "a.facetake"), "-o", str(tmp_path / "a.json")]
    assert main([*line, "--preset", "paper"]) == 0
    assert "drop" not in capsys.readouterr().out
    assert from_json((tmp_path / "a.json").read_text()).covariance is None
    assert main([*line, "--preset", "paper", "--search", "take"]) == 0
    assert from_json((tmp_path / "a.json").read_text()).covariance is not None
