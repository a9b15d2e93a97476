"""From meshes to controls: rigid motion, missing vertices and what users want of controls, against what is known to be true."""

from typing import Any

import numpy as np
import pytest
import roma
import torch

from riginv.clips.clip import Clip
from riginv.clips.options import ReadingOptions
from riginv.clips.sequence import MeshSequence, Polygons
from riginv.clips.units import resolve_units
from riginv.config.typed import convert
from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.alternation import WindowInverter, interpolate_controls, interpolate_motion
from riginv.tracking.anchors import Anchors
from riginv.tracking.assembly import build_parts, build_solver
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.estimators import SolverEstimator
from riginv.tracking.fixed_controls import FixedControlsRig
from riginv.tracking.options import ControlOptions, SolverOptions, TrackingOptions, VertexOptions
from riginv.tracking.penalties import PenalisedObjective
from riginv.tracking.regions import label, regions_of, vertex_weights, weighted_space
from riginv.tracking.rigid import apply_motion, fit_rigid, remove_motion
from riginv.tracking.run import Inversion, invert_clip, invert_smoothly
from riginv.tracking.stability import has_root_controls, stability_weights
from tests.support.clips import performance
from tests.support.toys import ToyRig

GROUPS = {"controls": ControlOptions, "solver": SolverOptions, "vertices": VertexOptions}


class Given(MeshSequence):
    """Meshes that are at hand."""

    def __init__(self, meshes: torch.Tensor, faces: torch.Tensor, numbers: np.ndarray | None = None) -> None:
        numbers = np.arange(len(meshes)) if numbers is None else numbers
        super().__init__("given.npz", numbers, meshes.shape[1], Polygons.triangles(faces.numpy()), 30.0, 1.0, "y")
        self.meshes = meshes.float().numpy()

    def read(self, start: int, stop: int) -> np.ndarray:
        return self.meshes[start:stop]


def options(**changes: Any) -> TrackingOptions:
    groups = {name: convert(value, GROUPS[name], name) for name, value in changes.items() if name in GROUPS}
    return TrackingOptions(**{"method": "levenberg_marquardt", "motion": "keep", **changes, **groups})


def inverted(rig: LinearRig, meshes: torch.Tensor, numbers: np.ndarray | None = None, **changes: Any) -> Inversion:
    frames = changes.pop("frames", {})
    settings, sequence = options(**changes), Given(meshes, rig.faces, numbers)
    clip = Clip(sequence, resolve_units(sequence, rig, ReadingOptions(unit="mm", up="y")), **frames)
    parts = build_parts(settings, clip, rig, rig, None)
    arguments = (clip, parts.inverter, parts.evaluator, settings.window, lambda what, frames: None)
    if parts.method == "clip":
        return invert_smoothly(*arguments, settings.solver)
    return invert_clip(*arguments)


@torch.no_grad()
def error_mm(rig: LinearRig, found: Inversion, meshes: torch.Tensor) -> float:
    return float((rig(found.controls) - meshes).norm(dim=2).mean())


