"""Clips that lie about what they hold; damage at random stands in tests/fuzz."""

import numpy as np
import pytest

from riginv.errors import InputError
from tests.fuzz.readers import CLIPS, read_clip, toy
from tests.support.clips import performance, write_mdd, write_obj


def test_a_header_that_promises_too_much_costs_nothing(tmp_path):
    """Headers that ask for terabytes are refused by the size of the file."""
    meshes = performance(toy(), 7)
    huge = np.array([2**31 - 1, 2**20], ">i4").tobytes()
    mdd = write_mdd(tmp_path / "a.mdd", meshes)
    mdd.write_bytes(huge + mdd.read_bytes()[8:])
    npy = CLIPS["npy"](tmp_path / "a.npy", meshes, toy().faces.numpy())
    npy.write_bytes(npy.read_bytes().replace(b"(7, 42, 3)", b"(7, 4294967295, 3)".ljust(10), 1))
    for path in (mdd, npy):
        with pytest.raises(InputError, match=path.name):
            read_clip(path)


def test_arrays_of_python_objects_are_never_loaded(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[[print] * 3]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="Python objects"):
        read_clip(tmp_path / "a.npy")


def test_a_folder_of_both_kinds_is_refused(tmp_path):
    meshes = performance(toy(), 2)
    write_obj(tmp_path / "a.1.obj", meshes[0], toy().faces.numpy())
    CLIPS["ply"](tmp_path / "a.2.ply", meshes, toy().faces.numpy())
    with pytest.raises(InputError, match="found both: .*names its OBJ files"):
        read_clip(tmp_path)
