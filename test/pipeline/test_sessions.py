# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Maps that are continued by other drives, programs and parameters."""

from __future__ import annotations

import pytest
from helpers import PERIOD_NS, START_NS, picture, twist
from test_stages import FORGETTING, SMALL, Message, circles

from ratslam_ros.errors import UnusableInput
from ratslam_ros.pipeline.ratslam import RatSLAM

DRIVE = circles(60, ('odometry', 'image'))


def fed(slam: RatSLAM, messages: list[Message] = DRIVE) -> RatSLAM:
    for message in messages:
        slam.pipeline.feed(*message)
    return slam


def finished(slam: RatSLAM) -> RatSLAM:
    fed(slam)
    slam.finish()
    return slam


def test_session_starts_apart_and_joins_where_it_recognises_a_place() -> None:
    slam = finished(RatSLAM(SMALL))
    graph, count = slam.experience_map, len(slam.experience_map)
    assert graph.component_count == 1
    slam.begin_session()
    for n in range(8):  # another drive with earlier stamps, which starts at an unknown place
        at_ns = START_NS // 2 + n * PERIOD_NS
        slam.odometry(twist(at_ns, 5.0))
        slam.image(at_ns, picture(500 + n))
    slam.finish()
    assert len(graph) > count
    assert graph.component_count == 2
    slam.begin_session()
    finished(slam)
    assert graph.component_of(graph.current_id) == 0


def test_session_on_an_empty_map_changes_nothing() -> None:
    plain, begun = RatSLAM(SMALL), RatSLAM(SMALL)
    begun.begin_session()
    assert repr(fed(begun).state()) == repr(fed(plain).state())


def test_states_of_other_parameters_are_refused() -> None:
    states = fed(RatSLAM(SMALL)).state()
    for name, value in (('local_view.template_y_size', 9), ('pose_cells.pc_dim_x', 30)):
        with pytest.raises(UnusableInput, match=name.partition('.')[2]):
            RatSLAM(SMALL.with_values({name: value})).restore(states)
    scans = SMALL.with_values({'experience_map.exp_align_scans': True})
    assert not RatSLAM(scans).restore(states)  # its inputs are others
    del states['experience_map']['core']['poses']
    with pytest.raises(UnusableInput, match=r"of other stages .*'poses'"):
        RatSLAM(SMALL).restore(states)


def test_restored_items_of_nodes_survive_and_named_places_follow_pruning() -> None:
    config = SMALL.with_values(FORGETTING)
    messages = circles(200, ('odometry', 'image'))
    states = fed(RatSLAM(config), messages[:200]).state()
    places = {f'place {n}': n for n in range(len(states['experience_map']['core']['poses']))}
    states['experience_map']['goals'] = {
        'named': [[name, at, 0.0, 0.0, 0.0] for name, at in places.items()]
    }
    states['experience_map']['reached'] = {}  # messages of the nodes, which a replay replaces
    states['local_view']['other'] = {'a': 1}
    again = RatSLAM(config)
    again.restore(states)
    found = fed(again, messages[200:]).state()
    assert found['local_view']['other'] == {'a': 1}
    assert 'reached' not in found['experience_map']
    anchors = {name: at for name, at, *_ in found['experience_map']['goals']['named']}
    assert anchors.keys() == places.keys()
    assert anchors != places  # Those of pruned experiences have other anchors.
