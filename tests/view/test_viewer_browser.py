"""The viewer in headless Chromium, where it and playwright are installed; elsewhere these tests are skipped."""

import html
import os
import pathlib
import shutil

import jax
import numpy as np
import pytest
from viewer_scenes import EVIL, path_of, resting_tower, scene_of_all, with_events

import jaxrb as rb
from jaxrb.view.viewer_surfaces import matrix_of, quaternion_of

CHROMIUM = next(
    (found for name in ("/usr/lib/chromium/chromium", "chromium", "chromium-browser", "google-chrome")
     if (found := shutil.which(name))),
    None,
)  # fmt: skip
_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]  # draws without a graphics card

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed (Debian: apt install chromium)"),
    pytest.mark.skipif(
        not jax.config.read("jax_enable_x64"), reason="the page is the same: run once, with the float64 suite"
    ),
]


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    flags = [*_FLAGS, "--no-sandbox"] if os.getuid() == 0 else _FLAGS  # Chromium refuses to be root otherwise
    with playwright.sync_playwright() as driver:
        try:
            running = driver.chromium.launch(executable_path=CHROMIUM, args=flags)
        except playwright.Error as error:
            pytest.skip(f"Chromium does not start here: {str(error).splitlines()[0]}")
        yield running
        running.close()


@pytest.fixture(scope="module")
def path():
    pytest.importorskip("scipy")
    return path_of(scene_of_all())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("pages")


class Opened:
    """A page, with all that it asked for and complained of."""

    def __init__(self, browser, file: pathlib.Path, **options):
        self.context = browser.new_context(offline=True, **options)
        self.page = self.context.new_page()
        self.asked, self.complaints = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on(
            "console",
            lambda said: self.complaints.append(said.text) if said.type in ("error", "warning") else None,
        )
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("dialog", lambda dialog: self.complaints.append(f"dialog: {dialog.message}"))
        self.page.goto(file.as_uri())

    @property
    def foreign(self):
        return [url for url in self.asked[1:] if not url.startswith("blob:")]

    @property
    def errors(self):
        # Of the driver that draws in software, which tells that reading pixels back is slow.
        return [text for text in self.complaints if "GPU stall" not in text]


@pytest.fixture(scope="module")
def opened(browser, path, folder):
    rb.view(path, folder / "all.html", title=EVIL)
    found = Opened(browser, folder / "all.html", viewport={"width": 1000, "height": 700})
    found.page.evaluate("window.jaxrb.ready")
    yield found
    found.context.close()


def expected(path, time):
    """Position and matrix of each body at a time: linear, and at constant angular velocity."""
    times = np.asarray(path.times, float)
    at = min(np.searchsorted(times, time, side="right") - 1, len(times) - 2)
    share = (time - times[at]) / (times[at + 1] - times[at])
    position = np.asarray(path.states.position, float)
    place = position[at] + share * (position[at + 1] - position[at])
    a, b = (jax.tree.map(lambda leaf, k=k: leaf[k], path.states.orientation) for k in (at, at + 1))
    return place, np.asarray(jax.vmap(rb.slerp, (0, 0, None))(a, b, share).as_matrix(), float)


def test_page_asks_for_nothing_and_complains_of_nothing(opened):
    opened.page.wait_for_timeout(300)
    assert opened.foreign == []
    assert opened.errors == []
    assert opened.page.locator("#message").is_hidden()


def test_names_are_text(opened, path):
    assert opened.page.locator("h1").inner_text() == EVIL
    assert opened.page.locator("img").count() == 0
    assert EVIL in opened.page.locator("#follow option").all_inner_texts()
    assert opened.page.locator("#follow option").count() == path.scene.count + 1


def test_seek_puts_each_body_on_the_trajectory(opened, path):
    times = np.asarray(path.times, float)
    random = np.random.default_rng(1)  # another seed than the path's, or these times are the saved ones
    asked = np.concatenate([times, random.uniform(times[0], times[-1], 12)])
    count = path.scene.count
    program = (
        "(asked) => asked.map(t => { jaxrb.seek(t); return [...Array(%d).keys()].map(i => jaxrb.pose(i)); })"
    )
    found = opened.page.evaluate(program % count, asked.tolist())
    assert not set(asked[len(times) :]) & set(times)
    saved = np.asarray(path.states.position, float)
    for k, (time, poses) in enumerate(zip(asked, found)):
        place, matrices = expected(path, time)
        drawn = np.array([pose["position"] for pose in poses])
        turned = np.array([matrix_of(np.array(pose["orientation"])) for pose in poses])
        np.testing.assert_allclose(drawn, place, atol=1e-9)
        np.testing.assert_allclose(turned, matrices, atol=1e-9)
        if k < len(times):
            np.testing.assert_array_equal(drawn, saved[k])
    turns = [pose["orientation"] for pose in found[3]]
    np.testing.assert_array_equal(turns, quaternion_of(path.states.orientation)[3])


