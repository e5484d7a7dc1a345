"""What a reader stumbles over and ruff does not count.

python .ci/readability.py                      all packages; exit code 1 above a limit
python .ci/readability.py FILE_OR_FOLDER...    each finding there: file, line, rule
"""

import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("replan", "logs", "planners", "metrics", "replay", "studies", "benchmarks", ".ci")
VAGUE = {
    *("found", "one", "at", "out", "each", "what", "way", "made", "some", "given", "there", "told"),
    *("done", "here", "kept", "this", "that", "who", "whose", "mine", "theirs", "said", "it"),
}
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
LOGIC = (ast.IfExp, ast.BoolOp, ast.Compare, *COMPREHENSIONS)


def inside(node: ast.AST, kinds: tuple[type[ast.AST], ...]) -> bool:
    """Whether a node of these kinds stands below the node."""
    return any(isinstance(child, kinds) for child in ast.walk(node) if child is not node)


def nested_conditional(node: ast.AST) -> bool:
    """`a if b else c if d else e`."""
    return isinstance(node, ast.IfExp) and inside(node, (ast.IfExp,))


def long_comprehension(node: ast.AST) -> bool:
    """More than two clauses, of `for` and `if`."""
    if not isinstance(node, COMPREHENSIONS):
        return False
    return sum(1 + len(generator.ifs) for generator in node.generators) > 2


def lambda_with_logic(node: ast.AST) -> bool:
    """A function without a name that decides something."""
    return isinstance(node, ast.Lambda) and inside(node, LOGIC)


def long_assignment(node: ast.AST) -> bool:
    """More than three values assigned by one tuple."""
    if not isinstance(node, ast.Assign) or not isinstance(node.value, ast.Tuple):
        return False
    return any(isinstance(target, ast.Tuple) and len(target.elts) > 3 for target in node.targets)


def number_as_index(node: ast.AST) -> bool:
    """The fourth or a later column by its number, or a range of columns by two numbers."""
    if not isinstance(node, ast.Subscript):
        return False
    index = node.slice
    if isinstance(index, ast.Slice):
        return isinstance(index.lower, ast.Constant) and isinstance(index.upper, ast.Constant)
    return isinstance(index, ast.Constant) and isinstance(index.value, int) and index.value > 2


def sentinel(node: ast.AST) -> bool:
    """A power of two that stands for "never" or "none"."""
    if not isinstance(node, ast.BinOp) or not isinstance(node.op, ast.LShift):
        return False
    return isinstance(node.right, ast.Constant) and node.right.value >= 20


def vague_name(node: ast.AST) -> bool:
    """A local name that does not say what the thing is."""
    return isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in VAGUE


RULES = {
    "conditional in a conditional": nested_conditional,
    "comprehension with more than two clauses": long_comprehension,
    "lambda with logic": lambda_with_logic,
    "more than three values assigned at once": long_assignment,
    "column by its number": number_as_index,
    "sentinel": sentinel,
    "vague local name": vague_name,
}


LIMITS = {
    "conditional in a conditional": 5,
    "comprehension with more than two clauses": 9,
    "lambda with logic": 13,
    "more than three values assigned at once": 4,
    "column by its number": 14,
    "sentinel": 3,
    "vague local name": 212,
}


def findings(path: Path) -> Iterator[tuple[int, str]]:
    """Line and rule of each finding in a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        for rule, breaks in RULES.items():
            if breaks(node):
                yield node.lineno, rule


def main(places: list[str]) -> int:
    """Print the findings in the places, or the numbers of all packages; the exit code."""
    counts: Counter[str] = Counter()
    for place in map(Path, places or [ROOT / package for package in PACKAGES]):
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            for line, rule in sorted(findings(path)):
                counts[rule] += 1
                if places:
                    print(f"{path}:{line}: {rule}")
    for rule, limit in LIMITS.items():
        print(f"{counts[rule]:5} {rule} (limit {limit})")
    return int(any(counts[rule] > limit for rule, limit in LIMITS.items()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
