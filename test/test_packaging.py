# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Packaging: metadata files agree, and colcon and pip find all that they need."""

import ast
import re
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import yaml

from ratslam_ros import __version__
from ratslam_ros.live import entry
from ratslam_ros.live.run import NODES, VIEWER_PACKAGES

ROOT = Path(__file__).resolve().parents[1]
SETUP = (ROOT / 'setup.py').read_text('utf-8')
PACKAGE = ET.parse(ROOT / 'package.xml').getroot()
LICENCE = 'Apache-2.0'

# Name for rosdep by name on the Python package index; None: not in the distribution.
ROSDEP = {
    'cyclonedds': None,
    'lz4': None,
    'matplotlib': 'python3-matplotlib',
    'mcap': None,
    'msgspec': None,
    'numba': 'python3-numba',
    'numpy': 'python3-numpy',
    'opencv-python-headless': 'python3-opencv',
    'pyyaml': 'python3-yaml',
    'rosbags': None,
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'zstandard': None,
}


def sources() -> list[Path]:
    """Return all files that must start with copyright and licence."""
    folders = (
        'ratslam_ros', 'ratslam_simulator', 'ratslam_tuning', 'rclpy_standin', 'test',
        'benchmarks', 'launch',
        'examples',
    )
    code = [path for folder in folders for path in (ROOT / folder).rglob('*.py')]
    others = ('setup.py', 'setup.cfg', 'pyproject.toml', 'Makefile', '.gitignore', 'CITATION.cff')
    scripts = [path for path in (ROOT / '.ci').iterdir() if path.is_file()]
    return code + scripts + [ROOT / name for name in others]


def test_version_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text('utf-8'))
    changes = (ROOT / 'CHANGELOG.rst').read_text('utf-8')
    assert re.fullmatch(r'\d+\.\d+\.\d+', __version__)
    assert PACKAGE.findtext('version') == __version__
    assert citation['version'] == __version__
    assert re.findall(r'^(\d+\.\d+\.\d+)\b.*\n-+$', changes, re.MULTILINE)[0] == __version__
    assert __version__ not in SETUP  # setup.py reads it from the package.


def test_licence_is_the_same_everywhere():
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text('utf-8'))
    assert [element.text for element in PACKAGE.findall('license')] == [LICENCE]
    assert citation['license'] == LICENCE
    assert f"license='{LICENCE}'" in SETUP
    text = (ROOT / 'LICENSE').read_text('utf-8')
    assert 'Apache License' in text and 'Version 2.0, January 2004' in text


def test_sources_begin_with_copyright_and_licence():
    for path in sources():
        text = path.read_text('utf-8')
        lines = [line for line in text.splitlines() if not line.startswith('#!')]
        assert lines[:2] == [
            '# Copyright 2026 the ratslam_ros authors', f'# SPDX-License-Identifier: {LICENCE}'
        ], path


def test_colcon_recognises_an_ament_python_package():
    assert PACKAGE.attrib['format'] == '3'
    assert PACKAGE.findtext('name') == 'ratslam_ros'
    assert PACKAGE.findtext('export/build_type') == 'ament_python'
    # If catkin_pkg rejects an address, colcon builds a plain Python package.
    for maintainer in PACKAGE.findall('maintainer'):
        assert re.fullmatch(r'[\w%+.-]+@[a-zA-Z0-9.-]+\.[a-zA-Z]{2,}', maintainer.attrib['email'])
    assert (ROOT / 'resource' / 'ratslam_ros').is_file()


def test_package_xml_and_setup_py_have_same_dependencies():
    block = SETUP[SETUP.index('install_requires=[') : SETUP.index('extras_require')]
    required = set(re.findall(r"'([\w-]+)[><=]", block))
    assert required == set(ROSDEP)
    known = {element.text for element in PACKAGE.iter('exec_depend')}
    assert {name for name in known if name.startswith('python3-')} == set(ROSDEP.values()) - {None}
    comment = (ROOT / 'package.xml').read_text('utf-8')
    for name, key in ROSDEP.items():
        assert key is not None or re.search(rf'\b{name}\b', comment), f'{name}: say how to get it'


def ros_imports() -> set[str]:
    """Return the ROS packages that the code imports."""
    folders = ('ratslam_ros/ros', 'ratslam_ros/live', 'launch')
    found = set()
    for path in [path for folder in folders for path in (ROOT / folder).rglob('*.py')]:
        for node in ast.walk(ast.parse(path.read_text('utf-8'))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            found |= {name.split('.')[0] for name in names}
    ours = {'ratslam_ros', 'ratslam_simulator', 'ratslam_tuning', 'rclpy_standin'}
    return found - ours - {'msgspec', 'numpy', 'yaml', 'tqdm', *sys.stdlib_module_names}


def test_package_xml_lists_all_imported_ros_packages():
    known = {element.text for element in PACKAGE.iter('exec_depend')}
    optional = {'nav2_msgs'}  # explained in a comment of package.xml
    assert {name for name in known if not name.startswith('python3-')} == ros_imports() - optional
    assert all(name in (ROOT / 'package.xml').read_text('utf-8') for name in optional)


def test_linux_on_arm_installs_without_cyclonedds():
    """It has no wheels there; only live commands without ROS need it."""
    marker = re.search(r"'cyclonedds[^;]*; ([^']*)'", SETUP)
    assert marker is not None
    fits = compile(marker[1], 'setup.py', 'eval')
    for machine, system, wanted in (
        ('x86_64', 'linux', True), ('aarch64', 'linux', False), ('armv7l', 'linux', False),
        ('arm64', 'darwin', True), ('AMD64', 'win32', True),
    ):
        assert eval(fits, {'platform_machine': machine, 'sys_platform': system}) == wanted


def test_all_files_for_ros_are_installed():
    for folder, ending in (
        ('config', '*.yaml'), ('launch', '*.launch.py'), ('rviz', '*.rviz'),
        ('foxglove', '*.json'),
    ):
        assert f"installed('{folder}', '{ending}')" in SETUP
        assert {path for path in (ROOT / folder).iterdir() if path.is_file()} == set(
            (ROOT / folder).glob(ending)
        )


def test_every_node_has_an_entry_point():
    block = SETUP[SETUP.index('NODES = ') :].partition(']')[0]
    assert re.findall(r"'(\w+)'", block) == list(NODES)
    for node in NODES:
        assert callable(getattr(entry, node))


def test_advice_names_packages_of_the_viewer_as_setup_does():
    for package in VIEWER_PACKAGES.values():
        assert f"'{package}'" in SETUP


def test_oldest_numpy_is_that_of_jazzy():
    assert "'numpy>=1.26'" in SETUP
    assert "python_requires='>=3.11'" in SETUP