def test_seek_beyond_the_run_stays_at_its_ends(opened, path):
    for asked, wanted in ((-5.0, 0.0), (1e9, float(path.times[-1]))):
        assert opened.page.evaluate("t => { jaxrb.seek(t); return jaxrb.time; }", asked) == wanted


def test_keys_move_through_the_run(opened, path):
    page, times = opened.page, np.asarray(path.times, float)
    page.locator("#picture").focus()
    page.keyboard.press("Home")
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    assert page.evaluate("jaxrb.time") == times[3]
    page.keyboard.press("ArrowLeft")
    assert page.evaluate("jaxrb.time") == times[2]
    assert page.locator("#live").inner_text().endswith(" s")
    page.keyboard.press("End")
    assert page.evaluate("jaxrb.time") == times[-1]
    page.keyboard.press("f")
    assert page.locator("#follow").input_value() == "0"
    page.keyboard.press("c")
    assert page.locator("#follow").input_value() == "-1"
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("Home")
    page.keyboard.press(" ")
    assert page.locator("#play").get_attribute("aria-label") == "Pause"
    for _ in range(100):  # the page's policy forbids what playwright waits for conditions with
        if page.evaluate("jaxrb.time") > 0.0:
            break
        page.wait_for_timeout(100)
    assert page.evaluate("jaxrb.time") > 0.0
    page.keyboard.press(" ")
    assert page.locator("#play").get_attribute("aria-label") == "Play"


def test_everything_that_can_be_shown_is_shown_without_complaint(opened):
    boxes = opened.page.locator("#show input")
    assert boxes.count() >= 5  # trails, labels, spheres, boxes, hulls
    for i in range(boxes.count()):
        boxes.nth(i).click()
    opened.page.wait_for_timeout(300)
    assert opened.page.locator("#labels span").first.inner_text() == "sphere"
    for i in range(boxes.count()):
        boxes.nth(i).click()
    assert opened.errors == []


def test_controls_have_names_for_those_who_do_not_see(opened):
    bare = opened.page.evaluate(
        """() => [...document.querySelectorAll('button, input, select, canvas, svg[role=img]')].filter(e =>
            !(e.getAttribute('aria-label') || e.textContent.trim() || e.closest('label')
              || document.querySelector(`label[for=${e.id}]`))).map(e => e.outerHTML)"""
    )
    assert bare == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_from_its_ground(browser, folder, opened, scheme):
    """WCAG 2.1: a contrast of at least 4.5 to 1."""
    page = Opened(browser, folder / "all.html", color_scheme=scheme)
    read = "(name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim()"
    colours = {
        name: page.page.evaluate(read, f"--{name}")
        for name in ("ink", "soft", "accent", "second", "third", "panel", "sky")
    }
    page.context.close()

    def light(colour):
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return np.dot(linear, [0.2126, 0.7152, 0.0722])

    for name in ("ink", "soft", "accent", "second", "third"):
        for ground in ("panel", "sky") if name in ("ink", "soft") else ("panel",):
            a, b = sorted((light(colours[name]), light(colours[ground])))
            assert (b + 0.05) / (a + 0.05) >= 4.5, (name, ground, colours)


def test_works_in_the_sandboxed_frame_of_a_notebook(browser, path, folder):
    frame = rb.view(path, bounds=False)._repr_html_()
    file = folder / "notebook.html"
    file.write_text(
        f"<!doctype html><meta charset=utf-8><title>{html.escape('notebook')}</title>{frame}",
        encoding="utf-8",
    )
    found = Opened(browser, file)
    inner = next(f for f in found.page.frames if f.parent_frame is not None)
    inner.evaluate("window.jaxrb.ready")
    place = inner.evaluate("t => { jaxrb.seek(t); return jaxrb.pose(2).position; }", float(path.times[7]))
    assert place == np.asarray(path.states.position, float)[7, 2].tolist()
    assert [url for url in found.foreign if not url.startswith("about:")] == []
    assert found.errors == []
    found.context.close()


def test_impacts_and_forces_are_arrows(browser, folder):
    scene = rb.Scene(rb.Body.from_shape(rb.Sphere(0.2), 100.0), rb.UniformGravity())
    rb.view(with_events(path_of(scene)), folder / "events.html", forces=True)
    found = Opened(browser, folder / "events.html")
    found.page.evaluate("window.jaxrb.ready")
    shown = found.page.evaluate("[0.3, 0.51, 1.9].map(t => { jaxrb.seek(t); return jaxrb.arrows(); })")
    assert shown == [1, 2, 1]  # gravity's; after an impact its impulse too
    assert found.errors == []
    found.context.close()


