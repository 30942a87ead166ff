"""`robodyn` and `python -m robodyn`: the command line."""

import gc
import os
import signal
import sys


def main() -> None:
    """Run the command line; Ctrl-C while its modules are being loaded ends it without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda number, _: os._exit(128 + number))
    gc.set_threshold(100_000, 50, 100)  # what is imported would be searched again and again
    from robodyn.cli import main as command_line

    command_line()


if __name__ == "__main__":
    # `python -m` puts the working directory first: no file there is to stand in for a module
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if not sys.flags.safe_path and sys.path[0] != here:
        del sys.path[0]
    main()
