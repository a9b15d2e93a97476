"""The logic of DNA files against plain arithmetic, rule by rule."""

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from riginv.errors import InputError
from rigs.dna.draft import Draft, Group, Joint, Row
from rigs.dna.format import DnaFile, Layer
from rigs.dna.format.later_layers import JointRepresentations, MachineLearningOperations, Representation, Twist, TwistsAndSwings
from rigs.dna.format.layers import Behavior, Conditions, Descriptor, Psds
from rigs.dna.logic import Logic
from rigs.dna.logic.rotations import (
    SEQUENCES,
    conjugate,
    euler_matrices,
    euler_quaternions,
    matrix_angles,
    multiply,
    quaternion_matrices,
    to_identity,
    twist_of,
)
from tests.rigs.dna.files import FIRST_ML, changed, draft, everything, floats, shorts


def logic_of(found: Draft | DnaFile, **fields) -> Logic:
    file = found.file() if isinstance(found, Draft) else found
    if fields:
        controls = dataclasses.replace(file.need(Behavior).controls, **fields)
        file = changed(file, Behavior, controls=controls)
    return Logic(file)


def with_layers(file: DnaFile, *contents) -> DnaFile:
    return dataclasses.replace(file, layers=(*file.layers, *(Layer.of(content) for content in contents)))


def table(*rows: tuple) -> Conditions:
    columns = list(zip(*rows))
    return Conditions(shorts(*columns[0]), shorts(*columns[1]), *(floats(*column) for column in columns[2:]))


def test_the_first_row_of_a_run_counts_and_runs_add_up():
    found = Draft("x", gui=["a", "b"], raw=["r", "s"])
    rows = table(
        *[(0, 0, 0.0, 0.5, 1.0, 0.0), (0, 0, 0.5, 1.0, 0.5, 0.4)],  # at 0.5 both hold: the first counts
        *[(1, 0, 1.0, 0.0, 0.2, 0.1), (0, 1, 0.0, 1.0, 2.0, -0.5)],  # from above to
        (0, 0, 0.8, 0.9, 0.0, 0.05),  # the same pair again, but another run
    )
    raw = logic_of(found, table=rows).raw_of(torch.tensor([[0.5, 0.0], [0.8, 0.06], [0.1, 2.0], [1.5, 0.0]]))
    expected = [[0.5 + 0.1, 0.5], [0.8 * 0.5 + 0.4 + 0.06 * 0.2 + 0.1 + 0.05, 1.0], [0.1, 0.0], [0.1, 0.0]]
    torch.testing.assert_close(raw, torch.tensor(expected))


def test_psds_are_products_of_clamped_controls_and_what_nothing_uses_stays_0():
    found = Draft("x", gui=[], raw=["a", "b", "c"], psds=[(0, 1)] * 5)
    found.channels = [(f"p{number}", 3 + number) for number in range(4)]
    matrix = Psds(shorts(3, 3, 4, 4, 5, 6, 6, 7), shorts(0, 1, 2, 2, 0, 3, 1, 0), floats(2, 0.9, 1, 1, -0.5, 1, 1, 1))
    raw = torch.tensor([[0.5, 0.8, 0.5], [3.0, 1.0, -2.0]])
    psds = logic_of(found, psds=matrix)(raw).controls[:, 3:]
    # A product, a control that counts twice, a negative factor, a PSD of a PSD (0 at first), one that nothing uses.
    torch.testing.assert_close(psds, torch.tensor([[0.72, 0.25, -0.25, 0.0, 0.0], [1.0, 0.0, -0.5, 0.0, 0.0]]))


def test_of_two_rows_that_write_one_attribute_the_later_stands_and_inputs_are_not_clamped():
    found = Draft("x", raw=["a", "b"], joints=[Joint("root", -1, (0, 0, 0))])
    found.groups = [Group((0, 1), [0, 1, 6], np.array([[10.0, 0], [20, 5], [0.5, 0]])), Group((1,), [1], np.array([[30.0]]))]
    changes = logic_of(found)(torch.tensor([[2.0, -1.0]])).joints.attributes
    expected = torch.zeros(1, 9, 1)
    expected[0, [0, 1, 6], 0] = torch.tensor([2.0, -3.0, 1.0])  # millimetres are centimetres in the file
    torch.testing.assert_close(changes, expected)


