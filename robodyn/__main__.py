"""`python -m robodyn`: the command line."""

from robodyn.cli import main

if __name__ == "__main__":
    main()
