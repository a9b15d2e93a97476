"""Scans on the page and on the contact sheet of an inversion."""

import numpy as np
import pytest
import torch
from PIL import Image

from riginv.tracking.markers.views import RigWithMarkers
from riginv.tracking.viewer.page import write_viewer
from riginv.tracking.viewer.scans import MAX_POINTS, DrawnScan, Scans
from riginv.tracking.viewer.sheet import write_sheet
from tests.support.animations import errors_of, moving
from tests.support.markers import placed
from tests.support.pages import read_page
from tests.support.toys import ToyRig
from tests.tracking.viewer.test_viewer import browsed, picture


def scan_of(rig: ToyRig, away_mm: float, faces: bool = True) -> DrawnScan:
    """A dense scan of the rig at rest, `away_mm` from it in one half and without a counterpart in another."""
    import trimesh

    points, triangles = trimesh.remesh.subdivide_loop(rig.rest_vertices.numpy(), rig.faces.numpy(), 3)
    mesh = trimesh.Trimesh(points, triangles, process=False)
    distance = np.where(points[:, 0] > 0, away_mm, np.nan)
    return DrawnScan(points, mesh.vertex_normals, triangles if faces else triangles[:0], distance)


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "view.html"
    animation = moving(ToyRig(), with_motion=False)
    scans = {0: scan_of(animation.rig, 1.5), 1: scan_of(animation.rig, 0.5, faces=False)}
    drawn = Scans(scans.get, len(animation.rig.rest_vertices))
    targets = animation.rig(animation.controls)
    targets[:, ::2] = torch.nan
    write_viewer(path, animation, errors_of(animation), lambda rows: targets[list(rows)], scans=drawn)
    write_sheet(path.parent / "sheet.png", animation, errors_of(animation), lambda rows: targets[list(rows)], drawn)
    return path, animation, scans


def test_scans_lie_in_the_page_with_their_distances(shown):
    path, animation, scans = shown
    page = read_page(path)
    assert len(page.scans) == len(animation) and [len(scan[0]) for scan in page.scans[2:]] == [0] * (len(animation) - 2)
    for (points, faces, distance), scan, away in zip(page.scans, scans.values(), (1.5, 0.5)):
        assert 1000 < len(points) <= MAX_POINTS < len(scan.points) and (len(faces) > 0) == (len(scan.faces) > 0)
        middle = points.mean(axis=0) - scan.points.mean(axis=0)
        nearest = np.linalg.norm(points[:50, None] - middle - scan.points, axis=2).min(axis=1)
        assert nearest.max() < 3 and np.nanmax(np.abs(distance - away)) <= page.facts["step"]
        assert 0.3 < np.isnan(distance).mean() < 0.7


@pytest.mark.parametrize("faces", [True, False])
def test_balls_around_landmarks_are_whole_on_a_scan_that_is_thinned(faces):
    rig = ToyRig()
    ball, triangles = RigWithMarkers(rig, placed(rig, 2)).balls.numpy(), np.array([[0, 1, 2], [1, 2, 3]])
    scan = scan_of(rig, 1.0, faces).with_balls(np.array([[90.0, 0, 0], [0, 90, 0]]), np.array([3.0, 4.0]), ball, triangles)
    thinned = scan.thinned()
    count = len(thinned.points) - thinned.balls
    assert thinned.balls == 2 * len(ball) and 1000 < count <= MAX_POINTS
    np.testing.assert_allclose(thinned.points[count:].reshape(2, -1, 3).mean(axis=1), [[90, 0, 0], [0, 90, 0]], atol=1e-3)
    assert thinned.distance[count:].tolist() == [3.0] * len(ball) + [4.0] * len(ball)
    np.testing.assert_allclose(np.linalg.norm(thinned.normals[count:], axis=1), 1, rtol=1e-5)
    of_balls = thinned.faces[(thinned.faces >= count).any(axis=1)]
    expected = np.concatenate([triangles, triangles + len(ball)]) + count
    np.testing.assert_array_equal(of_balls, expected if faces else expected[:0])


def test_a_scan_of_triangles_is_drawn_on_the_sheet_with_unknown_parts_grey(shown):
    sheet = np.asarray(Image.open(shown[0].parent / "sheet.png").convert("RGB")).astype(int)
    grey = (np.ptp(sheet, axis=2) < 6) & (sheet.max(axis=2) < 200) & (sheet.max(axis=2) > 60)
    assert grey[:, :240].sum() > 3 * grey[:, 240:480].sum()  # the scan; the recovered mesh is of clay, its label is not


def test_the_browser_draws_scans(shown):
    with browsed(shown[0]) as page:
        plain = picture(page)
        assert page.locator("#tag-target").text_content() == "Scan" and not page.problems
        page.keyboard.press("h")
        heat = picture(page)
        left, middle = slice(0, heat.shape[1] // 2), heat.shape[0] // 2
        assert (plain != heat)[:middle, left].any()
        page.keyboard.press("ArrowRight")
        assert (picture(page) != heat)[:, left].any() and not page.problems
