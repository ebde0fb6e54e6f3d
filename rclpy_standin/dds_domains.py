# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""DDS domains that this process has joined, and their configuration."""

from __future__ import annotations

import os
import threading
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain

from rclpy_standin.exceptions import RCLError

_domains: dict[int, tuple[Any, int]] = {}
_domains_lock = threading.Lock()


def enter_domain(domain_id: int) -> Any:
    """Join a domain; the first user in this process creates and configures it."""
    with _domains_lock:
        domain, users = _domains.get(domain_id, (None, 0))
        if domain is None:
            try:
                domain = Domain(domain_id, _configuration())
            except DDSException as error:
                raise RCLError(f'domain {domain_id} cannot be entered: {error}') from None
        _domains[domain_id] = domain, users + 1
        return domain


def leave_domain(domain_id: int) -> None:
    """Leave a domain; the last user of this process deletes it."""
    with _domains_lock:
        domain, users = _domains.pop(domain_id)
        if users > 1:
            _domains[domain_id] = domain, users - 1
        else:
            domain.__del__()


def _configuration() -> str:
    """Return the Cyclone DDS configuration (XML) for ROS's environment variables.

    Raises:
        ValueError: ROS_AUTOMATIC_DISCOVERY_RANGE has an invalid value, or ROS_SECURITY_STRATEGY
            requires DDS security.
    """
    if (
        os.environ.get('ROS_SECURITY_ENABLE') == 'true'
        and os.environ.get('ROS_SECURITY_STRATEGY') == 'Enforce'
    ):
        raise ValueError(
            'ROS_SECURITY_STRATEGY=Enforce: there is no DDS security without ROS; use ROS 2, or '
            'unset it if everyone on the network may control the nodes'
        )
    discovery_range = os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE') or 'SUBNET'
    if os.environ.get('ROS_LOCALHOST_ONLY') == '1':
        discovery_range = 'LOCALHOST'
    if discovery_range not in ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT'):
        raise ValueError(
            f'ROS_AUTOMATIC_DISCOVERY_RANGE={discovery_range}: expected SUBNET, LOCALHOST, OFF or '
            'SYSTEM_DEFAULT'
        )
    general = discovery = ''
    peers = [peer for peer in os.environ.get('ROS_STATIC_PEERS', '').split(';') if peer]
    if discovery_range == 'LOCALHOST':
        peers.insert(0, '127.0.0.1')
    if discovery_range in ('LOCALHOST', 'OFF'):
        general = '<AllowMulticast>false</AllowMulticast>'
    if peers == ['127.0.0.1']:
        general += '<Interfaces><NetworkInterface address="127.0.0.1"/></Interfaces>'
    if discovery_range == 'OFF':
        discovery = (
            f'<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>'
        )
    elif peers and discovery_range != 'SYSTEM_DEFAULT':
        addresses = ''.join(f'<Peer address="{peer}"/>' for peer in peers)
        discovery = (
            '<ParticipantIndex>auto</ParticipantIndex>'
            '<MaxAutoParticipantIndex>120</MaxAutoParticipantIndex>'
            f'<Peers>{addresses}</Peers>'
        )
    # By default each writer of a node waits up to 1 s at its deletion for a killed reader.
    linger = '<WriterLingerDuration>0.3 s</WriterLingerDuration>'
    xml = (
        f'<CycloneDDS><Domain><General>{general}</General><Discovery>{discovery}</Discovery>'
        f'<Internal>{linger}</Internal></Domain></CycloneDDS>'
    )
    user_configuration = os.environ.get('CYCLONEDDS_URI', '')
    return f'{xml},{user_configuration}' if user_configuration else xml
