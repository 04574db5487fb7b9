"""The report in a Chromium without a network: it fits the window, nothing overlaps, its controls work. The site."""

import io
import json
import re
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from PIL import Image, ImageColor
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from tb2rl import evaluate, report, train
from tb2rl.rendering.colours import WALL
from tb2rl.runs.folder import Run

CHECKOUT = Path(__file__).parent.parent
CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")  # Debian's
FIREFOX = Path("/usr/bin/firefox-esr")
IS_THERE = CHROMIUM.exists() and DRIVER.exists()
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not IS_THERE, reason="needs Debian's chromium and chromedriver")]
FLAGS = """headless=new no-sandbox disable-gpu disable-background-networking disable-component-update disable-sync
no-first-run hide-scrollbars"""
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
WIDTHS = [390, 1400]  # [px] a phone, a desk
A4 = 688  # [px] between the margins of a sheet
SMALLEST = 9  # [px] of text in a chart
LARGEST = 3_000_000  # bytes of a page
OVERLAPS = """
const picture = (element) => element.ownerSVGElement ?? null;
const shown = [...document.querySelectorAll(arguments[0])].filter((element) => element.getClientRects().length);
const boxes = shown.map((element) => element.getBoundingClientRect());
const found = [];
for (let i = 0; i < shown.length; i++) {
  for (let j = i + 1; j < shown.length; j++) {
    if (shown[i].contains(shown[j]) || picture(shown[i]) !== picture(shown[j])) continue;
    const wide = Math.min(boxes[i].right, boxes[j].right) - Math.max(boxes[i].left, boxes[j].left);
    const high = Math.min(boxes[i].bottom, boxes[j].bottom) - Math.max(boxes[i].top, boxes[j].top);
    if (wide > 1 && high > 1) found.push([shown[i].outerHTML.slice(0, 90), shown[j].outerHTML.slice(0, 90)]);
  }
}
return found;
"""
SIZES = """
return [...document.querySelectorAll("figure svg text")].map((text) => {
  const scale = text.getScreenCTM();
  return parseFloat(getComputedStyle(text).fontSize) * Math.hypot(scale.a, scale.b);
});
"""
CONTRASTS = """
const canvas = new OffscreenCanvas(1, 1).getContext("2d");
const luminance = (colour) => {
  canvas.fillStyle = colour;
  canvas.fillRect(0, 0, 1, 1);
  const [r, g, b] = [...canvas.getImageData(0, 0, 1, 1).data].map((v) => ((v / 255 + 0.055) / 1.055) ** 2.4);
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
};
const paper = luminance(getComputedStyle(document.body).backgroundColor);
const colours = (selector, property) =>
  [...document.querySelectorAll(selector)].map((element) => getComputedStyle(element)[property]);
const all = [...colours("h1, p, th, td, small, figcaption, summary, output", "color"),
  ...colours("figure svg text, #needle", "fill"), ...colours("figure svg [id*='tick'] use", "stroke")];
return all.map(luminance).map((ink) => (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05));
"""
BLOCKS = "h1, h2, h3, p, figure, figcaption, figure > :is(svg, img), .scroll, .bar, .chooser > *, details, .together"
LINES = "[id*='mean-'] > path, [id*='seed-'] > path"
STAR = "#paths [id$='-goal'] use"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """A report of two groups: two seeds with a short standard evaluation, and a run with a goal."""
    seeds, goal = (tmp_path_factory.mktemp("runs") / name for name in ("seeds", "goal"))
    short = {"simulation": "kinematic", "n_envs": 8, "eval_episodes": 2, "eval_steps": 50, "save_freq": 0}
    short |= {"total_timesteps": 24_000, "eval_freq": 6000, "stop_score": None, "settings": {"task.beams": 5}}
    for task, folder, seed in (("maze", seeds / "seed-0", 0), ("maze", seeds / "seed-1", 1), ("wall", goal, 0)):
        policy = train("qlearn", task, folder=folder, seed=seed, **short)
        evaluation = evaluate(policy, episodes=4, steps=300, workers=1, simulation="kinematic")
        Run.open(folder).write_evaluation(*evaluation.serialize(policy.trained_with, str(folder)))
    report.main([str(seeds), str(goal), "--out", str(seeds / "report.html")])
    return seeds / "report.html"


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for flag in [*FLAGS.split(), f"user-data-dir={tmp_path_factory.mktemp('chromium')}"]:
        options.add_argument(f"--{flag}")
    options.add_argument(OFFLINE)
    driver = webdriver.Chrome(options, Service(str(DRIVER)))  # named: selenium looks for none to download
    yield driver
    driver.quit()


