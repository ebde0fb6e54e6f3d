# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Services: answers reach whoever asked, in this process and in others."""

import threading
import time

import pytest


def doubling(node, m, name='double'):
    def answer(request, response):
        response.success = request.data
        response.message = str(request.data)
        return response

    return node.create_service(m.SetBool, name, answer)


def test_a_request_is_answered(ros, m) -> None:
    node = ros.node()
    doubling(node, m)
    client = node.create_client(m.SetBool, 'double')
    assert ros.call(client, m.SetBool.Request(data=True)).message == 'True'
    answer = ros.call(client, m.SetBool.Request(data=False))
    assert (answer.success, answer.message) == (False, 'False')
    assert client.srv_name == 'double'


def test_no_server_no_service(ros, m) -> None:
    client = ros.node().create_client(m.Trigger, 'nowhere')
    assert not client.service_is_ready()
    start_s = time.monotonic()
    assert not client.wait_for_service(timeout_sec=0.3)
    assert time.monotonic() - start_s < 5.0


def test_a_message_with_messages_in_it(ros, m) -> None:
    node = ros.node()

    def plan(request, response):
        response.plan.header.frame_id = 'map'
        response.plan.poses = [request.start, request.goal, request.goal]
        return response

    node.create_service(m.GetPlan, 'plan', plan)
    client = node.create_client(m.GetPlan, 'plan')
    request = m.GetPlan.Request(tolerance=0.5)
    request.goal.pose.position.x = 4.0
    answer = ros.call(client, request)
    assert [pose.pose.position.x for pose in answer.plan.poses] == [0.0, 4.0, 4.0]
    assert answer.plan.header.frame_id == 'map'


def test_an_empty_request_and_answer(ros, m) -> None:
    node = ros.node()
    node.create_service(m.Empty, 'nothing', lambda request, response: response)
    answer = ros.call(node.create_client(m.Empty, 'nothing'), m.Empty.Request())
    assert answer == m.Empty.Response()


def test_each_of_two_clients_gets_its_own_answers(ros, m) -> None:
    server = ros.node('server')
    doubling(server, m)
    clients = [ros.node(f'client_{i}').create_client(m.SetBool, 'double') for i in range(2)]
    for client in clients:
        assert client.wait_for_service(timeout_sec=10.0)
    futures = [
        (bool((i + k) % 2), client.call_async(m.SetBool.Request(data=bool((i + k) % 2))))
        for i in range(4)  # the queue holds ten
        for k, client in enumerate(clients)
    ]
    ros.until(lambda: all(future.done() for _, future in futures))
    assert all(future.result().success == wanted for wanted, future in futures)


CALL = """
import sys
import rclpy
from std_srvs.srv import SetBool
rclpy.init(args=[])
node = rclpy.create_node('caller')
client = node.create_client(SetBool, 'double')
assert client.wait_for_service(timeout_sec=20.0)
for data in (True, False) * 10:
    for _ in range(5):  # a server under load may answer the first one before it knows who asks
        future = client.call_async(SetBool.Request(data=data))
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        if future.done():
            break
    assert future.result().success == data
print('done')
node.destroy_node()
rclpy.shutdown()
"""


def test_two_other_processes_get_their_own_answers(ros, m, child) -> None:
    doubling(ros.node(), m)
    callers = [child(CALL) for _ in range(2)]
    ros.until(lambda: all(caller.poll() is not None for caller in callers), 40.0)
    for caller in callers:
        out, err = caller.communicate()
        assert (caller.returncode, out.strip()) == (0, 'done'), err


SERVE = """
import rclpy
from std_srvs.srv import Trigger
rclpy.init(args=[])
node = rclpy.create_node('server')
node.create_service(Trigger, 'there', lambda q, r: Trigger.Response(success=True, message='ü'))
rclpy.spin(node)
"""


def test_a_server_in_another_process(ros, m, child) -> None:
    client = ros.node().create_client(m.Trigger, 'there')
    server = child(SERVE)
    assert ros.call(client, m.Trigger.Request()) == m.Trigger.Response(success=True, message='ü')
    server.kill()
    server.wait()


def test_a_call_may_block_a_thread_while_another_spins(ros, m) -> None:
    node = ros.node()
    doubling(node, m)
    client = node.create_client(m.SetBool, 'double')
    assert client.wait_for_service(timeout_sec=10.0)
    answers = []

    def call() -> None:
        answers.append(client.call(m.SetBool.Request(data=True)))

    thread = threading.Thread(target=call)
    thread.start()
    ros.until(lambda: answers)
    thread.join()
    assert answers[0].success


def test_what_is_no_request_is_refused(ros, m) -> None:
    client = ros.node().create_client(m.SetBool, 'double')
    with pytest.raises(TypeError):
        client.call_async(m.Trigger.Request())


def test_a_future_calls_back_and_can_be_asked(ros, m) -> None:
    node, told = ros.node(), []
    doubling(node, m)
    client = node.create_client(m.SetBool, 'double')
    assert client.wait_for_service(timeout_sec=10.0)
    future = client.call_async(m.SetBool.Request(data=True))
    future.add_done_callback(lambda done: told.append(done.result().success))
    assert not future.done() and future.result() is None
    ros.until(lambda: told)
    assert told == [True] and future.done() and not future.cancelled()
