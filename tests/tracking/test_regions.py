"""Regions of a rig's mesh, and weights of vertices."""

import pytest
import torch

from riginv.errors import InputError
from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.tracking.assembly import build_solver
from riginv.tracking.constraints import resolve_constraints
from riginv.tracking.options import ControlOptions, TrackingOptions, VertexOptions
from riginv.tracking.regions import label, regions_of, vertex_weights, weighted_space
from tests.support.inverting import error_mm, inverted


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
    assert "upperleg01.L" in regions_of(body) and regions_of(toy.source) == {}


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


def test_a_prior_means_the_same_however_few_vertices_count(rig, meshes):
    """The distance is the mean square over the vertices that count: 20 of them, as markers, weigh as much as all."""
    weights = torch.zeros(len(rig.rest_vertices))
    weights[:20] = 1.0
    in_space, constraints = RigInMeshSpace(rig, MeshSpace.from_rig(rig)), resolve_constraints(rig, ControlOptions())
    solver = build_solver(TrackingOptions(), in_space, constraints, weights, None, "levenberg_marquardt")
    costs = [solver.objective.cost(torch.full((1, 7), value), solver.space.encode(meshes[:1])) for value in (0.5, 0.2)]
    controls = [rig.lower + (rig.upper - rig.lower) * torch.full((1, 7), value) for value in (0.5, 0.2)]
    apart = [0.5 * (rig(one) - meshes[:1])[:, :20].square().sum(dim=2).mean() for one in controls]
    expected = (apart[0] - apart[1]) * len(rig.rest_vertices)
    assert torch.allclose(costs[0] - costs[1], expected[None], rtol=1e-2)
