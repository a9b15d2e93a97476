"""Damaged, odd and hostile DNA files: one sentence each, or mended with a note."""

import dataclasses

import numpy as np
import pytest

from riginv.errors import InputError
from rigs.dna import DnaRig
from rigs.dna.format import DnaFile, Layer, read_dna
from rigs.dna.format.container import dna_bytes, parse_dna
from rigs.dna.format.later_layers import (
    Conventions,
    JointRepresentations,
    MachineLearning,
    RadialBasis,
    Representation,
    TwistsAndSwings,
)
from rigs.dna.format.layers import Axes, Behavior, Definition, Descriptor, Geometry, Lods
from rigs.dna.format.ragged import Ragged
from tests.rigs.dna.files import FIRST_ML, RAWS, changed, draft, everything, floats, shared, shorts, written


def refused(tmp_path, file: DnaFile, message: str, **arguments) -> None:
    path = written(tmp_path / "bad.dna", file)
    with pytest.raises(InputError, match=message) as caught:
        DnaRig(path, **arguments)
    assert "\n" not in str(caught.value) and str(caught.value).startswith(path)


def behaviour(**fields) -> DnaFile:
    return changed(everything(), Behavior, **fields)


def controls(**fields) -> DnaFile:
    return behaviour(controls=dataclasses.replace(everything().need(Behavior).controls, **fields))


def group(**fields) -> DnaFile:
    joints = everything().need(Behavior).joints
    first = dataclasses.replace(joints.groups[0], **fields)
    return behaviour(joints=dataclasses.replace(joints, groups=(first, *joints.groups[1:])))


def mesh(number: int = 0, **fields) -> DnaFile:
    meshes = list(everything().need(Geometry).meshes)
    meshes[number] = dataclasses.replace(meshes[number], **fields)
    return changed(everything(), Geometry, meshes=tuple(meshes))


def influences(edit) -> DnaFile:
    weights, joints = everything().need(Geometry).meshes[0].influences
    values, numbers = weights.values.copy(), joints.values.copy()
    edit(values, numbers)
    return mesh(influences=(Ragged(values, weights.sizes), Ragged(numbers, joints.sizes)))


@pytest.mark.parametrize("fraction", [0.001, 0.01, 0.05, 0.2, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("version", [1, 8])
def test_a_truncated_file_is_refused_wherever_it_ends(fraction, version):
    file = everything() if version == 8 else dataclasses.replace(draft().file(), version=1)
    data = dna_bytes(file)
    with pytest.raises(InputError) as caught:
        parse_dna(data[: int(fraction * len(data))], "a.dna")
    assert "truncated" in str(caught.value) or "damaged" in str(caught.value)


def test_a_count_beyond_the_file_is_refused_before_anything_is_made():
    data = bytearray(dna_bytes(draft().file()))
    start = data.index(b"defn") + 8
    offset = int.from_bytes(data[start : start + 4], "big")
    data[offset : offset + 4] = b"\xff\xff\xff\xff"
    with pytest.raises(InputError, match="layer 'defn': a list of 4,294,967,295 elements at byte .* does not fit"):
        parse_dna(bytes(data), "a.dna")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "expected 'DNA': this is no DNA file, or it is truncated"),
        (b"glTF\x02\0\0\0rest", "starts with b'glTF"),
        (b"DNA\0\3\0\1" + b"\0" * 40, "DNA version 3.1, expected 2.1 or later of generation 2"),
        (b"DNA\0\2\0\0" + b"\0" * 40, "DNA version 2.0, expected 2.1"),
        (b"DNA\0\2\0\2\xff\xff\xff\xff", "the index of its layers: a list of 4,294,967,295"),
        (b"DNA\0\2\0\2\0\0\0\1desc\0\1\0\1\0\0\0\x1b\0\0\1\0", "layer b'desc' is at bytes 27 to 283, the file has 27"),
        (b"DNA\0\2\0\2\0\0\0\1desc\0\1\0\1\0\0\0\x0b\0\0\0\4", "layer b'desc' is at bytes 11 to 15"),
    ],
)
def test_what_is_no_dna_file_is_told(data, message):
    with pytest.raises(InputError, match=message):
        parse_dna(data, "a.dna")


