"""The page of an inversion: whole without a network, and in a browser it does what its buttons say."""

import io
import re
import shutil
from contextlib import contextmanager

import numpy as np
import pytest
import torch
from PIL import Image

from riginv.animation.animation import Animation
from riginv.tracking.viewer.page import shown_rows, write_viewer
from riginv.tracking.viewer.sheet import sheet_rows, write_sheet
from riginv.tracking.viewer.tensorboard import write_tensorboard
from riginv.tracking.viewer.thinning import thin
from tests.support.animations import errors_of, moving
from tests.support.toys import ToyRig

SWIFT = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("viewer") / "view.html"
    animation = moving(ToyRig(), with_motion=False)
    meshes = animation.rig(animation.controls) + 2.0 * torch.linspace(0, 1, 162)[:, None]
    meshes[2, :20] = torch.nan
    shown = write_viewer(path, animation, errors_of(animation), lambda rows: meshes[list(rows)])
    return path, animation, shown


@contextmanager
def browsed(path):
    """The page in a browser without a network; `problems` collects what its console says, and what it asks for."""
    playwright = pytest.importorskip("playwright.sync_api", reason="pip install playwright: nothing drives a browser here")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None:
        pytest.skip("no Chromium here: install one, such as Debian's package chromium")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=SWIFT)
        page = browser.new_context(viewport={"width": 1200, "height": 760}, offline=True).new_page()
        page.problems = []
        page.on("console", lambda message: page.problems.append(message.text))
        page.on("pageerror", lambda error: page.problems.append(str(error)))
        page.on("request", lambda request: page.problems.append(request.url) if path.name not in request.url else None)
        page.goto(path.as_uri())
        page.wait_for_selector("body[data-ready]")
        yield page
        browser.close()


@pytest.fixture(scope="module")
def page(written):
    with browsed(written[0]) as page:
        yield page


def picture(page, selector="#stage"):
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    pixels = np.asarray(Image.open(io.BytesIO(page.locator(selector).screenshot())).convert("RGB")).astype(int)
    return pixels[:-70] if selector == "#stage" else pixels  # a button that the mouse is on looks different


def frame(page):
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return int(page.get_attribute("body", "data-frame"))


