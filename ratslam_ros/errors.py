# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors a user can cause; the command line answers them with one line and exit code 2."""


class RatslamError(Exception):
    """Something the user can mend; the text says what was seen, expected and what to do."""


class UnusableInput(RatslamError):  # noqa: N818
    """A recording, file or topic that cannot be used."""


class UnusableParameter(RatslamError):  # noqa: N818
    """A parameter that is unknown, of the wrong type or out of its range."""


class UnreachableGoal(RatslamError):  # noqa: N818
    """A goal that is not on the map or in the goal memory, or that no link leads to."""