def test_rows_and_channels_beyond_a_level_of_detail_are_0():
    file = everything()
    fine, coarse = Logic(file, 0), Logic(file, 1)
    raw = torch.rand(3, 12)
    one, other = fine(raw), coarse(raw)
    assert one.channels[:, 4:].abs().max() > 0 and other.channels[:, 4:].abs().max() == 0
    assert torch.equal(one.channels[:, :4], other.channels[:, :4])
    assert one.joints.attributes[3, 6:].abs().max() > 0 and other.joints.attributes[3, 6:].abs().max() == 0
    assert one.maps[:, 1].abs().max() > 0 and other.maps[:, 1].abs().max() == 0
    with pytest.raises(InputError, match="rig.lod=2, expected 0 to 1"):
        Logic(file, 2)


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_sequences_say_which_axis_rotates_first(sequence):
    order = tuple("xyz".index(axis) for axis in sequence)
    angles = torch.tensor(np.random.default_rng(0).uniform(-1.4, 1.4, (50, 3)))
    expected = Rotation.from_euler(sequence, angles[:, list(order)].numpy())  # small letters: axes that stay
    matrices = euler_matrices(angles, order)
    torch.testing.assert_close(matrices, torch.tensor(expected.as_matrix()))
    quaternions = euler_quaternions(angles, order)
    torch.testing.assert_close(quaternion_matrices(quaternions), matrices)
    torch.testing.assert_close(matrix_angles(matrices, order), angles)
    locked = torch.tensor([[0.3, 0.3, 0.3]], dtype=torch.float64)
    locked[0, order[1]] = np.pi / 2
    again = euler_matrices(matrix_angles(euler_matrices(locked, order), order), order)
    torch.testing.assert_close(again, euler_matrices(locked, order), atol=1e-6, rtol=0)


def test_quaternions_multiply_and_come_apart_into_swing_and_twist():
    one, other = (Rotation.random(20, random_state=seed) for seed in (0, 1))
    first, second = (torch.tensor(rotation.as_quat()) for rotation in (one, other))
    torch.testing.assert_close(quaternion_matrices(multiply(first, second)), torch.tensor((one * other).as_matrix()))
    twist = twist_of(first, 1)
    swing = multiply(first, conjugate(twist))
    assert twist[:, [0, 2]].abs().max() == 0 and swing[:, 1].abs().max() < 1e-12
    halves = Rotation.from_quat(to_identity(first, torch.tensor(0.25).double()).numpy())
    torch.testing.assert_close(torch.tensor(halves.magnitude()), torch.tensor(one.magnitude() * 0.75))
    identity = torch.tensor([[0.0, 0, 0, 1]], dtype=torch.float64, requires_grad=True)
    to_identity(identity, torch.tensor(0.3)).sum().backward()
    assert torch.isfinite(identity.grad).all()


def test_quaternion_joints_rotate_column_after_column():
    found = Draft("x", raw=["a", "b"], joints=[Joint("root", -1, (0, 0, 0))])
    found.groups = [Group((0, 1), [3, 4, 5], np.array([[40.0, 0], [0, 60.0], [10, -20]]))]
    file = with_layers(found.file(), JointRepresentations((Representation(0, 1, 0),)))
    weights = np.array([[0.3, 0.9], [1.0, 1.0], [0.0, 0.5]])
    changes = Logic(file)(torch.tensor(weights)).joints
    for row, (a, b) in enumerate(weights):
        product = Rotation.identity()
        for weight, angles in ((a, (40, 0, 10)), (b, (0, 60, -20))):
            p = Rotation.from_euler("xyz", angles, degrees=True).as_quat()
            blended = weight * p + (1 - weight) * np.array([0, 0, 0, 1])
            product = Rotation.from_quat(blended) * product
        expected = product.as_quat() * np.sign(product.as_quat()[3])
        torch.testing.assert_close(changes.quaternions[row, 0], torch.tensor(expected), atol=1e-7, rtol=0)


def test_swings_and_twists_take_part_of_a_rotation():
    found = Draft("x", raw=["q.x", "q.y", "q.z", "q.w", *"efgh"])
    found.joints = [Joint(name, -1 if name == "r" else 0, (0, 0, 0)) for name in "rabc"]
    found.groups = [Group((0,), [9, 10, 12, 13], np.full((4, 1), 30.0))]
    entries = TwistsAndSwings(
        twists=(Twist(floats(0.25), shorts(1), shorts(0, 1, 2, 3), 0), Twist(floats(0.5), shorts(2), shorts(4, 5, 6, 7), 2)),
        swings=(Twist(floats(0.4), shorts(3), shorts(0, 1, 2, 3), 0),),
    )
    logic = Logic(with_layers(found.file(), entries))
    q = Rotation.from_euler("xyz", [40, 25, -35], degrees=True)
    raw = torch.tensor(np.concatenate([q.as_quat(), q.as_quat()])[None])
    turns = Rotation.from_quat(logic(raw).joints.quaternions[0].numpy())
    assert logic(raw).joints.quaternion_joints.tolist() == [1, 2, 3]
    assert logic.quaternions.tolist() == [[0, 1, 2, 3], [4, 5, 6, 7]]

    def twist(axis: int) -> Rotation:
        kept = q.as_quat() * np.isin(np.arange(4), (axis, 3))
        return Rotation.from_quat(kept)

    def part(rotation: Rotation, amount: float) -> Rotation:
        return Rotation.from_rotvec(rotation.as_rotvec() * amount)

    x = twist(0)
    expected = [part(x.inv(), 0.75), part(twist(2), 0.5), x.inv() * part((q * x.inv()).inv(), 0.6)]
    for found_one, expected_one in zip(turns, expected):
        assert (found_one.inv() * expected_one).magnitude() < 1e-6


