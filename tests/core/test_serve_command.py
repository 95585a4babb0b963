"""The command `serve` in a separate process, and a viewer of it."""

import json
import signal
import subprocess

import pytest
from clocks import PATIENCE
from websockets.sync.client import connect

from commands import START, needs_posix
from facemime.cli.main import main
from facemime.core.viewer.page import PAGE

pytestmark = pytest.mark.skipif(not (PAGE / "three").is_dir(), reason="three.js is missing: make viewer")


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
