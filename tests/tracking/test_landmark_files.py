"""Landmarks of clips of scans from files: units, frames, names, results, and what is refused."""

import csv
import json

import numpy as np
import pytest
import torch

from riginv.tracking.markers.map_file import write_map
from riginv.tracking.markers.views import RigWithMarkers
from tests.conftest import ROOT
from tests.support.markers import placed, write_c3d, write_csv, write_trc
from tests.support.pages import read_page
from tests.support.scans import resampled, write_ragged
from tests.support.toys import ToyRig

NO_LOOK = ("look.page=false", "look.sheet=false")
CONF = ROOT / "tests/conf"
CONTROLS = torch.tensor([0.3, 0.6, 0.2, 0.5, 0.4, -0.5, 0.3])
TURN = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])


@pytest.fixture
def clip(tmp_path):
    """Three turned scans in cm, frames 1 to 3, as clip.npz; a map of five landmarks; their names and positions in mm."""
    rig = ToyRig(detail=3)
    controls = [CONTROLS * (0.6 + 0.2 * number) for number in range(3)]
    meshes = [resampled(rig, each, number) for number, each in enumerate(controls)]
    scans = [(mesh.points @ TURN.T / 10, mesh.faces) for mesh in meshes]
    write_ragged(tmp_path / "clip.npz", scans, frame_numbers=np.arange(1, 4), fps=24.0)
    placement = placed(rig, 5)
    write_map(tmp_path / "map.yaml", placement, rig)
    with torch.no_grad():
        points = placement.points(rig(torch.stack(controls))).double().numpy() @ TURN.T
    return tmp_path, placement.names, points


def invert(run, folder, *more: str, look=NO_LOOK):
    given = (f"clip={folder}/clip.npz", f"landmarks.map={folder}/map.yaml", *more)
    return run("invert", "rig=toy", "+rig.detail=3", f"--config-dir={CONF}", "out=got", *given, *look)


@pytest.mark.parametrize("kind", ["trc", "csv", "c3d"])
def test_a_clip_with_landmarks_from_the_command_line(run, clip, kind):
    folder, names, points = clip
    points[1, 2] = np.nan
    if kind == "trc":
        path = write_trc(folder / "take.trc", names, points)
    elif kind == "c3d":
        path = write_c3d(folder / "take.c3d", names, points)
    else:  # no unit of its own: that of the scans; from frame 0, so the last scan has none
        path = write_csv(folder / "take.csv", names, points / 10)
    done = invert(run, folder, f"landmarks.clip={path}")
    assert done.code == 0, done.text
    assert "the landmarks lie" in done.text and ("2 of 3 scans have landmarks" in done.text) == (kind == "csv")
    rows = list(csv.DictReader((folder / "got/scans.csv").read_text().splitlines()))
    if kind != "csv":
        assert all(float(row["landmarks_mm"]) < 0.5 for row in rows)
    markers = json.loads((folder / "got/curves.json").read_text())["markers"]
    assert [marker["name"] for marker in markers] == list(names) and markers[2]["seen"] == pytest.approx(
        2 / 3 if kind != "csv" else 1 / 3
    )


@pytest.mark.parametrize(
    "change, words",
    [
        ({"take": None}, "needs landmarks.clip=FILE"),
        ({"options": ["correspondence=vertices"]}, "landmarks are for correspondence=surface, not vertices"),
        ({"options": ["correspondence=markers", "markers=map.yaml"]}, "landmarks are for correspondence=surface, not markers"),
        ({"names": ["m00", "m01", "m02", "m03", "chin"]}, "'chin' are not in the map"),
        ({"names": ["m00", "m01"], "options": ["reading.unknown=ignore_missing"]}, "2 of its markers are in the map"),
        ({"first": 7}, "it has frames 7 to 9, and the scans 1 to 3, none in common"),
        ({"gaps": True}, "no landmark in any frame of the scans, only gaps"),
        ({"shift": 900.0}, "mm from the scan of frame 1, expected near it"),
        ({"rig": "other"}, "a map for rig 'other'"),
        ({"options": ["landmarks.weight=0"]}, "landmarks.weight is 0, expected a finite number above 0"),
    ],
)
def test_what_cannot_be_landmarks_is_refused_in_a_sentence(run, clip, change, words):
    folder, names, points = clip
    names = change.get("names", list(names))
    points = points[:, : len(names)] + change.get("shift", 0.0)
    points = np.full_like(points, np.nan) if change.get("gaps") else points
    path = write_trc(folder / "take.trc", names, points)
    lines = path.read_text().split("\n")
    start = change.get("first", 1)
    lines[6:9] = [f"{start + row}\t" + line.split("\t", 1)[1] for row, line in enumerate(lines[6:9])]
    path.write_text("\n".join(lines))
    if "rig" in change:
        text = (folder / "map.yaml").read_text()
        (folder / "map.yaml").write_text(text.replace("rig: toy", f"rig: {change['rig']}"))
    take = (f"landmarks.clip={path}",) if change.get("take", path) else ()
    done = invert(run, folder, *take, *change.get("options", []))
    assert done.code == 1 and words in done.text and "Traceback" not in done.text, done.text
    assert not (folder / "got").exists()


def test_landmarks_are_read_in_the_space_that_lies_on_the_scans(run, clip):
    """The file says metres, and its numbers are centimetres as those of the scans."""
    folder, names, points = clip
    done = invert(run, folder, f"landmarks.clip={write_trc(folder / 'take.trc', names, points / 10, unit='m')}")
    assert done.code == 0 and "the landmarks were read in the scans' unit and the scans' axes" in done.text, done.text


def test_a_landmark_in_the_wrong_place_is_flagged(run, clip):
    folder, names, points = clip
    points[:, 4] += 15.0
    done = invert(run, folder, f"landmarks.clip={write_trc(folder / 'take.trc', names, points)}")
    assert done.code == 0 and f"'{names[4]}' 2" in done.text and "far_landmarks" in done.text, done.text
    rows = list(csv.DictReader((folder / "got/scans.csv").read_text().splitlines()))
    assert all("far_landmarks" in row["flags"] and float(row["scan_to_rig_mm"]) < 0.1 for row in rows)


def test_landmarks_are_balls_on_the_page_with_their_residuals(run, clip):
    """The scale of the colours stays that of the surface, though a landmark is 15 mm off."""
    folder, names, points = clip
    points[:, 4] += 15.0
    points[1, 2] = np.nan
    done = invert(run, folder, f"landmarks.clip={write_trc(folder / 'take.trc', names, points)}", look=())
    assert done.code == 0 and (folder / "got/frames.png").exists(), done.text
    page, rig = read_page(folder / "got/look.html"), ToyRig(detail=3)
    balls = RigWithMarkers(rig, placed(rig, 5))
    corners = len(balls.balls)
    assert page.facts["vertices"] == len(balls.rest_vertices) and page.facts["top_mm"] < 2
    assert [counts[2] for counts in page.facts["scans"]] == [5 * corners, 4 * corners, 5 * corners]
    first, rows = page.scans[0], list(csv.DictReader((folder / "got/scans.csv").read_text().splitlines()))
    distance = first[2][-5 * corners :].reshape(5, corners)
    assert np.ptp(distance, axis=1).max() == 0 and 10 < distance[4, 0] < 30 and distance[:4].max() < 2
    assert distance[:, 0].mean() == pytest.approx(float(rows[0]["landmarks_mm"]), abs=0.05)