def test_layers_that_overlap_are_refused():
    """Else a small file could ask for a copy of itself for each of a million layers."""
    data = bytearray(dna_bytes(draft().file()))
    place = data.index(b"geom") + 8
    data[place : place + 8] = data[data.index(b"defn") + 8 :][:8]
    with pytest.raises(InputError, match="the file is damaged"):
        parse_dna(bytes(data), "a.dna")


def test_a_file_of_the_future_is_told(tmp_path):
    path = shared("dna/fixtures/v2.65535-newer.dna")
    with pytest.raises(InputError, match="no layer 'defn 1.1', which a rig needs; its layers are: desc 1.2"):
        DnaRig(str(path))
    file = everything()
    doubled = dataclasses.replace(file, layers=(*file.layers, file.layers[0]))
    refused(tmp_path, doubled, "two layers 'desc 1.1', expected one")
    assert dna_bytes(read_dna(tmp_path / "bad.dna")) == dna_bytes(doubled)
    without = dataclasses.replace(file, layers=tuple(layer for layer in file.layers if layer.name != "geom"))
    refused(tmp_path, without, "no layer 'geom 1.1'")


@pytest.mark.parametrize("name", ["v2.1", "v2.2", "v2.3", "v2.4", "v2.8", "v2.2-empty"])
def test_fixtures_that_no_engine_can_evaluate_are_told_what_is_wrong(name):
    with pytest.raises(InputError, match="PSD matrix is control 8|which is a PSD|expected 2 x 3|its axes x, y, z point in"):
        DnaRig(str(shared("dna/fixtures", f"{name}.dna")))


