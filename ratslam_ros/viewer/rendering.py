# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Viser's page, adapted to browsers that render without a graphics card."""

from __future__ import annotations

import gzip
from functools import lru_cache
from pathlib import Path

SCRIPT = Path(__file__).with_name('rendering.html')

HEAD = '<meta charset'
"""The first element of the head of viser's page: scripts before it run before viser's own."""


def with_elements(page: str, elements: str) -> str:
    """Return viser's page with elements at the beginning of its head.

    Raises:
        ValueError: the page is not one of viser's.
    """
    before, head, after = page.partition(HEAD)
    if not head:
        raise ValueError(f'no {HEAD}> in the page of viser')
    return before + elements + head + after


@lru_cache(2)
def adapted(body: bytes, encoding: str) -> bytes:
    """Return the body of the response with viser's page, without antialiasing in software.

    Args:
        body: the body as viser sends it.
        encoding: its content encoding: ``gzip``, or anything else for none.
    """
    page = (gzip.decompress(body) if encoding == 'gzip' else body).decode()
    content = with_elements(page, SCRIPT.read_text('utf-8')).encode()
    return gzip.compress(content) if encoding == 'gzip' else content