def test_the_file_is_whole(written):
    path, _, shown = written
    text = path.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:)|url\(|@import|https?://""", text)
    assert "/*" + "MESHES" not in text and text.count("<script") == 7
    assert (shown.frames, shown.vertices) == (12, 162) and "positions rounded to" in shown.note


def test_names_cannot_break_out_of_the_page(tmp_path):
    rig = ToyRig(last_name="</script><img src=x onerror=alert(1)>")
    animation = moving(rig, with_motion=False)
    animation = Animation(rig, animation.controls, 25.0, animation.frame_numbers, source="<b>&take")
    write_viewer(tmp_path / "view.html", animation, errors_of(animation), lambda rows: rig(animation.controls[list(rows)]))
    text = (tmp_path / "view.html").read_text()
    assert "onerror=alert(1)>" in text and "</script><img" not in text
    assert "<title>&lt;b&gt;&amp;take<" in text


def test_it_draws_both_meshes(page):
    stage = picture(page)
    left, right = np.array_split(stage, 2, axis=1)
    for side in (left, right):
        middle = side[side.shape[0] // 2 - 40 : side.shape[0] // 2 + 40, side.shape[1] // 2 - 40 : side.shape[1] // 2 + 40]
        assert middle[..., 0].mean() > middle[..., 2].mean() + 15  # clay
    assert page.inner_text("#now").startswith("frame 101")
    assert not page.problems


def test_the_heat_map_colours_the_recovered_mesh_alone(page):
    before = picture(page)
    page.click("#heat")
    after = picture(page)
    half = before.shape[1] // 2
    middle = slice(before.shape[0] // 2 - 60, before.shape[0] // 2 + 60)
    changed = np.abs(after - before).sum(axis=2) > 30
    assert changed[middle, half + 100 :].mean() > 0.1
    assert not changed[middle, :half].any()
    assert page.is_visible("#legend")
    page.click("#heat")
    assert np.abs(picture(page) - before).max() < 3


def test_buttons_keys_and_lists_go_to_frames(page):
    page.click("#frames .frame >> nth=0")
    assert frame(page) == 115  # the worst
    page.keyboard.press("ArrowLeft")
    assert frame(page) == 114
    page.keyboard.press("Home")
    page.click("#next-flag")
    assert frame(page) == 104
    assert page.inner_text("#badge") == "outside reach · not converged"
    box = page.locator("#timeline").bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 30)
    assert frame(page) in (108, 110)
    page.keyboard.press("2")
    assert page.get_attribute("#show-recovered", "aria-pressed") == "true" and not page.is_visible("#tag-target")
    page.keyboard.press("3")


def test_it_plays_in_the_clips_own_time(page):
    page.keyboard.press("Home")
    assert frame(page) == 101
    page.click("#play")
    page.wait_for_function("document.body.dataset.frame === '115'", timeout=10_000)
    page.wait_for_function("document.getElementById('play').ariaLabel === 'Play'")


def test_controls_can_be_found_and_plotted(page, written):
    page.click("#tab-curves")
    page.fill("#filter", "SIDE")
    assert page.locator(".control").count() == 1
    before = picture(page, "#plot")
    page.click(".control")
    assert not np.array_equal(before, picture(page, "#plot"))
    page.click("#timeline", position={"x": 13, "y": 30})
    picture(page)
    value = float(page.inner_text(".control .mm"))
    assert value == pytest.approx(float(written[1].controls[0, 5]), abs=6e-4)
    page.fill("#filter", "")
    assert page.locator(".control").count() == 7
    page.click("#tab-frames")


def test_dragging_turns_the_meshes(page):
    before = picture(page)
    box = page.locator("#view").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 320, box["y"] + 220, steps=3)
    page.mouse.up()
    assert np.abs(picture(page) - before).max() > 40
    page.click("#reset")
    assert np.abs(picture(page) - before).max() < 3
    assert not page.problems


def test_long_clips_are_shown_in_fewer_meshes_the_worst_among_them():
    rig = ToyRig()
    animation = moving(rig, numbers=torch.arange(500), with_motion=False)
    rows = shown_rows(animation, errors_of(animation), 50)
    assert len(rows) <= 50 and rows[0] == 0 and rows[-1] == 499
    assert {499, 498, 497, 3} & set(rows) >= {499, 498}
    assert rows == sorted(set(rows))


def test_large_meshes_are_thinned_to_what_they_look_like():
    rig = ToyRig(detail=5)
    vertices, faces = rig.rest_vertices.numpy(), rig.faces.numpy()
    thinned = thin(vertices, faces, 2000)
    assert 1000 < len(thinned.kept) <= 2000 and len(set(thinned.kept.tolist())) == len(thinned.kept)
    corners = vertices[thinned.kept][thinned.faces]
    volume = np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * 50**3, rel=0.02)
    assert thin(vertices, faces, len(vertices)).kept.tolist() == list(range(len(vertices)))


def test_the_contact_sheet_shows_the_worst_and_the_rest(tmp_path, written):
    _, animation, _ = written
    meshes = animation.rig(animation.controls) + 1.0
    write_sheet(tmp_path / "sheet.png", animation, errors_of(animation), lambda rows: meshes[list(rows)])
    rows = sheet_rows(animation, errors_of(animation))
    assert next(iter(rows.items())) == (11, "worst 1") and rows[0] == "evenly spread" and len(rows) >= 4
    with Image.open(tmp_path / "sheet.png") as picture:
        assert picture.width == 3 * 240 and picture.height > len(rows) * 290  # each below its label


def test_tensorboard_reads_the_curves(tmp_path, written):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    _, animation, _ = written
    write_tensorboard(tmp_path, animation, errors_of(animation))
    events = EventAccumulator(str(tmp_path))
    events.Reload()
    found = events.Scalars("controls/side")
    assert [event.step for event in found] == animation.frame_numbers.tolist()
    assert [event.value for event in found] == pytest.approx(animation.controls[:, 5].tolist())
    assert events.Scalars("errors/mean_vertex_error_mm")[-1].value == pytest.approx(0.4)
