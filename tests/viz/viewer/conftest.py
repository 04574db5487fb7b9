"""A viewer's page in a real Chromium, beside the drive that it shows."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver import ActionChains
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from viser.transforms import SO3

from tb2rl.viz.viewer.choices import make_selection
from tb2rl.viz.viewer.drive import Drive
from tb2rl.viz.viewer.page import Page
from tb2rl.viz.viewer.server import ViewerServer

CHROMIUM, DRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")  # Debian's
PATIENCE = 120.0  # [s] for a busy computer
MIN_FRAME_RATE = 10.0  # [1/s] below which a software renderer misses movements of the mouse
CANVAS = "canvas[data-engine]"
FLAGS = """headless=new no-sandbox disable-background-networking disable-component-update disable-sync no-first-run
use-gl=angle use-angle=swiftshader enable-unsafe-swiftshader window-size=1000,560"""
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1"


@pytest.fixture(scope="session")
def browser(tmp_path_factory) -> Iterator[webdriver.Chrome]:
    if not (CHROMIUM.exists() and DRIVER.exists()):
        pytest.skip("needs Debian's chromium and chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = str(CHROMIUM)
    for flag in [*FLAGS.split(), f"user-data-dir={tmp_path_factory.mktemp('chromium')}"]:
        options.add_argument(f"--{flag}")
    options.add_argument(OFFLINE)
    driver = webdriver.Chrome(options, Service(str(DRIVER)))
    yield driver
    driver.quit()


def eventually(condition: Callable[[], Any], seconds: float = PATIENCE) -> Any:
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < end, "the condition did not come true"
        time.sleep(0.05)
    return value


class Watched:
    """A drive in a thread, and its page in a browser."""

    def __init__(self, browser: webdriver.Chrome, policy: str, **settings: Any) -> None:
        self.browser, self.frames = browser, 0
        self.messages: list[str] = []
        self.server = ViewerServer(port=0)
        self.drive = Drive(make_selection(policy, "maze", settings, "kinematic"))
        self.page = Page(self.server, self.drive)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self.drive.run, args=(self._show, self._report, self._is_open))
        self._thread.start()

    def _show(self, drive: Drive) -> None:
        self.frames += 1
        self.page.show(drive)

    def _report(self, message: str) -> None:
        self.messages.append(message)
        self.page.report(message)

    def _is_open(self) -> bool:
        return not self._ended.is_set()

    def open(self) -> None:
        """Open the page, or reload it, and wait for the picture."""
        known = self.server.get_clients().keys()
        self.browser.get(self.server.url)
        eventually(lambda: self.server.get_clients().keys() - known)
        eventually(lambda: "drive" in self.browser.find_element(By.TAG_NAME, "body").text)

    def pixel(self, x: float, y: float, z: float = 0.0) -> tuple[int, int]:
        """Offset [px] of a point [m] from the centre of the scene's canvas."""
        camera = list(self.server.get_clients().values())[-1].camera
        right, down, ahead = SO3(camera.wxyz).inverse() @ (np.array([x, y, z]) - camera.position)
        height = self.browser.find_element(By.CSS_SELECTOR, CANVAS).rect["height"]
        scale = height / 2 / np.tan(camera.fov / 2) / ahead
        return round(right * scale), round(down * scale)

    def click(self, x: float, y: float) -> None:
        """Click on a point [m] of the floor."""
        canvas = self.browser.find_element(By.CSS_SELECTOR, CANVAS)
        ActionChains(self.browser).move_to_element_with_offset(canvas, *self.pixel(x, y)).click().perform()

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag from one point [m] of the floor to another."""
        canvas, actions = self.browser.find_element(By.CSS_SELECTOR, CANVAS), ActionChains(self.browser)
        self.drive.request(lambda: self.page._live.set_cameras())  # an earlier attempt may have turned the view
        time.sleep(1.0)
        actions.move_to_element_with_offset(canvas, *self.pixel(*start)).pause(1.0).click_and_hold().pause(0.5)
        for point in np.linspace(start, end, 5)[1:]:
            actions.move_to_element_with_offset(canvas, *self.pixel(*point)).pause(0.3)
        actions.pause(0.5).release().perform()

    def press(self, label: str) -> None:
        """Press the button with a label."""
        self.browser.find_element(By.XPATH, f"//button[normalize-space()='{label}']").click()

    def _input(self, label: str) -> WebElement:
        return self.browser.find_element(By.XPATH, f"//label[normalize-space()='{label}']/following::input[1]")

    def chosen(self, label: str) -> str | None:
        """The chosen option of the list with a label."""
        return self._input(label).get_attribute("value")

    def choose(self, label: str, option: str) -> None:
        """Choose an option of the list with a label."""
        self._input(label).click()
        path = f"//div[@role='option'][normalize-space()='{option}']"
        # Lists that were open before are still there, but hidden.
        options = eventually(lambda: [*filter(WebElement.is_displayed, self.browser.find_elements(By.XPATH, path))])
        options[0].click()

    def eventually(self, condition: Callable[[], Any]) -> Any:
        """Wait until a condition holds in the thread of the drive, which alone may read it; return its value."""

        def value() -> Any:
            answer: SimpleQueue[Any] = SimpleQueue()
            self.drive.request(lambda: answer.put(condition()))
            return answer.get(timeout=PATIENCE)

        return eventually(value)

    def until(self, condition: Callable[[], Any], act: Callable[[], None], attempts: int = 3) -> None:
        """Repeat what a user does until a condition holds, because a busy browser misses movements of the mouse."""
        for _ in range(attempts):
            act()
            with suppress(AssertionError):
                eventually(condition, seconds=8.0)
                return
        if (rate := self.frame_rate()) < MIN_FRAME_RATE:
            pytest.skip(f"the browser draws {rate:.1f} frames a second, too few to follow a mouse")
        pytest.fail("nothing happened")

    def frame_rate(self) -> float:
        """Frames per second that the browser draws."""
        script = """const [done, start] = [arguments[0], performance.now()]; let frames = 0;
        requestAnimationFrame(function count(now) {
          frames += 1;
          if (now - start < 3000) requestAnimationFrame(count); else done((1000 * frames) / (now - start));
        });"""
        return float(self.browser.execute_async_script(script))

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self.drive.close()
        self.server.stop()


@pytest.fixture
def watch(browser) -> Iterator[Callable[..., Watched]]:
    """A function that drives a policy, and opens its page."""
    watched: list[Watched] = []

    def start(policy: str, **settings: Any) -> Watched:
        watched.append(Watched(browser, policy, **settings))
        watched[-1].open()
        return watched[-1]

    yield start
    for each in watched:
        with closing(each):
            browser.get("about:blank")
