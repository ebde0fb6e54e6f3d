# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of nodes, topics and services: what is allowed, and what they are in full."""

from __future__ import annotations

import re

from ratslam_ros.standalone.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidServiceNameException,
    InvalidTopicNameException,
    NameValidationException,
)

_TOKEN = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
_LONGEST = 247
_SUBSTITUTION = re.compile(r'\{([^{}]*)\}')


def check_node_name(name: str) -> None:
    """Raise InvalidNodeNameException where ROS does not allow a name."""
    if not _TOKEN.fullmatch(name):
        raise InvalidNodeNameException(
            name, 'node name must be letters, digits and underscores, and not begin with a digit'
        )


def check_namespace(namespace: str) -> None:
    """Raise InvalidNamespaceException where ROS does not allow a full namespace."""
    tokens = namespace.split('/')[1:]
    if namespace == '/':
        return
    if not namespace.startswith('/') or not all(_TOKEN.fullmatch(token) for token in tokens):
        raise InvalidNamespaceException(
            namespace, 'namespace must be absolute, of tokens that node names are made of'
        )


def full_namespace(namespace: str) -> str:
    """Return a namespace with its leading slash, and checked."""
    if not namespace.startswith('/'):
        namespace = f'/{namespace}'
    check_namespace(namespace)
    return namespace


def join(namespace: str, name: str) -> str:
    """Return a name in a namespace."""
    return f'{namespace.rstrip("/")}/{name}'


def expand(name: str, node: str, namespace: str, is_service: bool = False) -> str:
    """Return the full name of a topic or service that a node calls by any name.

    Raises:
        InvalidTopicNameException, InvalidServiceNameException: ROS does not allow it.
    """
    wrong: type[NameValidationException] = (
        InvalidServiceNameException if is_service else InvalidTopicNameException
    )
    if not isinstance(name, str) or not name:
        raise wrong(str(name), 'name must not be empty')
    full = name
    if full.startswith('~'):
        full = join(namespace, node) + full[1:]
    known = {'node': node, 'ns': namespace.rstrip('/'), 'namespace': namespace.rstrip('/')}
    for found in _SUBSTITUTION.finditer(full):
        if found[1] not in known:
            raise wrong(name, f'unknown substitution {found[0]}', found.start())
    full = _SUBSTITUTION.sub(lambda found: known[found[1]], full)
    if not full.startswith('/'):
        full = join(namespace, full)
    for token in full.split('/')[1:]:
        if not _TOKEN.fullmatch(token):
            raise wrong(
                name,
                'name must be tokens of letters, digits and underscores that do not begin with a '
                'digit, with slashes between them',
                max(name.find(token), 0),
            )
    if len(full) > _LONGEST:
        raise wrong(name, f'name must not be longer than {_LONGEST} characters')
    return full


def type_from_dds(name: str) -> str:
    """Return the ROS name of a DDS type (std_msgs::msg::dds_::String_), itself if it has none."""
    namespace, found, short = name.rpartition('dds_::')
    if not found or not short.endswith('_'):
        return name
    return namespace.replace('::', '/') + short[:-1]


def topic_from_dds(name: str) -> str | None:
    """Return the ROS topic of a DDS topic (rt/chatter), None if it is none."""
    return name[2:] if name.startswith('rt/') else None


def service_from_dds(name: str) -> tuple[str, str] | None:
    """Return the service of a DDS topic and which half it is: Request or Reply."""
    for prefix, half in (('rq/', 'Request'), ('rr/', 'Reply')):
        if name.startswith(prefix) and name.endswith(half):
            return name[2 : -len(half)], half
    return None
