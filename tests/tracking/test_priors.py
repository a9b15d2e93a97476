"""Priors on controls: learned, made up, kept in files, and in the solvers."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from riginv.errors import InputError
from riginv.rig.interface import Control
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.solvers.every_mesh import refine_meshes
from riginv.solvers.objective import GaussianPrior, Objective
from riginv.tracking.priors.files import FACTS, NUMBERS, load_prior, save_prior
from riginv.tracking.priors.performances import PoseLibrary, default_prior
from riginv.tracking.priors.prior import blended, learn_prior
from riginv.tracking.priors.takes import LEAST, LEAST_FPS, Take, read_take, with_changes
from tests.support.toys import ToyRig


@pytest.fixture(scope="module")
def rig() -> ToyRig:
    return ToyRig()


def draws(rig: ToyRig, count: int = 400) -> torch.Tensor:
    """Controls of which the first two always go together."""
    units = torch.rand(count, len(rig.controls), generator=torch.Generator().manual_seed(1))
    units[:, 1] = units[:, 0]
    return rig.lower + (rig.upper - rig.lower) * units


def test_a_prior_says_what_went_together(rig):
    prior = learn_prior(rig, draws(rig))
    correlation = prior.covariance / torch.outer(prior.deviation, prior.deviation)
    assert correlation[0, 1] > 0.99 and abs(correlation[0, 2]) < 0.2
    assert prior.mean[5] == pytest.approx(0.5, abs=0.1)  # a two-sided control, in fractions of its range


def test_controls_that_make_no_prior_are_refused(rig):
    with pytest.raises(InputError, match="at least 2 frames"):
        learn_prior(rig, draws(rig)[:1])
    with pytest.raises(InputError, match="NaN"):
        learn_prior(rig, draws(rig) * float("nan"))


def test_what_a_take_does_not_move_stays_free(rig):
    still = draws(rig)
    still[:, 3] = 0.0
    prior = blended(learn_prior(rig, still), default_prior(rig))
    assert prior.deviation[3] >= 0.499 * default_prior(rig).deviation[3]


def test_rescaling_keeps_what_the_other_controls_say_about_hidden_ones(rig):
    prior, hidden = learn_prior(rig, draws(rig)), torch.arange(7) < 2
    found = prior.rescaled(hidden, 4.0, 0.25)

    def regression(covariance):
        return torch.linalg.solve(covariance[~hidden][:, ~hidden], covariance[~hidden][:, hidden])

    torch.testing.assert_close(regression(found.covariance), regression(prior.covariance))
    torch.testing.assert_close(found.covariance[~hidden][:, ~hidden], 4 * prior.covariance[~hidden][:, ~hidden])
    torch.testing.assert_close(found.precision[hidden][:, hidden], 4 * prior.precision[hidden][:, hidden])


def test_the_face_smiles_on_both_sides_at_once(face):
    prior = default_prior(face)
    number = {name: index for index, name in enumerate(prior.names)}
    correlation = prior.covariance / torch.outer(prior.deviation, prior.deviation)
    smile, other, squint, gaze = (number[n] for n in ("mouthSmileLeft", "mouthSmileRight", "cheekSquintLeft", "eyeLookUpLeft"))
    assert correlation[smile, other] > 0.5 > correlation[smile, squint] > 0.1 > abs(correlation[smile, gaze])


def test_the_library_has_each_control_on_its_own(rig):
    library = PoseLibrary.of(rig)
    start = torch.full((7,), 0.1, dtype=torch.float64)
    poses = library.around(start)
    assert all(bool(library.moved[:, number].any()) for number in range(7))
    assert bool((poses[~library.moved] == 0.1).all())


@pytest.mark.parametrize("units", [torch.rand(3, 7, generator=torch.Generator().manual_seed(2))])
def test_an_objective_with_a_prior_has_its_gradient_and_hessian(rig, units):
    in_space = RigInMeshSpace(rig.double(), MeshSpace.from_rig(rig.double()))
    learned = learn_prior(rig, draws(rig)).weighed(1.0, 50)
    with_prior, without = Objective(in_space, learned=learned), Objective(in_space)
    units, target = units.double(), torch.zeros(3, in_space.space.size, dtype=torch.float64)
    near, plain = with_prior.linearise(units, target), without.linearise(units, target)
    rig.float()
    torch.testing.assert_close(near.hessian - plain.hessian, (learned.precision * 162).expand(3, -1, -1))
    for number in range(7):
        step = 1e-5 * torch.eye(7, dtype=torch.float64)[number]
        rise = with_prior.cost(units + step, target) - with_prior.cost(units - step, target)
        torch.testing.assert_close(rise / 2e-5, near.gradient[:, number], rtol=1e-3, atol=1e-3)


def test_a_heavy_prior_pulls_a_solver_to_its_mean():
    rig = ToyRig()
    in_space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    mean = torch.full((7,), 0.4, dtype=torch.float64)
    objective = Objective(in_space, learned=GaussianPrior(mean, 1e4 * torch.eye(7, dtype=torch.float64)))
    found = refine_meshes(objective, torch.zeros(1, in_space.space.size), torch.full((1, 7), 0.2), 20)
    torch.testing.assert_close(found.units[0], mean.float(), atol=0.02, rtol=0)


def test_a_prior_comes_back_from_its_folder(rig, tmp_path):
    prior = learn_prior(rig, draws(rig), "monday.csv")
    save_prior(tmp_path / "prior", prior, rig, 400)
    found = load_prior(tmp_path / "prior", rig)
    torch.testing.assert_close(found.covariance, prior.covariance)
    assert found.source == "monday.csv" and found.names == rig.control_names


def smooth_take(rig: ToyRig, rate: float, numbers: torch.Tensor) -> Take:
    """Controls of which the first two move together, and the last one is still."""
    seconds = numbers[:, None] / rate
    units = 0.5 + 0.3 * torch.sin(seconds * torch.tensor([2.0, 2.0, 0.5, 1.0, 3.0, 5.0, 0.0]))
    return Take(rig.lower + (rig.upper - rig.lower) * units, (), numbers, rate)


def test_changes_are_the_second_differences_of_the_takes(rig):
    rows = torch.arange(200)
    take = smooth_take(rig, 30.0, torch.cat([rows, rows + 500]))  # a long gap is not a change
    prior = with_changes(learn_prior(rig, take.controls), rig, [take])
    halves = [smooth_take(rig, 30.0, numbers) for numbers in (rows, rows + 500)]
    torch.testing.assert_close(prior.changes, with_changes(prior, rig, halves).changes)
    units = (take.controls - rig.lower) / (rig.upper - rig.lower)
    second = torch.cat([half.diff(n=2, dim=0) for half in units.split(200)]).double()
    expected = second.T @ second / len(second) + LEAST**2 * torch.eye(7)
    torch.testing.assert_close(prior.changes / LEAST_FPS**3, expected, atol=1e-9, rtol=1e-4)
    at = prior.changes_at(60.0, 0.3, 50, 1.5)
    torch.testing.assert_close(at, prior.changes_at(30.0, 0.3, 50, 1.5) / 8)
    torch.testing.assert_close(1.5 * torch.linalg.inv(at), 0.3**2 / 50 * torch.linalg.inv(prior.changes / 60.0**3))
    assert with_changes(learn_prior(rig, take.controls), rig, [smooth_take(rig, 30.0, rows[:2])]).changes is None


def test_changes_come_back_from_a_folder_and_damaged_ones_are_refused(rig, tmp_path):
    take = smooth_take(rig, 24.0, torch.arange(90))
    prior = with_changes(learn_prior(rig, take.controls), rig, [take])
    save_prior(tmp_path / "prior", prior, rig, 90)
    torch.testing.assert_close(load_prior(tmp_path / "prior", rig).changes, prior.changes)
    save_prior(tmp_path / "older", learn_prior(rig, take.controls), rig, 90)
    assert load_prior(tmp_path / "older", rig).changes is None
    for number, changes in enumerate((-prior.changes, prior.changes[:3], torch.nan * prior.changes)):
        save_prior(tmp_path / f"damaged{number}", replace(prior, changes=changes), rig, 90)
        with pytest.raises(InputError, match="changes"):
            load_prior(tmp_path / f"damaged{number}", rig)


def test_a_prior_of_another_rig_is_refused(rig, tmp_path):
    save_prior(tmp_path / "prior", learn_prior(rig, draws(rig)), rig, 400)
    with pytest.raises(InputError, match="was made with rig 'toy', and rig 'toy' has 642 vertices"):
        load_prior(tmp_path / "prior", ToyRig(detail=3))
    other = ToyRig(last_name="everything")
    assert isinstance(other.controls[-1], Control)
    with pytest.raises(InputError, match="everything"):
        load_prior(tmp_path / "prior", other)


@pytest.mark.parametrize("damage", ["facts", "numbers", "indefinite", "missing"])
def test_a_damaged_prior_ends_in_one_sentence(rig, tmp_path, damage):
    folder, prior = tmp_path / "prior", learn_prior(rig, draws(rig))
    if damage == "indefinite":
        prior = type(prior)(prior.names, prior.mean, -prior.covariance)
    save_prior(folder, prior, rig, 400)
    if damage == "facts":
        (folder / FACTS).write_text("riginv_prior: 1\nrig: {}\n")
    if damage == "numbers":
        (folder / NUMBERS).write_bytes((folder / NUMBERS).read_bytes()[:100])
    if damage == "missing":
        (folder / NUMBERS).unlink()
    with pytest.raises(InputError):
        load_prior(folder, rig)


def test_curves_are_takes(rig, tmp_path):
    path = tmp_path / "curves.csv"
    rows = np.round(draws(rig, 5).numpy(), 4)
    header = ",".join(["frame", "seconds", *rig.control_names])
    path.write_text("\n".join([header, *(f"{n},0,{','.join(map(str, row))}" for n, row in enumerate(rows))]))
    np.testing.assert_allclose(read_take(path, rig, 1, 3).controls, rows[1:4], atol=1e-6)
    path.write_text(path.read_text().replace("bump2", "lump2"))
    with pytest.raises(InputError, match="bump2"):
        read_take(path, rig)
