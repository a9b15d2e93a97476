"""Every rig says how large it is, and one that can hardly be so large is doubted."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from riginv.rig.size import extent, length, rig_line, size_doubt
from tests.support.avatars import AvatarWriter
from tests.support.clips import performance, write_npz
from tests.support.sculpts import FACES, POINTS, offset, write_folder
from tests.support.toys import ToyRig

pytestmark = pytest.mark.usefixtures("own_cache")


class Scaled(ToyRig):
    """The toy at another size."""

    def __init__(self, size_mm: float) -> None:
        super().__init__()
        self.rest_vertices *= size_mm / 100


def test_a_rig_in_one_line():
    assert rig_line(ToyRig()) == "rig toy: 7 controls, 162 vertices, 320 faces, 100 mm tall (100 x 100 x 100 mm)"
    assert "1.75 m tall (1.75 x 1.75 x 1.75 m)" in rig_line(Scaled(1750))
    assert [length(mm) for mm in (0.0341, 34.1, 174.4, 999, 17400, 2e6)] == [
        "0.0341 mm",
        "34.1 mm",
        "174 mm",
        "999 mm",
        "17.4 m",
        "2 km",
    ]
    assert extent([1.0, 2.0, 3.5], "units") == "1 x 2 x 3.5 units"


@pytest.mark.parametrize("size", [0.17, 34, 49, 5100, 17400, 1.7e5])
def test_sizes_that_no_face_or_body_has_are_doubted(size):
    doubt = size_doubt(Scaled(size), 1.0)
    assert f"measures {length(size)}" in doubt and "counts as 1 mm (rig.unit_mm)" in doubt
    assert "rig.unit_mm" in size_doubt(Scaled(size))


@pytest.mark.parametrize("size", [51, 100, 174, 400, 1750, 4900])
def test_sizes_of_faces_and_bodies_are_not(size):
    assert size_doubt(Scaled(size), 1.0) == ""


@pytest.mark.parametrize(
    ("size", "unit_mm", "fits"),
    [
        (17400, 1000, "10 makes it a face of 174 mm, 100 makes it a body of 1.74 m"),
        (17.4, 1, "10 makes it a face of 174 mm, 100 makes it a body of 1.74 m"),
        (0.174, 1, "1000 makes it a face of 174 mm"),
        (34, 1, "10 makes it a face of 340 mm"),
        (1.75e6, 1000, "1 makes it a body of 1.75 m"),
    ],
)
def test_the_units_that_would_fit_are_named(size, unit_mm, fits):
    assert f"now a unit of its file counts as {unit_mm:g} mm (rig.unit_mm): {fits}" in size_doubt(Scaled(size), unit_mm)


def avatar(path: Path, scale: float) -> Path:
    """A cube of 0.2 units, its node scaled, with one morph target."""
    writer = AvatarWriter()
    points = POINTS / np.ptp(POINTS, axis=0).max() * 0.2
    targets = [writer.accessor(offset(1) * 0.01)]
    faces = np.array([[a, b, c] for a, b, c, *_ in FACES])
    primitive = writer.primitive(writer.accessor(points), faces, targets)
    writer.node("head", mesh=writer.mesh("head", [primitive], ["smile"]), scale=[scale] * 3)
    return writer.write(path)


def test_an_avatar_in_centimetres_is_doubted_by_every_command(run: Callable, tmp_path):
    avatar(tmp_path / "large.glb", 100)
    told = "warning: rig 'large' measures 20 m"
    checked = run("check", "rig=gltf", "rig.file=large.glb")
    assert checked.code == 0 and told in checked.text and "counts as 1000 mm (rig.unit_mm)" in checked.text
    assert "10 makes it a face of 200 mm" in checked.text
    right = run("check", "rig=gltf", "rig.file=large.glb", "rig.unit_mm=10")
    assert right.code == 0 and "200 mm tall" in right.text and "warning" not in right.text
    trained = run("train", "rig=gltf", "rig.file=large.glb", "trainer.max_steps=1")
    assert trained.code == 0 and told in trained.text
    rig = torch.from_numpy(np.repeat((POINTS / np.ptp(POINTS, axis=0).max() * 0.2 * 100)[None], 5, axis=0))
    write_npz(tmp_path / "clip.npz", rig.numpy(), np.zeros((0, 3), int))
    inverted = run(
        "invert", "rig=gltf", "rig.file=large.glb", "clip=clip.npz", "out=o", "method=levenberg_marquardt", "motion=keep"
    )
    assert inverted.code == 0 and told in inverted.text and "rig.unit_mm" in inverted.text
    assert told in run("inspect", "clip.npz", "rig=gltf", "rig.file=large.glb").text


def test_so_is_a_folder_of_shapes_and_its_sheet_shows_primary_shapes_first(run: Callable, tmp_path):
    names = ["jaw", "smile", "jaw50", "jaw_smile"]
    write_folder(tmp_path / "mine", **{name: POINTS * 10 + offset(number) for number, name in enumerate(names)})
    outcome = run("contact_sheet", "rig=shapes", "rig.folder=mine", "out=sheet.png", "random_poses=1", "expressions=3")
    assert outcome.code == 0, outcome.text
    assert "rig mine: 2 controls (2 primary shapes, 1 in-between, 1 combination)" in outcome.text
    assert "warning: rig 'mine' measures" in outcome.text and "100 makes it a face of 300 mm" in outcome.text
    assert "5 poses of rig 'mine'; 1 more of its expressions are not drawn (expressions=null draws all)" in outcome.text
    from rigs.shapes import ShapesRig

    assert list(ShapesRig(str(tmp_path / "mine")).expressions()) == ["jaw", "smile", "jaw50", "jaw_smile"]
    everything = run("contact_sheet", "rig=shapes", "rig.folder=mine", "out=all.png", "random_poses=0", "expressions=null")
    assert "5 poses of rig 'mine'\n" in everything.text
    refused = run("contact_sheet", "rig=shapes", "rig.folder=mine", "out=all.png", "expressions=-1")
    assert refused.code == 1 and "expressions is -1" in refused.text


def test_a_long_list_of_names_is_one_line_and_a_count(run: Callable, tmp_path):
    shapes = {f"shape{letter}": POINTS * 100 + offset(number) for number, letter in enumerate("abcdefghij")}
    shapes |= {f"shapea_shape{letter}": POINTS * 100 for letter in "bcdefghij"}
    write_folder(tmp_path / "many", **shapes)
    short, long = (run("check", "rig=shapes", "rig.folder=many", *more).text for more in ((), ("verbose=true",)))
    assert "rig many: 10 controls (10 primary shapes, 9 combinations)" in short and "combination of" not in short
    assert long.count(": combination of shapea and") == 9


def test_a_clip_of_a_rig_of_the_right_size_is_taken_without_a_word(run: Callable, tmp_path):
    rig = ToyRig()
    write_npz(tmp_path / "take.npz", performance(rig, 5), rig.faces.numpy())
    options = (
        f"--config-dir={Path(__file__).parents[1] / 'conf'}",
        "clip=take.npz",
        "out=o",
        "look.page=false",
        "look.sheet=false",
    )
    assert "warning" not in run("invert", "rig=toy", *options).text
