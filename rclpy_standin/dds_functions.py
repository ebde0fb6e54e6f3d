# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""C functions of Cyclone DDS, called through ctypes.

ctypes releases the interpreter lock during a call, so that a blocked writer or wait set does not
stop the other threads. cyclonedds' own ``DataWriter.write`` holds it. The functions are not part
of cyclonedds' public API, so its minor version is pinned.
"""

from __future__ import annotations

import ctypes as ct
from collections.abc import Callable
from typing import Any

from cyclonedds.core import DDSException
from cyclonedds.internal import DDS, dds_c_t

from rclpy_standin.exceptions import RCLError

STATUSES = {
    'sample_lost': (1 << 5, dds_c_t.sample_lost_status),
    'requested_incompatible_qos': (1 << 4, dds_c_t.requested_incompatible_qos_status),
    'offered_incompatible_qos': (1 << 3, dds_c_t.offered_incompatible_qos_status),
}
"""Status mask bit and C structure of each communication status of an endpoint."""


class Sample(ct.Structure):
    """A serialised sample, as cyclonedds' topics expect it."""

    _fields_ = (('data', ct.c_void_p), ('size', ct.c_size_t))


class Bytes(ct.Structure):
    """A memory region (iovec)."""

    _fields_ = (('data', ct.c_void_p), ('size', ct.c_size_t))


def _function(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    """Return a C function with a prototype of its own, not shared with cyclonedds."""
    function: Callable[..., Any] = ct.CFUNCTYPE(result, *arguments)((name, DDS._dll_handle))
    return function


def _checked(name: str, *arguments: Any) -> Callable[..., int]:
    """Return a C function that raises RCLError if it returns an error code."""
    function = _function(name, ct.c_int32, *arguments)

    def call(*values: Any) -> int:
        result = function(*values)
        if result < 0:
            raise RCLError(f'{name}: {DDSException(result)}')
        return int(result)

    return call


def completed(name: str, result: int) -> bool:
    """Return False if a C function timed out; raises RCLError for any other error code."""
    if result < 0 and result != DDSException.DDS_RETCODE_TIMEOUT:
        raise RCLError(f'{name}: {DDSException(result)}')
    return result >= 0


_entity = ct.c_int32
delete = _checked('dds_delete', _entity)
write = _function('dds_write', ct.c_int32, _entity, ct.c_void_p)
wait_for_acks = _function('dds_wait_for_acks', ct.c_int32, _entity, ct.c_int64)
take = _checked('dds_takecdr', _entity, ct.c_void_p, ct.c_uint32, ct.c_void_p, ct.c_uint32)
# The serialised bytes of a taken sample can be read without a copy until they are released.
sample_size = _function('ddsi_serdata_size', ct.c_uint32, ct.c_void_p)
sample_bytes = _function(
    'ddsi_serdata_to_ser_ref', ct.c_void_p, ct.c_void_p, ct.c_size_t, ct.c_size_t, ct.c_void_p
)
release_bytes = _function('ddsi_serdata_to_ser_unref', None, ct.c_void_p, ct.c_void_p)
release_sample = _function('ddsi_serdata_unref', None, ct.c_void_p)
create_reader = _checked('dds_create_reader', _entity, _entity, ct.c_void_p, ct.c_void_p)
create_writer = _checked('dds_create_writer', _entity, _entity, ct.c_void_p, ct.c_void_p)
create_condition = _checked('dds_create_readcondition', _entity, ct.c_uint32)
create_guard = _checked('dds_create_guardcondition', _entity)
set_guard = _checked('dds_set_guardcondition', _entity, ct.c_bool)
take_guard = _checked('dds_take_guardcondition', _entity, ct.c_void_p)
create_waitset = _checked('dds_create_waitset', _entity)
attach = _checked('dds_waitset_attach', _entity, _entity, ct.c_ssize_t)
detach = _checked('dds_waitset_detach', _entity, _entity)
wait = _checked('dds_waitset_wait', _entity, ct.c_void_p, ct.c_size_t, ct.c_int64)
set_mask = _checked('dds_set_status_mask', _entity, ct.c_uint32)
get_handle = _checked('dds_get_instance_handle', _entity, ct.c_void_p)
get_guid = _checked('dds_get_guid', _entity, ct.c_void_p)
matched_readers = _checked('dds_get_matched_subscriptions', _entity, ct.c_void_p, ct.c_size_t)
matched_writers = _checked('dds_get_matched_publications', _entity, ct.c_void_p, ct.c_size_t)
get_status = {name: _checked(f'dds_get_{name}_status', _entity, ct.c_void_p) for name in STATUSES}
