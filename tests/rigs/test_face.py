"""The default face: its sizes, its logic against plain NumPy, and its geometry."""

import numpy as np
import pytest
import torch
import trimesh
from scipy import sparse

from riginv.rig.arkit import ARKIT_NAMES
from rigs.face.build import build_geometry, face_geometry
from rigs.face.controls import build_controls
from rigs.face.inbetweens import bump
from rigs.face.limits import CAPACITY, CEILINGS, cost, limit_curve, region
from rigs.face.shapes import ARKIT_FOLDER, ARKIT_SPLIT, primary_names
from rigs.geometry.anny.subdivision import loop_matrix, unique_edges
from rigs.geometry.asset import PARTS, FaceSource, read_asset
from tests.geometry.test_curves import reference


def test_it_has_the_papers_sizes(face):
    assert (len(face.controls), len(face.coefficient_names), len(face.rest_vertices)) == (137, 628, 8447)
    assert (len(set(face.control_names)), len(set(face.coefficient_names))) == (137, 628)
    assert set(ARKIT_NAMES) <= set(face.control_names) and len(ARKIT_NAMES) == 52


def test_the_weights_stay_within_0_and_1_and_every_shape_can_be_reached(face):
    controls = face.lower + torch.rand(500, 137, generator=torch.Generator().manual_seed(0)) * (face.upper - face.lower)
    weights = face.coefficients(controls)
    assert weights.min() >= 0 and weights.max() <= 1
    assert {driver.shape for driver in build_controls()[1]} == set(primary_names())
    alone = torch.cat([share * torch.diag(limit) for limit in (face.lower, face.upper) for share in torch.linspace(0.1, 1, 10)])
    jaw_open = alone.clone()
    jaw_open[:, face.control_names.index("jawOpen")] = 1
    assert (face.coefficients(torch.cat([alone, jaw_open]))[:, : 134 + 150].amax(dim=0) > 0.5).all()
    assert (weights[:, 134 + 150 :].amax(dim=0) > 0).all()


def plain_weights(face, controls: dict[str, float]) -> dict[str, float]:
    """The weights as the rig's tables describe them, one number at a time."""
    remaining = dict.fromkeys(primary_names(), 1.0)
    for driver in build_controls()[1]:
        remaining[driver.shape] *= 1 - reference(driver.curve, controls[driver.control])
    weights = {shape: 1 - value for shape, value in remaining.items()}
    for ceiling in CEILINGS:
        weights[ceiling.shape] = min(weights[ceiling.shape], reference(ceiling.curve, weights[ceiling.under]))
    for name, capacity in CAPACITY.items():
        here = [shape for shape in weights if region(shape) == name]
        factor = reference(limit_curve(capacity), sum(cost(shape) * weights[shape] for shape in here))
        weights |= {shape: weights[shape] * factor for shape in here}
    geometry = face_geometry()
    owners = [primary_names()[shape] for shape in geometry["inbetween_shape"].tolist()]
    result = list(weights.values())
    for shape, place in zip(owners, geometry["inbetween_position"].tolist()):
        result.append(reference(bump(place, owners.count(shape)), weights[shape]))
    for group in geometry["combination_members"].tolist():
        result.append(np.prod([weights[primary_names()[shape]] for shape in group if shape >= 0]))
    return np.array(result)


def test_the_weights_equal_a_plain_evaluation(face):
    draw = np.random.default_rng(0)
    lower, upper = face.lower.numpy(), face.upper.numpy()
    for active in (3, 30, 137):
        values = np.zeros(137)
        chosen = draw.permutation(137)[:active]
        values[chosen] = draw.uniform(lower[chosen], upper[chosen])
        expected = plain_weights(face, dict(zip(face.control_names, values.tolist())))
        found = face.coefficients(torch.from_numpy(values)[None])[0]
        np.testing.assert_allclose(found, expected, atol=2e-6)


def test_an_arkit_control_at_1_gives_its_arkit_shape_and_nothing_else(face):
    source = FaceSource(read_asset())
    targets = {name: source.carried(source.target(f"{ARKIT_FOLDER}/{name}.target")) for name in ARKIT_NAMES}
    whole = {name: torch.from_numpy(deltas).float() for name, deltas in targets.items()}
    for name, deltas in face.arkit_deltas().items():
        torch.testing.assert_close(deltas, whole[name], atol=2e-4, rtol=0)
    controls = torch.stack([torch.tensor([float(control == name) for control in face.control_names]) for name in ARKIT_NAMES])
    controls[ARKIT_NAMES.index("mouthClose"), face.control_names.index("jawOpen")] = 1
    found = face(controls) - face.rest_vertices
    for number, name in enumerate(ARKIT_NAMES):
        expected = whole[name] + (whole["jawOpen"] if name == "mouthClose" else 0)
        torch.testing.assert_close(found[number], expected, atol=1e-3, rtol=0)


