"""`robodyn` and `python -m robodyn`: the command line."""

import os
import signal


def main() -> None:
    """Run the command line; Ctrl-C while its modules are being loaded ends it without a word."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda number, _: os._exit(128 + number))
    from robodyn.cli import main as command_line

    command_line()


if __name__ == "__main__":
    main()
