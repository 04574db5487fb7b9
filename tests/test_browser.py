"""What a browser shows of a run: the report, opened from disk, and TensorBoard; in a Chromium without a network."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import WebDriverWait

from tb2rl import evaluate, report, train
from tb2rl.runs.folder import Run

CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")  # Debian's

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (CHROMIUM.exists() and DRIVER.exists()), reason="needs chromium and chromedriver, as Debian packages them"
    ),
]

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
]
WIDTHS = [400, 1400]  # [px] a phone, a desk
A4 = 688  # [px] between the margins of a sheet
SMALLEST = 9  # [px] of text in a chart
PATIENCE = 30  # [s]

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
BLOCKS = "h1, h2, h3, p, figure, figcaption, figure > svg, .scroll, .bar, .chooser > *, details, .together"
LINES = "[id*='mean-'] > path, [id*='seed-'] > path"
STAR = "#paths [id$='-goal'] use"
LARGEST = 3_000_000  # bytes of a page

TEXT = """
function text(node) {
  if (["STYLE", "SCRIPT", "TEMPLATE"].includes(node.tagName)) return "";
  if (node.nodeType === Node.TEXT_NODE) return node.textContent;
  return [node.shadowRoot, ...node.childNodes].map((part) => part ? text(part) : "").join(" ");
}
return text(document.body);
"""  # innerText does not look into shadow roots, which TensorBoard's pages are made of
PICTURES = """
function pictures(node) {
  const inside = [...node.querySelectorAll("*")].flatMap((part) => part.shadowRoot ? pictures(part.shadowRoot) : []);
  return [...node.querySelectorAll("img"), ...inside];
}
return pictures(document).map((picture) => picture.naturalWidth);
"""


@pytest.fixture(scope="module")
def seeds(tmp_path_factory) -> Path:
    """A folder of runs of two seeds, each with a standard evaluation that is a short one."""
    folder = tmp_path_factory.mktemp("runs") / "seeds"
    for seed in (0, 1):
        trained("maze", folder / f"seed-{seed}", episodes=8, seed=seed)
    return folder


@pytest.fixture(scope="module")
def goal_run(tmp_path_factory) -> Path:
    """A run at a task with a goal, beside them."""
    return trained("wall", tmp_path_factory.mktemp("runs") / "goal", episodes=4)


def trained(task: str, run: Path, episodes: int, **settings: Any) -> Path:
    short = {"simulation": "kinematic", "n_envs": 8, "eval_episodes": 2, "eval_steps": 50, "save_freq": 0}
    short |= {"stop_score": None, **settings}
    beams = {"task.beams": 5}  # a small table
    policy = train("qlearn", task, settings=beams, total_timesteps=24_000, eval_freq=6000, folder=run, **short)
    evaluation = evaluate(policy, episodes=episodes, steps=300, workers=1)
    Run.open(run).write_evaluation(*evaluation.tree(policy.trained_with, str(run)))
    return run


@pytest.fixture(scope="module")
def page(seeds, goal_run) -> str:
    """The address of a report of two groups: the seeds, and the run with a goal."""
    file = seeds / "report.html"
    report.main([str(seeds), str(goal_run), "--out", str(file)])
    assert file.stat().st_size < LARGEST
    return file.as_uri()


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator[webdriver.Chrome]:
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for flag in [*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('chromium')}"]:
        options.add_argument(flag)
    driver = webdriver.Chrome(options, Service(str(DRIVER)))  # named: selenium looks for none to download
    yield driver
    driver.quit()


@pytest.fixture
def open_page(browser, page) -> Callable[[int], webdriver.Chrome]:
    """Opens the report in a window that is so many pixels wide: narrower than Chromium's own would go."""

    def opened(width: int) -> webdriver.Chrome:
        resize(browser, width)
        browser.get_log("browser")  # forget what other pages said
        browser.get(page)
        return browser

    return opened


