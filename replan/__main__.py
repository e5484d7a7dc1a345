"""`replan` and `python -m replan`: the command line."""


def main() -> None:
    """Run the command line; SIGINT and SIGTERM are handled before it is imported, which takes a moment."""
    from replay.interruption import end_at_once

    end_at_once()
    from replay.cli import main as run

    run()


if __name__ == "__main__":
    main()
