"""Fewer keys within a tolerance on the mesh, and other frame rates."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.animation.animation import Animation
from riginv.animation.formats import write_formats
from riginv.animation.reduction import reduced, straight_line_keys
from riginv.animation.resampling import fill_gaps, resampled
from riginv.errors import InputError
from tests.support.animations import errors_of, moving
from tests.support.toys import BlackBox, Plain, ToyRig


@pytest.mark.parametrize("rig", [ToyRig(), Plain(), BlackBox()], ids=["linear", "plain", "black box"])
@pytest.mark.parametrize("tolerance", [0.02, 0.5])
def test_no_vertex_goes_farther_than_the_tolerance(rig, tolerance):
    animation = moving(rig, numbers=torch.arange(200))
    found = reduced(animation, tolerance)
    apart = (rig(found.animation.controls) - rig(animation.controls)).norm(dim=2).max()
    assert float(apart) <= tolerance * 1.001 and found.worst_mm == pytest.approx(float(apart), rel=1e-3)
    assert found.keys < found.keys_before / (3 if tolerance == 0.5 else 1.2)
    for control, rows in enumerate(found.animation.keys):
        rows = rows.numpy()
        assert rows[0] == 0
        curve = np.interp(np.arange(200), rows, animation.controls[rows, control].numpy())
        np.testing.assert_allclose(found.animation.controls[:, control].numpy(), curve, atol=1e-5)


def test_more_tolerance_means_fewer_keys_and_still_curves_keep_one():
    rig = ToyRig()
    animation = moving(rig, numbers=torch.arange(120))
    animation.controls[:, 2] = 0.25
    counts = [reduced(animation, tolerance).keys for tolerance in (0.01, 0.1, 1.0)]
    assert counts[0] > counts[1] > counts[2]
    assert len(reduced(animation, 0.01).animation.keys[2]) == 1


def test_a_frame_that_nothing_spares_is_kept_exactly():
    """A tolerance that single precision can hardly tell: every frame that counts becomes a key."""
    rig = ToyRig()
    animation = moving(rig, numbers=torch.arange(30))
    found = reduced(animation, 1e-6)
    assert found.worst_mm <= 1e-6
    assert torch.equal(found.animation.controls, animation.controls)


def test_one_line_goes_as_far_as_it_serves():
    """Against trying every line."""
    generator = np.random.default_rng(3)
    seconds = np.sort(generator.random(300))
    values = np.cumsum(generator.normal(size=300)) * 0.1
    allowed = generator.uniform(0.05, 0.3, 300)
    keys = straight_line_keys(seconds, values, allowed)

    def serves(first, last):
        between = np.interp(seconds[first : last + 1], seconds[[first, last]], values[[first, last]])
        return (np.abs(between - values[first : last + 1]) <= allowed[first : last + 1] + 1e-12).all()

    row, expected = 0, [0]
    while row < 299:
        row = max(last for last in range(row + 1, 300) if serves(row, last))
        expected.append(row)
    assert keys == expected


def test_formats_that_hold_keys_hold_the_reduced_ones(tmp_path):
    animation = reduced(moving(ToyRig(), numbers=torch.arange(60), with_motion=False), 0.3).animation
    write_formats(tmp_path, animation, errors_of(animation), ["anim"])
    assert (tmp_path / "curves.anim").read_text().count(" linear linear ") == sum(map(len, animation.keys))


@pytest.mark.parametrize("fps", [12.5, 24.0, 100.0])
def test_resampling_keeps_times_values_and_limits(fps):
    numbers = torch.arange(50, 111)
    animation = moving(ToyRig(), fps=25.0, numbers=numbers)
    found = resampled(animation, fps)
    assert found.fps == fps and float(found.seconds[-1]) == pytest.approx(60 / 25, abs=1 / fps)
    assert int(found.frame_numbers[0]) == round(50 * fps / 25)
    assert (found.controls >= animation.rig.lower).all() and (found.controls <= animation.rig.upper).all()
    fine = moving(ToyRig(), fps=25.0, numbers=torch.arange(61))
    exact = np.stack([np.interp(found.seconds, animation.seconds, c) for c in fine.controls.numpy().T], axis=1)
    assert np.abs(found.controls.numpy() - exact).max() < 0.01
    turn = Rotation.from_matrix(found.motion[:, :3, :3].numpy())
    assert np.allclose(turn.as_matrix()[0], np.eye(3), atol=1e-6)
    again = resampled(found, 25.0) if fps > 25 else None
    if again is not None:
        assert torch.allclose(again.controls, animation.controls, atol=1e-5)
        assert torch.allclose(again.motion, animation.motion, atol=1e-6)


def test_every_frame_of_the_source_that_falls_on_a_new_one_keeps_its_values():
    animation = moving(ToyRig(), fps=60.0, numbers=torch.arange(0, 41))
    assert torch.allclose(resampled(animation, 30.0).controls, animation.controls[::2], atol=1e-6)


def test_gaps_are_filled():
    found = fill_gaps(moving(ToyRig()))
    assert found.frame_numbers.tolist() == list(range(101, 116))


def test_what_cannot_be_meant_is_refused():
    animation = moving(ToyRig())
    for fps in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="fps is"):
            resampled(animation, fps)
    with pytest.raises(InputError, match="the most is 10000000"):
        resampled(animation, 1e9)
    with pytest.raises(InputError, match="tolerance_mm is 0"):
        reduced(animation, 0)
    one = Animation(animation.rig, animation.controls[:1], 25.0, animation.frame_numbers[:1], animation.motion[:1])
    assert len(resampled(one, 50.0)) == 1 and reduced(one, 0.1).keys == 7
