"""The command `serve` in a separate process, and a viewer of it."""

import json
import re
import signal
import socket
import subprocess
from contextlib import ExitStack, suppress
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect

from facemime.cli.main import main
from facemime.core.viewer.page import BUILT, PAGE
from tests.helpers.clocks import PATIENCE
from tests.helpers.commands import START, needs_posix

pytestmark = pytest.mark.skipif(not (PAGE / BUILT).is_file(), reason="the page is not built: make viewer")


@needs_posix
def test_a_take_moves_the_head_on_the_page_until_ctrl_c(take, tmp_path):
    line = [*START, "serve", "--video", str(take), "--loop", "--listen", ":0", "--token", str(tmp_path / "token")]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        address = server.stdout.readline().strip()
        assert address.split("/")[3] == (tmp_path / "token").read_text().strip()
        with connect(address.replace("http", "ws", 1) + "stream", open_timeout=PATIENCE) as page:
            while json.loads(page.recv(timeout=PATIENCE))["images"] != [5]:
                pass
            frames = {page.recv(timeout=PATIENCE)[16:] for _ in range(40)}
        server.send_signal(signal.SIGINT)
        said = server.stderr.read()
    assert server.returncode == 0, said
    assert len(frames) > 10, "the head moves"
    assert "Anyone who has it can watch" in said and "█" not in said


@pytest.mark.thorough
@needs_posix
def test_hundreds_of_idle_connections_leave_file_descriptors_and_a_page_that_loads(take):
    """As many as a stranger likes, with as few descriptors as macOS gives to Blender."""
    limited = ["sh", "-c", 'ulimit -n 256; exec "$@"', "sh"]
    line = [*limited, *START, "serve", "--video", str(take), "--loop", "--listen", ":0"]
    with (
        subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server,
        ExitStack() as idle,
    ):
        address = server.stdout.readline().strip()
        parts = urlsplit(address)
        place = parts.hostname, parts.port
        strangers = [idle.enter_context(socket.create_connection(place, PATIENCE)) for _ in range(300)]
        with urlopen(address, timeout=PATIENCE) as answer:
            names = re.findall(r'(?:href|src)="([^"]+)"', answer.read().decode())
        for name in names:
            with urlopen(address + name, timeout=PATIENCE) as answer:
                assert answer.status == 200 and answer.read()
        assert len(names) == 3
        if (descriptors := Path(f"/proc/{server.pid}/fd")).is_dir():
            assert len(list(descriptors.iterdir())) < 128
        for stranger in strangers:
            with suppress(ConnectionError):
                assert stranger.recv(1) == b"", "all are closed in the end"
        server.send_signal(signal.SIGINT)
        said = server.stderr.read()
    assert server.returncode == 0 and "Traceback" not in said and "socket.accept" not in said, said


@pytest.mark.parametrize(
    ("options", "message"),
    (
        (("--cert", "none.pem"), "There is no certificate none.pem"),
        (("--key", "none.pem"), "Give the certificate, too"),
        (("--listen", "a b"), "is not an address"),
    ),
)
def test_invalid_serve_options_are_one_clear_error(take, options, message, capsys):
    assert main(["serve", "--video", str(take), *options]) == 1
    said = capsys.readouterr().err
    assert message in said and "Traceback" not in said
