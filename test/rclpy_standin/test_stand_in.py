# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Behaviour specific to the stand-in: installation, unsupported features, encoding."""
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contract import IS_STAND_IN, ROOT
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.srv import GetPlan
from sensor_msgs.msg import Image
from std_msgs.msg import String

pytestmark = pytest.mark.skipif(not IS_STAND_IN, reason='the real rclpy is installed')


def run_python(code: str, path: Path | None = None) -> str:
    run = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        check=False,
        env={'PYTHONPATH': f'{path}:{ROOT}' if path else str(ROOT)},
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


def test_install_with_real_rclpy_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / 'rclpy.py').write_text('NAME = "real"\n', encoding='utf-8')
    code = (
        'from rclpy_standin import install\n'
        'import sys\n'
        'before = list(sys.meta_path)\n'
        'print(install(), sys.meta_path == before)\n'
        'import rclpy\n'
        'print(rclpy.NAME, "cyclonedds" in sys.modules)\n'
    )
    assert run_python(code, tmp_path) == 'False True\nreal False'


def test_install_without_rclpy_adds_finder_once() -> None:
    code = (
        'from rclpy_standin import install\n'
        'import sys\n'
        'try:\n'
        '    import rclpy\n'
        'except ImportError:\n'
        '    print("none")\n'
        'print(install(), install())\n'
        'import rclpy, rclpy.node\n'
        'print(sum("rclpy_standin" in type(f).__module__ for f in sys.meta_path))\n'
    )
    assert run_python(code) == 'none\nTrue True\n1'


def test_install_without_cyclonedds_reports_requirements() -> None:
    code = (
        'import sys\n'
        'sys.modules["cyclonedds"] = None\n'
        'from rclpy_standin import StandaloneUnavailable, install\n'
        'try:\n'
        '    install()\n'
        'except StandaloneUnavailable as error:\n'
        '    print(error)\n'
    )
    message = run_python(code)
    assert 'ROS 2' in message and 'cyclonedds' in message and 'aarch64' in message


@pytest.mark.parametrize(
    'name', ['rclpy.action', 'rclpy.lifecycle', 'rclpy.wait_for_message', 'rosidl_runtime_py.get']
)
def test_importing_unsupported_module_raises(name: str) -> None:
    with pytest.raises(NotImplementedError, match=re.escape(name)) as error:
        __import__(name)
    assert isinstance(error.value, ImportError)


def test_accessing_unknown_names_raises() -> None:
    import rclpy
    import std_msgs.msg

    with pytest.raises(AttributeError, match='spin_forever'):
        _ = rclpy.spin_forever
    with pytest.raises(AttributeError, match='Nothing'):
        _ = std_msgs.msg.Nothing
    assert 'String' in dir(std_msgs.msg)
    with pytest.raises(ImportError):
        from std_msgs.msg import Nothing  # noqa: F401
    with pytest.raises(ModuleNotFoundError):
        import std_msgs.action


def test_unsupported_qos_settings_are_rejected() -> None:
    from rclpy.duration import Duration
    from rclpy.qos import QoSProfile

    for name in 'deadline', 'lifespan':
        with pytest.raises(NotImplementedError, match=name):
            QoSProfile(depth=1, **{name: Duration(seconds=1)})


def test_coroutine_callbacks_are_rejected(ros) -> None:
    async def callback(msg) -> None: ...

    with pytest.raises(NotImplementedError):
        ros.node().create_subscription(String, 'chat', callback, 1)


@pytest.mark.parametrize(
    ('make', 'message'),
    [
        (lambda: String(data=3), 'std_msgs/msg/String.data: expected string, not int 3'),
        (lambda: Point(x=1), r'Point.x: expected double, not int 1'),
        (lambda: Image(height=-1), r'Image.height: expected uint32'),
        (lambda: Image(data='text'), r'Image.data: expected sequence<uint8>'),
        (lambda: Image(data=np.zeros(3)), r'Image.data: expected sequence<uint8>'),
        (
            lambda: PoseStamped(pose=Point()),
            r'PoseStamped.pose: expected geometry_msgs/Pose',
        ),
        (lambda: GetPlan.Response(plan=None) and path_of_points(), r'Path.poses'),
    ],
)
def test_serialising_invalid_field_raises_type_error(make, message) -> None:
    from rclpy.serialization import serialize_message

    with pytest.raises(TypeError, match=message):
        serialize_message(make())
    assert serialize_message(Point(x=np.float64(1.0))) and serialize_message(
        Image(height=np.int64(3))
    )


def path_of_points():
    from nav_msgs.msg import Path

    return Path(poses=[Point()])


def test_every_known_type_survives_encoding() -> None:
    from rclpy_standin import definitions, types

    type_count = 0
    for package in definitions.packages():
        for name in definitions.names_in(package, 'msg'):
            kind = types.message_class(f'{package}/msg/{name}')
            assert types.decode(types.encode(kind()), kind) == kind()
            assert definitions.type_hash(f'{package}/msg/{name}').startswith('RIHS01_')
            type_count += 1
        for name in definitions.names_in(package, 'srv'):
            kind = types.service_class(f'{package}/srv/{name}')
            assert (
                types.decode(types.encode(kind.Request(), 16), kind.Request, 16) == kind.Request()
            )
    assert type_count > 150


def test_decoding_invalid_bytes_raises_value_error() -> None:
    from rclpy_standin import types

    kind = types.message_class('std_msgs/msg/String')
    valid = bytes(types.encode(kind(data='hello')))
    for data in (b'', b'\0\1', valid[:8], b'\7\7\7\7' + valid[4:], valid[:4] + b'\xff' * 8):
        with pytest.raises(ValueError):
            types.decode(data, kind)


def test_invalid_samples_are_logged_when_their_number_has_doubled(ros, capfd) -> None:
    node, received = ros.node(), []
    node.create_subscription(String, 'chat', lambda msg: received.append(msg.data), 200)
    publisher = node.create_publisher(String, 'chat', 200)
    ros.until(lambda: publisher.get_subscription_count())
    for _ in range(100):
        publisher.publish(b'\0\1\0\0\3\0\0\0\xff\xfe\0\0')
    publisher.publish(String(data='valid'))
    ros.until(lambda: received)
    lines = capfd.readouterr().err.splitlines()
    assert [line for line in lines if 'not a valid' in line] == lines
    assert len(lines) == 7


def test_event_of_a_destroyed_subscription_is_dropped(ros) -> None:
    """It was queued before a timer destroyed the subscription."""
    node = ros.node()
    subscription = node.create_subscription(String, 'chat', print, 10)
    runs = [waitable.run for waitable in subscription.waitables()]
    node.destroy_subscription(subscription)
    assert not any([run() for run in runs])
