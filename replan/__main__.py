"""`replan` and `python -m replan`: the command line."""

import sys


def main() -> None:
    """Run the command line; SIGINT and SIGTERM are handled before it is imported, which takes a
    moment.
    """
    from replan.interruption import end_at_once

    end_at_once()
    from replan.cli import main as run

    run()


if __name__ == "__main__":
    # The working directory is searched last, as by `replan` (replan.core.extension)
    if not sys.flags.safe_path:
        del sys.path[0]
    main()
