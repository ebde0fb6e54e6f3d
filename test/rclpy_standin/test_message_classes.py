# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Message classes, serialisation, and conversion to YAML."""
import array

import numpy as np
import pytest
import yaml
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseArray, PoseStamped, PoseWithCovariance, TransformStamped
from nav_msgs.msg import Odometry, Path
from nav_msgs.srv import GetPlan
from rcl_interfaces.msg import IntegerRange, ParameterDescriptor, ParameterValue
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_runtime_py import message_to_yaml, set_message_fields
from sensor_msgs.msg import CameraInfo, Image, LaserScan, NavSatStatus, PointField
from std_msgs.msg import Header, String
from std_srvs.srv import Empty, SetBool
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker


def test_message_fields_have_ros_defaults() -> None:
    odometry = Odometry()
    assert odometry.header.stamp.sec == 0 and odometry.header.frame_id == ''
    assert odometry.pose.pose.orientation.w == 1.0 and odometry.pose.pose.position.x == 0.0
    assert len(odometry.pose.covariance) == 36 and odometry.child_frame_id == ''
    image = Image()
    assert len(image.data) == 0 and image.is_bigendian == 0
    assert GetPlan.Response().plan.poses == []

    assert NavSatStatus().status == -2


def test_messages_with_equal_fields_are_equal() -> None:
    header = Header(frame_id='map')
    header.stamp.sec = 5
    pose = PoseStamped(header=header)
    pose.pose.position = Point(x=1.0, y=2.0, z=3.0)
    other = PoseStamped()
    assert pose != other and pose != 'pose'
    other.header.frame_id, other.header.stamp.sec = 'map', 5
    other.pose.position.x, other.pose.position.y, other.pose.position.z = 1.0, 2.0, 3.0
    assert pose == other
    assert 'frame_id=' in repr(pose) and repr(pose).startswith('geometry_msgs.msg.PoseStamped(')
    assert Image(data=array.array('B', b'ab')) == Image(data=array.array('B', b'ab'))
    assert Image(data=array.array('B', b'ab')) != Image(data=array.array('B', b'ac'))
    assert Header() is not Header() and Header().stamp is not Header().stamp


def test_setting_unknown_field_raises_attribute_error() -> None:
    with pytest.raises(AttributeError):
        String().dta = 'x'


def test_constants_and_byte_fields_survive_serialisation() -> None:
    assert (Marker.LINE_LIST, Marker.ADD) == (5, 0)
    assert DiagnosticStatus.WARN == b'\x01' and DiagnosticStatus().level == b'\x00'
    status = DiagnosticStatus(level=DiagnosticStatus.STALE, name='x')
    assert deserialize_message(serialize_message(status), DiagnosticStatus) == status


def test_message_classes_report_idl_field_types() -> None:
    assert Image.get_fields_and_field_types() == {
        'header': 'std_msgs/Header', 'height': 'uint32', 'width': 'uint32', 'encoding': 'string',
        'is_bigendian': 'uint8', 'step': 'uint32', 'data': 'sequence<uint8>',
    }
    assert Odometry().get_fields_and_field_types()['pose'] == 'geometry_msgs/PoseWithCovariance'

    assert PoseArray.get_fields_and_field_types()['poses'] == 'sequence<geometry_msgs/Pose>'
    assert PoseWithCovariance.get_fields_and_field_types()['covariance'] == 'double[36]'
    assert IntegerRange.get_fields_and_field_types()['step'] == 'uint64'
    assert ParameterDescriptor.get_fields_and_field_types()['integer_range'] == (
        'sequence<rcl_interfaces/IntegerRange, 1>'
    )
    assert SetBool.Request.get_fields_and_field_types() == {'data': 'boolean'}
    assert Empty.Request.get_fields_and_field_types() == {}


