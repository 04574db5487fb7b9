"""The viewer's page of a live drive: the 3D scene, the state of the robot, and the controls."""

import math
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass

import numpy as np

from tb2rl.core import handle_termination_signals
from tb2rl.robots import Robot
from tb2rl.viz.cameras import beam_ranges, goal_of
from tb2rl.viz.viewer.choices import AS_TRAINED
from tb2rl.viz.viewer.controls import Controls
from tb2rl.viz.viewer.drive import Drive, Selection
from tb2rl.viz.viewer.live_scene import LiveScene
from tb2rl.viz.viewer.server import ViewerServer
from tb2rl.viz.viewer.status import status, values

_TEXT_PERIOD, _PICTURE_PERIOD = 0.2, 0.5  # [s] between updates of texts, and of the camera's picture
_PICTURE_SIZE = (160, 120)  # [px] width and height
_MAX_DEPTH = 5.0  # [m] depth that is black in a picture without colours
_MESSAGE_DURATION = 8.0  # [s]


@dataclass(frozen=True)
class TourStop:
    """One stop of a tour."""

    title: str
    text: str
    policy: str
    world: str = AS_TRAINED  # an option of the page


class Page:
    """Shows a `Drive`, and has its controls.

    Args:
        server: The server of the page.
        drive: The drive.
        follow: Whether the camera follows the robot.
        tour: Stops of a tour; empty: no tour.
    """

    def __init__(self, server: ViewerServer, drive: Drive, follow: bool = False, tour: Sequence[TourStop] = ()) -> None:
        self._server = server
        self._live: LiveScene | None = None
        self._robot: Robot | None = None
        self._next_text = self._next_picture = 0.0
        self._followed = follow
        server.gui.main_panel.dock_right()
        if tour:
            self._add_tour(tour)
        self._controls = Controls(server, drive, follow)
        panel = server.gui.add_panel(order=-1.0)  # the first one on a phone
        panel.dock_left()
        with panel.add_tab("Robot"):
            self._status = server.gui.add_markdown("")
            with server.gui.add_folder("What the policy computes"):
                self._values = server.gui.add_html("")
            self._controls.add_steering()
            with server.gui.add_folder("Camera of the robot"):
                self._picture_shown = server.gui.add_checkbox("Show its picture", drive.scene.has_images)
                self._picture = server.gui.add_image(np.zeros((*_PICTURE_SIZE[::-1], 3), np.uint8), visible=False)

    def show(self, drive: Drive) -> None:
        """Show the present frame; called 60 times a second."""
        live = self._scene_of(drive)
        if not self._server.has_clients:
            return
        frame, scene, now = drive.frame, drive.scene, time.monotonic()
        outlines = None if frame.dynamic_obstacles is None else frame.dynamic_obstacles[None]
        with self._server.atomic():
            live.show_robots(frame.pose[None], goal_of(scene.task, frame.step.after.initial_state)[None], outlines)
            live.show_beams(frame.pose, scene.laser.angles, beam_ranges(frame, drive.episode_world, scene))
            live.show_label(frame.step.intervention, frame.pose)
            if self._controls.follows:
                self._follow(frame.pose)
            elif self._followed:
                live.set_cameras()
            self._followed = self._controls.follows
            if now >= self._next_text:
                self._next_text = now + _TEXT_PERIOD
                live.show_path(np.array([pose[:2] for pose in [*frame.path, frame.pose]]), drive.plan())
                self._status.content, self._values.content = status(drive), values(drive)
        self._picture.visible = bool(self._picture_shown.value)
        if self._picture.visible and now >= self._next_picture:
            self._next_picture = now + _PICTURE_PERIOD
            self._show_picture(drive)

    def report(self, message: str) -> None:
        """Show a message to everybody who has opened the page."""
        for client in self._server.get_clients().values():
            client.add_notification("Not possible", message, auto_close_seconds=_MESSAGE_DURATION, color="red")

    def _scene_of(self, drive: Drive) -> LiveScene:
        """The 3D scene of the episode's world, drawn again if the world or the robot is another one."""
        world, robot = drive.episode_world, drive.scene.robot
        if self._live is None or world is not self._live.worlds[0] or robot is not self._robot:
            is_other_place = self._live is None or world.bounds != self._live.worlds[0].bounds
            self._live, self._robot = LiveScene(self._server, robot, [world]), robot
            self._controls.attach(self._live)
            if is_other_place:
                self._live.set_cameras()
        return self._live

    def _follow(self, pose: np.ndarray) -> None:
        position, forward = np.array([*pose[:2], 0.0]), np.array([math.cos(pose[2]), math.sin(pose[2]), 0.0])
        for client in self._server.get_clients().values():
            client.camera.position = position - 1.4 * forward + np.array([0.0, 0.0, 1.3])
            client.camera.look_at = position + 0.5 * forward

    def _show_picture(self, drive: Drive) -> None:
        colours, depth = drive.step.after.render_camera(*_PICTURE_SIZE)
        near = np.clip(1.0 - depth[0] / _MAX_DEPTH, 0.0, 1.0) * 255
        self._picture.image = near.astype(np.uint8)[..., None].repeat(3, -1) if colours is None else colours[0]

    def _add_tour(self, tour: Sequence[TourStop]) -> None:
        stops = {f"{number}. {stop.title}": stop for number, stop in enumerate(tour, 1)}
        with self._server.gui.add_folder("Tour"):
            text = self._server.gui.add_markdown(f"**{tour[0].title}.** {tour[0].text}")
            buttons = self._server.gui.add_button_group("Go to", list(stops))

        def visit(stop: TourStop) -> None:
            text.content = f"**{stop.title}.** {stop.text}"
            self._controls.visit(stop.policy, stop.world)

        buttons.on_click(lambda _: self._controls.request(visit, stops.get(buttons.value, tour[0])))


def drive_live(
    selection: Selection,
    seed: int = 0,
    speed: float = 1.0,
    follow: bool = False,
    is_manual: bool = False,
    host: str | None = None,
    port: int | None = None,
    tour: Sequence[TourStop] = (),
) -> None:
    """Open a page, and drive until Ctrl-C.

    Args:
        selection: The policy, the task and the simulator.
        seed: Seed of the first episode; each further episode adds 1.
        speed: Simulated seconds per second.
        follow: Whether the camera follows the robot.
        is_manual: Whether the user drives at the start.
        host, port: See `ViewerServer`.
        tour: Stops of a tour; empty: no tour.

    Raises:
        InputError: If the policy does not fit the task, or the page cannot be opened.
    """
    is_stopped = threading.Event()
    with ExitStack() as stack:
        drive = stack.enter_context(closing(Drive(selection, seed)))
        drive.speed = speed
        if is_manual:
            drive.drive_manually(True)
        server = ViewerServer(host, port)
        stack.callback(server.stop)
        # No `KeyboardInterrupt` from here on: an exception within the libraries of 3D models can be lost or change.
        stack.enter_context(handle_termination_signals(lambda _: is_stopped.set()))
        server.announce()  # now, because the browser starts while this process makes the controls and the 3D models
        page = Page(server, drive, follow, tour)
        drive.run(page.show, page.report, lambda: not is_stopped.is_set())
