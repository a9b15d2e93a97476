"""The samplers' distributions, and that a generator's place is all that they depend on."""

import pytest
import torch

from riginv.errors import InputError
from riginv.evaluation.evaluation_sets import random_sets
from riginv.rig.batches import generator_at
from riginv.rig.random_controls import choose
from riginv.sampling.controls import PlausibleControls, SparseControls
from riginv.sampling.meshes import (
    Mixture,
    PlausibleCombinations,
    RandomCombinations,
    RigPoses,
    StoredPoses,
    WithNoise,
    random_weights,
)
from riginv.sampling.noise import CaptureNoise

COUNT = 20_000


def generator(place: str = "test") -> torch.Generator:
    return generator_at(0, place)


def ks_distance(values: torch.Tensor, cdf) -> float:
    """The greatest distance between the distribution of values and a continuous one."""
    ordered = values.sort().values
    steps = torch.arange(1, len(ordered) + 1) / len(ordered)
    return float(torch.maximum((steps - cdf(ordered)).abs(), (steps - 1 / len(ordered) - cdf(ordered)).abs()).max())


def test_the_papers_controls_have_uniform_counts_and_uniform_values(face_in_space):
    rig = face_in_space.source
    controls = SparseControls(face_in_space).sample(COUNT, generator())
    active = controls != rig.neutral_controls
    counts = active.sum(dim=1)
    assert counts.min() == 1 and counts.max() == 137
    shares = torch.bincount(counts, minlength=138)[1:] / COUNT
    assert (shares - 1 / 137).abs().max() < 5 * (1 / 137 / COUNT) ** 0.5
    for column in (0, 60, face_in_space.source.control_names.index("jawSide")):
        values = controls[active[:, column], column]
        low, high = rig.lower[column], rig.upper[column]
        assert ks_distance(values, lambda x, low=low, high=high: (x - low) / (high - low)) < 2 / len(values) ** 0.5
    each = active.float().mean(dim=0)
    assert (each - each.mean()).abs().max() < 5 * (0.25 / COUNT) ** 0.5


def test_the_papers_combinations_have_uniform_counts_and_uniform_weights():
    weights = random_weights(628, COUNT, generator())
    counts = (weights > 0).sum(dim=1)
    assert counts.min() >= 1 and counts.max() <= 628
    assert ks_distance(counts.float() - 0.5, lambda x: x / 628) < 2 / COUNT**0.5
    values = weights[weights > 0][::313]
    assert ks_distance(values, lambda x: x) < 2 / len(values) ** 0.5


def test_plausible_controls_are_few_and_often_faint(face_in_space):
    controls = PlausibleControls(face_in_space, max_active=40, weak_fraction=0.5).sample(COUNT, generator())
    counts = (controls != 0).sum(dim=1)
    assert counts.max() <= 40 and counts.median() <= 8
    assert ks_distance(counts.clamp(1, 40).float().log(), lambda x: x / torch.tensor(40.0).log()) < 0.12  # log-uniform, rounded
    assert (controls >= face_in_space.source.lower).all() and (controls <= face_in_space.source.upper).all()
    single = controls[counts == 1]
    strength = single.abs().amax(dim=1)
    assert 0.55 < (strength < 0.5).float().mean() < 0.75  # half are uniform, half the product of two uniforms


def test_chosen_ones_are_as_many_as_asked_for_and_all_equally_likely():
    counts = torch.randint(1, 8, (COUNT,), generator=generator())
    chosen = choose(counts, 7, generator("choose"))
    assert torch.equal(chosen.sum(dim=1), counts)
    shares = chosen.float().mean(dim=0)
    assert (shares - counts.float().mean() / 7).abs().max() < 5 * (0.25 / COUNT) ** 0.5


def test_meshes_are_what_they_say(face_in_space):
    batch = RigPoses(face_in_space, SparseControls(face_in_space)).sample(5, generator())
    assert torch.equal(batch["coordinates"], face_in_space(batch["controls"]))
    meshes = RandomCombinations(face_in_space).sample(5, generator())["coordinates"]
    torch.testing.assert_close(meshes, random_weights(628, 5, generator()) @ face_in_space.linear_map)
    few = PlausibleCombinations(face_in_space, max_active=1, weak_fraction=0).sample(200, generator())["coordinates"]
    primaries = torch.nn.functional.normalize(face_in_space.linear_map[:134], dim=1)
    aligned = (torch.nn.functional.normalize(few, dim=1) @ primaries.T).amax(dim=1)
    assert aligned.min() > 1 - 1e-4


