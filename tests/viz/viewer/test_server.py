"""The server of the page: this computer only, one port, nothing published, and one line for what is wrong."""

import socket
from importlib import import_module
from urllib.request import urlopen

import pytest

from tb2rl import InputError
from tb2rl.viz.viewer import server as server_module
from tb2rl.viz.viewer.server import ViewerServer


@pytest.fixture
def open_server():
    servers = []

    def start(*arguments) -> ViewerServer:
        servers.append(ViewerServer(*arguments))
        return servers[-1]

    yield start
    for server in servers:
        server.stop()


def test_only_this_computer_can_open_the_page(open_server, capsys):
    server = open_server(None, 0)
    assert server.warning == ""
    assert server.get_host() == "127.0.0.1"
    with urlopen(f"http://127.0.0.1:{server.get_port()}") as page:
        assert b"<html" in page.read()
    assert server.url == f"http://localhost:{server.get_port()}"
    assert capsys.readouterr().out == ""


def test_other_hosts_are_warned_of(open_server):
    assert "everybody who can reach this computer" in open_server("0.0.0.0", 0).warning


def test_no_page_can_publish_itself_on_the_internet(open_server, monkeypatch):
    tunnel = monkeypatch.setattr("viser._viser.ViserTunnel", lambda *_: pytest.fail("opened a tunnel"))
    assert tunnel is None
    assert open_server(None, 0).request_share_url() is None


def test_without_a_port_the_next_free_one_is_taken(open_server, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(server_module, "PORT", taken.getsockname()[1])
        assert open_server().get_port() != taken.getsockname()[1]


@pytest.mark.parametrize("line", ["--port {}", "--port 70000", "--host 203.0.113.7"])
@pytest.mark.parametrize("command", ["demo", "play --agent random", "train --viewer --total-timesteps 100"])
def test_a_page_that_cannot_be_opened_is_one_line(command, line, refused):
    name, *arguments = command.split()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        option, value = line.format(taken.getsockname()[1]).split()
        refused(import_module(f"tb2rl.{name}").main, [*arguments, option, value], [value])


def test_an_unknown_host_is_named():
    with pytest.raises(InputError, match=r"cannot open the viewer's page on 203\.0\.113\.7"):
        ViewerServer("203.0.113.7", 0)
