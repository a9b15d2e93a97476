"""Maps of markers proposed from a frame, places suggested for markers, and markers on the default face."""

import numpy as np
import pytest
import torch
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.markers.assembly import build_objective, marker_prior
from riginv.tracking.markers.layout import NOISE_MM, marker_skin, suggest_layout, unmarkable_controls
from riginv.tracking.markers.map_file import read_map, write_map
from riginv.tracking.markers.placement import Placement
from riginv.tracking.markers.proposing import at_common_height, propose
from riginv.tracking.markers.tracking import track_markers
from riginv.tracking.options import ControlOptions, SolverOptions, TrackingOptions
from riginv.tracking.priors.performances import default_prior
from riginv.tracking.surfaces.triangles import TriangleMesh
from tests.conftest import ROOT
from tests.support.markers import placed, write_csv
from tests.support.toys import ToyRig

CONF = f"{ROOT}/tests/conf"


@pytest.fixture(scope="module")
def layout(face) -> Placement:
    return suggest_layout(face, default_prior(face), 50, NOISE_MM, 3.0)


def test_suggested_places_are_on_the_skin_and_apart(face, layout):
    skin = marker_skin(face.rest_vertices.double().numpy(), face.faces.numpy())
    vertices = layout.corners[torch.arange(50), layout.barycentric.argmax(dim=1)]
    assert set(vertices.tolist()) <= set(skin.tolist())
    places = face.rest_vertices[vertices]
    assert float((torch.cdist(places, places) + 1e3 * torch.eye(50)).min()) > 3.0
    assert len(set(layout.names)) == 50


def test_gaze_and_tongue_are_hidden_from_markers(face):
    hidden = unmarkable_controls(face, default_prior(face).mean)
    names = {name for name, is_hidden in zip(face.control_names, hidden.tolist()) if is_hidden}
    assert names == {name for name in face.control_names if name.startswith(("eyeLook", "gaze", "tongue"))}


def test_exact_markers_do_not_turn_the_gaze_of_a_mesh_that_the_rig_cannot_make(face, layout):
    deltas = face.arkit_deltas()
    truth = face.rest_vertices + 0.5 * (deltas["eyeBlinkLeft"] + deltas["eyeBlinkRight"] + deltas["eyeSquintLeft"])[None]
    controls = face.neutral_controls.clone()
    controls[face.control_names.index("gazeHorizontal")] = 1.0
    eyes = (face(controls[None])[0] - face.rest_vertices).norm(dim=1) > 3
    options = TrackingOptions(correspondence="markers", markers="-", noise_mm=0.1)
    errors = []
    for prior in (default_prior(face), marker_prior(face, default_prior(face), 0.1)):
        objective = build_objective(face, layout, resolve_constraints(face, ControlOptions()), prior, False, options)
        found = track_markers(objective, layout.points(truth), torch.arange(1), SolverOptions(), 0.1)
        errors.append(float((face(found.controls) - truth)[:, eyes].norm(dim=2).mean()))
    assert errors[1] < 0.6 * errors[0], errors


def test_a_smile_is_recovered_on_the_default_face(face, layout):
    controls = face.neutral_controls.repeat(12, 1)
    for name in ("mouthSmileLeft", "mouthSmileRight", "jawOpen"):
        controls[:, face.control_names.index(name)] = torch.linspace(0, 0.6, 12)
    truth = face(controls)
    points = layout.points(truth) + 0.3 * torch.randn(12, 50, 3)
    points[torch.rand(12, 50) < 0.1] = torch.nan
    options = TrackingOptions(correspondence="markers", markers="-")
    constraints = resolve_constraints(face, ControlOptions())
    objective = build_objective(face, layout, constraints, default_prior(face), True, options)
    found = track_markers(objective, points, torch.arange(12), SolverOptions(), 0.3)
    errors, neutral = (face(found.controls) - truth).norm(dim=2).mean(), (face.rest_vertices - truth).norm(dim=2).mean()
    assert errors < 0.35 < 0.4 * neutral
    assert not found.stray.any() and not found.swapped.any()


