"""Check the contract of the reader."""

import replan

replan.check_reader("my_reader:READER", "drive.txy")
