# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``ratslam doctor`` and ``warm-up``: check the installation, and compile the inner loops."""

from __future__ import annotations

import argparse
import inspect
import os
import platform
import re
import shutil
import sys
import time
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from ratslam_ros import __version__
from ratslam_ros.cli.options import Commands
from ratslam_ros.errors import DONE, PIP_NAMES, UnusableInput

MODULES = {package: module for module, package in PIP_NAMES.items()}
"""Modules of packages with other names; packages of the system have no metadata of pip."""
OPTIONAL = ('viser', 'optuna', 'networkx', 'onnx', 'onnxruntime')
FREE_BYTES = 2**30
"""Free space below which results may not fit."""
DISCOVERY_S = 1.0
MAX_CAMERAS = 4
MAX_DOMAIN = 232


class Finding(NamedTuple):
    """What was found, and what to do; '' if nothing."""

    found: str
    advice: str = ''


def add_doctor(commands: Commands) -> None:
    """Add ``ratslam doctor``."""
    command = commands.add_parser(
        'doctor', help='check the installation and this machine, for bug reports too'
    )
    command.set_defaults(run=_doctor)


def add_warm_up(commands: Commands) -> None:
    """Add ``ratslam warm-up``."""
    from ratslam_ros.offline.compile_all import GROUPS

    command = commands.add_parser(
        'warm-up', help='compile the inner loops once, so that later starts are quick')
    command.add_argument('groups', nargs='*', metavar='GROUP',
                         help=f'{", ".join(GROUPS)} (default: all)')
    command.set_defaults(run=_warm_up)


def _warm_up(options: argparse.Namespace) -> int:
    from ratslam_ros.offline.compile_all import compile_all

    print(compile_all(options.groups, print))
    return DONE


def _doctor(options: argparse.Namespace) -> int:
    checks: dict[str, Callable[[], Finding]] = {
        'Python': _python, 'packages': _packages, 'compiled cache': _cache, 'cameras': _cameras,
        'ROS': _ros, 'DDS': _dds, 'free disk': _disk, 'browser': _browser,
    }
    for name, check in checks.items():
        try:
            found, advice = check()
        except ImportError as error:
            found, advice = str(error), 'install what is missing'
        except Exception as error:  # a report on a broken installation must be complete
            found, advice = f'the check failed: {error!r}', 'report it with these lines'
        line = ' '.join(f'{found}; {advice}'.split()) if advice else found
        print(f'{"!!" if advice else "ok"}  {name:<14}  {line}', flush=True)
    return DONE


def _python() -> Finding:
    return Finding(
        f'{platform.python_version()} ({sys.executable}), {platform.platform()}, '
        f'{os.cpu_count()} cores'
    )


def _packages() -> Finding:
    try:
        required = metadata.requires('ratslam_ros') or []
    except metadata.PackageNotFoundError:
        return Finding(f'ratslam_ros {__version__} is not installed', 'python3 -m pip install .')
    versions, missing = [f'ratslam_ros {__version__}'], []
    for requirement in sorted(required):
        name = re.split(r'[^\w.-]', requirement, maxsplit=1)[0]
        if 'extra ==' in requirement:
            continue
        if (version := _version(name)) is not None:
            versions.append(f'{name} {version}')
        elif ';' not in requirement:  # needed on every machine
            missing.append(name)
    versions += [f'{name} {version}' for name in OPTIONAL if (version := _version(name))]
    advice = f'missing: python3 -m pip install {" ".join(missing)}' if missing else ''
    return Finding(', '.join(versions), advice)


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return 'of the system' if find_spec(MODULES.get(name, name)) else None


def _cache() -> Finding:
    from ratslam_ros.core.pose_cells.packet_kernels import move

    dispatcher: Any = move
    folder = Path(dispatcher.stats.cache_path)
    version = f'py{sys.version_info.major}{sys.version_info.minor}'
    changed_s = Path(inspect.getfile(dispatcher.py_func)).stat().st_mtime
    indices = folder.glob(f'packet_kernels.move-*.{version}.nbi')
    if any(index.stat().st_mtime >= changed_s for index in indices):
        return Finding(f'in folders such as {folder}')
    return Finding(
        f'empty or out of date, in folders such as {folder}',
        'the first run compiles for about half a minute; run "ratslam warm-up" to do it now',
    )