def resize(browser: webdriver.Chrome, width: int) -> None:
    metrics = {"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


def coloured(png: bytes) -> int:
    """How many pixels of a picture are neither grey nor nearly so."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    return int((np.ptp(pixels, axis=2) > 30).sum())


# ---- the report


@pytest.mark.parametrize("width", WIDTHS)
def test_the_report_opens_without_a_word_and_fits_its_window(width, open_page):
    browser = open_page(width)
    assert browser.get_log("browser") == []
    assert browser.execute_script("return document.documentElement.scrollWidth") == width
    assert browser.title == "qlearn at maze in loop, qlearn at wall in wall: 3 runs"


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_overlaps(width, open_page):
    browser = open_page(width)
    for details in browser.find_elements(By.TAG_NAME, "summary"):
        details.click()
    assert len(browser.find_elements(By.CSS_SELECTOR, STAR)) == 1
    shown = browser.find_element(By.TAG_NAME, "body").text
    assert [part for part in ("What differs", "task.goal_tolerance", "goal reached") if part not in shown] == []
    assert browser.execute_script(OVERLAPS, BLOCKS) == []
    assert browser.execute_script(OVERLAPS, f"figure svg text, {STAR}") == []
    assert browser.execute_script(OVERLAPS, "th, td") == []


@pytest.mark.parametrize("width", WIDTHS)
def test_text_in_charts_is_large_enough_to_read(width, open_page):
    sizes = open_page(width).execute_script(SIZES)
    assert len(sizes) > 20
    assert min(sizes) >= SMALLEST


@pytest.mark.parametrize("width", WIDTHS)
def test_curves_and_pictures_are_drawn(width, open_page):
    browser = open_page(width)
    curves = browser.find_elements(By.CSS_SELECTOR, "#curves figure")
    lines = [curve.find_elements(By.CSS_SELECTOR, LINES) for curve in curves]
    assert [len(each) for each in lines] == [4, 4, 4, 4, 1], "a mean, two seeds, the other run; only that has a goal"
    assert all(line.rect["width"] > width / 20 for each in lines for line in each)
    for figure in browser.find_elements(By.TAG_NAME, "figure"):
        browser.execute_script("arguments[0].scrollIntoView()", figure)
        assert coloured(figure.screenshot_as_png) > 300, figure.text


def test_the_heading_changes_what_the_maps_show(open_page):
    browser = open_page(1400)
    picture = browser.find_element(By.CSS_SELECTOR, "#map figure svg")
    chooser, said = browser.find_element(By.ID, "heading"), browser.find_element(By.ID, "degrees")
    actions = np.array(json.loads(picture.get_attribute("data-actions")))
    assert len(actions) == 16

    def shown() -> list[int]:
        script = "return [...arguments[0].querySelectorAll('rect')].map((place) => place.getAttribute('class'))"
        return [int(name.removeprefix("a")) for name in browser.execute_script(script, picture)]

    seen = {}
    for heading, keys in enumerate(["", Keys.ARROW_RIGHT, Keys.ARROW_RIGHT]):
        chooser.send_keys(keys)
        assert shown() == actions[heading].tolist()
        seen[said.text] = picture.screenshot_as_png
    assert list(seen) == ["0° (along x)", "22.5°", "45°"]
    assert len(set(seen.values())) == 3
    chooser.send_keys(Keys.HOME)
    assert shown() == actions[0].tolist()


def test_it_prints_without_its_controls_and_within_the_sheet(open_page):
    browser = open_page(A4)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        assert not browser.find_element(By.ID, "heading").is_displayed()
        assert browser.find_element(By.CSS_SELECTOR, "#map figure svg").is_displayed()
        assert browser.execute_script("return document.documentElement.scrollWidth") == A4
        assert browser.execute_script(OVERLAPS, BLOCKS) == []
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_films_of_a_suite_are_shown_and_fit_the_window(browser, small_suite, tmp_path, monkeypatch):
    for module in ("tb2rl.commands.suite", "tb2rl.evaluation.suites"):
        monkeypatch.setattr(f"{module}.find_suite", lambda name, path: small_suite(name))
    result, file = str(tmp_path / "it.json"), tmp_path / "it.html"
    what = ["--agent", "random", "--task", "navigate", "--set", "task.world=loop", "--suite", "unseen"]
    import_module("tb2rl.evaluate").main([*what, "--json", result])
    report.main([result, "--out", str(file)])
    for width in WIDTHS:
        resize(browser, width)
        browser.get_log("browser")
        browser.get(file.as_uri())
        assert browser.get_log("browser") == []
        assert browser.execute_script("return document.documentElement.scrollWidth") == width
        assert browser.execute_script(PICTURES) == [640] * 3
        assert browser.execute_script(OVERLAPS, f"{BLOCKS}, figure > img") == []


def test_a_drive_is_drawn_and_fits_the_window(browser, seeds, tmp_path):
    pytest.importorskip("rosbags")
    bag, file = str(tmp_path / "drive.bag"), tmp_path / "it.html"
    import_module("tb2rl.play").main([str(seeds / "seed-0"), "--steps", "100", "--bag", bag])
    report.main([bag, "--world", "loop", "--out", str(file)])
    for width in WIDTHS:
        resize(browser, width)
        browser.get_log("browser")
        browser.get(file.as_uri())
        assert browser.get_log("browser") == []
        assert browser.title == "drive.bag"
        assert browser.execute_script("return document.documentElement.scrollWidth") == width
        assert browser.execute_script(OVERLAPS, BLOCKS) == []
        assert min(browser.execute_script(SIZES)) >= SMALLEST
        figures = browser.find_elements(By.TAG_NAME, "figure")
        assert len(figures) == 4
        for figure in figures:
            browser.execute_script("arguments[0].scrollIntoView()", figure)
            assert coloured(figure.screenshot_as_png) > 300, figure.text


# ---- TensorBoard


@pytest.fixture(scope="module")
def tensorboard(seeds) -> Iterator[str]:
    """The address of a TensorBoard of one run."""
    command = [sys.executable, "-m", "tensorboard.main", "--logdir", str(seeds / "seed-0"), "--port", "0"]
    with subprocess.Popen([*command, "--host", "127.0.0.1"], stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        try:
            said = ""
            for line in server.stderr:
                said += line
                if found := re.search(r"http://127\.0\.0\.1:\d+/", line):
                    yield found.group()
                    break
            else:
                pytest.fail(f"TensorBoard did not start: {said}")
        finally:
            server.terminate()


def shown_by(browser: webdriver.Chrome, address: str, parts: list[str]) -> str:
    """The text of a page of TensorBoard once it has these parts; none of its errors are severe."""
    browser.get("about:blank")  # a new hash alone would not load the page anew
    browser.get_log("browser")
    browser.get(address)
    waiting: Any = WebDriverWait(browser, PATIENCE, 0.2)
    text = waiting.until(
        lambda _: (text := browser.execute_script(TEXT)) and all(part in text for part in parts) and text,
        f"not all of {parts} are shown",
    )
    # Warnings it has many: of deprecated elements, of Three.js loaded twice, of software WebGL, of strings among the
    # hyper-parameters that it offers no choice of. None of them is ours.
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    return text


def test_tensorboard_shows_scalars(browser, tensorboard):
    resize(browser, 1400)
    shown_by(browser, f"{tensorboard}?tagFilter=rollout%2Fep_rew_mean#timeseries", ["ep_rew_mean", "24,000"])
    waiting: Any = WebDriverWait(browser, PATIENCE, 0.2)
    card = waiting.until(lambda _: browser.find_element(By.CSS_SELECTOR, "scalar-card"), "no card is shown")
    waiting.until(lambda _: coloured(card.screenshot_as_png) > 100, "no line is drawn")


def test_tensorboard_shows_pictures_of_paths(browser, tensorboard):
    resize(browser, 1400)
    shown_by(browser, f"{tensorboard}#images", ["eval/paths", "24,000"])
    waiting: Any = WebDriverWait(browser, PATIENCE, 0.2)
    waiting.until(lambda _: any(width > 300 for width in browser.execute_script(PICTURES)), "no picture is loaded")


def test_tensorboard_shows_hyperparameters(browser, tensorboard):
    resize(browser, 1400)
    shown_by(browser, f"{tensorboard}#hparams", ["agent.learning_rate.start", "task.world", "rollout/ep_rew_mean"])
