# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters: files, command lines, ranges, callbacks and parameter services."""

from pathlib import Path

import pytest
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    ParameterEvent,
    ParameterValue,
    SetParametersResult,
)
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
)
from rclpy.parameter import Parameter


def test_overrides_from_files_and_command_line_are_merged(make_ros, tmp_path: Path) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(
        """
/**:
  ros__parameters: {everywhere: 1, last: a}
/**/robot_node:
  ros__parameters: {wild: true}
/robot/robot_node:
  ros__parameters:
    nested: {deep: {er: 2.5}}
    list: [1, 2, 3]
    words: ['a', 'b c']
/robot/other:
  ros__parameters: {wrong: 1}
/robot:
  robot_node:
    ros__parameters: {below: 'x'}
""",
        encoding='utf-8',
    )
    ros = make_ros(
        'prog', '--ros-args', '--params-file', str(path), '-p', 'last:=b', '-p', 'n:=-4',
        '-p', 'x:=1e-3', '-p', 'on:=true', '-p', 'flag:=[true, false]',
        '-p', 'robot_node:text:=hi there', '--', 'unrelated',
    )
    node = ros.node(
        'robot_node', namespace='robot', automatically_declare_parameters_from_overrides=True
    )
    names = node.list_parameters([], 0).names
    values = {name: node.get_parameter(name).value for name in names}
    values.pop('use_sim_time')
    values.pop('start_type_description_service', None)
    assert list(values.pop('list')) == [1, 2, 3]
    assert list(values.pop('words')) == ['a', 'b c']
    assert list(values.pop('flag')) == [True, False]
    assert values == {
        'everywhere': 1, 'last': 'b', 'wild': True, 'nested.deep.er': 2.5, 'below': 'x', 'n': -4,
        'x': 1e-3, 'on': True,
    }


def test_overrides_replace_declared_defaults(make_ros) -> None:
    ros = make_ros('--ros-args', '-p', 'a:=5', '-p', 'b:=6')
    node = ros.node()
    assert node.declare_parameter('a', 1).value == 5
    assert node.declare_parameter('b', 1, ignore_override=True).value == 1
    assert node.declare_parameter('c', 'text').value == 'text'
    declared = node.declare_parameters('group', [('d', 2), ('e', 'text', None)])
    assert [(one.name, one.value) for one in declared] == [('group.d', 2), ('group.e', 'text')]
    assert node.get_parameter('a').value == 5
    assert [node.get_parameter(name).value for name in ('b', 'c')] == [1, 'text']
    assert node.has_parameter('a') and not node.has_parameter('d')
    assert {'a', 'b', 'c', 'use_sim_time'} <= set(node.get_parameters_by_prefix(''))


def test_parameter_type_follows_from_value(ros) -> None:
    node = ros.node()
    for name, value, kind in (
        ('b', True, Parameter.Type.BOOL),
        ('i', 3, Parameter.Type.INTEGER),
        ('d', 0.5, Parameter.Type.DOUBLE),
        ('s', 'x', Parameter.Type.STRING),
        ('bs', [True, False], Parameter.Type.BOOL_ARRAY),
        ('is', [1, 2], Parameter.Type.INTEGER_ARRAY),
        ('ds', [0.5], Parameter.Type.DOUBLE_ARRAY),
        ('ss', ['a'], Parameter.Type.STRING_ARRAY),
    ):
        parameter = node.declare_parameter(name, value)
        assert (parameter.type_, parameter.value) == (kind, value)
        message = parameter.to_parameter_msg()
        decoded = Parameter.from_parameter_msg(message).value
        assert (list(decoded) if isinstance(value, list) else decoded) == value
    with pytest.raises(TypeError):
        Parameter('x', value={'a': 1})
    with pytest.raises(ValueError, match='do not agree'):
        Parameter('x', Parameter.Type.INTEGER, 'text')


def test_invalid_parameter_access_raises_specific_exceptions(make_ros) -> None:
    node = make_ros('--ros-args', '-p', 'kind:=text').node()
    node.declare_parameter('a', 1)
    with pytest.raises(ParameterAlreadyDeclaredException):
        node.declare_parameter('a', 2)
    with pytest.raises(ParameterNotDeclaredException):
        node.get_parameter('unknown')
    with pytest.raises(ParameterNotDeclaredException):
        node.set_parameters([Parameter('unknown', value=1)])
    with pytest.raises(InvalidParameterTypeException):
        node.declare_parameter('kind', 1)


def descriptor(**fields):
    return ParameterDescriptor(**fields)