@pytest.fixture
def open_page(browser) -> Callable[[Path, int], webdriver.Chrome]:
    """Opens a page in a window of a width [px], narrower than Chromium's own would go, and checks how it fits."""

    def opened(file: Path, width: int) -> webdriver.Chrome:
        assert file.stat().st_size < LARGEST
        metrics = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        browser.get_log("browser")  # discards messages of other pages
        browser.get(file.as_uri())
        assert browser.get_log("browser") == []
        for summary in browser.find_elements(By.TAG_NAME, "summary"):
            summary.click()
        assert browser.execute_script("return document.documentElement.scrollWidth") == width
        assert browser.execute_script(OVERLAPS, BLOCKS) == []
        assert min([SMALLEST, *browser.execute_script(SIZES)]) == SMALLEST, "text in charts is large enough to read"
        return browser

    return opened


def assert_figures_are_drawn(browser: webdriver.Chrome) -> None:
    for figure in browser.find_elements(By.TAG_NAME, "figure"):
        browser.execute_script("arguments[0].scrollIntoView()", figure)
        pixels = np.asarray(Image.open(io.BytesIO(figure.screenshot_as_png)).convert("RGB")).astype(int)
        assert (np.ptp(pixels, axis=2) > 30).sum() > 300, f"{figure.text} has colours"


@pytest.mark.parametrize("width", WIDTHS)
def test_the_report_is_drawn_without_overlaps_and_fits_its_window(width, page, open_page):
    browser = open_page(page, width)
    assert browser.title == "qlearn at maze in loop, qlearn at wall in wall: 3 runs"
    shown = browser.find_element(By.TAG_NAME, "body").text
    assert [part for part in ("Differences", "task.goal_tolerance", "goal reached") if part not in shown] == []
    assert browser.execute_script(OVERLAPS, f"figure svg text, {STAR}") == []
    assert browser.execute_script(OVERLAPS, "th, td") == []
    curves = browser.find_elements(By.CSS_SELECTOR, "#curves figure")
    lines = [curve.find_elements(By.CSS_SELECTOR, LINES) for curve in curves]
    assert [len(each) for each in lines] == [4, 4, 4, 4, 1], "a mean, two seeds, the other run; only that has a goal"
    assert all(line.rect["width"] > width / 20 for each in lines for line in each)
    assert len(browser.find_elements(By.CSS_SELECTOR, STAR)) == 1
    assert_figures_are_drawn(browser)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_and_axes_are_readable_in_both_colour_schemes(scheme, page, open_page):
    browser = open_page(page, 390)
    feature = {"name": "prefers-color-scheme", "value": scheme}
    try:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        paper = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
        assert (paper == "rgb(255, 255, 255)") == (scheme == "light")
        assert min(browser.execute_script(CONTRASTS)) > 4.5, "the ratio that WCAG asks for"
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_the_heading_changes_what_the_maps_show(page, open_page):
    browser = open_page(page, 1400)
    picture = browser.find_element(By.CSS_SELECTOR, "#map figure svg")
    chooser, degrees = browser.find_element(By.ID, "heading"), browser.find_element(By.ID, "degrees")
    actions = np.array(json.loads(picture.get_attribute("data-actions")))
    assert len(actions) == 16

    def shown() -> list[int]:
        script = "return [...arguments[0].querySelectorAll('rect')].map((place) => place.getAttribute('class'))"
        return [int(name.removeprefix("a")) for name in browser.execute_script(script, picture)]

    for heading, text in enumerate(["0° (along x)", "22.5°", "45°"]):
        assert (shown(), degrees.text) == (actions[heading].tolist(), text)
        chooser.send_keys(Keys.ARROW_RIGHT)
    chooser.send_keys(Keys.HOME)
    assert shown() == actions[0].tolist()


