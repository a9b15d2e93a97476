"""Pictures show what they should."""

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from riginv.meshes.rendering import BACKGROUND, GAMMA, LINE, MARGIN, Camera, grid, heat_colors, wrapped
from tests.support.toys import ToyRig


def is_background(pixels: np.ndarray) -> np.ndarray:
    return (np.abs(pixels - BACKGROUND ** (1 / GAMMA) * 255) < 2).all(axis=-1)


def test_a_sphere_is_a_disc_in_the_middle():
    toy = ToyRig()
    picture = np.asarray(Camera(toy.rest_vertices, size=(120, 120)).picture(toy.rest_vertices, toy.faces))
    filled = ~is_background(picture)
    assert filled.mean() == pytest.approx(np.pi / 4 / 1.1**2, rel=0.08)  # its edge is blurred
    rows, columns = np.nonzero(filled)
    assert rows.mean() == pytest.approx(60, abs=1) and columns.mean() == pytest.approx(60, abs=1)


def test_colours_are_those_of_the_vertices(face):
    camera = Camera(face.rest_vertices, turn_degrees=0, size=(200, 240))
    red = torch.zeros(8447, 3)
    red[:, 0] = 0.8
    picture = np.asarray(camera.picture(face.rest_vertices, face.faces, red)).astype(int)
    filled = ~is_background(picture)
    assert filled.mean() > 0.4
    inside = picture[filled]
    assert (inside[:, 0] > inside[:, 1] + 20).mean() > 0.95


def test_a_moved_vertex_changes_the_picture_where_it_is(face):
    camera = Camera(face.rest_vertices, turn_degrees=0, size=(200, 240))
    controls = torch.zeros(1, 137)
    controls[0, face.control_names.index("jawOpen")] = 1
    before = np.asarray(camera.picture(face.rest_vertices, face.faces)).astype(int)
    after = np.asarray(camera.picture(face(controls)[0], face.faces)).astype(int)
    changed = np.abs(after - before).sum(axis=2) > 30
    assert changed[140:].mean() > 0.1 and changed[:90].mean() < 0.01  # the mouth, not the brow


def test_a_box_has_sharp_edges_and_a_sphere_has_none():
    tones = {}
    for mesh in (trimesh.creation.box(extents=(100, 100, 100)), trimesh.creation.icosphere(3, radius=50)):
        vertices, faces = torch.tensor(mesh.vertices), torch.tensor(mesh.faces)
        picture = np.asarray(Camera(vertices, turn_degrees=30, size=(120, 120)).picture(vertices, faces, smooth=1))
        tones[len(faces)] = len(np.unique(picture[~is_background(picture)], axis=0))
    assert tones[12] == 2 and tones[1280] > 200  # the two sides of the box that are in sight


def test_nothing_in_sight_is_an_empty_picture():
    toy = ToyRig()
    camera = Camera(toy.rest_vertices, size=(40, 40))
    assert is_background(np.asarray(camera.picture(toy.rest_vertices + 1000, toy.faces))).all()


def test_a_camera_follows_only_what_leaves_its_picture():
    toy = ToyRig()
    camera = Camera(toy.rest_vertices, size=(60, 60))
    assert camera.following(toy.rest_vertices * 1.05) is camera
    away = toy.rest_vertices + torch.tensor([0.0, 1000.0, 0.0])
    assert not is_background(np.asarray(camera.following(away).picture(away, toy.faces))).all()
    both = camera.following(away, toy.rest_vertices)
    assert both.half_height > 500
    rows = [np.nonzero(~is_background(np.asarray(both.picture(mesh, toy.faces))))[0] for mesh in (away, toy.rest_vertices)]
    assert rows[0].max() < 30 < rows[1].min()


def test_heat_rises_from_blue_to_red():
    colors = heat_colors(torch.tensor([0.0, 1.0, 2.0, 5.0]), top=2.0)
    assert colors[0, 2] > colors[0, 0] and colors[2, 0] > colors[2, 2]
    np.testing.assert_array_equal(colors[2], colors[3])


def test_a_grid_holds_every_picture():
    toy = ToyRig()
    picture = Camera(toy.rest_vertices, size=(40, 50)).picture(toy.rest_vertices, toy.faces)
    assert grid([picture] * 5, list("abcde"), columns=3).size == (120, 100 + 2 * (LINE + MARGIN))


def test_labels_are_whole_within_their_picture():
    """Every letter of a label is there, in lines that are no wider than the picture; only far too long ones are cut."""
    for text in (
        "error: mean 0.12 mm, largest 12.34 mm; red is 12.5 mm",
        "browDownLeft_mouthSmileLeft_jawOpen_cheekPuff",
        "x" * 60,
    ):
        lines = wrapped(text, 228)
        assert len(lines) > 1 and "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert len(wrapped("word " * 100, 228)) == 3 and wrapped("word " * 100, 228)[-1].endswith("...")
    white = Image.new("RGB", (60, 50), "white")
    sheet = np.asarray(grid([white] * 2, ["left and rather long", "right"], columns=2)).astype(int)
    ink = np.flatnonzero((sheet[:-50].sum(axis=2) < 400).any(axis=0))
    assert ink.min() >= MARGIN - 1 and ink[ink < 60].max() <= 60 - MARGIN and (sheet[-50:] == 255).all()
