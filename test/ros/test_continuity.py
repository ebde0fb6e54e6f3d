# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a regular stream that a restarted node has lost are recognised by the stamps."""

from __future__ import annotations

from unittest.mock import MagicMock

import pytest
from helpers import START_NS, template_text

from ratslam_ros.ros.restart.continuity import NEW_COUNT, Continuity


def judged(known: list[int], new: list[int]) -> Continuity:
    continuity = Continuity(known)
    for count, stamp_ns in enumerate(new, 1):
        assert continuity.add(stamp_ns) == (count >= NEW_COUNT)
    return continuity


def test_complete_stream_has_lost_nothing() -> None:
    assert judged([100, 120, 140], [160, 180, 200, 220, 240]).lost() is None


@pytest.mark.parametrize('missing', [1, 2, 20])
def test_missing_messages_are_recognised_without_recovered_ones(missing: int) -> None:
    first = 100 + 20 * (missing + 1)
    continuity = judged([100], [first + 20 * n for n in range(NEW_COUNT)])
    assert continuity.lost() == (100, first)


def test_several_gaps_are_one_span() -> None:
    # A neighbour has logged two of the messages.
    continuity = judged([100, 160, 180], [300, 320, 340, 360, 380])
    assert continuity.lost() == (100, 300)


def test_jitter_and_duplicates_are_no_loss() -> None:
    assert judged([100, 118, 141], [141, 158, 182, 199, 199]).lost() is None


def test_silent_stream_is_not_judged() -> None:
    continuity = Continuity([100])
    assert continuity.lost() is None
    assert not continuity.has_new
    assert continuity.last_ns == 100


def test_gap_between_resent_and_live_messages_is_filled_by_asking_again() -> None:
    from ratslam_ros.ros.restart.resuming import Resuming, Wanted

    def message(number: int) -> MagicMock:
        text = template_text(START_NS + number * 100, number, error=0.5, is_new=True)
        return MagicMock(spec=['data'], data=text)

    wanted = Wanted('image', object, START_NS, print)
    resuming = Resuming(MagicMock(), {'image': wanted}, (), START_NS, print)
    resend = resuming._receiver('image', wanted)
    for number in (1, 2, 3, 4):
        resend(message(number))
    resuming._promised['image'] = 4
    assert not resuming._is_missing()
    resuming.keep('image', message(6), print)  # 5 was sent before the topic was connected
    assert resuming._is_missing()
    for number in (1, 2, 3, 4, 5, 6):
        resend(message(number))
    resuming._promised['image'] = 6
    assert not resuming._is_missing()
    # The source itself has made a pause.
    for number in (9, 10):
        resend(message(number))
    resuming._promised['image'] = 8
    assert not resuming._is_missing()


def test_neighbours_save_their_logs_after_the_topics_are_connected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What they publish before the restarted node is connected is only in their logs."""
    from ratslam_ros.messages.json_schema import decode, encode
    from ratslam_ros.messages.resending import ResendAnswer, ResendRequest
    from ratslam_ros.ros.restart import resuming as module

    now_s = 0.0
    monkeypatch.setattr(module.time, 'monotonic', lambda: now_s)
    node = MagicMock()
    node.get_node_names_and_namespaces.return_value = [('pose_cells', '/'), ('local_view', '/')]
    node.get_name.return_value, node.get_namespace.return_value = 'pose_cells', '/'
    node.count_publishers.return_value = 0
    wanted = module.Wanted('template', object, START_NS, print)
    resuming = module.Resuming(node, {'template': wanted}, (), START_NS, print)

    def requests() -> list[str]:
        return [call.args[0].data for call in node.create_publisher().publish.call_args_list]

    def answer(request: str) -> None:
        answer = ResendAnswer(decode(ResendRequest, request).number, 'local_view')
        resuming._on_answer(MagicMock(data=encode(answer)))

    assert not resuming.update()
    (first,) = requests()
    answer(first)
    now_s = module.LEAST_S
    assert not resuming.update()  # the answer came before the topics were connected
    answer(first)
    assert not resuming.update()
    last = requests()[-1]
    assert decode(ResendRequest, last).after == {'template': START_NS}
    assert decode(ResendRequest, last).number != decode(ResendRequest, first).number
    answer(last)
    assert resuming.update()


def test_message_that_was_sent_while_the_topic_was_being_connected_is_asked_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No later message shows that it is missing if the source makes a pause or ends."""
    from ratslam_ros.messages.json_schema import decode, encode
    from ratslam_ros.messages.resending import ResendAnswer, ResendRequest
    from ratslam_ros.ros.restart import resuming as module

    now_s = 0.0
    monkeypatch.setattr(module.time, 'monotonic', lambda: now_s)
    node = MagicMock()
    node.get_name.return_value, node.get_node_names_and_namespaces.return_value = 'local_view', []
    node.count_publishers.return_value = 1
    wanted = module.Wanted('image', object, START_NS, print)
    resuming = module.Resuming(node, {'image': wanted}, (), START_NS, print)

    def resend(count: int, first: int, last: int) -> int:
        """Send messages again, and answer the last request; return the stamp after which."""
        request = decode(ResendRequest, node.create_publisher().publish.call_args.args[0].data)
        for number in range(first, last + 1):
            text = template_text(START_NS + number, number, error=0.5, is_new=True)
            resuming._receiver('image', wanted)(MagicMock(spec=['data'], data=text))
        answer = ResendAnswer(request.number, 'player', {'image': count})
        resuming._on_answer(MagicMock(data=encode(answer)))
        return request.after['image'] - START_NS

    assert not resuming.update()
    assert resend(2, 1, 2) == 0
    now_s = module.LEAST_S
    assert not resuming.update()  # the third message was sent on the topic before this
    assert not resuming.is_complete
    assert resend(1, 3, 3) == 2
    assert resuming.update()
    assert resuming.is_complete