@pytest.mark.slow
def test_a_map_is_proposed_from_a_neutral_frame_in_any_pose(face, layout):
    points = layout.points(face.rest_vertices).double().numpy() + np.random.default_rng(0).normal(0, 0.3, (50, 3))
    points = points @ Rotation.from_euler("xyz", [100, 15, -10], degrees=True).as_matrix().T + 300
    found = propose(face, layout.names, points, None, False, False)
    off = (found.placement.points(face.rest_vertices) - layout.points(face.rest_vertices)).norm(dim=1)
    assert off.mean() < 1.5 and off.max() < 3.5
    assert abs(float(found.placement.offset_mm.mean()) - 3) < 1


def test_a_map_is_proposed_by_anchors_from_the_command_line(run, tmp_path):
    rig = ToyRig()
    placement = placed(rig, 12, 2.0)
    turn = torch.tensor(Rotation.from_euler("xyz", [80, 20, 10], degrees=True).as_matrix(), dtype=torch.float32)
    points = (placement.points(rig.rest_vertices) @ turn.T + 40).numpy()
    write_csv(tmp_path / "take.csv", placement.names, np.stack([points, points + 1]) / 10)
    write_map(tmp_path / "some.yaml", placement.subset([0, 4, 7, 9]), rig)
    given = ("rig=toy", f"--config-dir={CONF}", "clip=take.csv", "frame=0", "out=map.yaml")
    done = run("markers", *given, "anchors=some.yaml")
    assert done.code == 0, done.text
    found = read_map(tmp_path / "map.yaml", rig)
    off = (found.points(rig.rest_vertices) - placement.points(rig.rest_vertices)).norm(dim=1)
    assert found.names == placement.names and off.max() < 1.0
    assert (tmp_path / "map.png").stat().st_size > 1000
    again = run("markers", *given)
    assert again.code == 1 and "it is there already" in again.text


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ([], "give clip=TAKE.c3d"),
        (["clip=take.csv", "count=3"], "give clip=TAKE.c3d"),
        (["clip=take.csv", "frame=9"], "has frames 0 to 1"),
        (["clip=take.csv", "out=map.obj"], "ends in .yaml"),
        (["clip=none.csv"], "no such file"),
        (["clip=take.csv", "anchors=one.yaml"], "expected 3 at least"),
    ],
)
def test_a_map_that_cannot_be_made_is_told_in_a_sentence(run, tmp_path, more, said):
    rig = ToyRig()
    placement = placed(rig, 12)
    points = placement.points(rig.rest_vertices).numpy()
    write_csv(tmp_path / "take.csv", placement.names, np.stack([points, points]))
    write_map(tmp_path / "one.yaml", placement.subset([0]), rig)
    done = run("markers", "rig=toy", f"--config-dir={CONF}", "out=map.yaml", *more)
    assert done.code == 1 and said in " ".join(done.text.split()) and "Traceback" not in done.text
    assert not (tmp_path / "map.yaml").exists()


def test_places_are_suggested_from_the_command_line(run, tmp_path):
    many = run("markers", "rig=toy", f"--config-dir={CONF}", "count=5000", "out=many.yaml")
    assert many.code == 0 and "count=5000 would put them nearer to each other than 2% of the rig's size" in many.text
    done = run("markers", "rig=toy", f"--config-dir={CONF}", "count=5", "out=map.yaml")
    assert done.code == 0, done.text
    assert len(read_map(tmp_path / "map.yaml", ToyRig())) == 5


def test_a_marker_goes_to_the_lip_at_the_height_of_the_others_and_not_to_the_nearest_one():
    grid = np.stack(np.meshgrid(np.linspace(-20, 20, 21), np.linspace(0.2, 20.2, 11)), axis=2).reshape(-1, 2)
    faces = Delaunay(grid).simplices
    upper, lower = np.c_[grid, np.ones(len(grid))], np.c_[grid * (1, -1), np.zeros(len(grid))]
    strips = TriangleMesh(np.concatenate([upper, lower]), np.concatenate([faces, faces[:, ::-1] + len(grid)]))
    markers = np.array([(-9.0, -9.0, 2.0), (5.0, -12.0, 2.1), (7.0, 9.0, 3.0), (0.0, -0.3, 2.0)])
    nearest = strips.closest(markers)
    assert nearest.points[3, 2] == 1.0  # the other strip, which the marker does not belong to
    found = at_common_height(strips, markers, nearest)
    np.testing.assert_allclose(found.points[3], (0.0, -0.3, 0.0), atol=1e-9)
    np.testing.assert_allclose(found.points[[0, 1, 2]], nearest.points[[0, 1, 2]])
