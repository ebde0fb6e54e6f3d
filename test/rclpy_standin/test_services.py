# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services and clients in one process and in several processes."""

import pytest
from nav_msgs.srv import GetPlan
from std_srvs.srv import SetBool, Trigger


def create_echo_service(node, name='echo'):
    def respond(request, response):
        response.success = request.data
        response.message = str(request.data)
        return response

    return node.create_service(SetBool, name, respond)


def test_client_receives_response_to_each_request(ros) -> None:
    node = ros.node()
    create_echo_service(node)
    client = node.create_client(SetBool, 'echo')
    assert ros.call(client, SetBool.Request(data=True)).message == 'True'
    response = ros.call(client, SetBool.Request(data=False))
    assert (response.success, response.message) == (False, 'False')
    assert client.srv_name == 'echo'


def test_service_with_nested_messages_returns_response(ros) -> None:
    node = ros.node()

    def plan(request, response):
        response.plan.header.frame_id = 'map'
        response.plan.poses = [request.start, request.goal, request.goal]
        return response

    node.create_service(GetPlan, 'plan', plan)
    client = node.create_client(GetPlan, 'plan')
    request = GetPlan.Request(tolerance=0.5)
    request.goal.pose.position.x = 4.0
    response = ros.call(client, request)
    assert [pose.pose.position.x for pose in response.plan.poses] == [0.0, 4.0, 4.0]
    assert response.plan.header.frame_id == 'map'


def test_two_clients_receive_only_their_own_responses(ros) -> None:
    server = ros.node('server')
    create_echo_service(server)
    clients = [ros.node(f'client_{i}').create_client(SetBool, 'echo') for i in range(2)]
    for client in clients:
        assert client.wait_for_service(timeout_sec=10.0)
    futures = [
        (bool((i + k) % 2), client.call_async(SetBool.Request(data=bool((i + k) % 2))))
        for i in range(4)  # within the queue depth of 10
        for k, client in enumerate(clients)
    ]
    ros.until(lambda: all(future.done() for _, future in futures))
    assert all(future.result().success == expected for expected, future in futures)


CALL = """
import sys
import rclpy
from std_srvs.srv import SetBool
rclpy.init(args=[])
node = rclpy.create_node('caller')
client = node.create_client(SetBool, 'echo')
assert client.wait_for_service(timeout_sec=20.0)
for data in (True, False) * 10:
    for _ in range(5):  # the response is dropped if the server has not discovered the client
        future = client.call_async(SetBool.Request(data=data))
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        if future.done():
            break
    assert future.result().success == data
print('done')
node.destroy_node()
rclpy.shutdown()
"""


def test_clients_in_two_processes_receive_their_own_responses(ros, start_process) -> None:
    create_echo_service(ros.node())
    client = ros.node('here').create_client(SetBool, 'echo')
    caller, number = start_process(CALL), 0
    while caller.poll() is None:
        number += 1
        assert ros.call(client, SetBool.Request(data=number % 2 == 0)).success == (number % 2 == 0)
    out, err = caller.communicate()
    assert (caller.returncode, out.strip()) == (0, 'done'), err


def test_request_of_wrong_type_is_rejected(ros) -> None:
    client = ros.node().create_client(SetBool, 'echo')
    with pytest.raises(TypeError):
        client.call_async(Trigger.Request())


def test_future_runs_callback_when_response_arrives(ros) -> None:
    node, results = ros.node(), []
    create_echo_service(node)
    client = node.create_client(SetBool, 'echo')
    assert client.wait_for_service(timeout_sec=10.0)
    future = client.call_async(SetBool.Request(data=True))
    future.add_done_callback(lambda done: results.append(done.result().success))
    assert not future.done() and future.result() is None
    ros.until(lambda: results)
    assert results == [True] and future.done()
