"""`robodyn` as a command that starts at once: a copy of a process that has imported it already.

A server imports the package once.  A small program named `robodyn` hands it its own streams,
arguments, directory, environment and limit of a file's size; the server forks, and the copy runs
the command line on them as a new process would.  What starting and ending do (imports, closed
streams, signals that come early, a last flush that fails) is for real processes to test.
"""

from __future__ import annotations

import atexit
import gc
import io
import locale
import marshal
import os
import pkgutil
import resource
import selectors
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
import warnings
from functools import cache
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# what modules of the package import only when they run
LATE = ("scipy.integrate", "scipy.optimize", "scipy.linalg", "rich.table", "llvmlite.binding")
LATE += ("matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg")
EXTRAS = ("llvmlite", "orjson", "matplotlib")  # what the base installation lacks
SIZE = 1 << 20  # bytes that a call may have

# it must start in a few milliseconds: nothing but modules in C
CLIENT = """#!{python} -IS
import _socket, marshal, posix, resource, sys
link = _socket.socket(_socket.AF_UNIX, _socket.SOCK_STREAM)
link.connect({address!r})
size = resource.getrlimit(resource.RLIMIT_FSIZE)
call = marshal.dumps((sys.argv[1:], posix.getcwd(), posix.environ, size))
streams = b"".join(n.to_bytes(4, sys.byteorder) for n in (0, 1, 2))
link.sendmsg([len(call).to_bytes(4, "big")], [(_socket.SOL_SOCKET, _socket.SCM_RIGHTS, streams)])
while call:
    call = call[link.send(call):]
status = int.from_bytes(link.recv(4), "big")
if status & 0x7F:
    posix.kill(posix.getpid(), status & 0x7F)
posix._exit(status >> 8)
"""


@cache
def folder(extras: bool = True) -> Path:
    """The folder of a program `robodyn` that starts at once; its server ends with this process.

    Without `extras` the program finds no package of an extra, as in the base installation.
    """
    path = Path(tempfile.mkdtemp(prefix="robodyn-"))
    (path / "robodyn").write_text(CLIENT.format(python=sys.executable, address=f"{path}/socket"))
    (path / "robodyn").chmod(0o700)
    hidden = () if extras else EXTRAS
    line = [sys.executable, str(Path(__file__).resolve()), f"{path}/socket", *hidden]
    server = subprocess.Popen(line, cwd=ROOT, stdin=subprocess.PIPE, start_new_session=True)
    atexit.register(shutil.rmtree, path)
    atexit.register(server.wait)
    atexit.register(server.kill)  # the last one registered is the first one called
    deadline = time.monotonic() + 60
    while not (path / "socket").exists():
        assert server.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return path


def serve(address: str, hidden: list[str]) -> None:
    """Answer calls until stdin, which the process that began this one holds, is closed."""
    for name in hidden:
        sys.modules[name] = None  # type: ignore[assignment]  # an import of it fails from now on
    import robodyn

    kept = warnings.filters[:]
    warnings.simplefilter("ignore")
    for found in pkgutil.walk_packages(robodyn.__path__, "robodyn."):
        if not found.name.startswith("robodyn.robots"):
            import_module(found.name)
    for name in LATE:
        if name.partition(".")[0] not in hidden:
            import_module(name)
    sys.modules["__main__"] = import_module("robodyn.__main__")  # what processes of a sweep begin
    warnings.filters[:] = kept
    gc.collect()
    gc.freeze()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(f"{address}.new")
    listener.listen(64)
    os.rename(f"{address}.new", address)
    ended, told = socket.socketpair()
    told.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(told.fileno())
    waiting = selectors.DefaultSelector()
    for source in (listener, ended, sys.stdin):
        waiting.register(source, selectors.EVENT_READ)
    clients: dict[int, socket.socket] = {}
    while True:
        for key, _ in waiting.select():
            if key.fileobj is sys.stdin:
                return
            if key.fileobj is listener:
                link, _ = listener.accept()
                child = os.fork()
                if child == 0:
                    listener.close()
                    _become(link)
                clients[child] = link
                continue
            ended.recv(4096)
            while clients:
                child, status = os.waitpid(-1, os.WNOHANG)
                if child == 0:
                    break
                with clients.pop(child) as link:
                    link.sendall(status.to_bytes(4, "big"))


def _become(link: socket.socket) -> None:
    """Run the command line as the process that calls would."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    length, streams, _, _ = socket.recv_fds(link, 4, 3)
    call = b""
    while len(call) < int.from_bytes(length, "big"):
        call += link.recv(SIZE)
    arguments, directory, environment, size = marshal.loads(call)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    link.close()
    os.chdir(directory)
    resource.setrlimit(resource.RLIMIT_FSIZE, size)
    os.environ.clear()
    os.environb.update(environment)
    locale.setlocale(locale.LC_CTYPE, "")
    kind = os.environ.get("PYTHONIOENCODING") or locale.getencoding()
    sys.stdin = io.TextIOWrapper(io.BufferedReader(io.FileIO(0)), encoding=kind)
    sys.stdout = io.TextIOWrapper(io.BufferedWriter(io.FileIO(1, "w")), encoding=kind)
    errors = io.BufferedWriter(io.FileIO(2, "w"))
    sys.stderr = io.TextIOWrapper(errors, kind, "backslashreplace", line_buffering=True)
    sys.argv = ["robodyn", *arguments]
    import_module("robodyn.__main__").main()


def path_with_it(extras: bool = True) -> str:
    """A search path on which `robodyn` is the program that starts at once."""
    places = [str(folder(extras)), str(Path(sys.executable).parent), os.environ["PATH"]]
    return os.pathsep.join(places)


if __name__ == "__main__":
    serve(sys.argv[1], sys.argv[2:])
