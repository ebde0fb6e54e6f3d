# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of nodes, topics and services: validation, expansion, and mapping from DDS names."""

from __future__ import annotations

import re

from rclpy_standin.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidServiceNameException,
    InvalidTopicNameException,
    NameValidationException,
)

_TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
_MAX_LENGTH = 247


def check_node_name(name: str) -> None:
    """Raise InvalidNodeNameException if a node name is invalid."""
    if not _TOKEN.fullmatch(name):
        raise InvalidNodeNameException(
            name, 'node name must be letters, digits and underscores, and not begin with a digit'
        )


def check_namespace(namespace: str) -> None:
    """Raise InvalidNamespaceException if a full namespace is invalid."""
    tokens = namespace.split('/')[1:]
    if namespace == '/':
        return
    if not namespace.startswith('/') or not all(_TOKEN.fullmatch(token) for token in tokens):
        raise InvalidNamespaceException(
            namespace, 'namespace must be absolute, and each token must be a valid node name'
        )


def full_namespace(namespace: str) -> str:
    """Return a namespace with a leading slash; raises InvalidNamespaceException."""
    if not namespace.startswith('/'):
        namespace = f'/{namespace}'
    check_namespace(namespace)
    return namespace


def join(namespace: str, name: str) -> str:
    """Return a name prefixed with a namespace."""
    return f'{namespace.rstrip("/")}/{name}'


def expand(name: str, node: str, namespace: str, is_service: bool = False) -> str:
    """Expand a relative, private or absolute name of a topic or service to its full name.

    Args:
        name: name to expand; ``~`` stands for the node.
        node: name of the node.
        namespace: full namespace of the node.
        is_service: whether the name is that of a service.

    Raises:
        InvalidTopicNameException, InvalidServiceNameException: the name is invalid.
    """
    error: type[NameValidationException] = (
        InvalidServiceNameException if is_service else InvalidTopicNameException
    )
    if not isinstance(name, str) or not name:
        raise error(str(name), 'name must not be empty')
    full = name
    if full.startswith('~'):
        full = join(namespace, node) + full[1:]
    if not full.startswith('/'):
        full = join(namespace, full)
    for token in full.split('/')[1:]:
        if not _TOKEN.fullmatch(token):
            raise error(
                name,
                'name must be tokens of letters, digits and underscores that do not begin with a '
                'digit, with slashes between them',
                max(name.find(token), 0),
            )
    if len(full) > _MAX_LENGTH:
        raise error(name, f'name must not be longer than {_MAX_LENGTH} characters')
    return full


def type_from_dds(name: str) -> str:
    """Return the ROS name of a DDS type such as std_msgs::msg::dds_::String_.

    Names of other types are returned unchanged.
    """
    namespace, found, short = name.rpartition('dds_::')
    if not found or not short.endswith('_'):
        return name
    return namespace.replace('::', '/') + short[:-1]


def topic_from_dds(name: str) -> str | None:
    """Return the ROS name of a DDS topic such as rt/chatter; None if it is no ROS topic."""
    return name[2:] if name.startswith('rt/') else None


def service_from_dds(name: str) -> tuple[str, str] | None:
    """Return the service of a DDS topic, and Request or Reply; None if it belongs to none."""
    for prefix, half in (('rq/', 'Request'), ('rr/', 'Reply')):
        if name.startswith(prefix) and name.endswith(half):
            return name[2 : -len(half)], half
    return None
