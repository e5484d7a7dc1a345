"""`python start.py MODULE:CLASS`: answers replan's messages on stdin and stdout."""

from __future__ import annotations

import sys

if __name__ == "__main__":
    try:
        from .nuplan_server import serve
    except ImportError as error:
        needs = "nuPlan's devkit and what it imports, shapely, scipy and msgpack"
        sys.exit(f"{sys.executable} lacks {error.name or error}: a planner of nuPlan needs {needs}")
    serve(sys.argv[1])
