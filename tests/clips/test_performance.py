"""Simulated performances: those of ARKit's names as ever, those of other rigs as large and as sparse as real ones."""

import numpy as np
import pytest
import torch

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.clips.performance import simulated_performance
from riginv.errors import InputError
from riginv.rig.arkit import ARKIT_NAMES
from riginv.tracking.rigs import build_clip
from rigs.shapes import ShapesRig
from tests.support import sculpts
from tests.support.toys import BlackBox, ToyRig

NAMES = [f"{part}{number:02d}_{side}" for part in ("lip", "lid") for number in range(18) for side in "LR"]  # 72


def rig_of(folder, names) -> ShapesRig:
    shapes = {name: sculpts.POINTS + sculpts.offset(number) for number, name in enumerate(names)}
    return ShapesRig(str(sculpts.write_folder(folder / "rig", **shapes)))


def test_a_rig_without_arkits_names_performs_as_productions_do(tmp_path):
    """Against a production's animation of 72 shapes: 5.9 of them on at a time, their sum 2.4."""
    clip = simulated_performance(rig_of(tmp_path, NAMES))
    weights, size = clip.weights.double(), clip.deltas.norm(dim=2).mean()
    assert weights.shape == (900, 72) and weights.min() >= 0 and weights.max() <= 1
    assert 4.5 < (weights > 0.02).sum(dim=1).double().mean() < 8 and 2 < weights.sum(dim=1).mean() < 3.5
    assert (weights.amax(dim=0) > 0.3).double().mean() > 0.7  # nearly all of them take part
    assert clip.vertices(0, 900).sub(clip.rest_vertices).norm(dim=2).mean() > size
    assert "shapes are on at a time" in clip.notes[0] and "mm from neutral" in clip.notes[0]
    together = (weights[:, ::2] - weights[:, 1::2]).abs().amax(dim=0) < 1e-6
    assert 0.1 < together.double().mean() < 0.95  # most left shapes move with the right one, not all
    assert torch.equal(clip.weights, simulated_performance(rig_of(tmp_path, NAMES)).weights)


@pytest.mark.parametrize(("poses", "frames"), [(None, 900), (2000, 900), (200, 900), (20, 900), (19, 86), (1, 4)])
def test_fewer_random_poses_shorten_it(poses, frames):
    rig = ToyRig()
    clip = build_clip(None, ReadingOptions(), FrameOptions(), rig, rig, poses)
    assert len(clip) == frames and clip.name == "simulated_performance"


@pytest.mark.parametrize("count", [1, 5, 300])
def test_few_shapes_and_many(count, tmp_path):
    weights = simulated_performance(rig_of(tmp_path, [f"s{number:03d}" for number in range(count)])).weights
    active = (weights > 0.02).sum(dim=1).double().mean()
    assert 0.1 * count < active < 0.5 * count if count < 20 else 4.5 < active < 8
    assert weights.amax() > 0.5


def test_a_few_names_of_arkits_do_not_make_an_arkit_rig(tmp_path):
    """It was performed by the seven of its shapes that have such names."""
    clip = simulated_performance(rig_of(tmp_path, ["browDown_L", "browDown_R", "jawOpen", *NAMES[:60]]))
    assert clip.weights.shape[1] == 63 and (clip.weights.amax(dim=0) > 0.1).double().mean() > 0.7


def test_the_performance_of_arkits_names_is_the_one_of_before(tmp_path):
    weights = simulated_performance(rig_of(tmp_path, ARKIT_NAMES)).weights.double()
    np.testing.assert_allclose([weights.sum(), weights.square().sum()], [1953.86215, 977.23204], rtol=1e-6)


def test_a_quick_look_takes_the_middle(tmp_path):
    rig = rig_of(tmp_path, NAMES)
    some, all_of_them = simulated_performance(rig, most=24), simulated_performance(rig)
    assert torch.equal(some.weights, all_of_them.weights[438:462]) and "of 0.8 s" in some.notes[0]
    assert len(simulated_performance(rig, most=5000)) == 900


def test_rigs_without_shapes_have_none():
    assert simulated_performance(BlackBox()) is None and len(simulated_performance(ToyRig(), 10)) == 10
    with pytest.raises(InputError, match="performance of 0 frames"):
        simulated_performance(ToyRig(), 0)
