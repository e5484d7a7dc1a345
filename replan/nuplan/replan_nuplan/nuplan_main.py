"""`python start.py MODULE:CLASS FOLDER ...`: answers replan's messages on stdin and stdout; the
planner and the devkit are imported from the folders, and from where Python looks otherwise.
"""

from __future__ import annotations

import sys

if __name__ == "__main__":
    sys.path[:0] = sys.argv[2:]
    try:
        from .nuplan_server import serve
    except ImportError as error:
        needs = "nuPlan's devkit and what it imports, shapely, scipy and msgpack"
        sys.exit(f"{sys.executable} lacks {error.name or error}: a planner of nuPlan needs {needs}")
    serve(sys.argv[1])
