"""The Maya script's parts that need no Maya: what it writes is what NumPy reads."""

import numpy as np
import pytest

from rigs.maya.sample import NpyFile, bounded, draw_poses, write_npy, write_table


@pytest.mark.parametrize(
    ("dtype", "rows"), [("<f4", [[0.1, -2.5, 3e9]] * 7), ("<i4", [[1, 2, 3], [4, 5, -6]]), ("<U9", ["jaw", "browé", ""])]
)
def test_numpy_reads_what_it_writes(dtype, rows, tmp_path):
    expected = np.array(rows, dtype)
    write_npy(str(tmp_path / "a.npy"), dtype, expected.shape, rows)
    found = np.load(tmp_path / "a.npy", allow_pickle=False)
    assert found.dtype == expected.dtype
    np.testing.assert_array_equal(found, expected)
    assert (tmp_path / "a.npy").read_bytes().index(b"\n") % 64 == 63  # aligned as NumPy's own


def test_a_file_with_too_few_rows_is_noticed(tmp_path):
    file = NpyFile(str(tmp_path / "a.npy"), "<f4", (2, 1))
    file.write([1.0])
    with pytest.raises(ValueError, match="1 rows are missing"):
        file.close()


def test_poses_leave_neutral_in_few_controls_within_limits():
    limits = [(-1.0, 1.0, 0.0), (0.0, 10.0, 5.0), (2.0, 3.0, 2.0), (0.0, 1.0, 0.0)]
    poses = np.array(list(draw_poses(limits, 2, 500, seed=1)))
    lower, upper, neutral = np.array(limits).T
    moved = (poses != neutral).sum(axis=1)
    assert set(moved) == {1, 2} and (poses >= lower).all() and (poses <= upper).all()
    assert poses.min(axis=0) == pytest.approx(lower, abs=0.2) and (poses != neutral).any(axis=0).all()
    assert np.array_equal(poses, np.array(list(draw_poses(limits, 2, 500, seed=1))))


def test_limits_follow_the_command_line():
    assert bounded("face.jaw", (0.0, 1.0, 0.0), ["*.jaw=-1:2", "arm.*=5:6"]) == (-1.0, 2.0, 0.0)
    with pytest.raises(SystemExit, match="mend it with --bounds"):
        bounded("face.jaw", (0.0, 1.0, 0.0), ["*=1:2"])


def test_a_table_is_what_pairs_are_read_from(tmp_path):
    names, limits, rest = ["jaw", "brow.left"], [(0.0, 1.0, 0.0), (-1.0, 1.0, 0.0)], [float(i) for i in range(12)]
    poses = [[0.0, 0.0], [1.0, -1.0], [0.5, 0.25]]
    folder = tmp_path / "pairs"
    write_table(str(folder), names, limits, rest, [0, 1, 2, 0, 2, 3], poses, lambda pose: [x + pose[0] for x in rest])
    table = {path.stem: np.load(path, allow_pickle=False) for path in folder.iterdir()}
    assert set(table) == {"controls", "vertices", "rest_vertices", "faces", "control_names", "lower", "upper", "neutral"}
    assert {name: array.shape for name, array in table.items() if name in ("controls", "vertices", "faces", "lower")} == {
        "controls": (3, 2),
        "vertices": (3, 4, 3),
        "faces": (2, 3),
        "lower": (2,),
    }
    assert table["control_names"].tolist() == names
    expected = np.array(rest, np.float32).reshape(4, 3) + np.array([0, 1, 0.5], np.float32)[:, None, None]
    np.testing.assert_array_equal(table["vertices"], expected)