def _cameras() -> Finding:
    os.environ.setdefault('OPENCV_LOG_LEVEL', 'SILENT')  # a camera that fails is reported below
    import cv2

    devices = sorted(Path('/dev').glob('video*')) if sys.platform == 'linux' else [Path('0')]
    found, refused = [], []
    for device in devices[:MAX_CAMERAS]:
        if sys.platform == 'linux' and not os.access(device, os.R_OK | os.W_OK):
            refused.append(str(device))
            continue
        capture = cv2.VideoCapture(int(re.sub(r'\D', '', device.name)))
        is_read, image = capture.read()
        capture.release()
        if is_read:
            found.append(f'{device} ({image.shape[1]}x{image.shape[0]})')
    if refused:
        return Finding(
            ', '.join([*found, *(f'{device} is not permitted' for device in refused)]),
            'add the user to the group video, and log in again',
        )
    return Finding(', '.join(found) or 'none gives an image (recordings and topics need none)')


def _ros() -> Finding:
    if find_spec('rclpy') is not None:
        rmw = os.environ.get('RMW_IMPLEMENTATION') or 'the default middleware'
        return Finding(f'rclpy of ROS 2 {os.environ.get("ROS_DISTRO", "(unknown)")}, {rmw}')
    if find_spec('cyclonedds') is None:
        return Finding(
            'neither rclpy nor cyclonedds: replays work, live commands do not',
            'source /opt/ros/jazzy/setup.bash, or python3 -m pip install cyclonedds',
        )
    return Finding(f'no rclpy; the stand-in uses cyclonedds {_version("cyclonedds")}')


def _dds() -> Finding:
    names = ('ROS_DOMAIN_ID', 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOCALHOST_ONLY',
             'ROS_STATIC_PEERS', 'CYCLONEDDS_URI')
    given = [f'{name}={os.environ[name]}' for name in names if os.environ.get(name)]
    settings = ', '.join(given) or 'ROS_DOMAIN_ID=0, discovery in the local network (defaults)'
    if find_spec('rclpy') is None and find_spec('cyclonedds') is None:
        return Finding(f'{settings}; not used')
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (domain.isdecimal() and int(domain) <= MAX_DOMAIN):
        return Finding(settings, f'set ROS_DOMAIN_ID to a number from 0 to {MAX_DOMAIN}')
    from ratslam_ros.live import ros

    ros.require()
    try:
        with ros.node('_ratslam_doctor', ()) as node:
            time.sleep(DISCOVERY_S)
            others = sorted({*node.get_node_names()} - {'_ratslam_doctor'})
    except (UnusableInput, RuntimeError, ValueError) as error:
        return Finding(f'{settings}; no node can start: {error}', 'correct these variables')
    return Finding(f'{settings}; other nodes: {", ".join(others) or "none"}')


def _disk() -> Finding:
    folder = Path.cwd()
    free = shutil.disk_usage(folder).free
    writable = os.access(folder, os.W_OK)
    text = f'{free / 2**30:.1f} GiB in {folder}{"" if writable else ", which is not writable"}'
    if writable and free >= FREE_BYTES:
        return Finding(text)
    return Finding(text, 'write results elsewhere with --out, or free some space')


def _browser() -> Finding:
    import webbrowser

    from ratslam_ros.live.run import VIEWER_PACKAGES
    from ratslam_ros.viewer.desktop import has_desktop

    if find_spec('viser') is None:
        advice = f"python3 -m pip install '{VIEWER_PACKAGES['viser']}'"
        return Finding('the live view is not installed', advice)
    if not has_desktop():
        return Finding(
            'this machine has no desktop',
            'open the address that "ratslam view" prints in a browser, from another machine with '
            '--host 0.0.0.0',
        )
    try:
        return Finding(str(getattr(webbrowser.get(), 'name', 'the default one')))
    except webbrowser.Error:
        return Finding('none was found', 'open the address that "ratslam view" prints in one')
