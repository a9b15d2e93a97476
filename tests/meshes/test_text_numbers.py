"""Numbers as programs write them: NaN in every spelling is not known, Fortran's are read, commas are named."""

import math
from pathlib import Path

import numpy as np
import pytest

from riginv.errors import InputError
from riginv.meshes.obj import ObjMesh
from riginv.meshes.ply import PlyMesh
from riginv.meshes.text_numbers import mend_numbers, no_number, number_of, parse_numbers
from rigs.shapes import ShapesRig
from tests.support.sculpts import POINTS, offset, write_folder

NOT_KNOWN = """nan NaN -nan +NAN nan(ind) -nan(ind) -nan(snan) nan(0x8000) NaNQ nans 1.#IND -1.#IND00 1.#QNAN 1.#QNAN0 1.#SNAN
    1.#INF -1.#INF00 1.#J -1.#J 1.#R 1.#QO -1.#IO -1.$ 1.#QNANe+000 1.#INFe+000 inf -inf +Infinity INFINITY ∞ -∞""".split()
FORTRAN = {"1.0D+02": 100.0, "-.25d1": -2.5, "0.5D-01": 0.05, "3d0": 3.0, "1.5Q+01": 15.0}
NAMED = {
    "1,5": "decimal comma",
    "-0,25": "decimal comma",
    ",5": "decimal comma",
    "1,5e-3": "decimal comma",
    "1,234.5": "separators of thousands",
    "1.234.567,5": "separators of thousands",
    "1'234.5": "separators of thousands",
    "1\u00a0234.5": "separators of thousands",
    "1\u202f234": "separators of thousands",
    "1_234.5": "separators of thousands",
    "1.5-2.5": "two numbers without a space",
    "0.1234-102": "Fortran exponent that lacks its letter",
    "*****": "does not fit its columns",
    "0x1.8p3": "hexadecimal",
    "50%": "per cent",
}


@pytest.mark.parametrize("word", NOT_KNOWN)
def test_every_spelling_of_nan_and_infinity_is_not_known(word):
    assert math.isnan(number_of(word))
    data = f"v 1 2 3\nv 4 {word} 6\nv 7 8 9 # 1.#IND\nf 1 2 3\n".encode()
    points = ObjMesh(Path("a.obj"), data).points
    assert np.isfinite(points).tolist() == [[True] * 3, [True, False, True], [True] * 3]
    again = ObjMesh(Path("a.obj"), data.replace(b" # 1.#IND", b"")).points  # all at once, or line by line
    np.testing.assert_array_equal(points, again)
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    found = PlyMesh(Path("a.ply"), f"{header}1 2 3\n4 {word} 6\n".encode()).points
    assert np.isfinite(found).tolist() == [[True] * 3, [True, False, True]]


@pytest.mark.parametrize("word, value", FORTRAN.items())
def test_exponents_of_fortran_are_read_with_a_note(word, value):
    assert number_of(word) == value
    for extra in ("", "v 7 8 9 # a comment\n"):  # all at once, or line by line
        mesh = ObjMesh(Path("a.obj"), f"v 1 2 3\nv 4 {word} 6\n{extra}".encode())
        assert mesh.points[1].tolist() == [4, value, 6] and "Fortran" in mesh.notes[0]
    assert not ObjMesh(Path("a.obj"), b"v 1 2 3\nv 4 5E+01 6\n").notes


@pytest.mark.parametrize("word, reason", NAMED.items())
def test_what_is_no_number_is_named_with_its_line(word, reason):
    assert number_of(word) is None and reason in no_number(word)
    with pytest.raises(InputError, match=f"a.obj, line 3: found ['\"]v .*expected v X Y Z: .*{reason}"):
        ObjMesh(Path("a.obj"), f"# x\nv 1 2 3\nv 4 {word} 6\n".encode())
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    with pytest.raises(InputError, match=f"a.ply, line 9: found .*expected numbers: .*{reason}"):
        PlyMesh(Path("a.ply"), f"{header}1 2 3\n4 {word} 6\n".encode())


@pytest.mark.parametrize(
    "word", ["1e", "abc", "--1", "1.#abc", "1.#", "nanx", "xnan", "1.0D", "D+02", "1 2", "", "1e5e5", "infinite"]
)
def test_nothing_else_is_a_number(word):
    assert number_of(word) is None and no_number(word) == ""


@pytest.mark.parametrize("word", ["1", "+1", "-1.", ".5", "1e5", "1.5E-3", " 7 ", "0001"])
def test_plain_numbers_are_what_they_are(word):
    assert number_of(word) == float(word) and mend_numbers(word.encode()).text == word.encode()


def test_nothing_is_made_of_no_text():
    assert parse_numbers(b" \n\t").tolist() == [] and parse_numbers(b"1 2 x") is None


def test_long_words_cost_little():
    """Words of digits, commas and dots that fit no pattern are not tried in every way."""
    for word in ("1" * 200_000, "1," * 100_000, "1." * 100_000, "1" * 100_000 + "D", "nan(" * 50_000):
        assert number_of(word + "x") is None and len(no_number(word + "x")) < 200
        with pytest.raises(InputError):
            ObjMesh(Path("a.obj"), f"v 1 2 {word}x\n".encode())


@pytest.mark.parametrize("word", ["1.#IND00", "-nan(ind)", "1.#QNAN", "-1.#J", "Infinity"])
@pytest.mark.parametrize("name", ["neutral", "smile"])
def test_a_rig_is_not_made_of_what_is_not_known(word, name, tmp_path, own_cache):
    folder = write_folder(tmp_path / "rig", smile=POINTS + offset(1))
    path = folder / f"{name}.obj"
    first = path.read_text().split("\n")[0]
    path.write_text(path.read_text().replace(first, f"v 1 2 {word}", 1))
    with pytest.raises(
        InputError, match=f"{name}.obj: 1 vertices have NaN or infinite coordinates, the first is vertex 1 of 8"
    ):
        ShapesRig(str(folder))


def test_a_rig_in_fortrans_numbers_says_so_every_time(tmp_path, own_cache):
    folder = write_folder(tmp_path / "rig", smile=POINTS + offset(1))
    plain = ShapesRig(str(folder))
    path = folder / "smile.obj"
    lines = [line + ("D+00" if line.startswith("v ") else "") for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    for _ in range(2):  # read, and from the cache
        rig = ShapesRig(str(folder))
        assert len(rig.notes) == 1 and "Fortran" in rig.notes[0] and bool((rig.basis == plain.basis).all())
    assert plain.notes == ()
