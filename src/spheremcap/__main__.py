"""python -m spheremcap, and the command `spheremcap`: Ctrl-C is taken care of before anything large is imported."""

from spheremcap.interrupt import leave_at_once


def main() -> None:
    """Run the command line."""
    leave_at_once()
    from spheremcap import cli

    cli.main()


if __name__ == "__main__":
    main()
