"""Drive it: world, loops, vehicle, controllers, traffic; and what is made of a drive."""

from typing import TYPE_CHECKING

import replan.own

if not TYPE_CHECKING:  # a type checker would take any name for one of ours
    __getattr__ = replan.own.missing("replay")
