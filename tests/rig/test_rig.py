"""The contract that every rig keeps, and that a broken rig does not pass."""

import pytest
import torch

from riginv.errors import InputError
from riginv.rig.contract import ContractError, check_rig
from riginv.rig.interface import Control
from tests.support.toys import BlackBox, ToyRig


def test_the_toy_and_a_black_box_keep_the_contract():
    check_rig(ToyRig())
    check_rig(BlackBox())


class Hill(ToyRig):
    """A rig of 50 m, whose float32 meshes have steps of 0.004 mm, which a batch may round differently."""

    step_mm = 0.03

    def __init__(self) -> None:
        super().__init__()
        self.rest_vertices, self.basis = 500 * self.rest_vertices, 500 * self.basis

    def forward(self, controls):
        return super().forward(controls) + (self.step_mm if len(controls) > 1 else 0.0)


class UnevenHill(Hill):
    step_mm = 0.2


def test_the_tolerance_grows_with_the_rig():
    check_rig(Hill())
    with pytest.raises(ContractError, match="poses in a batch differ"):
        check_rig(UnevenHill())


def test_the_face_keeps_the_contract(face):
    check_rig(face)


class AwayFromRest(ToyRig):
    def forward(self, controls):
        return super().forward(controls) + 0.01


class LooksAtItsBatch(ToyRig):
    def forward(self, controls):
        return super().forward(controls - controls.mean(dim=0) * 0.1)


class WrongGradient(ToyRig):
    def coefficients(self, controls):
        found = super().coefficients(controls)
        return found + (0.5 * controls.sum() - (0.5 * controls.sum()).detach())


class SinglePrecision(ToyRig):
    def forward(self, controls):
        return super().forward(controls).float()


class NotANumber(ToyRig):
    def forward(self, controls):
        return super().forward(controls) / (controls[:, :1, None] < 1)


@pytest.mark.parametrize(
    ("broken", "says"),
    [
        (AwayFromRest, "from the rest mesh"),
        (LooksAtItsBatch, "in a batch"),
        (WrongGradient, "gradients"),
        (SinglePrecision, "float64"),
        (NotANumber, "upper limits"),
    ],
)
def test_a_broken_rig_is_found_out(broken, says):
    with pytest.raises(ContractError, match=says):
        check_rig(broken())


@pytest.mark.parametrize(
    ("controls", "says"),
    [
        ([Control("a"), Control("a")], "two controls are named 'a'"),
        ([Control("a", lower=1, upper=1)], "lower 1 >= upper 1"),
        ([Control("a", neutral=2)], "neutral at 2"),
        ([], "no controls"),
    ],
)
def test_controls_that_make_no_rig_are_refused(controls, says):
    toy = ToyRig()
    with pytest.raises(InputError, match=says):
        super(ToyRig, toy).__init__("r", controls, toy.rest_vertices, toy.faces, toy.basis)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"rest_vertices": torch.full((162, 3), torch.nan)}, "NaN"),
        ({"rest_vertices": torch.zeros(162, 2)}, "expected \\(vertex, 3\\)"),
        ({"faces": torch.tensor([[0, 1, 999]])}, "use vertices 0 to 999"),
        ({"faces": torch.zeros(4, 4)}, "triangulate"),
        ({"basis": torch.zeros(2, 5, 3)}, "the basis has shape"),
    ],
)
def test_meshes_that_make_no_rig_are_refused(change, says):
    toy = ToyRig()
    parts = {"rest_vertices": toy.rest_vertices, "faces": toy.faces, "basis": toy.basis, **change}
    with pytest.raises(InputError, match=says):
        super(ToyRig, toy).__init__("r", toy.controls, **parts)