PSDS = everything().need(Behavior).controls.psds
TABLE = everything().need(Behavior).controls.table
WRONG = {
    "psd row": (
        controls(psds=dataclasses.replace(PSDS, rows=PSDS.rows - 12)),
        "row of the PSD matrix is control 0, its 3 PSDs",
    ),
    "psd column": (controls(psds=dataclasses.replace(PSDS, columns=PSDS.columns + 90)), "column of the PSD matrix uses number"),
    "psd lists": (controls(psds=dataclasses.replace(PSDS, values=PSDS.values[1:])), "the PSD matrix has lists of different"),
    "psd NaN": (
        controls(psds=dataclasses.replace(PSDS, values=PSDS.values * np.nan)),
        "the PSD matrix holds 7 numbers",
    ),
    "gui": (
        controls(table=dataclasses.replace(TABLE, inputs=TABLE.inputs + 9)),
        "input of the GUI table uses number 12",
    ),
    "raw": (controls(table=dataclasses.replace(TABLE, outputs=TABLE.outputs + 9)), "output of the GUI table uses number 15 of"),
    "table NaN": (controls(table=dataclasses.replace(TABLE, cuts=TABLE.cuts + np.inf)), "the GUI table, cuts holds"),
    "group size": (group(values=floats(1, 2)), "joint group 0 has 2 values, expected 9 rows x 4 columns"),
    "group column": (group(inputs=shorts(0, 1, 3, 900)), "a column of joint group 0 uses number 900 of its controls"),
    "group row": (group(outputs=shorts(*range(46, 55))), "a row of joint group 0 uses number 54 of its joint attributes"),
    "group level": (group(row_counts=shorts(10, 6)), "joint group 0 uses 10 rows at level of detail 0, there are 9"),
    "group NaN": (group(values=floats(*[np.nan] * 36)), "joint group 0 holds 36 numbers"),
    "parents": (changed(everything(), Definition, parents=shorts(0, 0, 3, 2, 2, 2)), "the joints form a cycle"),
    "parent": (changed(everything(), Definition, parents=shorts(0, 0, 1, 2, 2, 99)), "joint 'right' has parent number 99"),
    "few parents": (changed(everything(), Definition, parents=shorts(0)), "1 joints have parents, 6 have names"),
    "names": (changed(everything(), Definition, gui_controls=("a", "b", "a", "c", "d")), "two GUI controls are named 'a'"),
    "no meshes": (
        changed(everything(), Definition, lod_meshes=Lods(shorts(0, 0), (shorts(),))),
        "level of detail 0 has no meshes",
    ),
    "mesh": (changed(everything(), Definition, lod_meshes=Lods(shorts(0, 0), (shorts(7),))), "uses number 7 of its meshes"),
    "table of levels": (changed(everything(), Definition, lod_meshes=Lods(shorts(5, 0), (shorts(),))), "uses row 5 of 1"),
    "mesh names": (changed(everything(), Definition, meshes=("a",)), "1 meshes have names, 3 have vertices"),
    "axes": (changed(everything(), Descriptor, axes=Axes(1, 0, 2)), r"its axes x, y, z point in directions \(1, 0, 2\)"),
    "sequence": (changed(everything(), Conventions, sequence=9), "rotations are of unit 0, sequence 9"),
    "unit": (changed(everything(), Descriptor, rotation_unit=4), "rotations are of unit 4"),
    "corners": (mesh(position_of_corner=shorts(0, 1)), "a face of mesh 'skin' uses number 41 of its corners, it has 0 to 1"),
    "face": (mesh(faces=Ragged(shorts(0, 1), np.array([2]))), "face 0 of mesh 'skin' has 2 corners, expected at least 3"),
    "weight": (influences(lambda values, joints: values.__setitem__(3, -0.5)), "vertex 0 has a negative weight|vertex 1 has a"),
    "NaN weight": (
        influences(lambda values, joints: values.__setitem__(3, np.nan)),
        "skin weights of mesh 'skin' holds 1",
    ),
    "joint": (influences(lambda values, joints: joints.__setitem__(3, 77)), "skin weights of mesh 'skin' uses number 77"),
    "no weight": (influences(lambda values, joints: values.__setitem__(slice(None), 0)), "vertex 0 has no weight above 0"),
    "representations": (
        changed(everything(), JointRepresentations, joints=(Representation(0, 1, 0),)),
        "1 joints have representations, there are 6",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_evaluated_is_refused_in_one_sentence(tmp_path, name):
    refused(tmp_path, *WRONG[name])


def learned(**fields) -> DnaFile:
    nets = everything().need(MachineLearning).nets
    return changed(everything(), MachineLearning, nets=(dataclasses.replace(nets[0], **fields), *nets[1:]))


def solver(**fields) -> DnaFile:
    solvers = everything().need(RadialBasis).solvers
    return changed(everything(), RadialBasis, solvers=(dataclasses.replace(solvers[0], **fields), *solvers[1:]))


def twist(**fields) -> DnaFile:
    twists = everything().need(TwistsAndSwings).twists
    return changed(everything(), TwistsAndSwings, twists=(dataclasses.replace(twists[0], **fields),))


WRONG_LATER = {
    "net writes a PSD": (
        learned(outputs=shorts(RAWS)),
        "net 0 writes control 12, which is a PSD: controls 12 to 14 are",
    ),
    "net reads": (learned(inputs=shorts(0, 1, 99)), "an input of net 0 uses number 99 of its controls"),
    "net size": (learned(inputs=shorts(0, 1)), "layer 0 of net 0 has 9 weights, expected 3 x 2"),
    "net outputs": (learned(outputs=shorts(FIRST_ML, 0)), "net 0 gives 1 numbers for 2 controls"),
    "solver values": (solver(values=floats(1, 2)), "solver 'aim' has 2 values, expected 3 poses x 4 controls"),
    "solver distance": (solver(distance=9), "solver 'aim' has distance 9, expected 0 to 3"),
    "solver pose": (solver(poses=shorts(0, 1, 50)), "solver 'aim' uses number 50 of its poses"),
    "solver radius": (solver(radius=0.0), "solver 'aim' has a radius of 0, expected more than 0"),
    "solver twins": (solver(kind=1, values=floats(*[0, 0, 0, 1] * 3)), "solver 'aim' has poses that cannot be told apart"),
    "twist": (twist(controls=shorts(1, 2)), "twist 0 has 2 controls and axis 0, expected 4"),
    "twist joint": (twist(joints=shorts(70)), "twist 0 uses number 70 of its joints"),
}


@pytest.mark.parametrize("name", WRONG_LATER)
def test_what_cannot_be_evaluated_of_later_layers_is_refused(tmp_path, name):
    refused(tmp_path, *WRONG_LATER[name])


def test_weights_that_do_not_sum_to_1_are_divided_by_their_sums_with_a_note(tmp_path, caplog):
    whole = DnaRig(written(tmp_path / "a.dna", everything()), "raw")
    with caplog.at_level("INFO"):
        halved = DnaRig(written(tmp_path / "b.dna", influences(lambda values, joints: values.__imul__(0.5))), "raw")
    assert "the skin weights of mesh 'skin' of 42 vertices do not sum to 1, such as 0.5 of vertex" in caplog.text
    found, expected = (rig(rig.upper[None]) for rig in (halved, whole))
    assert (found - expected).abs().max() < 1e-3


def test_names_lead_nowhere(tmp_path):
    """Names in a file are never paths, and what moves a cursor is no name."""
    found = draft()
    found.meshes = [found.meshes[0]._replace(name="../../etc/passwd")]
    found.channels = [(f"a/b\\{number}", control) for number, (_, control) in enumerate(found.channels)]
    assert DnaRig(written(tmp_path / "a.dna", found.file()), meshes=["..*"]).parts[0][0] == "../../etc/passwd"
    file = changed(found.file(), Definition, gui_controls=("a\x1b[2J", "b", "c", "d", "e"))
    with pytest.raises(InputError, match="expected printable text"):
        DnaRig(written(tmp_path / "b.dna", file))


def test_layers_with_their_own_bytes_stay_bytes(tmp_path):
    file = everything()
    odd = dataclasses.replace(file, layers=(*file.layers, Layer("....", (0, 0), b"")))
    path = written(tmp_path / "a.dna", odd)
    assert read_dna(path).layers[-1].name == "...." and DnaRig(path).name == "a"


@pytest.mark.parametrize("name", ["nowhere.dna", "folder", "bad\0name"])
def test_a_path_that_leads_to_no_file_is_told(tmp_path, name):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="no such file|cannot be read"):
        read_dna(f"{tmp_path}/{name}")


def bomb(name: str) -> DnaFile:
    """A file of less than a megabyte whose tables would fill tens of gigabytes."""
    many = 60_000
    if name == "psds":
        psds = dataclasses.replace(PSDS, rows=shorts(*[RAWS] * many), columns=shorts(*[0] * many), values=floats(*[1] * many))
        file = draft().file()
        crowded = dataclasses.replace(file.need(Behavior).controls, psds=psds, psd_count=50_000)
        return changed(file, Behavior, controls=crowded)
    if name == "table":
        ones = {field: floats(*[1.0] * (2 * many)) for field in ("lower", "upper", "slopes", "cuts")}
        outputs = shorts(*[0] * many, *np.arange(many) % 2)
        return controls(table=dataclasses.replace(TABLE, inputs=shorts(*[0] * (2 * many)), outputs=outputs, **ones))
    poses = 20_000
    values = floats(*[0, 0, 0, 1] * poses)
    return solver(poses=shorts(*[0] * poses), values=values)


@pytest.mark.parametrize(("name", "what"), [("psds", "PSD matrix"), ("table", "GUI table"), ("poses", "solver 'aim'")])
def test_a_small_file_cannot_ask_for_a_large_table(tmp_path, name, what):
    refused(tmp_path, bomb(name), f"{what} needs a table of .* numbers, more than could be meant")
