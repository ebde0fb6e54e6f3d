# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What only the stand-in does: keeping out of the way, and saying what it does not offer."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from contract import IS_STAND_IN, ROOT

pytestmark = pytest.mark.skipif(not IS_STAND_IN, reason='the real rclpy is installed')


def python(code: str, path: Path | None = None) -> str:
    run = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        check=False,
        env={'PYTHONPATH': f'{path}:{ROOT}' if path else str(ROOT)},
    )
    assert run.returncode == 0, run.stderr
    return run.stdout.strip()


def test_a_real_rclpy_is_never_shadowed(tmp_path: Path) -> None:
    (tmp_path / 'rclpy.py').write_text('NAME = "real"\n', encoding='utf-8')
    code = (
        'from ratslam_ros.standalone import install\n'
        'import sys\n'
        'before = list(sys.meta_path)\n'
        'print(install(), sys.meta_path == before)\n'
        'import rclpy\n'
        'print(rclpy.NAME, "cyclonedds" in sys.modules)\n'
    )
    assert python(code, tmp_path) == 'False True\nreal False'


def test_without_rclpy_the_stand_in_is_used_from_then_on() -> None:
    code = (
        'from ratslam_ros.standalone import install\n'
        'import sys\n'
        'try:\n'
        '    import rclpy\n'
        'except ImportError:\n'
        '    print("none")\n'
        'print(install(), install())\n'
        'import rclpy, rclpy.node\n'
        'print(sum("ratslam" in type(f).__module__ for f in sys.meta_path))\n'
    )
    assert python(code) == 'none\nTrue True\n1'


def test_without_cyclonedds_it_says_what_is_needed() -> None:
    code = (
        'import sys\n'
        'sys.modules["cyclonedds"] = None\n'
        'from ratslam_ros.standalone import StandaloneUnavailable, install\n'
        'try:\n'
        '    install()\n'
        'except StandaloneUnavailable as error:\n'
        '    print(error)\n'
    )
    told = python(code)
    assert 'ROS 2' in told and 'cyclonedds' in told and 'aarch64' in told


@pytest.mark.parametrize(
    'name', ['rclpy.action', 'rclpy.lifecycle', 'rclpy.wait_for_message', 'rosidl_runtime_py.get']
)
def test_modules_that_are_not_offered_say_so(name: str) -> None:
    with pytest.raises(NotImplementedError, match=re.escape(name)) as error:
        __import__(name)
    assert isinstance(error.value, ImportError)


def test_names_that_are_not_offered_say_so() -> None:
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


def test_several_threads_are_not_offered(ros) -> None:
    from rclpy.executors import MultiThreadedExecutor

    with pytest.raises(NotImplementedError, match='SingleThreadedExecutor'):
        MultiThreadedExecutor()


def test_qualities_of_service_that_are_not_offered_say_so(ros, m) -> None:
    from rclpy.duration import Duration
    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.qos import LivelinessPolicy, QoSProfile, ReliabilityPolicy

    node = ros.node()
    for options in (
        {'deadline': Duration(seconds=1)},
        {'lifespan': Duration(seconds=1)},
        {'liveliness': LivelinessPolicy.MANUAL_BY_TOPIC},
        {'reliability': ReliabilityPolicy.BEST_AVAILABLE},
    ):
        with pytest.raises(NotImplementedError):
            node.create_publisher(m.String, 'chat', QoSProfile(depth=1, **options))
    with pytest.raises(NotImplementedError, match='deadline'):
        SubscriptionEventCallbacks(deadline=print)


def test_coroutines_are_not_offered(ros, m) -> None:
    async def callback(msg) -> None: ...

    with pytest.raises(NotImplementedError):
        ros.node().create_subscription(m.String, 'chat', callback, 1)


@pytest.mark.parametrize(
    ('make', 'told'),
    [
        (lambda m: m.String(data=3), 'std_msgs/msg/String.data: expected string, not int 3'),
        (lambda m: m.Point(x=1), r'Point.x: expected double, not int 1'),
        (lambda m: m.Image(height=-1), r'Image.height: expected uint32'),
        (lambda m: m.Image(data='text'), r'Image.data: expected sequence<uint8>'),
        (lambda m: m.Image(data=np.zeros(3)), r'Image.data: expected sequence<uint8>'),
        (
            lambda m: m.PoseStamped(pose=m.Point()),
            r'PoseStamped.pose: expected geometry_msgs/Pose',
        ),
        (lambda m: m.GetPlan.Response(plan=None) and wrong_list(m), r'Path.poses'),
    ],
)
def test_what_does_not_fit_is_told_before_it_is_sent(m, make, told) -> None:
    from rclpy.serialization import serialize_message

    with pytest.raises(TypeError, match=told):
        serialize_message(make(m))
    assert serialize_message(m.Point(x=np.float64(1.0))) and serialize_message(
        m.Image(height=np.int64(3))
    )


def wrong_list(m):
    from nav_msgs.msg import Path

    return Path(poses=[m.Point()])


def test_every_message_that_is_known_can_be_sent() -> None:
    from ratslam_ros.standalone import definitions, types

    number = 0
    for package in definitions.packages():
        for name in definitions.names_in(package, 'msg'):
            kind = types.message_class(f'{package}/msg/{name}')
            assert types.decode(types.encode(kind()), kind) == kind()
            assert definitions.type_hash(f'{package}/msg/{name}').startswith('RIHS01_')
            number += 1
        for name in definitions.names_in(package, 'srv'):
            kind = types.service_class(f'{package}/srv/{name}')
            assert (
                types.decode(types.encode(kind.Request(), 16), kind.Request, 16) == kind.Request()
            )
    assert number > 150


def test_what_is_no_message_is_refused() -> None:
    from ratslam_ros.standalone import types

    kind = types.message_class('std_msgs/msg/String')
    good = bytes(types.encode(kind(data='hello')))
    for data in (b'', b'\0\1', good[:8], b'\7\7\7\7' + good[4:], good[:4] + b'\xff' * 8):
        with pytest.raises(ValueError):
            types.decode(data, kind)