def test_a_replay_plays_orbits_zooms_and_scrubs(page, open_page):
    browser = open_page(page, 1400)
    figure = browser.find_element(By.CSS_SELECTOR, ".replay")
    canvas, slider, play = (figure.find_element(By.CSS_SELECTOR, name) for name in ("canvas", "input", "button"))
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)

    def picture() -> str:
        return browser.execute_script("return arguments[0].toDataURL()", canvas)

    def assert_changes(action: Callable[[], object], time: float | None = None) -> None:
        before, was = picture(), float(slider.get_property("value"))
        action()
        WebDriverWait(browser, 5).until(lambda _: picture() != before)
        if time is not None:
            assert float(slider.get_property("value")) - was == pytest.approx(time, abs=0.1)

    sleep(0.3)  # because a wheel that turns while the page scrolls does not zoom
    assert_changes(ActionChains(browser).drag_and_drop_by_offset(canvas, 80, 30).perform, time=0)
    wheel = ScrollOrigin.from_element(canvas)
    assert_changes(ActionChains(browser).scroll_from_origin(wheel, 0, -200).perform, time=0)
    assert_changes(lambda: canvas.send_keys(Keys.ARROW_RIGHT), time=0.2)
    assert_changes(lambda: canvas.send_keys(Keys.ARROW_LEFT), time=-0.2)
    assert_changes(lambda: slider.click(), time=float(slider.get_attribute("max")) / 2)
    assert_changes(play.click)
    assert play.text == "Pause"
    assert_changes(lambda: None)
    canvas.send_keys(" ")
    assert play.text == "Play"
    assert_changes(lambda: slider.send_keys(Keys.END))


@pytest.mark.flaky(reruns=2)  # on a busy machine, the picture may be taken before anything is drawn
@pytest.mark.skipif(not FIREFOX.exists(), reason="needs Debian's firefox-esr")
def test_firefox_draws_replays_from_a_file(page, tmp_path):
    text = re.sub(r"<h1>.*?(?=<section id=.replays)", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    (tmp_path / "it.html").write_text(text, encoding="utf-8")
    profile = tmp_path / "profile"
    profile.mkdir()
    command = [FIREFOX, "--headless", "--no-remote", "--profile", profile, "--window-size", "1280,1000", "--screenshot"]
    uri = (tmp_path / "it.html").as_uri()
    subprocess.run([*command, tmp_path / "it.png", uri], check=True, capture_output=True, timeout=60)
    with Image.open(tmp_path / "it.png") as screenshot:
        pixels = np.asarray(screenshot.convert("RGB")).astype(int)
    tops = np.abs(pixels - np.minimum(255, 1.18 * np.array(ImageColor.getrgb(WALL)))).max(axis=2) < 3
    assert tops.sum() > 10_000, "the tops of walls, whose colour nothing else has"


def test_it_prints_without_its_controls_and_within_the_sheet(page, open_page):
    browser = open_page(page, A4)
    browser.refresh()  # closes what was opened
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert not browser.find_element(By.ID, "heading").is_displayed()
        assert browser.find_element(By.CSS_SELECTOR, "#map figure svg").is_displayed()
        assert browser.execute_script("return document.documentElement.scrollWidth") == A4
        assert browser.execute_script(OVERLAPS, BLOCKS) == []
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_a_drive_is_drawn(open_page, page, workdir):
    pytest.importorskip("rosbags")
    import_module("tb2rl.play").main([str(page.with_name("seed-0")), "--steps", "100", "--bag", "drive.bag"])
    report.main(["drive.bag", "--world", "loop", "--out", "it.html"])
    for width in WIDTHS:
        browser = open_page(workdir / "it.html", width)
        assert browser.title == "drive.bag"
        assert len(browser.find_elements(By.TAG_NAME, "figure")) == 4
        assert_figures_are_drawn(browser)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The site as of `make docs`, without executing its notebooks."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going", "-b", "html"]
    settings = ["-c", "docs", "-D", "nb_execution_mode=off", "-d", str(folder / "doctrees")]
    subprocess.run([*command, *settings, ".", str(folder / "html")], cwd=CHECKOUT, check=True)
    return folder / "html"


def test_every_public_name_is_on_the_site_and_no_other(site):
    public_modules = re.findall(r"automodule:: (\S+)", (CHECKOUT / "docs/reference/api.md").read_text())
    public = {f"{module}.{name}" for module in public_modules for name in import_module(module).__all__}
    inventory = zlib.decompress((site / "objects.inv").read_bytes().split(b"\n", 4)[4]).decode()
    documented = set(re.findall(r"^(\S+) py:(?!module)", inventory, flags=re.MULTILINE))
    assert {name for name in documented if name.rpartition(".")[0] in public_modules} == public


@pytest.mark.parametrize("width", WIDTHS)
def test_the_site_is_searched_and_read_from_disk(width, site, browser):
    metrics = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get(f"{site.as_uri()}/search.html?q=domain+randomisation")
    wait = WebDriverWait(browser, 20)
    wait.until(
        lambda _: "Robots" in [link.text for link in browser.find_elements(By.CSS_SELECTOR, "#search-results a")]
    )
    browser.get(f"{site.as_uri()}/index.html")
    wait.until(lambda _: browser.current_url.endswith("README.html"))
    assert browser.execute_script("return document.documentElement.scrollWidth") == width
