"""Decodes selected fields of serialised ROS messages, without objects for the other fields.

A message type is compiled once into a Python function that walks the bytes: unwanted fields are
skipped, and runs of numbers of one size are unpacked at once. This takes a tenth of the steps of
objects for all nested messages, as objects of perception have point clouds, images, predicted paths
and covariances that no scenario needs.

Layouts: CDR as ROS 2 writes it (XCDR1: a number lies at a multiple of its size after the 4 bytes of
the encapsulation header; a string ends in NUL) and ROS 1 (nothing is aligned, little endian, a
Header begins with its sequence number).

`wanted` is a tuple of dotted names; an item `(name, wanted)` selects fields of a list of messages.
The result is a tuple in the same order, with a list of such tuples for a list of messages, and a
plain list for a list of numbers or texts, which is selected by `(name, ())`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from replan.core.errors import LogError

Wanted = tuple[Any, ...]
"""Names, and pairs (name, Wanted)."""
Types = Mapping[str, tuple[Any, list[tuple[str, Any]]]]
"""Fields of each message type as `rosbags` parses them: (name, (node type, what))."""
BASE, NAME = 1, 2
ARRAY, SEQUENCE = 3, 4
"""Node types of rosbags."""
CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "octet": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
HEADER = "std_msgs/msg/Header"
TEXT = "string"
_DEEPEST = 24
MOST_FIELDS = 10_000
"""Greatest number of fields of a message, nested messages included: Autoware's largest types have
some 100.
"""
MOST_FIXED_BYTES = 1024**3
"""Largest list of fixed length, bytes: no message is longer
(`replan.logs.readers.ros.storage.MAX_CHUNK_BYTES`).
"""
SIMPLIFY = "record the topic with a simpler message type, or leave it out of the bag"
ENDS = {0: ">", 1: "<"}
"""Byte order by the second byte of the encapsulation header of plain XCDR1."""


def has_field(types: Types, kind: str, path: str) -> bool:
    """Return whether a message type has a field, given by its dotted name, also within lists."""
    name, _, rest = path.partition(".")
    for field_name, desc in types.get(kind, ((), []))[1]:
        if field_name == name:
            while desc[0] in (ARRAY, SEQUENCE):
                desc = desc[1][0]
            return not rest or (desc[0] == NAME and has_field(types, desc[1], rest))
    return False


def decoder(
    types: Types, kind: str, wanted: Wanted, *, cdr: bool
) -> Callable[[bytes], tuple[Any, ...]]:
    """Return a function that decodes the wanted fields of messages of a type from bytes; LogError
    if it has none.

    The function raises `struct.error`, `IndexError` or `ValueError` on bytes that are not such a
    message.
    """
    walks: dict[str, Callable[[bytes], tuple[Any, ...]]] = {}
    for end in ("<", ">") if cdr else ("<",):
        code = _Code(types, end, cdr)
        code.line("def walk(b):")
        code.depth += 1
        code.line("p = 0")
        answer = _tuple(code.message(kind, wanted, 0))
        code.flush()
        code.line("if p > len(b): raise ValueError('the message is cut off')")
        code.line(f"return {answer}")
        space: dict[str, Any] = dict(code.constants)
        exec("\n".join(code.lines), space)
        walks[end] = space["walk"]
    if not cdr:
        return walks["<"]

    def decoded(raw: bytes) -> tuple[Any, ...]:
        if len(raw) < 4 or raw[1] not in ENDS:
            raise ValueError("the message is not encoded as plain CDR")
        return walks[ENDS[raw[1]]](raw[4:])

    return decoded


@dataclass
class _Code:
    """The text of the function while it is generated."""

    types: Types
    end: str
    cdr: bool
    lines: list[str] = field(default_factory=list)
    depth: int = 0
    known: int = 8  # A number of which the position is known to be a multiple
    # numbers that are not unpacked yet: code, size, name (None: skipped), count
    run: list[tuple[str, int, str | None, int]] = field(default_factory=list)
    # Results of `uniform` by message type
    uniforms: dict[str, tuple[int, int] | None] = field(default_factory=dict)
    fields: int = 0  # number of fields walked, at most `MOST_FIELDS`
    constants: dict[str, Any] = field(default_factory=dict)
    names: int = 0

    def line(self, text: str) -> None:
        self.lines.append("  " * self.depth + text)

    def name(self) -> str:
        self.names += 1
        return f"v{self.names}"

    def unpacker(self, form: str) -> str:
        name = "U" + "".join(c if c.isalnum() else "_" for c in form)
        self.constants[name] = struct.Struct(self.end + form).unpack_from
        return name

    def align(self, size: int) -> None:
        if self.cdr and self.known < size:
            self.line(f"p = (p + {size - 1}) & -{size}")
            self.known = size

    def message(self, kind: str, wanted: Wanted, level: int) -> list[str]:
        """Walk a message; return the names of the variables with the wanted fields."""
        if kind not in self.types:
            raise LogError(
                f"the message type {kind} is not defined in the log",
                remedy="record with definitions",
            )
        if level > _DEEPEST:
            raise LogError(f"the message type {kind} holds itself")
        if not self.cdr and _lacks_sequence(self.types, kind):
            self.number("uint32", None)
        places: dict[int, str] = {}
        for name, desc in self.types[kind][1]:
            self.fields += 1
            if self.fields > MOST_FIELDS:
                problem = (
                    f"the message type has more than {MOST_FIELDS} fields with all messages in it"
                )
                raise LogError(problem, remedy=SIMPLIFY)
            # What is left of each wanted path behind the field's name; "": the field itself
            wanted_here: list[tuple[int, Any]] = []
            for i, w in enumerate(wanted):
                path, inner = (w, None) if isinstance(w, str) else w
                first, dot, rest = path.partition(".")
                if first != name:
                    continue
                if inner is None:
                    wanted_here.append((i, rest))
                else:
                    wanted_here.append((i, (rest, inner) if dot else inner))
            places |= self.value(desc, wanted_here, level + 1)
        for i, w in enumerate(wanted):
            if i not in places:
                lacking = w if isinstance(w, str) else w[0]
                raise LogError(f"the message type {kind} has no field {lacking}")
        return [places[i] for i in range(len(wanted))]

    def value(self, desc: Any, wanted: list[tuple[int, Any]], level: int) -> dict[int, str]:
        """Walk one field; return the names of the wanted variables by their index in `wanted`."""
        node, content = desc
        if node == BASE:
            place, name = (wanted[0][0], self.name()) if wanted else (0, None)
            self.text(name) if content[0] == TEXT else self.number(content[0], name)
            return {place: name} if name is not None else {}
        if node == NAME:
            inner = self.message(content, tuple(w for _, w in wanted), level)
            return {i: inner[k] for k, (i, _) in enumerate(wanted)}
        if node == ARRAY:
            return self.array(content[0], content[1], wanted, level)
        return self.sequence(content[0], wanted, level)

    def number(self, kind: str, name: str | None) -> None:
        if kind not in CODES:
            raise LogError(f"a message holds a {kind}, which replan does not read")
        size = struct.calcsize("<" + CODES[kind])
        if self.run and self.run[0][1] != size:
            self.flush()
        self.run.append((CODES[kind], size, name, 1))

    def flush(self) -> None:
        run, self.run = self.run, []
        if not run:
            return
        size = run[0][1]
        self.align(size)
        chosen = [k for k, (_, _, name, _) in enumerate(run) if name is not None]
        if chosen:
            first, last = chosen[0], chosen[-1]
            form = "".join(
                c if name is not None else f"{size * n}x" for c, _, name, n in run[first : last + 1]
            )
            names = ", ".join(str(run[k][2]) for k in chosen)
            before = sum(n for *_, n in run[:first])
            self.line(f"{names}, = {self.unpacker(form)}(b, p + {before * size})")
        self.line(f"p += {sum(n for *_, n in run) * size}")
        self.known = size if self.cdr else 1

    def count(self) -> str:
        """Walk the length of a list or text and return its name.

        The code checks it against the remaining bytes.
        """
        self.flush()
        self.align(4)
        name = self.name()
        self.line(f"{name}, = {self.unpacker('I')}(b, p)")
        self.line("p += 4")
        self.line(f"if {name} > len(b) - p: raise ValueError('the message is cut off')")
        self.known = 4
        return name

    def text(self, name: str | None) -> None:
        count = self.count()
        if name is not None:
            self.line(
                f"{name} = b[p:p + {count}{' - 1' if self.cdr else ''}].decode('utf-8', 'replace')"
            )
        self.line(f"p += {count}")
        self.known = 1

    def array(
        self, desc: Any, length: int, wanted: list[tuple[int, Any]], level: int
    ) -> dict[int, str]:
        """Walk a list of fixed length: skip it, or read it as bytes."""
        if wanted:
            if desc[0] != BASE or CODES.get(desc[1][0]) not in ("B", "b"):
                raise LogError("a list of fixed length that is not of bytes cannot be read")
            _check_fixed(length)
            self.flush()
            name = self.name()
            self.line(f"{name} = b[p:p + {length}]")
            self.line(f"p += {length}")
            self.known = 1
            return {wanted[0][0]: name}
        if desc[0] == BASE and desc[1][0] != TEXT:
            self.number(desc[1][0], None)
            code, size, *_ = self.run.pop()
            _check_fixed(size * length)
            self.run += [(code, size, None, length)] if length else []
            return {}
        self.flush()
        numbers = self.uniform(desc, level)
        if numbers is not None:
            size, many = numbers
            _check_fixed(size * many * length)
            if many * length:
                self.align(size)
                self.line(f"p += {size * many * length}")
                self.known = size if self.cdr else 1
            return {}
        self.line(f"for _ in range({length}):")
        self.body(desc, (), level)
        return {}

    def sequence(self, desc: Any, wanted: list[tuple[int, Any]], level: int) -> dict[int, str]:
        count, numbers = self.count(), self.uniform(desc, level)
        if not wanted and numbers is not None:
            size, many = numbers
            up = f"((p + {size - 1}) & -{size})" if self.cdr and size > 4 else "p"
            self.line(f"if {count}: p = {up} + {size * many} * {count}")
            self.known = min(4, size) if self.cdr else 1
            return {}
        lists = [(i, self.name(), w) for i, w in wanted]
        for _, name, _ in lists:
            self.line(f"{name} = []")
        self.line(f"for _ in range({count}):")
        self.body(desc, tuple((name, w) for _, name, w in lists), level)
        return {i: name for i, name, _ in lists}

    def body(self, desc: Any, lists: tuple[tuple[str, Wanted], ...], level: int) -> None:
        """The loop over a list's elements: each is walked, and what is wanted of it appended to the
        `lists`.
        """
        self.depth += 1
        self.known = 1
        self.line("if p > len(b): raise ValueError('the message is cut off')")
        if desc[0] == BASE and lists:
            (value,) = self.value(desc, [(0, "")], level).values()
            self.flush()
            self.line(f"{lists[0][0]}.append({value})")
        elif desc[0] == NAME and lists:
            answer = _tuple(self.message(desc[1], lists[0][1], level))
            self.flush()
            self.line(f"{lists[0][0]}.append({answer})")
        else:
            self.value(desc, [], level)
            self.flush()
        self.depth -= 1
        self.known = 1

    def uniform(self, desc: Any, level: int) -> tuple[int, int] | None:
        """(size, how many) of the numbers that an element consists of, if they are of one size.

        Else None.
        """
        node, content = desc
        if level > _DEEPEST or node == SEQUENCE:
            return None
        if node == BASE:
            return (struct.calcsize("<" + CODES[content[0]]), 1) if content[0] in CODES else None
        if node == ARRAY:
            element = self.uniform(content[0], level + 1)
            return (element[0], element[1] * content[1]) if element is not None else None
        if content not in self.types or (not self.cdr and _lacks_sequence(self.types, content)):
            return None
        if content not in self.uniforms:
            self.uniforms[content] = None  # of a type that holds itself
            parts = [self.uniform(part, level + 1) for _, part in self.types[content][1]]
            sizes = {part[0] for part in parts if part is not None and part[1]} or {1}
            if None not in parts and len(sizes) == 1:
                self.uniforms[content] = (
                    sizes.pop(),
                    sum(part[1] for part in parts if part is not None),
                )
        return self.uniforms[content]


def _check_fixed(size: int) -> None:
    if size > MOST_FIXED_BYTES:
        problem = (
            f"the message type has a list of fixed length of more than {MOST_FIXED_BYTES} bytes"
        )
        raise LogError(problem, remedy=SIMPLIFY)


def _lacks_sequence(types: Types, kind: str) -> bool:
    """Return whether a type is a Header without a sequence number (ROS 2).

    In ROS 1 the bytes begin with it.
    """
    return kind == HEADER and types[HEADER][1][0][0] != "seq"


def _tuple(names: list[str]) -> str:
    return "(" + "".join(f"{name}, " for name in names) + ")"