def test_the_lips_close_no_further_than_the_jaw_opens(face):
    close, jaw = face.control_names.index("mouthClose"), face.control_names.index("jawOpen")
    controls = torch.zeros(1, 137)
    controls[0, close] = 1
    assert face.coefficients(controls)[0, primary_names().index("mouthClose")] < 0.07
    controls[0, jaw] = 0.5
    assert face.coefficients(controls)[0, primary_names().index("mouthClose")] < 0.75


def test_what_a_real_performance_asks_for_is_not_held_back(face):
    weights = torch.zeros(1, 137)
    for name, value in {"jawOpen": 0.9, "mouthSmileLeft": 0.9, "mouthSmileRight": 0.9, "mouthFunnel": 0.5}.items():
        weights[0, face.control_names.index(name)] = value
    found = face.coefficients(weights)[0]
    for name in ("jawOpen", "mouthSmileLeft"):
        alone = torch.zeros(1, 137)
        alone[0, face.control_names.index(name)] = 0.9
        place = primary_names().index(name)
        assert found[place] == face.coefficients(alone)[0, place]


def test_it_is_built_the_same_every_time(face):
    built = build_geometry()
    assert torch.equal(built["rest_vertices"], face.rest_vertices)
    assert torch.equal(built["basis"], face.basis)


def test_the_mesh_is_whole(face):
    rest, faces = face.rest_vertices.numpy(), face.faces.numpy()
    assert set(np.unique(faces)) == set(range(8447))
    mesh = trimesh.Trimesh(rest, faces, process=False)
    assert mesh.area_faces.min() > 1e-3
    pieces = trimesh.graph.connected_components(mesh.face_adjacency, nodes=np.arange(len(faces)))
    assert len(pieces) == 6  # skin with the mouth, two eyes, two rows of teeth, the tongue
    edges, counts = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    assert counts.max() == 2
    skin = face.part.numpy() == PARTS.index("skin")
    border = edges[(counts == 1) & skin[edges[:, 0]]]
    graph = sparse.coo_array((np.ones(len(border)), border.T), shape=(8447, 8447))
    loops = sparse.csgraph.connected_components(graph, directed=False)[0] - (8447 - len(np.unique(border)))
    assert loops == 3  # the edge of the face, and one for each eye
    middle = rest[skin & (np.abs(rest[:, 0]) < 4)]
    assert middle[:, 1].max() > 790 and middle[:, 1].min() < 625  # mm: hairline, under the chin (the chin is at 630)


def test_left_and_right_mirror_each_other(face):
    names = list(face.control_names)
    for left in ("eyeBlinkLeft", "mouthSmileLeft", "browOuterUpLeft", "cheekSuckLeft", "lipPurseLeft"):
        sizes = []
        for name in (left, left.replace("Left", "Right")):
            controls = torch.zeros(1, 137)
            controls[0, names.index(name)] = 1
            sizes.append((face(controls)[0] - face.rest_vertices).norm(dim=1).sort().values)
        assert (sizes[0] - sizes[1]).abs().mean() < 0.05


def tube(rings: int = 4, around: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """An open tube, whose border is two loops."""
    ring, turn = np.divmod(np.arange(rings * around), around)
    angle = 2 * np.pi * turn / around
    corners = np.arange((rings - 1) * around)
    right = corners - corners % around + (corners + 1) % around
    faces = np.concatenate(
        [np.stack([corners, right, corners + around], 1), np.stack([right, right + around, corners + around], 1)]
    )
    return np.stack([np.cos(angle) * (1 + 0.3 * ring), np.sin(angle), ring**1.5], axis=1), faces


@pytest.mark.parametrize("shape", ["tube", "sphere"])
def test_loop_subdivision_equals_that_of_trimesh(shape):
    sphere = trimesh.creation.uv_sphere(count=[7, 9])
    vertices, faces = tube() if shape == "tube" else (sphere.vertices, sphere.faces)
    edges, edge_of_side = unique_edges(faces)
    found = loop_matrix(faces, edges, edge_of_side) @ vertices
    expected, _ = trimesh.remesh.subdivide_loop(vertices, faces)
    found, expected = (points[np.lexsort(points.round(6).T)] for points in (found, expected))
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_expressions_name_controls_within_their_limits(face):
    limits = {control.name: control for control in face.controls}
    assert len(face.expressions()) == 12
    for expression in face.expressions().values():
        for name, value in expression.items():
            assert limits[name].lower <= value <= limits[name].upper
    assert ARKIT_SPLIT and face.vertex_colors().shape == (8447, 3)