@pytest.mark.parametrize(
    'data',
    [b'\x01\x02\x03', array.array('B', [1, 2, 3]), np.array([1, 2, 3], np.uint8), [1, 2, 3]],
    ids=lambda data: type(data).__name__,
)
def test_uint8_sequence_accepts_bytes_arrays_and_lists(data) -> None:
    message = deserialize_message(serialize_message(Image(data=data)), Image)
    assert bytes(message.data) == b'\x01\x02\x03'
    assert np.frombuffer(message.data, np.uint8).tolist() == [1, 2, 3]
    image = Image()
    image.data = data
    assert image.data == message.data == array.array('B', [1, 2, 3])
    with pytest.raises((TypeError, OverflowError)):
        image.data = [1, 300]


def test_every_field_kind_survives_serialisation() -> None:
    value = ParameterValue(
        type=3, bool_value=True, integer_value=-(2**63), double_value=0.1, string_value='ü€',
        byte_array_value=[b'\x01', b'\xff'], bool_array_value=[True, False],
        integer_array_value=[1, -2], double_array_value=[0.5], string_array_value=['', 'ß'],
    )
    info = CameraInfo(height=2, d=[0.1, 0.2], k=np.arange(9.0), distortion_model='plumb_bob')
    scan = LaserScan(ranges=[0.5, float('inf')], angle_min=-1.5)
    transforms = TFMessage()
    for name in 'ab':
        transforms.transforms.append(TransformStamped(child_frame_id=name))
    for message in (value, info, scan, transforms, PointField(count=3)):
        copy = deserialize_message(serialize_message(message), type(message))
        assert copy == message
    decoded = deserialize_message(serialize_message(value), ParameterValue)
    assert list(decoded.byte_array_value) == [b'\x01', b'\xff']
    assert list(decoded.string_array_value) == ['', 'ß']


def test_messages_convert_to_yaml_and_back() -> None:
    odometry = Odometry(child_frame_id='base ü')
    odometry.header.stamp.sec, odometry.pose.pose.position.x = 4, 2.5
    odometry.pose.covariance[3] = 0.5
    text = message_to_yaml(odometry)
    assert 'base ü' in text and text.startswith('header:\n  stamp:\n    sec: 4\n')
    restored = Odometry()
    set_message_fields(restored, yaml.safe_load(text))
    assert restored == odometry
    tree = yaml.safe_load(text)
    assert list(tree) == ['header', 'child_frame_id', 'pose', 'twist']
    assert tree['pose']['pose']['position']['x'] == 2.5
    plan = GetPlan.Request()
    set_message_fields(plan, {'goal': {'pose': {'position': {'x': 1, 'y': 2.0}}}, 'tolerance': 1})
    assert plan.goal.pose.position == Point(x=1.0, y=2.0) and plan.tolerance == 1.0
    assert isinstance(plan.goal.pose.position.x, float)
    with pytest.raises(AttributeError):
        set_message_fields(plan, {'unknown': {}})
    with pytest.raises((TypeError, ValueError)):
        set_message_fields(plan, {'tolerance': 'far'})


def test_stamps_given_as_auto_or_now_have_setters() -> None:
    odometry, pose = Odometry(), PoseStamped()
    for message, values in ((odometry, 'auto'), (pose, {'stamp': 'now', 'frame_id': 'a'})):
        (set_stamp,) = set_message_fields(message, {'header': values}, True, True)
        assert message.header.stamp == Time()
        set_stamp(Time(sec=3))
        assert message.header.stamp == Time(sec=3)
    with pytest.raises(TypeError, match='auto'):
        set_message_fields(odometry, {'header': 'auto'})


def test_yaml_output_truncates_long_values() -> None:
    image = Image(data=bytes(1000), encoding='x' * 50)
    short = message_to_yaml(image, truncate_length=8)
    assert 'xxxxxxxx...' in short and short.count('- 0') == 8


def test_message_lists_are_set_from_plain_values() -> None:
    path = Path()
    set_message_fields(path, {'poses': [{'header': {'frame_id': 'a'}}, {}]})
    assert [pose.header.frame_id for pose in path.poses] == ['a', '']
