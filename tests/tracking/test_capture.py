"""Clips that judge: without rigid motion, unknown vertices kept apart, and rigid motion that is not there left alone."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.performance import simulated_performance
from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_poses
from riginv.evaluation.optimum import find_optima
from riginv.evaluation.results import evaluate_controls
from riginv.geometry.kinematics import apply_motion
from riginv.reproduce.preflight import check_capture
from riginv.reproduce.sets import CaptureSource, SetSizes, mesh_sets
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_sets import WeightedShapes
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.solvers.objective import PRIOR, Objective
from riginv.tracking.anchors import Anchors
from riginv.tracking.capture import content_key, open_capture
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.rigid_check import RigidCheck, check_rigid
from riginv.tracking.stability import stability_weights
from tests.conftest import ROOT
from tests.support.clips import obj_sequence, performance, write_npz
from tests.support.toys import ToyRig
from tests.tracking.test_inversion import tumbled

TOY = ("rig=toy", f"--config-dir={ROOT / 'tests/conf'}")
FRAMES = 24


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


@pytest.fixture(scope="module")
def meshes(rig) -> torch.Tensor:
    return torch.tensor(performance(rig, FRAMES), dtype=torch.float32)


def captured(path, rig, **frames):
    return open_capture(str(path), rig, rig, ReadingOptions(), FrameOptions(**frames))


def written(path, meshes, rig):
    return write_npz(path, meshes.numpy(), rig.faces.numpy())


@pytest.mark.usefixtures("own_cache")
def test_a_clip_that_stands_still_is_taken_as_it_is(rig, meshes, tmp_path):
    found = captured(written(tmp_path / "a.npz", meshes, rig), rig)
    assert torch.equal(found.vertices(0, FRAMES), meshes) and found.known(0, 3) is None
    assert (found.name, found.fps, len(found)) == ("capture", 24, FRAMES) and found.motion is None


@pytest.mark.usefixtures("own_cache")
def test_rigid_motion_is_taken_out_and_said(rig, meshes, tmp_path):
    world, _ = tumbled(meshes)
    found = captured(written(tmp_path / "a.npz", world, rig), rig)
    assert (found.vertices(0, FRAMES) - meshes).norm(dim=2).mean() < 0.05
    assert (found.vertices(5, 8) - found.vertices(0, FRAMES)[5:8]).abs().max() == 0
    assert any("rigid motion was removed" in note for note in found.notes)


@pytest.mark.usefixtures("own_cache")
def test_what_is_not_known_counts_for_no_error(rig, meshes, tmp_path):
    holes = meshes.clone()
    holes[3, 10:60], holes[7], holes[9, :, 1] = torch.nan, torch.nan, torch.nan
    found = captured(written(tmp_path / "a.npz", holes, rig), rig, exclude=[12])
    assert found.frame_numbers.tolist() == [frame for frame in range(FRAMES) if frame not in (7, 9, 12)]
    assert "left out: 3 of 24" in found.notes[-1]
    whole, known = found.vertices(0, len(found)), found.known(0, len(found))
    assert torch.isfinite(whole).all() and (~known).sum() == 50 and not known[3, 10:60].any()
    assert (whole[3] - meshes[3]).norm(dim=1).mean() < 0.1  # the rig's own mesh stands in
    neutral = rig.neutral_controls.repeat(len(found), 1)
    result = evaluate_controls(rig, found, neutral)
    distances = (rig.rest_vertices - whole).norm(dim=2)
    assert result.metrics["capture/mean_vertex_error_mm"] == pytest.approx(float(distances[known].mean()), rel=1e-5)
    assert result.metrics["capture/max_vertex_error_mm"] == pytest.approx(float(distances[known].max()), rel=1e-5)
    assert result.errors_mm[3] == pytest.approx(float(distances[3][known[3]].mean()), rel=1e-5)
    assert torch.isfinite(find_optima(rig, [found])["capture"].errors_mm).all()


@pytest.mark.usefixtures("own_cache")
def test_a_clip_of_which_nothing_is_known_is_refused(rig, meshes, tmp_path):
    gone = meshes.clone()
    gone[1:] = torch.nan
    with pytest.raises(InputError, match="no frame has enough known vertices"):
        captured(written(tmp_path / "a.npz", gone, rig), rig, exclude=[0], last=5, first=0)


def test_sets_of_other_frames_have_other_keys(rig):
    clips = [
        WeightedShapes("a", rig.rest_vertices, rig.basis[:2], torch.rand(4, 2, generator=generator_at(0, "key")), fps)
        for fps in (24, 25)
    ]
    assert content_key(clips[0]) != content_key(clips[1]) and len(content_key(clips[0])) == 64


@pytest.mark.parametrize("command", ["train", "compare"])
def test_commands_judge_on_any_clip(command, run, rig, meshes, tmp_path):
    world, _ = tumbled(meshes / 10)
    world[4, 20:30] = torch.nan
    pattern = obj_sequence(tmp_path / "shot", np.nan_to_num(world.numpy(), nan=0.0), rig.faces.numpy())
    npz = written(tmp_path / "take.npz", world, rig)
    for clip in (pattern, npz):
        more = ["reading.unit=cm", "frames.exclude=[2]"] if clip == npz else ["frames.last=1010", "frames.exclude=[1005]"]
        given = [
            f"capture={clip}",
            *more,
            *(["model.network.hidden=[8]"] if command == "train" else [*TOY, "methods=[neutral]", "poses=4"]),
        ]
        outcome = run(command, *given, folder=f"{command}{clip == npz}")
        assert outcome.code == 0, outcome.text
        assert "rigid motion was removed" in outcome.text and "note:" in outcome.text
        if command == "train":
            errors = [value for key, value in outcome.metrics.items() if key.startswith("capture/") and "error" in key]
            assert len(errors) >= 4 and all(np.isfinite(errors)) and outcome.metrics["capture/roughness"] >= 0
    if command == "train":
        again = run("evaluate", f"bundle={outcome.folder}", TOY[0], TOY[1], *given[:3], "poses=4", folder="again")
        assert again.code == 0, again.text
        key = "capture/mean_vertex_error_mm"
        assert again.metrics[key] == pytest.approx(outcome.metrics[key], rel=1e-4)


@pytest.mark.usefixtures("own_cache")
def test_a_reproduction_takes_any_clip(rig, meshes, tmp_path):
    world, _ = tumbled(meshes)
    world[3, 10:60], world[7] = torch.nan, torch.nan
    path = str(written(tmp_path / "a.npz", world, rig))
    source = CaptureSource(path, ReadingOptions(unit="mm"), FrameOptions(last=20))
    key, captured = check_capture(source, rig)
    assert len(key) == 64 and any("rigid motion was removed" in note for note in captured.notes)
    sets = mesh_sets(SetSizes(6, 5), source, rig)
    clip, spread = sets["clip"], sets["captured"]
    assert (len(clip), clip.fps, len(spread), spread.fps) == (5, 24, 6, None)
    assert clip.frame_numbers.tolist() == [8, 9, 10, 11, 12] and clip.known(0, 5).all()
    assert (clip.vertices(0, 5) - meshes[8:13]).norm(dim=2).mean() < 0.05
    with pytest.raises(InputError, match="2 frames, expected at least 3"):
        check_capture(replace(source, frames=FrameOptions(last=1)), rig)


def test_advice_about_captures_is_right_for_any_rig(run):
    outcome = run("train", "model.network.hidden=[8]")
    assert "generated, as no clip was given (capture=CLIP)" in " ".join(outcome.text.split())
    assert "TAKE.csv" not in outcome.text and "mm from neutral" in outcome.text


def solver(rig: LinearRig, space: RigInMeshSpace) -> SolverEstimator:
    held = FixedControlsRig(rig, torch.arange(len(rig.controls)), rig.neutral_controls)
    return SolverEstimator(Objective(RigInMeshSpace(held, space.space), PRIOR), None, 30, 1, 0)


class Frames:
    """Meshes at hand, as a clip."""

    def __init__(self, meshes: torch.Tensor) -> None:
        self.meshes = meshes

    def __len__(self) -> int:
        return len(self.meshes)

    def vertices(self, start: int, stop: int) -> torch.Tensor:
        return self.meshes[start:stop]


def slight(count: int, mm: float, degrees: float) -> torch.Tensor:
    """Random motions of up to so many mm and degrees, `(frame, 4, 4)`."""
    generator = generator_at(0, "slight")
    axes, ways = torch.nn.functional.normalize(torch.randn(2, count, 3, generator=generator), dim=2)
    sizes = 0.3 + 0.7 * torch.rand(2, count, 1, generator=generator)
    motion = torch.eye(4).repeat(count, 1, 1)
    motion[:, :3, :3] = roma.rotvec_to_rotmat(axes * torch.deg2rad(degrees * sizes[0]))
    motion[:, :3, 3] = mm * sizes[1] * ways
    return motion


def check(rig: LinearRig, space: RigInMeshSpace, meshes: torch.Tensor) -> RigidCheck:
    return check_rigid(Frames(meshes), rig, solver(rig, space), Anchors(rig, stability_weights(rig)), None, 12)


@pytest.mark.parametrize("noise_mm", [0.0, 0.1, 0.5])
def test_a_clip_within_its_own_noise_is_left_alone(noise_mm, toy):
    for meshes in (
        random_poses(toy.source, FRAMES).vertices(0, FRAMES),
        simulated_performance(toy.source).vertices(100, 100 + FRAMES),
    ):
        noisy = meshes + noise_mm * torch.randn(meshes.shape, generator=generator_at(0, "capture noise"))
        found = check(toy.source, toy, noisy)
        assert not found.moves and "no rigid motion found" in found.note, found


@pytest.mark.parametrize("size", [(0.5, 0.5), (0.5, 0.0), (0.0, 0.5), (0.0, 0.2), (200.0, 60.0)])
def test_motion_that_is_there_is_found_however_small(size, toy):
    still = random_poses(toy.source, FRAMES).vertices(0, FRAMES)
    assert check(toy.source, toy, apply_motion(slight(FRAMES, *size), still)).moves


def test_motion_of_a_few_frames_and_of_all_alike_is_found(toy):
    still = random_poses(toy.source, FRAMES).vertices(0, FRAMES)
    few = still.clone()
    few[5:8] = apply_motion(slight(3, 20, 10), few[5:8])
    assert check(toy.source, toy, few).moves
    assert check(toy.source, toy, still + torch.tensor([0.4, 0.0, 0.0])).moves


@pytest.mark.slow
@torch.no_grad()
def test_the_faces_own_noise_is_no_motion(face, face_in_space):
    """What its ARKit shapes make and the rig cannot: fitted motions went 0.05 to 0.1 mm there."""
    acted = simulated_performance(face).vertices(300, 312)
    found = check(face, face_in_space, acted)
    assert not found.moves and found.extent_mm < 0.2
    assert check(face, face_in_space, apply_motion(slight(12, 0.5, 0.5), acted)).moves


def test_invert_leaves_alone_what_does_not_move_and_says_so(run, rig, meshes, tmp_path):
    plain = ("look.page=false", "look.sheet=false", "method=levenberg_marquardt")
    written(tmp_path / "still.npz", meshes, rig)
    written(tmp_path / "slight.npz", apply_motion(slight(FRAMES, 0.5, 0.5), meshes), rig)
    still = run("invert", *TOY, *plain, "clip=still.npz", "out=a")
    assert still.code == 0 and "no rigid motion found" in still.text and "was removed" not in still.text
    assert "motion" not in json.loads((tmp_path / "a/curves.json").read_text())
    slightly = run("invert", *TOY, *plain, "clip=slight.npz", "out=b")
    assert slightly.code == 0 and "Rigid motion was removed" in slightly.text
    forced = run("invert", *TOY, *plain, "clip=still.npz", "out=c", "motion=remove")
    assert forced.code == 0 and "Rigid motion was removed" in forced.text


def test_invert_says_what_neutral_and_the_best_would_be(run, rig, meshes, tmp_path):
    written(tmp_path / "take.npz", meshes, rig)
    outcome = run("invert", *TOY, "look.sheet=false", "clip=take.npz", "out=o", "motion=keep")
    assert outcome.code == 0, outcome.text
    assert "neutral pose" in outcome.text and "Lowest possible mean error on 8 frames" in outcome.text
    rows = list(csv.DictReader((tmp_path / "o/frames.csv").read_text().splitlines()))
    neutral = (rig.rest_vertices - meshes).norm(dim=2).mean(dim=1)
    np.testing.assert_allclose([float(row["neutral_error_mm"]) for row in rows], neutral, rtol=1e-4)
    least = [row for row in rows if row["least_error_mm"]]
    assert len(least) == 8 and all(float(row["least_error_mm"]) <= float(row["mean_error_mm"]) + 1e-6 for row in least)
    errors = json.loads((tmp_path / "o/curves.json").read_text())["errors"]
    assert errors["neutral_mean_error_mm"] == pytest.approx(float(neutral.mean()), rel=1e-4)
    assert errors["least_mean_error_mm"] <= errors["mean_error_there_mm"] + 1e-6
    assert errors["least_error_frames"] == [int(row["frame"]) for row in least]
    assert "mm at neutral" in (tmp_path / "o/look.html").read_text()


def test_a_rig_that_no_gradient_passes_has_no_least_error(run, rig, meshes, tmp_path):
    written(tmp_path / "take.npz", meshes[:6], rig)
    options = (
        "rig=black_box",
        TOY[1],
        "mesh_space.samples=60",
        "mesh_space.residual_mm=0.5",
        "look.page=false",
        "look.sheet=false",
    )
    outcome = run("invert", *options, "clip=take.npz", "out=o", "method=levenberg_marquardt")
    assert outcome.code == 0, outcome.text
    assert "neutral pose" in outcome.text and "Lowest possible" not in outcome.text