def test_a_mixture_gives_each_its_share(toy):
    parts = {"poses": RigPoses(toy, SparseControls(toy)), "combinations": RandomCombinations(toy)}
    mixed = Mixture(toy, parts, {"poses": 1, "combinations": 3})
    batch = mixed.sample(64, generator())
    assert batch["coordinates"].shape == (64, toy.space.size) and "controls" not in batch
    only = Mixture(toy, parts, {"poses": 1, "combinations": 0}).sample(8, generator())
    assert torch.equal(only["coordinates"], parts["poses"].sample(8, generator())["coordinates"]) and "controls" in only
    for shares, says in (
        ({"poses": 1}, "names"),
        ({"poses": -1, "combinations": 2}, "at least 0"),
        ({"poses": 0, "combinations": 0}, "all 0"),
    ):
        with pytest.raises(InputError, match=says):
            Mixture(toy, parts, shares)


def test_a_place_gives_the_same_batch_whatever_was_drawn_before(toy):
    sampler = RandomCombinations(toy)
    once = sampler.sample(4, generator_at(7, "training", 12, 0))
    sampler.sample(9, generator_at(7, "training", 11, 0))
    again = sampler.sample(4, generator_at(7, "training", 12, 0))
    assert torch.equal(once["coordinates"], again["coordinates"])
    for other in ((7, "training", 13, 0), (8, "training", 12, 0), (7, "training", 12, 1), (7, "calibration")):
        assert not torch.equal(once["coordinates"], sampler.sample(4, generator_at(*other))["coordinates"])


def test_test_sets_are_fixed_and_disjoint(face):
    rows = {}
    for purpose in ("test", "validation"):
        combinations, poses = random_sets(face, 300, purpose)
        rows[purpose] = {tuple(row) for row in combinations.weights.tolist()} | {tuple(row) for row in poses.controls.tolist()}
        assert len(rows[purpose]) == 600
        assert torch.equal(combinations.vertices(3, 5), random_sets(face, 300, purpose)[0].vertices(3, 5))
    assert not rows["test"] & rows["validation"]
    training = random_weights(628, 300, generator_at(20221206, "training", 0, 0))
    assert not rows["test"] & {tuple(row) for row in training.tolist()}


def test_stored_poses_are_drawn_once(toy):
    stored = StoredPoses.drawn(RigPoses(toy, SparseControls(toy)), 10, generator())
    batch = stored.sample(500, generator("batch"))
    assert len({tuple(row) for row in batch["controls"].tolist()}) == 10
    torch.testing.assert_close(batch["coordinates"], toy(batch["controls"]))


def test_noise_has_the_size_that_it_says_and_smooth_noise_is_smooth(face_in_space):
    space = face_in_space.space
    white = CaptureNoise(space, vertex_mm=0.5).sample(2000, generator())
    assert white.std() == pytest.approx(0.5, rel=0.02)
    full = 0.5 * torch.randn(200, 8447, 3, generator=generator("full"))
    assert space.encode(space.rest_vertices + full).std() == pytest.approx(0.5, rel=0.02)
    smooth = CaptureNoise(space, smooth_mm=1.0, radius_mm=25).sample(200, generator())
    moved = space.decode(smooth) - space.rest_vertices
    assert 0.4 < moved.square().sum(dim=2).mean().sqrt() <= 1.1  # what of 1 mm the rig's space can see
    edges = torch.cat([face_in_space.source.faces[:, :2], face_in_space.source.faces[:, 1:]])
    apart = (moved[:, edges[:, 0]] - moved[:, edges[:, 1]]).norm(dim=2).mean()
    assert apart < 0.35 * moved.norm(dim=2).mean()
    noisy = WithNoise(RandomCombinations(face_in_space), CaptureNoise(space, vertex_mm=0.1))
    clean = RandomCombinations(face_in_space).sample(50, generator())["coordinates"]
    assert not torch.equal(noisy.sample(50, generator())["coordinates"], clean)
    for wrong in ({"vertex_mm": -1}, {"smooth_mm": -1}, {"radius_mm": 0}):
        with pytest.raises(InputError, match="noise"):
            CaptureNoise(space, **wrong)