def test_fifty_boxes_are_drawn(browser, folder):
    scene = rb.Scene(
        rb.replicate(rb.Body.from_shape(rb.Box((0.1, 0.2, 0.3)), 500.0), 50), rb.UniformGravity()
    )
    rb.view(path_of(scene), folder / "fifty.html", bounds=False)
    found = Opened(browser, folder / "fifty.html", viewport={"width": 800, "height": 600})
    found.page.evaluate("window.jaxrb.ready")
    # A picture that is all of one colour shows nothing.
    different = found.page.evaluate(
        """() => new Promise(done => { jaxrb.seek(1.0); requestAnimationFrame(() => requestAnimationFrame(() => {
            const canvas = document.getElementById('picture');
            const copy = Object.assign(document.createElement('canvas'), { width: 200, height: 150 });
            const pen = copy.getContext('2d');
            jaxrb.draw();
            pen.drawImage(canvas, 0, 0, 200, 150);
            const seen = pen.getImageData(0, 0, 200, 150).data;
            done(new Set(Array.from({ length: 30000 }, (_, k) => seen.slice(4 * k, 4 * k + 3).join())).size);
        })); })"""
    )
    assert different > 50
    assert found.errors == []
    found.context.close()


def test_contact_forces_are_arrows(browser, folder):
    rb.view(resting_tower(), folder / "tower.html", forces=True)
    found = Opened(browser, folder / "tower.html")
    found.page.evaluate("window.jaxrb.ready")
    # Gravity's of two balls, and where the floor bears both and one the other.
    assert found.page.evaluate("[0.0, 0.4].map(t => { jaxrb.seek(t); return jaxrb.arrows(); })") == [4, 4]
    found.page.locator("#picture").focus()
    found.page.keyboard.press("p")
    assert found.page.evaluate("jaxrb.seek(0.2), jaxrb.arrows()") == 2
    assert found.errors == []
    found.context.close()


@pytest.mark.skipif(os.environ.get("JAXRB_LONG") != "1", reason="JAXRB_LONG=1 measures frames a second")
def test_fifty_boxes_play_at_thirty_frames_a_second(browser, folder):
    """Drawn by software. The best of some seconds: what else the machine does is not the page's fault."""
    found = Opened(browser, folder / "fifty.html", viewport={"width": 800, "height": 600})
    found.page.evaluate("window.jaxrb.ready")
    rates = []
    for _ in range(8):
        found.page.evaluate("jaxrb.seek(0), jaxrb.play()")
        found.page.wait_for_timeout(300)
        before = found.page.evaluate("[jaxrb.frames, performance.now()]")
        found.page.wait_for_timeout(1200)
        after = found.page.evaluate("[jaxrb.frames, performance.now()]")
        rates.append(1000 * (after[0] - before[0]) / (after[1] - before[1]))
        found.page.evaluate("jaxrb.pause()")
        if rates[-1] > 40:
            break
    print(f"50 boxes, software rendering: {max(rates):.1f} frames/s (of {[round(rate) for rate in rates]})")
    assert max(rates) >= 30
    found.context.close()


PICTURES = pathlib.Path(__file__).with_name("pictures")
PICTURED = {
    "shapes": lambda path: (path, {"bounds": False}, 1.0),
    "contact": lambda path: (resting_tower(), {"forces": True, "bounds": False}, 0.5),
    "impacts": lambda path: (
        with_events(path_of(rb.Scene(rb.Body.from_shape(rb.Capsule(0.2, 0.4), 100.0), rb.UniformGravity()))),
        {"forces": True},
        0.51,
    ),
}


@pytest.mark.parametrize("name", PICTURED)
def test_pictures_look_as_they_did(name, browser, path, folder):
    """Beside the picture of a page that was looked at: means over squares of 8 points, which edges do not move.

    JAXRB_WRITE_PICTURES=1 takes new ones; look at them.
    """
    from matplotlib import image

    run, options, time = PICTURED[name](path)
    rb.view(run, folder / f"{name}.html", **options)
    found = Opened(
        browser, folder / f"{name}.html", viewport={"width": 360, "height": 560}, color_scheme="light"
    )
    found.page.evaluate("window.jaxrb.ready")
    found.page.evaluate("t => jaxrb.seek(t)", time)
    found.page.wait_for_timeout(300)
    file, kept = folder / f"{name}.png", PICTURES / f"{name}.png"
    file.write_bytes(found.page.locator("#picture").screenshot())
    found.context.close()
    if os.environ.get("JAXRB_WRITE_PICTURES") == "1":
        kept.write_bytes(file.read_bytes())
    seen, wanted = (image.imread(picture)[..., :3] for picture in (file, kept))
    assert seen.shape == wanted.shape
    high, wide = (8 * (length // 8) for length in seen.shape[:2])
    squares = [
        np.asarray(x)[:high, :wide].reshape(high // 8, 8, wide // 8, 8, 3).mean(axis=(1, 3))
        for x in (seen, wanted)
    ]
    apart = np.abs(squares[0] - squares[1]).max(axis=-1)
    assert apart.mean() < 0.004, f"{name}: the picture differs by {apart.mean():.4f} on the mean"
    assert (apart > 0.1).mean() < 0.002, (
        f"{name}: {np.argwhere(apart > 0.1).tolist()[:5]} (squares of 8) differ"
    )


def test_pictures_are_small():
    assert sum(file.stat().st_size for file in PICTURES.glob("*.png")) <= 100_000