def tumbled(meshes: torch.Tensor, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Meshes, turned at random by up to 90 degrees and moved by up to a metre each; and how."""
    generator, count = generator_at(seed, "tumble"), len(meshes)
    axes = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)
    motion = torch.eye(4).repeat(count, 1, 1)
    motion[:, :3, :3] = roma.rotvec_to_rotmat(axes * torch.rand(count, 1, generator=generator) * torch.pi / 2)
    motion[:, :3, 3] = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1) * 1000
    return apply_motion(motion, meshes), motion


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig(arkit=True)


@pytest.fixture(scope="module")
def meshes(rig) -> torch.Tensor:
    return torch.tensor(performance(rig), dtype=torch.float32)


@pytest.fixture(scope="module")
def acted(face) -> torch.Tensor:
    """A stretch of a performance of the face, near its reach but not in it."""
    from riginv.clips.performance import simulated_performance

    return simulated_performance(face).vertices(300, 306)


def test_rigid_motion_is_found_whatever_a_third_of_the_vertices_does(rig):
    rest = rig.rest_vertices
    still = rest.expand(8, -1, -1).clone()
    still[:, ::3] += 20 * torch.randn(8, len(rest[::3]), 3, generator=generator_at(0, "noise"))
    target, motion = tumbled(still)
    found = fit_rigid(rest[None], target, torch.ones(len(rest)))
    assert (found - motion).abs().max() < 1e-3
    assert (remove_motion(found, apply_motion(found, still)) - still).abs().max() < 1e-2
    target[3, 5:] = torch.nan
    assert torch.isfinite(fit_rigid(rest[None], target, torch.ones(len(rest)))).all()


@pytest.fixture(scope="module")
def face_solver(face, face_in_space) -> SolverEstimator:
    settings = options(solver={"descent_steps": 0, "key_starts": 1, "steps": 15})
    return build_solver(settings, face_in_space, resolve_constraints(face, settings.controls), None, None, settings.method)


@torch.no_grad()
def test_a_moved_clip_gives_the_controls_of_the_unmoved_one(face, face_solver, acted):
    """Must reach: a difference of 0.05 mm at most, also from the clip that was solved without looking for motion."""
    anchors = Anchors(face, stability_weights(face))
    meshes, motion = tumbled(acted)
    kept, still, found = (
        WindowInverter(face, face_solver, looked_for, None, 12).invert(given)
        for looked_for, given in ((None, acted), (anchors, acted), (anchors, meshes))
    )
    errors = [float((face(one.controls) - acted).norm(dim=2).mean()) for one in (kept, still, found)]
    assert max(errors) - min(errors) < 0.05
    judged = [float((one.recovered - one.stabilised).norm(dim=2).mean()) for one in (still, found)]
    assert abs(judged[0] - judged[1]) < 0.01
    assert (apply_motion(found.motion, found.recovered) - meshes).norm(dim=2).mean() < errors[0] + 0.05
    assert (found.motion[:, :3, :3] - motion[:, :3, :3]).abs().max() < 0.01


@torch.no_grad()
def test_a_tenth_of_the_vertices_may_be_missing(face, face_solver, acted):
    """Must reach: the error on all vertices, also the missing ones, changes by 10 % at most."""
    holes = acted.clone()
    holes[torch.rand(holes.shape[:2], generator=generator_at(0, "holes")) < 0.1] = torch.nan
    inverter = WindowInverter(face, face_solver, None, None, 12)
    whole, found = (inverter.invert(given) for given in (acted, holes))
    errors = [float((face(one.controls) - acted).norm(dim=2).mean()) for one in (whole, found)]
    assert errors[1] < 1.1 * errors[0]


def test_missing_vertices_are_told_frame_by_frame(rig, meshes):
    holes = meshes.clone()
    holes[3, 10:20] = torch.nan
    found = inverted(rig, holes)
    assert [row for row, flags in enumerate(found.errors.flags) if "missing_vertices" in flags] == [3]
    assert error_mm(rig, found, meshes) < 0.05


def test_a_rig_with_a_root_keeps_its_motion(body_in_space, toy):
    assert has_root_controls(body_in_space) and not has_root_controls(toy)


def test_the_still_vertices_are_those_that_no_pose_moves(face):
    weights = stability_weights(face)
    skull, chin = face.rest_vertices[:, 1].argmax(), face.arkit_deltas()["jawOpen"].norm(dim=1).argmax()
    assert weights[skull] > 0.5 and weights[chin] < 0.05
    anchors = Anchors(face, weights)
    controls = torch.rand(3, len(face.controls), generator=generator_at(0, "poses")) * 0.2
    with torch.no_grad():
        assert (anchors.mesh(controls) - face(controls)[:, anchors.vertices]).abs().max() < 1e-3
    assert anchors.for_window(torch.zeros(2, len(weights), dtype=torch.bool)).stride == 1


def test_whole_frames_that_are_unknown_are_bridged(rig, meshes):
    gone = meshes.clone()
    gone[4:6] = torch.nan
    for method in ("levenberg_marquardt", "clip"):
        found = inverted(rig, gone, method=method)
        assert error_mm(rig, found, meshes) < 0.3
        assert found.errors.mean_mm[4:6].isnan().all() and found.errors.flags[4] == ["missing_vertices"]
    with pytest.raises(InputError, match="nothing to invert"):
        inverted(rig, torch.full_like(meshes, torch.nan))


def test_bridges_are_straight_and_turn_the_short_way():
    known = torch.tensor([False, True, False, False, True, False])
    values = torch.tensor([9.0, 0.0, 9.0, 9.0, 3.0, 9.0])[:, None]
    assert interpolate_controls(values, known, torch.arange(6)).flatten().tolist() == [0, 0, 1, 2, 3, 3]
    motion = torch.eye(4).repeat(6, 1, 1)
    motion[4, :3, :3] = roma.rotvec_to_rotmat(torch.tensor([0.0, 0.0, 0.9]))
    angles = roma.rotmat_to_rotvec(interpolate_motion(motion, known, torch.arange(6))[:, :3, :3])[:, 2]
    assert torch.allclose(angles, torch.tensor([0, 0, 0.3, 0.6, 0.9, 0.9]), atol=1e-5)


def test_excluded_frames_do_not_disturb_their_neighbours(rig, meshes):
    spoiled = meshes.clone()
    spoiled[6] += 30 * torch.randn(meshes[6].shape, generator=generator_at(0, "spoil"))
    found = inverted(rig, spoiled, frames={"exclude": [6]}, method="clip")
    assert error_mm(rig, found, meshes) < 0.2


def test_a_weighted_space_is_weighted_least_squares(rig, meshes):
    """The encoded distance equals the weighted distance of vertices, constant aside."""
    weights = torch.rand(len(rig.rest_vertices), generator=generator_at(0, "weights"))
    space = weighted_space(rig, weights)
    inside = RigInMeshSpace(rig, space)
    controls = torch.rand(5, len(rig.controls), generator=generator_at(0, "controls"))
    with torch.no_grad():
        short = (inside(controls) - space.encode(meshes[:1])).square().sum(dim=1)
        whole = (weights[:, None] * (rig(controls) - meshes[0]).square()).sum(dim=(1, 2))
    assert torch.allclose(short - short[0], whole - whole[0], rtol=1e-3, atol=0.05)


def test_vertices_without_weight_may_be_anything(rig, meshes, tmp_path):
    spoiled, gone = meshes.clone(), list(range(0, 40))
    spoiled[:, gone] += 50
    (tmp_path / "gone.txt").write_text(" ".join(map(str, gone)))
    vertices = {"regions": {"gone": str(tmp_path / "gone.txt")}, "weights": {"gone": 0}}
    assert error_mm(rig, inverted(rig, spoiled, vertices=vertices), meshes) < 0.2
    assert error_mm(rig, inverted(rig, spoiled), meshes) > 1


def test_regions_have_names(face, body, toy):
    regions = regions_of(face)
    assert {"mouth", "eye", "jaw", "brow", "still"} <= regions.keys()
    assert sum(members.int() for members in regions.values()).max() == 1
    labels = label(regions, len(face.rest_vertices))
    assert labels[int(face.arkit_deltas()["mouthSmileLeft"].norm(dim=1).argmax())] == "mouth"
    assert "upperleg01.L" in regions_of(body) and regions_of(toy.rig) == {}


@pytest.mark.parametrize(
    "content, name, message",
    [
        ("1 2 three", "a.txt", "cannot be read"),
        ("1 2 9999", "a.txt", "found int64 of shape"),
        ("{}", "a.json", "found"),
        ("[1, 2", "a.json", "cannot be read"),
        (None, "none.txt", "no such file"),
    ],
)
def test_a_region_that_is_none_is_refused(content, name, message, rig, tmp_path):
    if content is not None:
        (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        vertex_weights(rig, VertexOptions({"mine": 0}, regions={"mine": str(tmp_path / name)}))
    with pytest.raises(InputError, match="has no such region"):
        vertex_weights(rig, VertexOptions({"elbow": 0}))
    with pytest.raises(InputError, match="fewer than three"):
        vertex_weights(rig, VertexOptions(default=0.0))


def constraints(rig, **changes):
    return resolve_constraints(rig, convert(changes, ControlOptions, "controls"))


def test_held_controls_stay_and_the_others_make_up_for_them(rig, meshes):
    found = inverted(rig, meshes, controls={"freeze": ["bump0"], "hold": {"side": -0.5}})
    names = rig.control_names
    assert (found.controls[:, names.index("bump0")] == 0).all() and (found.controls[:, names.index("side")] == -0.5).all()
    free = inverted(rig, meshes)
    assert error_mm(rig, free, meshes) < 0.03 < error_mm(rig, found, meshes)


def test_a_held_rig_is_the_rig(rig):
    held = torch.rand(len(rig.controls), generator=generator_at(0, "held"))
    part = FixedControlsRig(rig, torch.tensor([1, 3, 6]), held)
    free = torch.rand(4, 3, generator=generator_at(0, "free"))
    whole = held.repeat(4, 1)
    whole[:, [1, 3, 6]] = free
    assert torch.equal(part(free), rig(whole))
    _, jacobian = part.coefficient_jacobian(free)
    _, expected = rig.coefficient_jacobian(whole)
    assert torch.allclose(jacobian.dense(), expected.dense()[:, :, [1, 3, 6]])


def test_the_gradient_of_preferences_is_that_of_their_cost(rig):
    """Against finite differences in float64, for every kind of preference at once."""
    rig = ToyRig().double()
    penalties = constraints(
        rig, weights={"bump*": 50.0}, symmetric=[["bump0", "bump1"]], exclusive=[["bump2", "side"], ["bump3", "all"]]
    ).penalties
    objective = PenalisedObjective(RigInMeshSpace(rig, MeshSpace.from_rig(rig)), 1e-2, 1e-2, penalties)
    objective.exclusive_penalty, objective.symmetric_penalty = 20.0, 30.0
    units = 0.2 + 0.6 * torch.rand(3, 7, generator=generator_at(0, "units"), dtype=torch.float64)
    _, gradient, _ = objective._prior(units)
    step = 1e-6
    for column in range(7):
        ahead, behind = units.clone(), units.clone()
        ahead[:, column] += step
        behind[:, column] -= step
        derivative = (objective._prior(ahead)[0] - objective._prior(behind)[0]) / (2 * step)
        assert torch.allclose(derivative, gradient[:, column], rtol=1e-4, atol=1e-4)


def test_symmetric_pairs_move_alike_and_exclusive_ones_do_not_meet(rig, meshes):
    free = inverted(rig, meshes).controls
    apart = (free[:, 0] - free[:, 1]).abs().max()
    tied = inverted(rig, meshes, controls={"symmetric": [["bump0", "bump1"]], "symmetric_mm2": 1e3}).controls
    assert apart > 0.1 > 20 * (tied[:, 0] - tied[:, 1]).abs().max()
    both = (free[:, 2] * free[:, 3]).max()
    single = inverted(rig, meshes, controls={"exclusive": [["bump2", "bump3"]], "exclusive_mm2": 100.0}).controls
    assert both > 0.05 and (single[:, 2] * single[:, 3]).max() < 1e-3


def test_dear_controls_are_used_less_and_sparse_ones_fewer(rig, meshes):
    free = inverted(rig, meshes).controls.abs()
    dear = inverted(rig, meshes, controls={"weights": {"bump0": 1e7}}).controls.abs()
    assert dear[:, 0].mean() < 0.5 * free[:, 0].mean() and dear[:, 4].mean() > 0.5 * free[:, 4].mean()
    sparse = inverted(rig, meshes, solver={"sparsity": 0.3}).controls.abs()
    assert (sparse > 1e-3).sum() < (free > 1e-3).sum()


def test_static_controls_have_one_value_and_it_is_nearly_the_best(rig, meshes):
    found = inverted(rig, meshes, controls={"static": ["bump4"]})
    value = found.controls[:, 4]
    assert (value == value[0]).all()
    errors = [
        error_mm(rig, inverted(rig, meshes, controls={"hold": {"bump4": float(share)}}), meshes)
        for share in np.linspace(0, 1, 11)
    ]
    assert error_mm(rig, found, meshes) < 1.1 * min(errors)


def test_a_whole_clip_is_smoother_than_its_frames(rig, meshes):
    noisy = meshes + 0.5 * torch.randn(meshes.shape, generator=generator_at(0, "capture"))
    rough = [
        inverted(rig, noisy, method=method).controls.diff(n=2, dim=0).square().mean()
        for method in ("clip", "levenberg_marquardt")
    ]
    assert rough[0] < rough[1]


def test_names_that_nobody_knows_follow_the_policy(rig, tmp_path):
    for options in ({"freeze": ["jaw*"]}, {"weights": {"jaw": 2.0}}, {"symmetric": [["bump0", "jaw"]]}, {"hold": {"jaw": 0}}):
        with pytest.raises(InputError, match="toy' has no such control"):
            constraints(rig, **options)
        assert bool(constraints(rig, **options, unknown="ignore_new").free.all())
    mask = tmp_path / "mask.json"
    mask.write_text('{"bump0": 0, "bump1": 1, "jaw": 1}')
    for policy, message in (("error", "jaw"), ("ignore_missing", "jaw"), ("ignore_new", "does not name 5 of the 7 controls")):
        with pytest.raises(InputError, match=message):
            constraints(rig, mask=str(mask), unknown=policy)
    assert constraints(rig, mask=str(mask), unknown="ignore_both").free.tolist() == [False] + 6 * [True]
    with pytest.raises(InputError, match="controls.unknown is 'perhaps'"):
        constraints(rig, unknown="perhaps")


@pytest.mark.parametrize(
    "name, content",
    [
        ("a.json", "[1, 2]"),
        ("a.json", '{"bump0": "x"}'),
        ("a.json", '{"bump0": -1}'),
        ("a.json", "{"),
        ("a.yaml", "bump0: !!python/object/apply:os.system ['true']"),
        ("a.csv", "bump0\n"),
    ],
)
def test_a_mask_that_is_none_is_refused(name, content, rig, tmp_path):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=name):
        constraints(rig, mask=str(tmp_path / name))


def test_values_that_cannot_be_meant_are_refused(rig):
    for options in (
        {"hold": {"bump0": 2.0}},
        {"weights": {"bump0": -1}},
        {"symmetric": "both"},
        {"activate": []},
        {"freeze": "bump0"},
    ):
        with pytest.raises(InputError):
            constraints(rig, **options)


def test_sides_are_paired_by_their_names(face):
    names, pairs = face.control_names, constraints(face, symmetric="auto").penalties.symmetric.tolist()
    assert [names.index("browDownLeft"), names.index("browDownRight")] in pairs and len(pairs) > 20


def test_frames_beyond_the_rig_are_flagged(rig, meshes):
    strange = meshes.clone()
    strange[7] += 6 * torch.randn(meshes[7].shape, generator=generator_at(0, "strange"))
    found = inverted(rig, strange)
    assert [row for row, flags in enumerate(found.errors.flags) if "outside_reach" in flags] == [7]
    assert int(found.errors.worst(1)[0]) == 7
