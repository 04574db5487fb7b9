"""The server of the viewer's page."""

import io
import os
import socket
import sys
import webbrowser
from contextlib import redirect_stdout

import viser

from tb2rl.core.errors import InputError
from tb2rl.evaluation.progress import say

LOOPBACK, PORT = "127.0.0.1", 8080
_PRIVATE = (LOOPBACK, "localhost", "::1")
_MAX_PORT = 65_535


class ViewerServer(viser.ViserServer):
    """A `ViserServer` on one port, which no page can publish on the internet.

    Args:
        host: Address of the network interface, whose network can open the page; None: only this computer can.
        port: The port; None: `PORT`, or the next free one. 0: any free one.

    Raises:
        InputError: If the address is not one of this computer, or the port is taken.
    """

    def __init__(self, host: str | None = None, port: int | None = None) -> None:
        host = host or LOOPBACK
        if port is not None and not 0 <= port <= _MAX_PORT:
            raise InputError(f"--port must be from 0 to {_MAX_PORT}, got {port}")
        _check_address(host, port or 0)
        with redirect_stdout(io.StringIO()):  # it prints addresses in a box
            super().__init__(host, PORT if port is None else port, label="tb2rl", verbose=False)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")

    def request_share_url(self, verbose: bool = True) -> None:
        """Refuse the request, because a page can send it, and it would publish the page on the internet."""

    def announce(self) -> None:
        """Say where the page is, and open it in the browser if there is a display."""
        say(f"open {self.url} in a browser; Ctrl-C ends")
        if self.warning:
            print(f"warning: {self.warning}", file=sys.stderr, flush=True)
        if sys.stdout.isatty() and (not sys.platform.startswith("linux") or os.environ.get("DISPLAY")):
            webbrowser.open(self.url)

    def stop(self) -> None:
        """Close all pages."""
        with redirect_stdout(io.StringIO()):  # it prints that it has stopped
            super().stop()

    @property
    def has_clients(self) -> bool:
        """Whether anybody has opened the page; faster than `get_clients`, which copies."""
        return bool(self._connected_clients)

    @property
    def url(self) -> str:
        """Address of the page on this computer."""
        host = self.get_host()
        return f"http://{'localhost' if host in (LOOPBACK, '0.0.0.0', '') else host}:{self.get_port()}"

    @property
    def warning(self) -> str:
        """A warning if other computers can open the page; else empty."""
        is_private = self.get_host() in _PRIVATE
        return "" if is_private else "everybody who can reach this computer can open the page and drive the robot"


def _check_address(host: str, port: int) -> None:
    """Raise an `InputError` if the port is taken, because `viser` would silently use the next one."""
    try:
        with socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET):
            pass
    except OSError as error:
        reason = f"port {port} is taken; choose another --port" if port else error.strerror
        raise InputError(f"cannot open the viewer's page on {host}: {reason}") from None
