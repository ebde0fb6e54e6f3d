# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""``play``, ``echo``, ``call`` and ``pub`` in processes that communicate over DDS."""

import signal
from pathlib import Path

import numpy as np
import pytest
from helpers import (
    ODOM_TOPIC,
    PERIOD_NS,
    START_NS,
    TEMPLATE_TOPIC,
    circles,
    image_message,
    odometry_message,
    string_message,
    template_text,
    write_bag,
)
from processes import TIMEOUT_S, Commands

from ratslam_ros.core.common.pose import Pose
from ratslam_ros.errors import UnusableInput

TEMPLATES = 40
SERVER = """
import rclpy
from std_srvs.srv import SetBool
from std_msgs.msg import String
from ratslam_ros.ros.qos import LATCHED
rclpy.init()
node = rclpy.create_node('server')
def answer(request, response):
    response.success, response.message = request.data, 'heard'
    return response
node.create_service(SetBool, 'robot/switch', answer)
publisher = node.create_publisher(String, 'kept', LATCHED)
publisher.publish(String(data='{"kept": "ö"}'))
print('ready', flush=True)
rclpy.spin(node)
"""


@pytest.fixture(scope='module')
def templates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of templates and odometry, 4 s long."""
    messages = []
    for i in range(TEMPLATES):
        stamp_ns = START_NS + i * PERIOD_NS
        odometry = odometry_message(stamp_ns, 1.0, 0.1, Pose(0.0, 0.0, 0.0))
        messages.append((stamp_ns, ODOM_TOPIC, 'odometry', odometry))
        text = string_message(template_text(stamp_ns, i))
        messages.append((stamp_ns + 1000, TEMPLATE_TOPIC, 'string', text))
    return write_bag(tmp_path_factory.mktemp('recordings') / 'templates', messages)


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp('recordings') / 'circles', circles(1, 20))


def test_played_messages_arrive_complete_and_in_order(commands: Commands, templates: Path) -> None:
    listener = commands.start(
        'echo', 'local_view/template', 'std_msgs/msg/String', '--field', 'data', '--timeout', '8'
    )
    moved = commands.start('echo', 'odom', 'nav_msgs/msg/Odometry', '--once')
    code, out, err = commands.run('play', str(templates), '--rate', '10')
    assert code == 0, err
    assert f'{TEMPLATES} templates and {TEMPLATES} odometry messages over 3.9 s' in out
    listener.send_signal(signal.SIGINT)
    lines = listener.communicate(timeout=20)[0].splitlines()
    assert lines == [template_text(START_NS + i * PERIOD_NS, i) for i in range(TEMPLATES)]
    assert listener.returncode == 130
    shown = moved.communicate(timeout=20)[0]
    assert 'frame_id: odom' in shown and 'child_frame_id: base_link' in shown
    assert shown.endswith('---\n') and moved.returncode == 0


def test_clock_advances_between_messages(commands: Commands, tmp_path: Path) -> None:
    stamps = [START_NS, START_NS + 2 * 10**9]
    sparse = write_bag(
        tmp_path / 'sparse',
        [(s, '/image', 'image', image_message(s, np.zeros((4, 4), np.uint8))) for s in stamps],
    )
    clock = commands.start('echo', '/clock', 'rosgraph_msgs/msg/Clock', '--field', 'clock')
    images = commands.start('echo', 'image', 'sensor_msgs/msg/Image', '--field', 'header.stamp')
    code, _, err = commands.run('play', str(sparse), '--clock', '--rate', '1')
    assert code == 0, err
    for process in (clock, images):
        process.send_signal(signal.SIGINT)
    words = clock.communicate(timeout=20)[0].split()
    numbers = [int(word) for word in words if word.isdecimal()]
    times_ns = [sec * 10**9 + ns for sec, ns in zip(numbers[::2], numbers[1::2], strict=True)]
    assert times_ns == sorted(times_ns)
    assert times_ns[0] >= START_NS and times_ns[-1] == stamps[-1]
    # 100 are sent; a subscriber that stands still receives only the newest one.
    assert sum(stamps[0] < time_ns < stamps[1] for time_ns in times_ns) >= 10
    assert images.communicate(timeout=20)[0].count('sec: 17000000') == 2


def test_play_without_subscribers_is_reported(here, bag: Path) -> None:
    code, out, err = here('play', str(bag), '--wait', '0.5')
    assert (code, out) == (2, '')
    assert any(f'no node subscribes to {names}:' in err for names in (
        '/image or /odom', '/odom or /image'
    ))


# The name of a node may arrive after its subscriptions, as it does here on the stand-in.
def test_play_without_odometry_names_visual_odometry(commands: Commands, here, bag: Path) -> None:
    commands.start_python(
        'import sys, threading, rclpy\n'
        'from sensor_msgs.msg import Image\n'
        'rclpy.init()\n'
        'graph = sys.modules.get("rclpy_standin.graph")\n'
        'if graph is not None:\n'
        '    publish = graph.Graph._publish\n'
        '    graph.Graph._publish = lambda self: threading.Timer(1.0, publish, [self]).start()\n'
        'node = rclpy.create_node("local_view")\n'
        'node.create_subscription(Image, "image", lambda message: None, 10)\n'
        'print("ready", flush=True)\n'
        'rclpy.spin(node)\n'
    )
    words = ['play', str(bag), '--visual-odometry', '--wait', '2', '--rate', '10']
    code, _, err = here(*words)
    assert code == 0 and 'started with "ratslam launch --odometry camera"' in err
    assert 'going on without' in err and 'a publisher of /odom' in err


def test_lockstep_without_pose_cells_is_reported(commands: Commands, here, bag: Path) -> None:
    commands.start_python(
        'import rclpy\n'
        'from nav_msgs.msg import Odometry\n'
        'rclpy.init()\n'
        'node = rclpy.create_node("listener")\n'
        'node.create_subscription(Odometry, "odom", lambda message: None, 10)\n'
        'print("ready", flush=True)\n'
        'rclpy.spin(node)\n'
    )
    code, _, err = here('play', str(bag), '--lockstep', '--wait', '2', '--quiet')
    assert code == 2 and '/pose_cells/action' in err.splitlines()[-1]


def test_interrupt_ends_playback_at_once(commands: Commands, bag: Path) -> None:
    player = commands.start('play', str(bag), '--wait', '0', '--rate', '0.01', '--clock')
    code, _, err = commands.run('echo', '/clock', 'rosgraph_msgs/msg/Clock', '--once')
    assert code == 0, err  # playback has started
    player.send_signal(signal.SIGINT)
    _, err = player.communicate(timeout=20)
    assert player.returncode == 130
    assert 'Traceback' not in err and err.rstrip().endswith('ratslam: interrupted')


@pytest.mark.parametrize(
    ('words', 'part'),
    [
        (['--rate', '-1'], '--rate -1'),
        (['--rate', 'nan'], '--rate nan'),
        (['--wait', '-1'], '--wait -1'),
        (['--start', '1e6', '--wait', '0'], 'the start at 1e+06 s'),
        (['--image-topic', '/odom'], '--image-topic /odom'),
    ],
)
def test_invalid_play_option_is_reported_in_one_line(here, bag: Path, words, part) -> None:
    code, out, err = here('play', str(bag), '--quiet', *words)
    assert (code, out) == (2, '')
    assert err.startswith('ratslam: ') and err.count('\n') == 1 and part in err


def test_invalid_ros_arguments_are_reported_in_one_line(here, bag: Path) -> None:
    code, _, err = here('play', str(bag), '--quiet', '--ros-args', '-r', 'nonsense')
    assert code == 2 and 'Traceback' not in err  # rclpy logs another line.
    assert err.splitlines()[-1].startswith('ratslam: --ros-args -r nonsense: ')


def test_services_are_called_and_latched_topics_echoed(commands: Commands, here) -> None:
    commands.start_python(SERVER)
    kind = 'std_srvs/srv/SetBool'
    assert here('call', 'robot/switch', kind, '{data: true}') == (
        0, 'success: true\nmessage: heard\n', '',
    )
    assert here('call', 'switch', kind, '--ros-args', '-r', '__ns:=/robot')[:2] == (
        0, 'success: false\nmessage: heard\n',
    )
    # In a process of its own, to compare the bytes of the output.
    assert commands.run('echo', 'kept', '--once', '--field', 'data') == (
        0, '{"kept": "ö"}\n', '',
    )
    code, _, err = here('call', 'robot/swich', kind, '--timeout', '0.5')
    assert code == 2 and 'no node offers /robot/swich' in err and '/robot/switch' in err
    code, _, err = here('call', 'robot/switch', 'std_srvs/srv/Trigger', '--timeout', '0.5')
    assert code == 2 and kind in err
    code, _, err = here('echo', 'kept', '--field', 'dat', '--once')
    assert code == 2 and "'dat'" in err and 'data' in err
    code, _, err = here('echo', 'kept', 'sensor_msgs/msg/Image', '--timeout', '2')
    assert code == 2 and 'std_msgs/msg/String' in err
    code, _, err = here('pub', 'kept', 'sensor_msgs/msg/Image', '--once', '--timeout', '9')
    assert code == 2 and 'of type std_msgs/msg/String, not sensor_msgs/msg/Image' in err


def test_pub_waits_for_subscriber_and_sets_stamps(commands: Commands, here) -> None:
    pub = commands.start(
        'pub', 'pose', 'geometry_msgs/msg/PoseStamped', '{header: {stamp: now, frame_id: map}}',
        '--times', '2', '--rate', '50',
    )
    listener = commands.start(
        'echo', 'pose', 'geometry_msgs/msg/PoseStamped', '--field', 'header', '--timeout', '2'
    )
    out, err = pub.communicate(timeout=TIMEOUT_S)
    assert pub.returncode == 0 and out.count('publishing #') == 2, err
    words = listener.communicate(timeout=TIMEOUT_S)[0].split()
    assert words.count('map') == 2
    first_s, second_s = (int(words[i + 1]) for i, word in enumerate(words) if word == 'sec:')
    assert START_NS // 10**9 < first_s <= second_s
    code, _, err = here('pub', 'x', 'std_msgs/msg/String', '--once', '--timeout', '0.1')
    assert code == 1 and 'no node has subscribed to /x' in err


def test_echo_without_messages_returns_no_answer(here) -> None:
    code, _, err = here('echo', 'nothing', 'std_msgs/msg/String', '--timeout', '0.3')
    assert code == 1 and '/nothing' in err
    code, _, err = here('echo', 'nothing', '--timeout', '0.3')
    assert code == 2 and '/nothing does not exist' in err


@pytest.mark.parametrize(
    ('words', 'part'),
    [
        (['call', 'x', 'std_srvs/srv/Nothing'], 'std_srvs/srv/Nothing'),
        (['call', 'x', 'nonsense'], 'nonsense'),
        (['call', 'x', 'std_srvs/srv/SetBool', '{date: true}'], 'data'),
        (['call', 'x', 'nav_msgs/srv/GetPlan', '{tolerance: wide}'], 'wide'),
        (['call', 'x', 'std_srvs/srv/SetBool', '{data: '], 'YAML'),
        (['call', 'x', 'std_srvs/srv/SetBool', 'true'], 'expected fields'),
        (['echo', 'x', 'std_msgs/msg/Nothing'], 'std_msgs/msg/Nothing'),
        (['echo', 'x', 'nonsense'], 'nonsense'),
        (['pub', 'x', 'std_msgs/msg/Nothing'], 'std_msgs/msg/Nothing'),
        (['pub', 'x', 'std_msgs/msg/String', '{date: a}'], 'data'),
        (['pub', 'x', 'std_msgs/msg/String', '--rate', '0'], '--rate: 0'),
        (['pub', 'x', 'std_msgs/msg/String', '--times', '0'], '--times: 0'),
    ],
)
def test_invalid_call_echo_or_pub_is_reported_in_one_line(here, words, part) -> None:
    code, out, err = here(*words)
    assert (code, out) == (2, '')
    assert err.startswith('ratslam: ') and err.count('\n') == 1 and part in err


class Slow:
    """Publisher whose middleware refuses some messages before it accepts one."""

    topic_name = '/image'

    def __init__(self, refusals: int) -> None:
        self.refusals = refusals
        self.sent: list[str] = []

    def publish(self, message: str) -> None:
        if self.refusals:
            self.refusals -= 1
            raise RuntimeError('Failed to publish')
        self.sent.append(message)


@pytest.mark.usefixtures('ros')
def test_message_refused_by_middleware_is_repeated() -> None:
    from ratslam_ros.live.ros import send

    slow = Slow(5)
    send(slow, 'a')
    assert slow.sent == ['a']
    with pytest.raises(UnusableInput, match='/image: publishing failed'):
        send(Slow(10**9), 'a', timeout_s=0.05)