def test_operations_gather_run_nets_sum_and_scatter():
    """Operations that do what plain nets do, with their outputs mixed, give the mixture."""
    plain, operations = Logic(everything(operations=False)), Logic(everything(operations=True))
    raw = torch.rand(5, 12, dtype=torch.float64)
    one, other = (logic.all_controls(raw)[:, FIRST_ML : FIRST_ML + 2] for logic in (plain, operations))
    torch.testing.assert_close(other[:, 0], 0.25 * one[:, 0] + 0.75 * one[:, 1])
    torch.testing.assert_close(other[:, 1], one[:, 1])


def test_joints_that_nets_move_are_added_and_rotated_last():
    found = Draft("x", raw=["a", "b", "c"], joints=[Joint("root", -1, (0, 0, 0))])
    found.groups = [Group((0,), [0, 3], np.array([[10.0], [30.0]]))]
    entry = MachineLearningOperations((), shorts(1), shorts(0), shorts(1, 2), shorts(0, 5))
    changes = Logic(with_layers(found.file(), entry))(torch.tensor([[1.0, 0.5, 40.0]], dtype=torch.float64)).joints
    assert changes.attributes[0, 0, 0] == pytest.approx(1.5)
    expected = Rotation.from_euler("z", 40, degrees=True) * Rotation.from_euler("x", 30, degrees=True)
    torch.testing.assert_close(quaternion_matrices(changes.quaternions[0, 0]), torch.tensor(expected.as_matrix()))


def test_radial_weights_fall_with_the_distance_to_their_poses():
    logic = Logic(everything())
    raw = torch.zeros(3, 12, dtype=torch.float64)
    raw[:, 11] = 1.0
    raw[1, 8:] = torch.tensor([0.5, 0, 0, 0.5]).double().sqrt()  # the second pose of the solver, 90 degrees about x
    raw[2, 8] = np.sin(np.pi / 8)
    raw[2, 11] = np.cos(np.pi / 8)  # half way
    found = logic.all_controls(raw)[:, 17:19]
    radius = np.deg2rad(80)

    def weight(degrees: float) -> float:
        return np.exp(-np.deg2rad(degrees) / radius**2)

    rows = []
    for to in ((0, 90, 90), (90, 0, 120), (45, 45, None)):
        third = np.rad2deg(2 * np.arccos(np.cos(np.pi / 8) * np.sqrt(0.5))) if to[2] is None else to[2]
        weights = np.array([weight(to[0]), weight(to[1]), weight(third)])
        weights = weights / weights.sum() * [1, 1, 0.8]
        rows.append(weights[1:])
    torch.testing.assert_close(found, torch.tensor(np.array(rows)), atol=1e-4, rtol=0)  # poses are float32


@pytest.mark.parametrize("operations", [False, True])
def test_every_stage_is_differentiable(operations):
    logic = Logic(everything(operations=operations)).double()
    generator = torch.Generator().manual_seed(0)
    raw = (0.1 + 0.8 * torch.rand(3, 12, generator=generator, dtype=torch.float64)).requires_grad_()

    def stages(raw: torch.Tensor) -> tuple[torch.Tensor, ...]:
        found = logic(raw)
        return found.controls, found.joints.attributes, found.joints.quaternions, found.channels, found.maps

    assert torch.autograd.gradcheck(stages, (raw,), check_batched_grad=True)
    gui = (0.1 + 0.25 * torch.rand(3, 5, generator=generator, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(logic.raw_of, (gui,))


def test_degrees_and_radians_and_signs_are_those_of_the_file():
    file = draft().file()
    degrees = Logic(file)(torch.rand(2, 12, generator=torch.Generator().manual_seed(0)))
    radians = Logic(changed(file, Descriptor, rotation_unit=1))
    one = radians.joints.angles.in_file(radians.joints.angles.radians(degrees.joints.attributes[:, 3:6].movedim(1, -1)))
    torch.testing.assert_close(one, degrees.joints.attributes[:, 3:6].movedim(1, -1))
    assert radians.joints.angles.factors == (1.0, 1.0, 1.0)
    assert Logic(everything()).joints.angles.factors == pytest.approx((np.pi / 180, -np.pi / 180, np.pi / 180))


def test_a_table_of_a_user_is_made_of_lines():
    row = Row.between("g", "r", (-1, 1), (0, 0.5))
    assert (row.slope * -1 + row.cut, row.cut) == (1.0, 0.5) and (row.lower, row.upper) == (-1, 0)