def test_descriptor_ranges_types_and_read_only_are_enforced(ros) -> None:
    node = ros.node()
    integers = IntegerRange(from_value=0, to_value=10, step=1)
    floats = FloatingPointRange(from_value=0.0, to_value=1.0, step=0.0)
    node.declare_parameter('i', 4, descriptor(integer_range=[integers], description='few'))
    node.declare_parameter('d', 0.5, descriptor(floating_point_range=[floats]))
    node.declare_parameter('fixed', 1, descriptor(read_only=True))
    node.declare_parameter('typed', 1)

    def set_to(name, value):
        return node.set_parameters([Parameter(name, value=value)])[0]

    assert set_to('i', 10).successful
    assert not set_to('i', 12).successful and node.get_parameter('i').value == 10
    assert set_to('d', 1.0).successful and not set_to('d', 1.5).successful
    assert not set_to('fixed', 2).successful and 'read-only' in set_to('fixed', 2).reason
    assert not set_to('typed', 'text').successful and not set_to('typed', 1.0).successful
    described = node.describe_parameters(['i'])[0]
    assert (described.name, described.description, described.type) == ('i', 'few', 2)
    with pytest.raises(InvalidParameterValueException):
        node.declare_parameter('wrong', 11, descriptor(integer_range=[integers]))
    with pytest.raises(ParameterImmutableException):
        node.undeclare_parameter('fixed')
    node.undeclare_parameter('i')
    assert not node.has_parameter('i')


def test_set_callbacks_can_reject_changes(ros) -> None:
    node = ros.node()
    node.declare_parameter('a', 1)
    node.declare_parameter('b', 1)

    def reject_large(parameters):
        return SetParametersResult(successful=all(p.value < 5 for p in parameters), reason='big')

    node.add_on_set_parameters_callback(reject_large)
    both = [Parameter('a', value=2), Parameter('b', value=9)]
    result = node.set_parameters_atomically(both)
    assert (result.successful, result.reason) == (False, 'big')
    assert node.get_parameter('a').value == 1
    assert [r.successful for r in node.set_parameters(both)] == [True, False]


def test_parameter_services_let_other_nodes_read_and_set(ros) -> None:
    node, other, events = ros.node('node'), ros.node('other'), []
    node.declare_parameter('a', 1)
    node.declare_parameter('deep.b', 'text', descriptor(read_only=True, description='why'))

    def collect(event):
        if event.node == '/node':
            events.append(event)

    other.create_subscription(ParameterEvent, '/parameter_events', collect, 10)
    ros.until(lambda: other.count_publishers('/parameter_events') >= 2)
    ros.spin()

    def call(kind, name, **fields):
        return ros.call(other.create_client(kind, f'/node/{name}'), kind.Request(**fields))

    listed = call(ListParameters, 'list_parameters').result
    assert {'a', 'deep.b', 'use_sim_time'} <= set(listed.names) and 'deep' in listed.prefixes
    assert call(ListParameters, 'list_parameters', prefixes=['deep']).result.names == ['deep.b']
    values = call(GetParameters, 'get_parameters', names=['a', 'deep.b']).values
    assert (values[0].integer_value, values[1].string_value) == (1, 'text')
    assert list(call(GetParameters, 'get_parameters', names=['unknown']).values) == []
    assert list(call(GetParameterTypes, 'get_parameter_types', names=['a', 'deep.b']).types) == [
        2,
        4,
    ]
    described = call(DescribeParameters, 'describe_parameters', names=['deep.b']).descriptors[0]
    assert (described.name, described.description, described.read_only) == ('deep.b', 'why', True)
    new = ParameterMessage(name='a', value=ParameterValue(type=2, integer_value=5))
    read_only = ParameterMessage(name='deep.b', value=ParameterValue(type=4, string_value='x'))
    undeclared = ParameterMessage(name='unknown', value=ParameterValue(type=4, string_value='x'))
    parameters = [new, read_only, undeclared]
    results = call(SetParameters, 'set_parameters', parameters=parameters).results
    assert [result.successful for result in results] == [True, False, False]
    assert node.get_parameter('a').value == 5
    changed = ros.until(lambda: [e for e in events if e.changed_parameters])[0]
    assert changed.changed_parameters[0].value.integer_value == 5
    assert changed.stamp.sec > 0
    result = call(
        SetParametersAtomically, 'set_parameters_atomically', parameters=[new, read_only]
    ).result
    assert not result.successful and result.reason


def test_node_without_parameter_services_has_none(ros) -> None:
    node = ros.node('quiet', start_parameter_services=False, enable_rosout=False)
    assert not [service for service in node.services if 'parameter' in service.srv_name]


def test_failed_node_creation_leaves_no_node_in_graph(make_ros) -> None:
    ros = make_ros('--ros-args', '-p', 'use_sim_time:=perhaps')
    with pytest.raises(Exception, match='use_sim_time'):
        ros.node('wrong')
    watcher = ros.node('watcher', use_global_arguments=False)
    ros.until(lambda: 'watcher' in watcher.get_node_names())
    assert 'wrong' not in watcher.get_node_names()
