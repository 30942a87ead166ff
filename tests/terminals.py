"""What a command shows on a terminal."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

from conftest import ROOT

PATIENCE = 30.0  # s, on a busy machine; nothing here takes one second


def on_terminal(*arguments: str, columns: int = 80) -> str:
    """What a terminal of this width is shown."""
    leader, follower = pty.openpty()
    environment = {**os.environ, "COLUMNS": str(columns), "TERM": "xterm"}
    environment.pop("NO_COLOR", None)
    child = subprocess.Popen(
        [sys.executable, "-m", "robodyn", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=follower,
        stderr=subprocess.PIPE,
        cwd=ROOT,
        env=environment,
    )
    os.close(follower)
    data = b""
    try:
        while piece := os.read(leader, 65536):
            data += piece
    except OSError:
        pass  # how Linux tells that the other side of a terminal is closed
    finally:
        os.close(leader)
    assert child.stderr is not None
    with child.stderr as stream:
        assert stream.read() == b""
    assert child.wait(PATIENCE) == 0
    return data.decode().replace("\r\n", "\n")
