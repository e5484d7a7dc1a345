"""All places where two things differ, to the bit: `replan.contract.breaches.difference` names the
first one only, and takes a list for a tuple.
"""

from collections.abc import Mapping
from dataclasses import fields

import numpy as np


def differences(one: object, two: object, where: str = "scenario") -> list[str]:
    """Where two nouns differ, to the bit; NaN equals NaN."""
    if isinstance(one, np.ndarray):
        same = isinstance(two, np.ndarray) and (one.dtype, one.shape, one.tobytes()) == (
            two.dtype,
            two.shape,
            two.tobytes(),
        )
        return [] if same else [where]
    if isinstance(one, Mapping):
        if not isinstance(two, Mapping) or list(one) != list(two):
            return [where]
        return [d for key in one for d in differences(one[key], two[key], f"{where}[{key!r}]")]
    if isinstance(one, tuple):
        if not isinstance(two, tuple) or len(one) != len(two):
            return [where]
        return [
            d
            for i, (a, b) in enumerate(zip(one, two, strict=True))
            for d in differences(a, b, f"{where}[{i}]")
        ]
    if hasattr(one, "__dataclass_fields__"):
        if type(one) is not type(two):
            return [where]
        names = [f.name for f in fields(one)]  # type: ignore[arg-type]
        return [
            d for n in names for d in differences(getattr(one, n), getattr(two, n), f"{where}.{n}")
        ]
    return [] if one == two or (one != one and two != two) else [where]
