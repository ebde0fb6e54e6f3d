# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Protocol of a stage."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

from ratslam_ros.core.common.saved import Field
from ratslam_ros.core.common.state import STAGE, State
from ratslam_ros.core.config import Config
from ratslam_ros.core.vision.prepared_image import PreparedImage

NAME = re.compile('(?!inputs$)[a-z][a-z0-9_]{0,39}')
"""Form of the name of a stage. A map file has a part for each, and one named `inputs`."""


class Output(NamedTuple):
    """An item that a stage adds to the stream."""

    stream: str
    stamp_ns: int
    item: Any


OF_HOST = (
    Field('settings', '', list, of_session=True, optional=True),
    Field('inputs', '', dict, of_session=True, optional=True),
    # Of earlier versions.
    Field('reached', '', dict, of_session=True, optional=True),
    Field('rhythm', '', dict, of_session=True, optional=True),
)
"""Fields that a host adds to the states of its stages."""

Reader = Callable[[int, Any], Iterable[Output] | None]
"""Takes the stamp and the item of a stream, and returns what the stage adds to the stream, if
anything."""


@runtime_checkable
class Preparing(Protocol):
    """A stage that can compute a part of its work from an image alone, in another thread."""

    def prepare(self, image: PreparedImage) -> PreparedImage:
        """Return the image with what the stage will need of it."""
        ...


@runtime_checkable
class Awaiting(Protocol):
    """A stage that must have some answers before it reads the next item which is answered."""

    def awaits_answer(self) -> bool:
        """Return whether an answer is missing."""
        ...

    def expect_answers(self) -> None:
        """Await all answers from now on: a follower gives them, although it may not run yet."""


class Stage(Protocol):
    """A part of the system that reads streams, keeps a state, and writes streams.

    Its results depend on its configuration and on the items that it has read, in their order, and
    on nothing else: no clock, no file, no random numbers. Therefore they are the same in a replay,
    in a live process, and in a process of its own.
    """

    NAME: ClassVar[str]
    """Name of the stage, of its node, and of its part of a saved map."""
    WRITES: ClassVar[tuple[str, ...]]
    """Names of the streams that it writes."""

    def __init__(self, config: Config) -> None:
        """Create the stage with an empty memory."""
        ...

    def readers(self) -> dict[str, Reader]:
        """Return the reader of each stream that the stage needs. It is called once.

        Among them is `command`, with at least ``Reset`` and ``SetMapping`` (commands.py). Commands
        for another stage are not read.
        """
        ...

    def state(self) -> State:
        """Return everything that influences later results, for ``restore``.

        Arrays in it must not be changed afterwards, as another thread may write them: return
        copies. What commands have set is not part of it; the pipeline repeats these.
        """
        ...

    def restore(self, state: State) -> None:
        """Restore what ``state`` returned, into an empty memory; reset it after an error."""
        ...


def own_class(stage: Stage) -> str:
    """Return the name of the class of a stage of the user, '' for a stage of this package."""
    kind = type(getattr(stage, 'stage', stage))  # LiveTemplates contains one
    return '' if kind.__module__.startswith('ratslam_ros.') else kind.__name__


def saved_state(stage: Stage) -> State:
    """Return the state of a stage as it is saved: that of a user's stage with its class."""
    own, state = own_class(stage), stage.state()
    return {STAGE: own, 'state': state} if own else state
