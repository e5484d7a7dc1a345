"""Drives logs: world, loops, vehicle, controllers, traffic; results, reports and analyses of drives."""

from typing import TYPE_CHECKING

import replan.own

if not TYPE_CHECKING:  # with `__getattr__` visible, a type checker would accept any name
    __getattr__ = replan.own.missing("replay")
