"""The command line: one file a verb; each parses, calls the api and prints. `app` has them all."""

import os
import sys
import traceback

from spheremcap.errors import SpheremcapError, UsageError, short

DEBUG = "SPHEREMCAP_DEBUG"


def main() -> None:
    """Run the command line; every error is one line on stderr and an exit code."""
    try:
        from spheremcap.cli.app import app  # here, so that Ctrl-C while it loads is no traceback

        app()
    except UsageError as error:
        print(f"spheremcap: {error}", file=sys.stderr)
        sys.exit(2)
    except SpheremcapError as error:
        print(f"spheremcap: {error}", file=sys.stderr)
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read has gone; Python would try once more to write what is left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        print("spheremcap: stopped", file=sys.stderr)
        sys.exit(1)
    except Exception as error:
        if os.environ.get(DEBUG):
            traceback.print_exc()
        else:
            print(
                f"spheremcap: a fault of spheremcap's own, please report it: {type(error).__name__}: {short(error)} "
                f"(run the same with {DEBUG}=1 for the trace that belongs into the report)",
                file=sys.stderr,
            )
        sys.exit(1)
