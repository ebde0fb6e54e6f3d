# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The SROS 2 policy permits what the nodes use, and nothing else."""

from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path

import pytest
import sros2_policies

ROOT = Path(__file__).parents[2]
POLICY = ElementTree.parse(ROOT / 'policies' / 'ratslam.policy.xml').getroot()
LISTS = {
    'topics': ('topic', {'publish', 'subscribe'}), 'services': ('service', {'reply', 'request'}),
    'actions': ('action', {'call', 'execute'}),
}
NAME = re.compile(r'(/|~/)?[a-zA-Z0-9_]+(/[a-zA-Z0-9_]+)*')


def permitted(node: str, kind: str) -> set[str]:
    return {
        str(entry.text)
        for profile in POLICY.iter('profile') if profile.get('node') == node
        for group in profile if group.get(kind) == 'ALLOW'
        for entry in group
    }


def test_policy_has_the_layout_of_its_schema() -> None:
    """As policy.xsd of sros2 has it: elements, attributes and values; an enclave per node."""
    assert (POLICY.tag, POLICY.get('version')) == ('policy', '0.2.0')
    (enclaves,) = POLICY
    assert enclaves.tag == 'enclaves'
    for enclave in enclaves:
        assert enclave.tag == 'enclave' and set(enclave.attrib) == {'path'}
        (profiles,) = enclave
        (profile,) = profiles
        assert (profiles.tag, profile.tag) == ('profiles', 'profile')
        assert set(profile.attrib) == {'ns', 'node'}
        assert enclave.get('path') == f'/ratslam/{profile.get("node")}'
        for group in profile:
            item, kinds = LISTS[group.tag]
            assert set(group.attrib) <= kinds and set(group.attrib.values()) == {'ALLOW'}
            assert len(group) > 0
            for entry in group:
                assert entry.tag == item and not entry.attrib
                assert NAME.fullmatch(str(entry.text)), entry.text


def test_policy_is_up_to_date() -> None:
    if find_spec('nav2_msgs') is not None:
        pytest.skip('the policies are written with the stand-in for rclpy')
    done = subprocess.run(
        [sys.executable, ROOT / 'tools' / 'sros2_policies.py', '--check'], capture_output=True,
        text=True, check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_all_nodes_have_a_policy() -> None:
    nodes = {str(profile.get('node')) for profile in POLICY.iter('profile')}
    text = (ROOT / 'setup.py').read_text(encoding='utf-8')
    listed = set(re.findall(r"'(\w+)'", text.split('NODES = [')[1].split(']')[0]))
    # Those of single_process are in one process.
    assert nodes == listed - {'single_process'}


def test_policy_permits_what_nav2_needs() -> None:
    served = {'navigate_to_pose', 'navigate_through_poses'}
    assert permitted('goal_follower', 'execute') == served
    assert permitted('route_to_nav2', 'call') == {'follow_path'}
    assert permitted('route_server_graph', 'request') == {
        'route_server/set_route_graph', 'route_server/DynamicEdgesScorer/adjust_edges',
        'experience_map/send_all',
    }


def test_viewer_may_call_what_its_controls_call() -> None:
    source = ''.join(
        (ROOT / 'ratslam_ros/ros' / name).read_text(encoding='utf-8')
        for name in ('viewing/viewer_controls.py', 'mapping/followed_map.py')
    )
    called = set(re.findall(r"_call_all\(\w+, '(\w+)'", source))
    called |= set(re.findall(r"\{(?:name|node)\}/(\w+)'", source))
    called |= set(re.findall(r"_change_map\('ratslam/(\w+)'", source))
    called |= set(re.findall(r"(?:Trigger|SetBool), 'experience_map/(\w+)'", source))
    assert called == sros2_policies.REQUESTED


def test_only_the_goal_follower_drives() -> None:
    nodes = [str(profile.get('node')) for profile in POLICY.iter('profile')]
    assert [n for n in nodes if 'cmd_vel' in permitted(n, 'publish')] == ['goal_follower']
